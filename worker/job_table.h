/* worker/job_table.h: the jobs a worker has been told of, and their scenes.
 *
 * A job's scene is loaded when the job is announced, and again when a lease comes for
 * a job whose scene was dropped. A job on a package that another job has built shares its tables
 * and tree, and is ready at once. Scenes stay, beyond the end of their job and beyond a
 * connection, until memory is wanted: over scene_bytes_max, those without
 * leases go, ended jobs first, then the one used longest ago.
 *
 *   IDLE --> LOADING --> READY --> IDLE (dropped)
 *              |           |
 *              |        FAILING  (a late picture cannot be had; until its last unit has ended)
 *              |           |
 *              +-------> FAILED  (told the master; a new JobInfo tries again)
 *
 * A job that was FAILING is loaded whole from then on: it is not READY before all is there, so that
 * the master sees whether it ever can be.
 *
 * Thread: the loop's; render threads read grid, spec and scene of a job that is in use.
 */
#ifndef WORKER_JOB_TABLE_H
#define WORKER_JOB_TABLE_H

#include "common/grid.h"
#include "worker/outlet.h"
#include "worker/scene_fetcher.h"

enum { JOBS_MAX = 1024 };

enum worker_job_state {
    WORKER_JOB_IDLE,
    WORKER_JOB_LOADING,
    WORKER_JOB_READY,
    WORKER_JOB_FAILING,
    WORKER_JOB_FAILED
};

enum { WORKER_JOB_WHY_BYTES = 200 };

struct worker_job {
    uint64_t id;
    digest package;
    digest spec_digest; /* of the spec's text */
    struct job_spec spec;
    struct grid grid;
    struct job_blocks blocks;
    enum worker_job_state state;
    struct loaded_scene loaded; /* READY, FAILING */
    bool eager;                 /* none of its pictures is late */
    enum err error;             /* FAILING: what is to be told, and why */
    char why[WORKER_JOB_WHY_BYTES];
    uint32_t users; /* leases that refer to it: it stays while there are any */
    bool ended;     /* the master said so */
    bool gone;      /* of another farm or replaced: no longer found, freed with its last user */
    uint64_t used;  /* grows with each use */
    TAILQ_ENTRY(worker_job) in_jobs;
};

struct job_table; /* opaque */

struct job_table_handlers {
    void (*ready)(void *ctx, struct worker_job *job);  /* READY now, or a late picture came */
    void (*failed)(void *ctx, struct worker_job *job); /* its leases are the master's again */
};

TL_NODISCARD enum err job_table_new(struct pool *pool, struct chunk_cache *cache,
                                    uint64_t scene_bytes_max, bool eager,
                                    const struct outlet *outlet,
                                    const struct job_table_handlers *handlers, void *ctx,
                                    struct job_table **out);
void job_table_free(struct job_table *t); /* after pool_close */

/* NULL: never told of it, or ended. */
struct worker_job *job_table_find(struct job_table *t, uint64_t id);

/* A JobInfo: loads the scene, or says JobReady at once when it is there. ERR_LIMIT: too many jobs;
 * ERR_NOMEM: the connection cannot go on. A spec that does not hold is told by JobFailed. */
TL_NODISCARD enum err job_table_announce(struct job_table *t, const tilery_JobInfo *info);

/* A JobEnd. */
void job_table_end(struct job_table *t, struct worker_job *job);

/* Leases hold their job while they live; taking one loads the scene if it was dropped. */
void job_table_hold(struct job_table *t, struct worker_job *job);
void job_table_release(struct job_table *t, struct worker_job *job);

/* Asks for late pictures, or parts of such, of a READY job, by their numbers (scene_late.h);
 * `ready` is called for each that comes. ERR_NOMEM. */
TL_NODISCARD enum err job_table_bring(struct job_table *t, struct worker_job *job,
                                      const uint32_t *numbers, size_t count);

/* The same for all that are not there yet. */
TL_NODISCARD enum err job_table_bring_all(struct job_table *t, struct worker_job *job);

/* Another farm: all jobs are gone. */
void job_table_forget(struct job_table *t);

/* What is being loaded is not wanted any more (drain). */
void job_table_stop_loading(struct job_table *t);

struct scene_fetcher *job_table_loader(struct job_table *t);

#endif
