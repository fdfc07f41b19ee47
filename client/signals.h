/* client/signals.h: Ctrl-C and ending children, turned into a readable descriptor.
 *
 * SIGINT, SIGTERM and SIGHUP count as interruptions; SIGCHLD only wakes. The handler also
 * shows the cursor again and, from the second interruption on, kills the children registered
 * here at once, since the program may be busy. One process-wide state; main thread.
 */
#ifndef CLIENT_SIGNALS_H
#define CLIENT_SIGNALS_H

#include <signal.h>
#include <sys/types.h>

#include "common/err.h"

/* Installs the handlers. ERR_IO. */
TL_NODISCARD enum err signals_install(void);

/* Readable after a signal; drain with signals_clear before looking at what happened. */
int signals_fd(void);
void signals_clear(void);

/* How often we were interrupted. */
extern volatile sig_atomic_t signals_interrupts;

/* Children that the second interruption kills. Full tables ignore; pid 0 is never one. */
enum { SIGNALS_CHILDREN_MAX = 300 };
void signals_child_add(pid_t pid);
void signals_child_remove(pid_t pid);

#endif
