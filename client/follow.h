/* client/follow.h: stays with a job until it ends, over the farm's event stream.
 *
 * Reconnects with Last-Event-ID when the stream breaks, and asks for the state at intervals
 * meanwhile, so that a proxy without streaming only makes it coarser. One thread.
 */
#ifndef CLIENT_FOLLOW_H
#define CLIENT_FOLLOW_H

#include "client/farm_api.h"
#include "client/progress.h"

enum follow_end {
    FOLLOW_DONE,      /* the job is done */
    FOLLOW_FAILED,    /* failed or cancelled */
    FOLLOW_STOPPED,   /* the hook said so */
    FOLLOW_PAUSED,    /* paused, under pause_ends */
    FOLLOW_FARM_LOST, /* farm cannot be reached, or does not know the job; it has been said */
};

struct follow {
    struct farm *farm;
    const char *job;
    struct progress *progress;
    int wake_fd;                              /* also wakes the wait; -1: none */
    bool (*on_wake)(void *ctx);               /* called after each wait; true stops. May be NULL */
    void (*on_news)(void *ctx, double now_s); /* after each change of the job; may be NULL */
    void *ctx;
    bool pause_ends;         /* a paused job is not waited for: nobody is there to resume it */
    uint32_t joins_expected; /* so many workers that join are no news */
    double patience_s;       /* how long the farm may be silent */
    char state[24];          /* out: the last state known */
};

enum follow_end follow_job(struct follow *f);

/* Seconds of the monotonic clock. */
double follow_now_s(void);

#endif
