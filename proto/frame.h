/* proto/frame.h: how bytes on a connection are cut into frames.
 *
 *   0      2       3    4     6        8         12        16
 *   +------+-------+----+-----+--------+---------+---------+------+------+
 *   |magic |version|type|flags|reserved|meta_len |body_len | meta | body |
 *   +------+-------+----+-----+--------+---------+---------+------+------+
 *
 * All little-endian. Meta is one nanopb message (message.h) of at most
 * LIMIT_META_BYTES, body is raw bytes and only some types have one. The header's
 * version is that of this layout and stays while the layout does, so that a peer
 * of another protocol can still be told so by a Refuse; the protocol's version
 * is agreed on in Hello and Welcome.
 *
 * The decoder is fed any split of the bytes. It takes memory as bytes arrive,
 * never because a length says so, and asks before the first body byte whether
 * that body is wanted. No I/O, no clock; one thread per decoder. Tests:
 * test_frame, prop_frame, fuzz_frame.
 */
#ifndef PROTO_FRAME_H
#define PROTO_FRAME_H

#include "common/err.h"
#include "proto/limits.h"

/* Raise MAX when something is added that both ends must know; raise MIN when the old way goes. */
enum { PROTOCOL_VERSION_MIN = 1, PROTOCOL_VERSION_MAX = 1 };

enum {
    FRAME_MAGIC = 0x4C54, /* bytes 'T' 'L' */
    FRAME_VERSION = 1,    /* of the 16-byte header */
    FRAME_HEADER_BYTES = 16,
};

/* Who may send a type. */
enum frame_side { FRAME_SIDE_WORKER = 1, FRAME_SIDE_MASTER = 2, FRAME_SIDE_BOTH = 3 };

/* X(suffix, number, nanopb message, union member, who sends it, most body bytes) */
#define FRAME_MAP(X)                                                                               \
    X(HELLO, 1, Hello, hello, WORKER, 0)                                                           \
    X(WELCOME, 2, Welcome, welcome, MASTER, 0)                                                     \
    X(REFUSE, 3, Refuse, refuse, MASTER, 0)                                                        \
    X(HEARTBEAT, 4, Heartbeat, heartbeat, BOTH, 0)                                                 \
    X(JOB_INFO, 5, JobInfo, job_info, MASTER, 0)                                                   \
    X(JOB_READY, 6, JobReady, job_ready, WORKER, 0)                                                \
    X(JOB_FAILED, 7, JobFailed, job_failed, WORKER, 0)                                             \
    X(JOB_END, 8, JobEnd, job_end, MASTER, 0)                                                      \
    X(CHUNK_REQUEST, 9, ChunkRequest, chunk_request, WORKER, 0)                                    \
    X(CHUNK_DATA, 10, ChunkData, chunk_data, MASTER, LIMIT_CHUNK_BODY_BYTES)                       \
    X(CHUNK_MISSING, 11, ChunkMissing, chunk_missing, MASTER, 0)                                   \
    X(LEASE, 12, Lease, lease, MASTER, 0)                                                          \
    X(REVOKE, 13, Revoke, revoke, MASTER, 0)                                                       \
    X(RESULT, 14, Result, result, WORKER, LIMIT_RESULT_BODY_BYTES)                                 \
    X(RESULT_ACK, 15, ResultAck, result_ack, MASTER, 0)                                            \
    X(UNIT_FAILED, 16, UnitFailed, unit_failed, WORKER, 0)                                         \
    X(DRAIN, 17, Drain, drain, MASTER, 0)                                                          \
    X(GOODBYE, 18, Goodbye, goodbye, WORKER, 0)

/* What the tile codec makes of the largest unit at worst (tile_codec_bound). */
#define LIMIT_RESULT_BODY_BYTES (LIMIT_UNIT_RAW_BYTES + LIMIT_UNIT_RAW_BYTES / 128 + 1024)

enum frame_type {
#define FRAME_ENUM(suffix, number, message, member, side, body) FRAME_##suffix = number,
    FRAME_MAP(FRAME_ENUM)
#undef FRAME_ENUM
};

/* "HELLO"; NULL for a number that is no type. */
const char *frame_type_name(int type);

/* Sides that may send the type (bits of enum frame_side); 0 for a number that is no type. */
int frame_type_side(int type);

/* Most body bytes the type may have; 0: none. */
uint32_t frame_type_body_max(int type);

struct frame_header {
    enum frame_type type;
    uint32_t meta_bytes, body_bytes;
};

/* Writes the 16 bytes. The lengths must be within the type's limits (asserted). */
void frame_header_encode(const struct frame_header *h, unsigned char out[FRAME_HEADER_BYTES]);

/* ERR_CORRUPT: not a frame of this layout, an unknown type, flags or reserved bits set;
 * ERR_LIMIT: a length over the type's limit; ERR_VERSION: a later layout. */
TL_NODISCARD enum err frame_header_decode(const unsigned char in[FRAME_HEADER_BYTES],
                                          struct frame_header *out);

/* A complete frame. Meta and body are the decoder's until the next call on it; to keep the body,
 * call frame_decoder_take_body. */
struct frame {
    struct frame_header header;
    const unsigned char *meta;
    const unsigned char *body; /* NULL when body_bytes is 0 */
};

struct frame_rules {
    int peer_side; /* enum frame_side of the one who sends: other types are ERR_CORRUPT */

    /* May be NULL: every body within its type's limit is wanted. Called when the meta of a frame
     * with a body is complete (frame->body is NULL), before any memory is taken for the body.
     * Anything but ERR_OK is the decoder's error from then on. */
    enum err (*body_wanted)(void *ctx, const struct frame *frame);
    void *ctx;
};

struct frame_decoder {
    struct frame_rules rules;
    enum err error; /* sticky */
    unsigned char head[FRAME_HEADER_BYTES];
    struct frame_header header;
    unsigned char *meta, *body; /* owned */
    size_t head_have, meta_have, meta_capacity, body_have, body_capacity;
    bool header_known, body_asked, complete;
};

void frame_decoder_init(struct frame_decoder *d, const struct frame_rules *rules);
void frame_decoder_release(struct frame_decoder *d);

/* Takes bytes until one frame is complete or none are left; *used says how many it took. *ready
 * says whether *out holds a frame; then call again with the rest. ERR_CORRUPT, ERR_LIMIT,
 * ERR_VERSION, ERR_NOMEM or body_wanted's error: the stream is lost, and every later call returns
 * the same. */
TL_NODISCARD enum err frame_decoder_feed(struct frame_decoder *d, const void *data, size_t bytes,
                                         size_t *used, bool *ready, struct frame *out);

/* The body of the frame that feed just gave: yours (mem_free); NULL if it has none. */
TL_NODISCARD unsigned char *frame_decoder_take_body(struct frame_decoder *d);

/* True between frames: the peer may close here without having cut anything off. */
bool frame_decoder_idle(const struct frame_decoder *d);

/* Memory held for the frame in progress. */
size_t frame_decoder_held_bytes(const struct frame_decoder *d);

#endif
