/* worker/outlet.h: where messages to the master go, without saying how.
 *
 * The session gives one to those who have something to say (work.h, job_table.h),
 * so that they know no connection. Thread: the loop's.
 */
#ifndef WORKER_OUTLET_H
#define WORKER_OUTLET_H

#include "proto/transport.h"

struct outlet {
    /* Sends one message, `body` as in conn_send. ERR_CLOSED: there is no connection now;
     * ERR_AGAIN: not now, try after the next acknowledgement (results only: of others there are
     * few, and one that finds no room ends the connection). */
    enum err (*send)(void *ctx, const struct message *m, struct blob *body);
    void *ctx;
};

#endif
