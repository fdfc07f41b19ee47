/* client/load.h: a scene file, or a model, and the options of a command line into what the farm
 * takes.
 *
 * Blocking; may run on a thread of its own, since it owns all that it makes.
 */
#ifndef CLIENT_LOAD_H
#define CLIENT_LOAD_H

#include "client/cli_option.h"
#include "common/package.h"
#include "common/scene.h"

struct load {
    struct scene scene;
    struct job_spec spec;
    struct job_spec scene_spec; /* before the options */
    struct package package;
    char *spec_json;           /* owned */
    char *plan_json;           /* owned; NULL: no --plan */
    struct diag_list problems; /* errors and warnings, also after success */
    uint64_t light_count; /* triangles and spheres that emit, lights without a surface, the sky */
    bool has_scene, has_package;
    double read_s, pack_s; /* what reading took, and making the package */
    enum err trouble;      /* of the machine, with status 5 */
    int status;            /* exit status: 0, 2 (options do not fit), 3 (bad scene), 5 */
};

/* Reads, applies the options, checks, and makes the package; the scene itself is dropped then
 * unless `keep_scene`. The result is in load->status and load->problems. */
void load_scene(struct load *load, const struct cli_line *line, bool keep_scene);

/* The same scene under another command line: spec and spec_json are made again. The exit status,
 * also in load->status; problems are added. */
int load_respec(struct load *load, const struct cli_line *line);

/* Frees the package once it has been sent: a render goes on for hours beside it. */
void load_drop_package(struct load *load);
void load_release(struct load *load);

/* Prints what load found, with `tail` (may be NULL) after the count; its exit status. */
int load_explain(const struct load *load, const char *tail);

#endif
