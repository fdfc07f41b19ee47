#include "common/package_split.h"

#include <stdatomic.h>
#include <string.h>

#include "common/mem.h"
#include "common/package_codec.h"
#include "common/parallel.h"
#include "common/pyramid.h"
#include "common/texel.h"

bool package_is_split(const struct scene_image *image, unsigned stored, uint64_t bytes_min)
{
    uint64_t bytes = (uint64_t)image->width * image->height *
                     texel_bytes(image->format, (uint32_t)__builtin_popcount(stored));
    return pyramid_can_be_pieces(image) && bytes >= bytes_min;
}

/* --- Cutting --------------------------------------------------------------- */

/* A picture on its way into pieces. */
struct cutting {
    const struct scene_image *image;
    unsigned stored;
    struct split *out;
    struct pyramid_level coarse; /* the first level of the base, which each piece adds to */
    atomic_int error;            /* of any of them */
};

static enum err copy_piece(const struct scene_image *image, uint32_t left, uint32_t top,
                           struct scene_image *piece)
{
    size_t texel = texel_bytes(image->format, image->channel_count), row = piece->width * texel;
    unsigned char *to = mem_alloc_array(piece->height, row);
    piece->pixels = to;
    for (uint32_t y = 0; to && y < piece->height; y++)
        memcpy(to + y * row,
               (const unsigned char *)image->pixels +
                   ((size_t)(top + y) * image->width + left) * texel,
               row);
    return to ? ERR_OK : ERR_NOMEM;
}

/* The piece's part of the base's first level, at its corner. */
static enum err add_coarse(const struct scene_image *piece, uint32_t left, uint32_t top,
                           struct pyramid_level *coarse)
{
    struct pyramid_level level, next;
    TL_TRY(pyramid_first(piece, false, &level));
    for (int l = 1; l < PYRAMID_PIECE_LEVELS; l++) {
        enum err e = pyramid_next(&level, false, &next);
        mem_free(level.samples);
        TL_TRY(e);
        level = next;
    }
    size_t row = (size_t)level.width * level.channel_count;
    float *to = coarse->samples + ((size_t)(top >> PYRAMID_PIECE_LEVELS) * coarse->width +
                                   (left >> PYRAMID_PIECE_LEVELS)) *
                                      coarse->channel_count;
    for (uint32_t y = 0; y < level.height; y++, to += (size_t)coarse->width * coarse->channel_count)
        memcpy(to, level.samples + y * row, row * sizeof *to);
    mem_free(level.samples);
    return ERR_OK;
}

static enum err cut_piece(struct cutting *c, size_t i)
{
    uint32_t across = pyramid_pieces_across(c->image), left, top;
    struct split_piece *out = &c->out->pieces[i];
    struct scene_image piece =
        pyramid_piece_at(c->image, (uint32_t)i % across, (uint32_t)i / across, &left, &top);
    TL_TRY(copy_piece(c->image, left, top, &piece));
    enum err e = package_image_put(&piece, c->stored, &out->bytes);
    if (e == ERR_OK) {
        out->name = digest_of(out->bytes.data, out->bytes.bytes);
        e = add_coarse(&piece, left, top, &c->coarse);
    }
    mem_free(piece.pixels);
    return e;
}

static void cut_one(void *arg, size_t i)
{
    struct cutting *c = arg;
    enum err e = cut_piece(c, i);
    if (e != ERR_OK)
        atomic_store(&c->error, (int)e);
}

/* --- The base -------------------------------------------------------------- */

/* A level as texels, after the others of the base. */
static enum err add_level(const struct pyramid_level *level, struct package_base *base)
{
    struct scene_image *to = &base->levels[base->level_count];
    size_t count = (size_t)level->width * level->height;
    *to = base->picture;
    to->width = level->width;
    to->height = level->height;
    to->pixels = mem_alloc_array(count, texel_bytes(to->format, to->channel_count));
    if (!to->pixels)
        return ERR_NOMEM;
    base->level_count++;
    for (size_t i = 0; i < count; i++)
        pyramid_round(to->format, to->channel_count, level->samples + i * level->channel_count,
                      to->pixels, i);
    return ERR_OK;
}

/* All levels from `coarse` on, whose samples it takes. */
static enum err make_levels(struct pyramid_level *coarse, struct package_base *base)
{
    enum err e;
    while ((e = add_level(coarse, base)) == ERR_OK && (coarse->width > 1 || coarse->height > 1)) {
        struct pyramid_level next;
        e = pyramid_next(coarse, false, &next);
        if (e != ERR_OK)
            break;
        mem_free(coarse->samples);
        *coarse = next;
    }
    mem_free(coarse->samples);
    coarse->samples = NULL;
    return e;
}

/* Pictures that differ in their pieces alone have bases of their own. */
static enum err detail_of(const struct split *s, digest *out)
{
    struct digest_ctx names;
    TL_TRY(digest_begin(&names));
    for (size_t i = 0; i < s->count; i++)
        digest_add(&names, s->pieces[i].name.bytes, DIGEST_BYTES);
    *out = digest_end(&names);
    return ERR_OK;
}

static enum err make_base(struct cutting *c)
{
    struct split *s = c->out;
    struct package_base base = {.picture = s->picture};
    digest detail;
    enum err e = make_levels(&c->coarse, &base);
    if (e == ERR_OK)
        e = detail_of(s, &detail);
    if (e == ERR_OK)
        e = package_base_put(&base, &detail, c->stored, &s->base);
    package_base_release(&base);
    if (e == ERR_OK)
        s->name = digest_of(s->base.data, s->base.bytes);
    return e;
}

enum err package_split(const struct scene_image *image, unsigned stored, struct split *out)
{
    TL_ASSERT(pyramid_can_be_pieces(image));
    *out = (struct split){.picture = *image};
    out->picture.pixels = NULL;
    buf_init(&out->base);
    struct cutting c = {.image = image, .stored = stored, .out = out};
    c.coarse = (struct pyramid_level){.width = image->width >> PYRAMID_PIECE_LEVELS,
                                      .height = image->height >> PYRAMID_PIECE_LEVELS,
                                      .channel_count = image->channel_count};
    size_t count = (size_t)pyramid_pieces_across(image) * pyramid_pieces_down(image);
    c.coarse.samples = mem_alloc_array((size_t)c.coarse.width * c.coarse.height,
                                       c.coarse.channel_count * sizeof(float));
    out->pieces = mem_calloc(count, sizeof *out->pieces);
    if (!c.coarse.samples || !out->pieces) {
        mem_free(c.coarse.samples);
        return ERR_NOMEM;
    }
    out->count = count;
    for (size_t i = 0; i < count; i++)
        buf_init(&out->pieces[i].bytes);
    parallel_for(count, cut_one, &c);
    enum err e = (enum err)atomic_load(&c.error);
    if (e == ERR_OK)
        return make_base(&c);
    mem_free(c.coarse.samples);
    return e;
}

void package_split_release(struct split *s)
{
    for (size_t i = 0; i < s->count; i++)
        buf_release(&s->pieces[i].bytes);
    mem_free(s->pieces);
    buf_release(&s->base);
    *s = (struct split){0};
}
