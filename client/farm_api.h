/* client/farm_api.h: the farm's HTTP API as the commands use it.
 *
 * A call either succeeds (0) or has said on standard error what is wrong and gives the exit
 * status: 4 for a farm that cannot be reached, refuses, or knows no such thing, 3 for a scene it
 * does not take, 1 for what is not possible in a state. One thread.
 */
#ifndef CLIENT_FARM_API_H
#define CLIENT_FARM_API_H

#include "client/cli.h"
#include "client/http_client.h"
#include "common/json_get.h"
#include "common/package.h"

enum { FARM_ID_BYTES = 64, FARM_PATH_BYTES = 256 };

struct farm {
    struct http_client *http;
    const char *origin;      /* "TILERY_MASTER", "--master", ...; for messages */
    struct http_reply reply; /* of the last call */
    bool is_private;         /* our own children: no advice about TILERY_MASTER */
};

/* From the settings of the command line. */
TL_NODISCARD int farm_open(struct farm *f, const struct cli *cli);
/* A farm of our own children. */
TL_NODISCARD int farm_open_private(struct farm *f, const char *url, const char *token,
                                   const volatile sig_atomic_t *interrupted);
void farm_release(struct farm *f);

/* Parsed reply of a call; `json.root` lives until farm_json_release. */
struct farm_json {
    struct json_get json;
    struct diag_list problems;
    bool open;
};
void farm_json_release(struct farm_json *j);

/* One call; `body` may be NULL, `out` may be NULL (reply not wanted). */
TL_NODISCARD int farm_call(struct farm *f, const char *method, const char *path,
                           const struct buf *body, struct farm_json *out);

/* The same, silent: ERR_OK and the HTTP status in f->reply.status, or the connection's error. */
TL_NODISCARD enum err farm_try(struct farm *f, const char *method, const char *path,
                               struct farm_json *out);

/* Says why the last call failed: for callers of farm_try and http_call. The exit status. */
int farm_explain(struct farm *f, enum err e);

/* "/api/v1/jobs/ID" + tail. A text that no id can be is answered as unknown: exit 4. */
TL_NODISCARD int farm_job_path(const char *id, const char *tail, char out[FARM_PATH_BYTES]);

/* GET of a whole picture ("picture.exr", "picture.png", FARM_HALF) to its place. Says how many
 * values were too large for a half. `job` has been accepted by
 * the farm before, or comes from the user: an unknown one gives 4, an unfinished one 1. `rescue`
 * is what to say when the disk is full; may be NULL. */
#define FARM_HALF "picture.exr?half=1"
TL_NODISCARD int farm_fetch_picture(struct farm *f, const char *job, const char *what,
                                    const char *path, const char *rescue);

/* The EXR that a command line asks for: "picture.exr", or FARM_HALF under --half. */
const char *farm_exr_of(const struct cli_line *line);

/* One picture of a shot. */
struct farm_frame {
    uint32_t number;
    const char *shot; /* id of the first frame's job; NULL: this is the first */
};

/* Sends what the master lacks of the package, then the job; fills id. */
struct farm_job_request {
    const char *name;
    const struct package *package;
    const char *spec_json;
    const char *plan_json; /* NULL: none */
    int64_t priority;
    const struct farm_frame *frame; /* NULL: a picture on its own */
};
TL_NODISCARD int farm_submit(struct farm *f, const struct farm_job_request *request,
                             char id[FARM_ID_BYTES]);

/* Values of a reply: a missing key, null or another type gives the fallback. */
double reply_number(const struct json *object, const char *key, double fallback);
const char *reply_text(const struct json *object, const char *key, const char *fallback);

/* The value as one line of JSON text. */
void reply_put(const struct json *v, struct buf *out);

/* Two numbers, [low, high]; false if there are none. */
bool reply_range(const struct json *object, const char *key, double out[2]);

#endif
