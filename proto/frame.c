#include "proto/frame.h"

#include <string.h>

#include "common/mem.h"

/* First memory taken for a body; doubled as bytes really arrive. */
enum { BODY_FIRST_BYTES = 4096 };

static uint16_t get_u16(const unsigned char *p)
{
    return (uint16_t)(p[0] | p[1] << 8);
}

static uint32_t get_u32(const unsigned char *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static void put_u32(unsigned char *p, uint32_t v)
{
    for (int i = 0; i < 4; i++)
        p[i] = (unsigned char)(v >> (8 * i));
}

const char *frame_type_name(int type)
{
    switch (type) {
#define FRAME_NAME(suffix, number, message, member, side, body)                                    \
    case number:                                                                                   \
        return #suffix;
        FRAME_MAP(FRAME_NAME)
#undef FRAME_NAME
    default:
        return NULL;
    }
}

int frame_type_side(int type)
{
    switch (type) {
#define FRAME_WHO(suffix, number, message, member, side, body)                                     \
    case number:                                                                                   \
        return FRAME_SIDE_##side;
        FRAME_MAP(FRAME_WHO)
#undef FRAME_WHO
    default:
        return 0;
    }
}

uint32_t frame_type_body_max(int type)
{
    switch (type) {
#define FRAME_BODY(suffix, number, message, member, side, body)                                    \
    case number:                                                                                   \
        return body;
        FRAME_MAP(FRAME_BODY)
#undef FRAME_BODY
    default:
        return 0;
    }
}

void frame_header_encode(const struct frame_header *h, unsigned char out[FRAME_HEADER_BYTES])
{
    TL_ASSERT(frame_type_side((int)h->type) != 0);
    TL_ASSERT(h->meta_bytes <= LIMIT_META_BYTES);
    TL_ASSERT(h->body_bytes <= frame_type_body_max((int)h->type));
    memset(out, 0, FRAME_HEADER_BYTES);
    out[0] = FRAME_MAGIC & 0xff;
    out[1] = FRAME_MAGIC >> 8;
    out[2] = FRAME_VERSION;
    out[3] = (unsigned char)h->type;
    put_u32(out + 8, h->meta_bytes);
    put_u32(out + 12, h->body_bytes);
}

enum err frame_header_decode(const unsigned char in[FRAME_HEADER_BYTES], struct frame_header *out)
{
    if (get_u16(in) != FRAME_MAGIC)
        return ERR_CORRUPT;
    if (in[2] != FRAME_VERSION)
        return in[2] > FRAME_VERSION ? ERR_VERSION : ERR_CORRUPT;
    if (frame_type_side(in[3]) == 0 || get_u16(in + 4) != 0 || get_u16(in + 6) != 0)
        return ERR_CORRUPT;
    uint32_t meta_bytes = get_u32(in + 8), body_bytes = get_u32(in + 12);
    if (meta_bytes > LIMIT_META_BYTES || body_bytes > frame_type_body_max(in[3]))
        return ERR_LIMIT;
    *out = (struct frame_header){
        .type = (enum frame_type)in[3], .meta_bytes = meta_bytes, .body_bytes = body_bytes};
    return ERR_OK;
}

/* --- Decoder ---------------------------------------------------------------- */

void frame_decoder_init(struct frame_decoder *d, const struct frame_rules *rules)
{
    *d = (struct frame_decoder){.rules = *rules};
}

void frame_decoder_release(struct frame_decoder *d)
{
    mem_free(d->meta);
    mem_free(d->body);
    *d = (struct frame_decoder){.error = ERR_CLOSED};
}

/* Ready for the next header. The meta buffer is small and stays; a body's memory goes at once. */
static void begin_frame(struct frame_decoder *d)
{
    mem_free(d->body);
    d->body = NULL;
    d->head_have = d->meta_have = d->body_have = d->body_capacity = 0;
    d->header_known = d->body_asked = d->complete = false;
}

/* Copies what is there of a part of `want` bytes, growing its buffer no further than twice what has
 * come. */
static enum err take_part(unsigned char **part, size_t *have, size_t *capacity, size_t want,
                          const unsigned char **at, const unsigned char *end)
{
    size_t bytes = want - *have;
    if (bytes > (size_t)(end - *at))
        bytes = (size_t)(end - *at);
    if (bytes == 0)
        return ERR_OK;
    if (*have + bytes > *capacity) {
        size_t grown = *capacity * 2 > BODY_FIRST_BYTES ? *capacity * 2 : BODY_FIRST_BYTES;
        if (grown < *have + bytes)
            grown = *have + bytes;
        if (grown > want)
            grown = want;
        unsigned char *p = mem_realloc_array(*part, grown, 1);
        if (!p)
            return ERR_NOMEM;
        *part = p;
        *capacity = grown;
    }
    memcpy(*part + *have, *at, bytes);
    *have += bytes;
    *at += bytes;
    return ERR_OK;
}

static struct frame current_frame(const struct frame_decoder *d)
{
    return (struct frame){.header = d->header,
                          .meta = d->header.meta_bytes ? d->meta : d->head,
                          .body = d->complete ? d->body : NULL};
}

static enum err take_header(struct frame_decoder *d, const unsigned char **at,
                            const unsigned char *end)
{
    size_t bytes = FRAME_HEADER_BYTES - d->head_have;
    if (bytes > (size_t)(end - *at))
        bytes = (size_t)(end - *at);
    memcpy(d->head + d->head_have, *at, bytes);
    d->head_have += bytes;
    *at += bytes;
    if (d->head_have < FRAME_HEADER_BYTES)
        return ERR_OK;
    TL_TRY(frame_header_decode(d->head, &d->header));
    if ((frame_type_side((int)d->header.type) & d->rules.peer_side) == 0)
        return ERR_CORRUPT;
    d->header_known = true;
    return ERR_OK;
}

/* One pass over header, meta and body; leaves d->complete set when the frame is. */
static enum err advance(struct frame_decoder *d, const unsigned char **at, const unsigned char *end)
{
    if (!d->header_known)
        TL_TRY(take_header(d, at, end));
    if (!d->header_known)
        return ERR_OK;

    TL_TRY(take_part(&d->meta, &d->meta_have, &d->meta_capacity, d->header.meta_bytes, at, end));
    if (d->meta_have < d->header.meta_bytes)
        return ERR_OK;

    if (d->header.body_bytes > 0 && !d->body_asked) {
        struct frame frame = current_frame(d);
        if (d->rules.body_wanted)
            TL_TRY(d->rules.body_wanted(d->rules.ctx, &frame));
        d->body_asked = true;
    }
    TL_TRY(take_part(&d->body, &d->body_have, &d->body_capacity, d->header.body_bytes, at, end));
    d->complete = d->body_have == d->header.body_bytes;
    return ERR_OK;
}

enum err frame_decoder_feed(struct frame_decoder *d, const void *data, size_t bytes, size_t *used,
                            bool *ready, struct frame *out)
{
    *used = 0;
    *ready = false;
    if (d->error != ERR_OK)
        return d->error;
    if (d->complete)
        begin_frame(d);
    if (bytes == 0)
        return ERR_OK;

    const unsigned char *at = data;
    d->error = advance(d, &at, at + bytes);
    *used = (size_t)(at - (const unsigned char *)data);
    TL_ASSERT(*used <= bytes);
    if (d->error == ERR_OK && d->complete) {
        *ready = true;
        *out = current_frame(d);
    }
    return d->error;
}

unsigned char *frame_decoder_take_body(struct frame_decoder *d)
{
    TL_ASSERT(d->complete);
    unsigned char *body = d->body;
    d->body = NULL;
    d->body_capacity = 0;
    return body;
}

bool frame_decoder_idle(const struct frame_decoder *d)
{
    return d->complete || d->head_have == 0;
}

size_t frame_decoder_held_bytes(const struct frame_decoder *d)
{
    return d->meta_capacity + d->body_capacity;
}
