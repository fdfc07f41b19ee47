/* common/process.h: what a program makes sure of before anything else.
 *
 * Call first in main, before a descriptor is opened or a thread started. Test:
 * tests/e2e/test_e2e_faults.py (standard files closed, a limit of the size of files).
 */
#ifndef COMMON_PROCESS_H
#define COMMON_PROCESS_H

/* Descriptors 0, 1 and 2 are open afterwards: where one was closed, what is read from it or written
 * to it fails with EBADF. Otherwise the next file or socket gets its number, talk for people goes
 * there, and libuv aborts when that is closed.
 *
 * SIGPIPE and SIGXFSZ are ignored: a reader that left, and a file over the limit of its size, are
 * errors of a write (EPIPE, EFBIG), and no end of the program. */
void process_prepare(void);

#endif
