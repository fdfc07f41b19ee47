/* master/job_record.h: what is kept about a job, in memory and on disk alike.
 *
 * Plain data. The loop thread owns the live ones (jobs.h); the store gets copies.
 */
#ifndef MASTER_JOB_RECORD_H
#define MASTER_JOB_RECORD_H

#include "common/buf.h"
#include "common/digest.h"
#include "common/job_spec.h"

/* The names are those of the API. Stored by number: append only. */
#define JOB_STATES(X)                                                                              \
    X(QUEUED, "queued")                                                                            \
    X(RENDERING, "rendering")                                                                      \
    X(PAUSED, "paused")                                                                            \
    X(DONE, "done")                                                                                \
    X(FAILED, "failed")                                                                            \
    X(CANCELLED, "cancelled")

enum job_state {
#define JOB_STATE_ENUM(suffix, name) JOB_STATE_##suffix,
    JOB_STATES(JOB_STATE_ENUM)
#undef JOB_STATE_ENUM
        JOB_STATE_COUNT
};

extern const char *const job_state_names[JOB_STATE_COUNT];

/* True when nothing more will be rendered unless somebody asks again. */
bool job_state_ended(enum job_state s);

/* Sums over the results that are in the film: what a replay of the journal gives again. */
struct job_totals {
    uint64_t units, samples, rays, render_us;
    uint64_t nonfinite, nonfinite_pixel, nonfinite_sample; /* pixel UINT64_MAX: none */
    uint64_t result_bytes;
};

#define JOB_STATS_U64(X)                                                                           \
    X(retried)                                                                                     \
    X(speculated)                                                                                  \
    X(rejected)                                                                                    \
    X(verified)                                                                                    \
    X(workers)                                                                                     \
    X(scene_sent_bytes)                                                                            \
    X(spp_min)                                                                                     \
    X(spp_max)                                                                                     \
    X(error_known)
#define JOB_STATS_F64(X)                                                                           \
    X(load_s)                                                                                      \
    X(build_s)                                                                                     \
    X(render_s)                                                                                    \
    X(gather_s)                                                                                    \
    X(total_s)                                                                                     \
    X(spp_mean)                                                                                    \
    X(relmse)                                                                                      \
    X(relmse_low)                                                                                  \
    X(relmse_high)                                                                                 \
    X(mean_low)                                                                                    \
    X(mean_high)

/* Added later: a record of before has none of them. */
#define JOB_STATS_ADDED(X)                                                                         \
    X(effective)                                                                                   \
    X(worst_relmse)                                                                                \
    X(worst_x)                                                                                     \
    X(worst_y)                                                                                     \
    X(stopped_by)                                                                                  \
    X(first_result_s) /* from the start; 0: none yet, or not known */

/* Everything else that the report tells. */
struct job_stats {
#define JOB_STATS_FIELD(name) uint64_t name;
    JOB_STATS_U64(JOB_STATS_FIELD)
#undef JOB_STATS_FIELD
#define JOB_STATS_FIELD(name) double name;
    JOB_STATS_F64(JOB_STATS_FIELD)
    JOB_STATS_ADDED(JOB_STATS_FIELD)
#undef JOB_STATS_FIELD
};

enum { JOB_NAME_BYTES = JOB_NAME_BYTES_MAX + 1, JOB_NOTE_BYTES = 257 };

struct job_record {
    uint64_t id;
    enum job_state state;
    int32_t priority; /* higher first */
    char name[JOB_NAME_BYTES];
    char note[JOB_NOTE_BYTES];                   /* why it is not moving; empty: nothing to say */
    uint64_t shot;                               /* id of its first frame's job; 0: no frame */
    uint64_t frame;                              /* its number in the shot */
    digest package;                              /* root chunk */
    char *spec_json;                             /* owned by whoever owns the record */
    int64_t created_us, started_us, finished_us; /* since 1970; 0: not yet */
    bool has_image;
    digest image; /* of the picture, once done */
    struct job_totals totals;
    struct job_stats stats;
};

/* Totals and stats as bytes, for the store and the checkpoint. */
void job_numbers_put(struct buf *b, const struct job_totals *totals, const struct job_stats *stats);
/* Both untouched unless the bytes are whole. ERR_CORRUPT. */
TL_NODISCARD enum err job_numbers_get(const void *data, size_t bytes, struct job_totals *totals,
                                      struct job_stats *stats);

#endif
