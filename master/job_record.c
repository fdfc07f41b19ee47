#include "master/job_record.h"

const char *const job_state_names[JOB_STATE_COUNT] = {
#define JOB_STATE_NAME(suffix, name) [JOB_STATE_##suffix] = name,
    JOB_STATES(JOB_STATE_NAME)
#undef JOB_STATE_NAME
};

bool job_state_ended(enum job_state s)
{
    return s == JOB_STATE_DONE || s == JOB_STATE_FAILED || s == JOB_STATE_CANCELLED;
}

/* Raise when a field is added in the middle; fields added at the end may be absent. */
enum { NUMBERS_VERSION = 1 };

void job_numbers_put(struct buf *b, const struct job_totals *totals, const struct job_stats *stats)
{
    buf_put_u32(b, NUMBERS_VERSION);
    buf_put_u64(b, totals->units);
    buf_put_u64(b, totals->samples);
    buf_put_u64(b, totals->rays);
    buf_put_u64(b, totals->render_us);
    buf_put_u64(b, totals->nonfinite);
    buf_put_u64(b, totals->nonfinite_pixel);
    buf_put_u64(b, totals->nonfinite_sample);
    buf_put_u64(b, totals->result_bytes);
#define PUT(name) buf_put_u64(b, stats->name);
    JOB_STATS_U64(PUT)
#undef PUT
#define PUT(name) buf_put_f64(b, stats->name);
    JOB_STATS_F64(PUT)
    JOB_STATS_ADDED(PUT)
#undef PUT
}

enum err job_numbers_get(const void *data, size_t bytes, struct job_totals *totals,
                         struct job_stats *stats)
{
    struct buf_reader r = buf_reader_of(data, bytes);
    if (buf_get_u32(&r) != NUMBERS_VERSION)
        return ERR_CORRUPT;
    struct job_totals t = {0};
    struct job_stats s;
    t.units = buf_get_u64(&r);
    t.samples = buf_get_u64(&r);
    t.rays = buf_get_u64(&r);
    t.render_us = buf_get_u64(&r);
    t.nonfinite = buf_get_u64(&r);
    t.nonfinite_pixel = buf_get_u64(&r);
    t.nonfinite_sample = buf_get_u64(&r);
    t.result_bytes = buf_get_u64(&r);
#define GET(name) s.name = buf_get_u64(&r);
    JOB_STATS_U64(GET)
#undef GET
#define GET(name) s.name = buf_get_f64(&r);
    JOB_STATS_F64(GET)
#undef GET
    if (r.failed)
        return ERR_CORRUPT;
#define GET(name) s.name = buf_left(&r) > 0 ? buf_get_f64(&r) : 0;
    JOB_STATS_ADDED(GET)
#undef GET
    if (r.failed)
        return ERR_CORRUPT;
    *totals = t;
    *stats = s;
    return ERR_OK;
}
