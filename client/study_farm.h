/* client/study_farm.h: renders for a study, one after the other, on one farm.
 *
 * The farm is our own children (private_farm.h) unless --master names one on the command line;
 * TILERY_MASTER is ignored, as `tilery render` does, because core-seconds on a farm that others
 * use mean little. On our own farm the cost of a render is the CPU time of its workers, read from
 * the kernel, so that a busy machine spoils it less; on a named one it is the report's
 * core_seconds. Main thread only.
 */
#ifndef CLIENT_STUDY_FARM_H
#define CLIENT_STUDY_FARM_H

#include "client/farm_api.h"
#include "client/load.h"
#include "client/private_farm.h"
#include "client/progress.h"
#include "client/study.h"

/* Not an exit status: the time was over first. */
enum { STUDY_OUT_OF_TIME = -1 };

struct study_farm {
    struct cli *cli;
    struct load load;
    struct private_farm own;
    bool own_runs; /* a private farm has been started */
    struct farm api;
    uint32_t workers, threads;  /* threads of all workers; 0: a named farm, not known */
    struct progress *progress;  /* of the study; borrowed */
    double start_s, deadline_s; /* follow_now_s(); renders are stopped then */
    char last_job[FARM_ID_BYTES];
};

/* Reads the scene of the command line and starts (or finds) the farm. The exit status; what is
 * wrong has been said. study_farm_close also after a failure. */
TL_NODISCARD int study_farm_open(struct study_farm *f, struct cli *cli, struct progress *progress);
void study_farm_close(struct study_farm *f);

/* One render. */
struct study_render {
    uint32_t width, height;
    float *rgb; /* you own it */
    double core_s, wall_s, spp_mean;
    uint64_t rays, file_bytes;
    char sha256[STUDY_HASH_BYTES];
};

/* Renders the scene with the command line's options and these on top; --size and --seed come from
 * the caller among them. Exit status or STUDY_OUT_OF_TIME; `out` only when EXIT_DONE. */
TL_NODISCARD int study_farm_render(struct study_farm *f, const struct study_setting *settings,
                                   uint32_t setting_count, struct study_render *out);

/* Renders the scene by another spec and gives the report (farm_json_release). Exit status. */
TL_NODISCARD int study_farm_report(struct study_farm *f, const struct job_spec *spec,
                                   struct farm_json *report);

/* Processor time of all threads of our workers so far; NaN if it cannot be told (a named farm, a
 * worker that is being started again). */
double study_farm_cpu_s(const struct study_farm *f);

/* Bytes that the last render's picture takes as a file of half floats; 0 if unknown. */
uint64_t study_farm_half_bytes(struct study_farm *f);

#endif
