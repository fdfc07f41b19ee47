/* client/progress.h: how a wait looks: a bar on a terminal, plain lines when piped, or JSON lines.
 *
 *    57% [=========>       ] 38-52 s left  relMSE 0.0210  119 Mray/s  8 workers
 *
 * The percentage never goes back. Events scroll above the bar, once each; after three of a
 * kind they are only counted. The bar is painted at most 5 times a second, by one write, as
 * wide as the window is at that moment. One thread; the caller gives the time.
 */
#ifndef CLIENT_PROGRESS_H
#define CLIENT_PROGRESS_H

#include <stdio.h>

#include "common/buf.h"

enum progress_mode { PROGRESS_NONE, PROGRESS_BAR, PROGRESS_LINES, PROGRESS_JSON };

/* What is known of the job now. */
struct progress_now {
    char job[64], state[24];
    double done; /* 0..1 */
    bool has_left;
    double left_s[2];
    double relmse; /* NaN: not measured */
    double rays_s; /* 0: not measured */
    uint32_t workers;
    double waiting_s;   /* so long nobody has worked at it; 0: someone does */
    char note[120];     /* why, as the master says it; "": no worker is there */
    const char *advice; /* what would end the wait for a worker; may be NULL */
};

enum { PROGRESS_KINDS_MAX = 16, PROGRESS_KIND_BYTES = 80, PROGRESS_COLUMNS_MAX = 400 };

struct progress {
    enum progress_mode mode;
    int fd;       /* where bar and lines go */
    bool painted; /* a bar stands on the line now */
    double start_s, last_paint_s, last_line_s;
    double done_max;
    int next_tenth; /* lines: 1..10 */
    bool stalled;   /* lines: it stands still, and that was said */
    bool grew;      /* said that more is to be done than was thought */
    struct {
        char kind[PROGRESS_KIND_BYTES];
        uint32_t count;
    } kinds[PROGRESS_KINDS_MAX];
    size_t kind_count;
    uint64_t line_count; /* lines written so far: what stands above the bar has moved up so far */
    struct progress_now now;
};

void progress_init(struct progress *p, enum progress_mode mode, int fd, double now_s);

/* News of the job; paints if it is time. */
void progress_update(struct progress *p, const struct progress_now *now, double now_s);

/* Paints again with what is known: the window may have changed, time has passed. */
void progress_tick(struct progress *p, double now_s);

/* One event line, without newline. In JSON mode it becomes {"event":"log",...}. */
void progress_event(struct progress *p, const char *line, double now_s);

/* A line of JSON from the caller, in JSON mode only: `members` is `"key":value,...`. */
void progress_json(struct progress *p, const char *event, const char *members, double now_s);

/* Takes the bar away until the next paint, which may come at once. */
void progress_hide(struct progress *p);

/* Takes the bar away, says how many events were only counted, shows the cursor. */
void progress_end(struct progress *p);

/* The bar's text for a window of that width; pure. Drops workers, rate, error, bar, in that order.
 */
void progress_text(const struct progress_now *now, int columns, char out[PROGRESS_COLUMNS_MAX]);

#endif
