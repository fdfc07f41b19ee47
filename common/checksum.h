/* common/checksum.h: 64 bits over bytes, to notice what a disk or a broken write has changed.
 *
 * As fast as memory; no digest: who wants another file of the same sum can make one. The same
 * on every machine. Pure; any thread.
 */
#ifndef COMMON_CHECKSUM_H
#define COMMON_CHECKSUM_H

#include <stddef.h>
#include <stdint.h>

/* Any single changed run of up to 8 bytes changes it, and any other change but one in 2^60 or so.
 * Test: test_checksum. */
uint64_t checksum64(const void *data, size_t bytes);

#endif
