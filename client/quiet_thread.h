/* client/quiet_thread.h: a thread beside the main one, which takes no signals: those are for the
 * threads that wait for them. Any thread.
 */
#ifndef CLIENT_QUIET_THREAD_H
#define CLIENT_QUIET_THREAD_H

#include <pthread.h>

/* As pthread_create: 0, or what went wrong; then nothing runs. Join it. */
int quiet_thread_begin(pthread_t *thread, void *(*run)(void *ctx), void *ctx);

#endif
