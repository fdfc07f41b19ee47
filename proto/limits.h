/* proto/limits.h: what a peer may ask of us, in one place.
 *
 * Every number that bounds memory taken or work done for the sake of bytes from
 * the network. docs/PROTOCOL.md quotes them; both ends enforce them.
 */
#ifndef PROTO_LIMITS_H
#define PROTO_LIMITS_H

#include <stdint.h>

enum {
    LIMIT_META_BYTES = 64 * 1024,  /* of one frame */
    LIMIT_EARLY_BYTES = 64 * 1024, /* received or held on a connection before its Hello */
    LIMIT_HANDSHAKE_MS = 5000,     /* from connect to Welcome or accepted Hello */

    LIMIT_THREADS = 4096, /* a worker may say it has */
    LIMIT_TAGS = 8,
    LIMIT_HELD = 2,                 /* leases a worker holds beyond its threads */
    LIMIT_HELD_TOLD = 256,          /* leases and results that a Hello tells of */
    LIMIT_HEARTBEAT_MS = 60 * 1000, /* longest interval a Welcome may ask for */
    LIMIT_MISSED_HEARTBEATS = 3,    /* silence, in intervals, after which a peer is lost */

    LIMIT_UNIT_VALUES = 3 << 24, /* floats of one unit: 2^24 pixels of RGB, fewer with AOVs */
    LIMIT_UNIT_RAW_BYTES = LIMIT_UNIT_VALUES * 4,

    LIMIT_ZSTD_WINDOW_LOG = 20, /* of any zstd frame on the wire */

    LIMIT_TURN_FRAMES = 64, /* handled per connection before others have their turn */
    LIMIT_TURN_BYTES = 1024 * 1024,
};

/* A chunk as sent: the frame's body length is 32 bits. */
#define LIMIT_CHUNK_BODY_BYTES UINT32_MAX
#define LIMIT_CHUNK_RAW_BYTES  (UINT64_C(1) << 36) /* 64 GiB: the largest mesh */

_Static_assert(LIMIT_META_BYTES <= LIMIT_EARLY_BYTES, "a Hello fits what is allowed before it");

#endif
