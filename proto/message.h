/* proto/message.h: the meta part of a frame as a C struct, and back.
 *
 * One tagged union over the nanopb structs of tilery.proto. Decoding takes no
 * memory, enforces the maxima of tilery.options, UTF-8 in every string and the
 * ranges any receiver needs (message_check), so that a decoded message can be
 * used without looking again; what depends on state (is this job known, does the
 * unit lie in its grid) stays with the receiver. Pure; any thread. Tests:
 * test_message, fuzz_message.
 */
#ifndef PROTO_MESSAGE_H
#define PROTO_MESSAGE_H

#include "common/digest.h"
#include "proto/frame.h"
#include "proto/tilery.pb.h" /* generated into the build tree */

struct message {
    enum frame_type type;
    union {
#define MESSAGE_MEMBER(suffix, number, message, member, side, body) tilery_##message member;
        FRAME_MAP(MESSAGE_MEMBER)
#undef MESSAGE_MEMBER
    };
};

/* No encoded message is longer. */
enum { MESSAGE_BYTES_MAX = 12800 };

/* Writes the message's meta bytes. ERR_LIMIT: a text without its NUL, a count over its maximum,
 * or a message that message_check would refuse; nothing of use was written. */
TL_NODISCARD enum err message_encode(const struct message *m, unsigned char out[MESSAGE_BYTES_MAX],
                                     size_t *bytes);

/* Reads the meta bytes of a frame of that type. ERR_CORRUPT: not protobuf, over a maximum, not
 * UTF-8, or refused by message_check. *out is unspecified then. Unknown fields are skipped. */
TL_NODISCARD enum err message_decode(enum frame_type type, const void *meta, size_t bytes,
                                     struct message *out);

/* NULL, or what is wrong with the message by itself (a static text for the log): versions out of
 * order, no threads, an empty unit, a negative time, ... */
const char *message_check(const struct message *m);

/* Copies text into a fixed field, cut at the last whole UTF-8 character that fits; bytes that are
 * not UTF-8 become '?'. */
void message_text(char *field, size_t field_bytes, const char *text);
#define MESSAGE_TEXT(field, text) message_text((field), sizeof(field), (text))

#endif
