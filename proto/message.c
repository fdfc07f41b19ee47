#include "proto/message.h"

#include <math.h>
#include <pb_decode.h>
#include <pb_encode.h>
#include <string.h>

#include "common/utf8.h"

/* nanopb's description and the longest encoding of each type. */
static const pb_msgdesc_t *fields_of(int type)
{
    switch (type) {
#define MESSAGE_FIELDS(suffix, number, message, member, side, body)                                \
    case number:                                                                                   \
        return &tilery_##message##_msg;
        FRAME_MAP(MESSAGE_FIELDS)
#undef MESSAGE_FIELDS
    default:
        return NULL;
    }
}

#define MESSAGE_FITS(suffix, number, message, member, side, body)                                  \
    _Static_assert(tilery_##message##_size <= MESSAGE_BYTES_MAX, #message " fits");
FRAME_MAP(MESSAGE_FITS)
#undef MESSAGE_FITS
_Static_assert((int)MESSAGE_BYTES_MAX <= (int)LIMIT_META_BYTES, "any message fits a frame");
_Static_assert(sizeof((struct message *)0)->hello.tags /
                       sizeof *((struct message *)0)->hello.tags ==
                   LIMIT_TAGS,
               "tilery.options and limits.h agree");
_Static_assert(sizeof((struct message *)0)->hello.held /
                       sizeof *((struct message *)0)->hello.held ==
                   LIMIT_HELD_TOLD,
               "tilery.options and limits.h agree");

/* --- UTF-8 -------------------------------------------------------------------- */

static bool utf8_valid(const char *text)
{
    const char *end = text + strlen(text);
    while (text < end) {
        size_t length = utf8_length(text, end);
        if (length == 0)
            return false;
        text += length;
    }
    return true;
}

void message_text(char *field, size_t field_bytes, const char *text)
{
    TL_ASSERT(field_bytes > 0);
    utf8_copy(field, field_bytes, text);
}

/* The strings of each type: `count` in a row, each of `bytes`. */
struct text_field {
    int type;
    size_t offset, bytes, count;
};
#define TEXT(suffix, member, field)                                                                \
    {                                                                                              \
        FRAME_##suffix, offsetof(struct message, member.field),                                    \
            sizeof((struct message *)0)->member.field, 1                                           \
    }
static const struct text_field text_fields[] = {
    TEXT(HELLO, hello, build_id),
    TEXT(HELLO, hello, name),
    TEXT(HELLO, hello, host),
    TEXT(HELLO, hello, token),
    TEXT(HELLO, hello, cpu),
    TEXT(HELLO, hello, last_id),
    {FRAME_HELLO, offsetof(struct message, hello.tags), sizeof((struct message *)0)->hello.tags[0],
     LIMIT_TAGS},
    TEXT(WELCOME, welcome, worker_id),
    TEXT(REFUSE, refuse, text),
    TEXT(JOB_FAILED, job_failed, error),
    TEXT(JOB_FAILED, job_failed, text),
    TEXT(UNIT_FAILED, unit_failed, error),
    TEXT(UNIT_FAILED, unit_failed, text),
    TEXT(DRAIN, drain, reason),
    TEXT(GOODBYE, goodbye, reason),
};

static bool texts_valid(const struct message *m)
{
    for (size_t i = 0; i < sizeof text_fields / sizeof *text_fields; i++) {
        const struct text_field *f = &text_fields[i];
        if (f->type != (int)m->type)
            continue;
        for (size_t k = 0; k < f->count; k++) {
            const char *text = (const char *)m + f->offset + k * f->bytes;
            if (strnlen(text, f->bytes) == f->bytes || !utf8_valid(text))
                return false;
        }
    }
    return true;
}

/* --- Ranges --------------------------------------------------------------------- */

static const char *check_run(uint32_t cell_begin, uint32_t cell_count)
{
    if (cell_count == 0)
        return "a unit without cells";
    return cell_begin > UINT32_MAX - cell_count ? "a unit past the last cell number" : NULL;
}

static const char *check_hello(const tilery_Hello *h)
{
    if (h->protocol_min == 0 || h->protocol_min > h->protocol_max)
        return "protocol versions out of order";
    if (h->threads == 0 || h->threads > LIMIT_THREADS)
        return "a thread count out of range";
    for (size_t i = 0; i < h->held_count; i++) {
        const char *problem = check_run(h->held[i].cell_begin, h->held[i].cell_count);
        if (problem)
            return problem;
        if (h->held[i].state > tilery_HELD_RESULT) /* an open enumeration on the wire */
            return "a held lease in no known state";
    }
    return h->name[0] == '\0' ? "a worker without a name" : NULL;
}

static const char *check_result(const tilery_Result *r)
{
    if (r->raw_bytes == 0 || r->raw_bytes % sizeof(float) != 0 ||
        r->raw_bytes > LIMIT_UNIT_RAW_BYTES)
        return "a result that is no whole number of values within the limit";
    if (r->nonfinite > r->samples)
        return "more non-finite samples than samples";
    return check_run(r->cell_begin, r->cell_count);
}

static const char *check_seconds(double a, double b)
{
    return isfinite(a) && isfinite(b) && a >= 0 && b >= 0 ? NULL : "a time that is no time";
}

const char *message_check(const struct message *m)
{
    if (frame_type_side((int)m->type) == 0)
        return "an unknown type";
    if (!texts_valid(m))
        return "a text that is not UTF-8";
    switch (m->type) {
    case FRAME_HELLO:
        return check_hello(&m->hello);
    case FRAME_WELCOME:
        if (m->welcome.heartbeat_ms == 0 || m->welcome.heartbeat_ms > LIMIT_HEARTBEAT_MS)
            return "a heartbeat interval out of range";
        return m->welcome.worker_id[0] == '\0' ? "a worker without an id" : NULL;
    case FRAME_JOB_READY:
        return check_seconds(m->job_ready.load_seconds, m->job_ready.build_seconds);
    case FRAME_CHUNK_DATA:
        return m->chunk_data.raw_bytes == 0 || m->chunk_data.raw_bytes > LIMIT_CHUNK_RAW_BYTES
                   ? "a chunk size out of range"
                   : NULL;
    case FRAME_LEASE:
        return check_run(m->lease.cell_begin, m->lease.cell_count);
    case FRAME_RESULT:
        return check_result(&m->result);
    default:
        return NULL;
    }
}

/* --- Encoding -------------------------------------------------------------------- */

/* Where the union's members begin: all at the same place. */
static void *payload(struct message *m)
{
    return &m->hello;
}

enum err message_encode(const struct message *m, unsigned char out[MESSAGE_BYTES_MAX],
                        size_t *bytes)
{
    if (message_check(m) != NULL)
        return ERR_LIMIT;
    pb_ostream_t stream = pb_ostream_from_buffer(out, MESSAGE_BYTES_MAX);
    if (!pb_encode(&stream, fields_of((int)m->type), &m->hello))
        return ERR_LIMIT;
    *bytes = stream.bytes_written;
    return ERR_OK;
}

enum err message_decode(enum frame_type type, const void *meta, size_t bytes, struct message *out)
{
    const pb_msgdesc_t *fields = fields_of((int)type);
    if (!fields || bytes > LIMIT_META_BYTES)
        return ERR_CORRUPT;
    *out = (struct message){.type = type};
    pb_istream_t stream = pb_istream_from_buffer(meta, bytes);
    if (!pb_decode(&stream, fields, payload(out)))
        return ERR_CORRUPT;
    return message_check(out) == NULL ? ERR_OK : ERR_CORRUPT;
}
