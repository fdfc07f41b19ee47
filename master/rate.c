/* master/rate.c: the rate's two marks, moved on by additions. */
#include "master/rate.h"

void rate_begin(struct rate *r, int64_t now_ms)
{
    if (r->running)
        return;
    struct rate_mark start = {.at_ms = now_ms};
    *r = (struct rate){.running = true, .from = start, .next = start, .last = start};
}

void rate_end(struct rate *r)
{
    *r = (struct rate){0};
}

void rate_add(struct rate *r, int64_t now_ms, uint64_t count)
{
    if (!r->running)
        return;
    r->last.at_ms = now_ms;
    r->last.count += count;
    if (now_ms - r->next.at_ms >= RATE_MARK_MS) {
        r->from = r->next;
        r->next = r->last;
    }
}

double rate_per_s(const struct rate *r, int64_t now_ms)
{
    int64_t until = now_ms - r->last.at_ms > RATE_MARK_MS ? now_ms : r->last.at_ms;
    int64_t span_ms = until - r->from.at_ms;
    if (!r->running || span_ms <= 0)
        return 0;
    return 1000.0 * (double)(r->last.count - r->from.count) / (double)span_ms;
}
