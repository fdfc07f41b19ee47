/* master/rate.h: how fast a count rises while work is under way, over the last seconds.
 *
 * Pure; the caller owns the struct and tells the time. A rate begins when the work does, so that
 * idle time before it does not count, and is measured up to the last addition, since results come
 * in lumps: only when nothing has come for RATE_MARK_MS does the time since then count too. */
#ifndef MASTER_RATE_H
#define MASTER_RATE_H

#include <stdbool.h>
#include <stdint.h>

enum { RATE_MARK_MS = 2000 }; /* the rate is over one to two of these, less at the beginning */

struct rate {
    bool running; /* zeroed: not */
    struct rate_mark {
        int64_t at_ms;
        uint64_t count;
    } from, next, last; /* what is measured from; from what it will be next; the last addition */
};

/* Work begins, or goes on (then nothing changes). `now_ms`: any monotonic clock. */
void rate_begin(struct rate *r, int64_t now_ms);

/* Work pauses or ends: the rate is 0 until it begins again. */
void rate_end(struct rate *r);

/* `count` more; passed over while no work is under way. */
void rate_add(struct rate *r, int64_t now_ms, uint64_t count);

/* A second; 0 until something was added. */
double rate_per_s(const struct rate *r, int64_t now_ms);

#endif
