/* The chunks of one mesh or one image, or of its base: arrays and samples to bytes and back, every
 * size and index checked before it is used. Owns the layouts TLYM, TLYI and TLYB; no state, any
 * thread. */
#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/package_codec.h"
#include "common/package_filter.h"
#include "common/package_split.h"
#include "common/pyramid.h"

static const char mesh_magic[4] = {'T', 'L', 'Y', 'M'};
static const char image_magic[4] = {'T', 'L', 'Y', 'I'};
static const char base_magic[4] = {'T', 'L', 'Y', 'B'};

enum {
    MESH_HAS_NORMALS = 1,
    MESH_HAS_UVS = 2,
    MESH_POSITIONS_F32 = 4,
    MESH_HAS_COLORS = 8,
    MESH_HAS_ALPHAS = 16,
    MESH_FLAGS_ALL = 31
};
enum { HEAD_BYTES = 8 }; /* magic and version */

/* --- Meshes -------------------------------------------------------------- */

bool package_mesh_fits_f32(const struct scene_mesh *m)
{
    size_t count = (size_t)m->vertex_count * 3;
    for (size_t i = 0; i < count; i++)
        if ((double)(float)m->positions[i] != m->positions[i])
            return false;
    return true;
}

static void put_words(struct buf *out, const void *rows, size_t count, size_t columns,
                      size_t word_bytes)
{
    unsigned char *at = buf_extend(out, count * columns * word_bytes);
    if (at)
        filter_words_put(rows, count, columns, word_bytes, at);
}

/* Most files hold floats: then four bytes a coordinate lose nothing. */
static void put_positions(struct buf *out, const struct scene_mesh *m, bool f32)
{
    if (!f32) {
        put_words(out, m->positions, m->vertex_count, 3, sizeof(double));
        return;
    }
    unsigned char *at = buf_extend(out, (size_t)m->vertex_count * 3 * sizeof(float));
    if (at)
        filter_floats_put(m->positions, m->vertex_count, 3, at);
}

enum err package_mesh_put(const struct scene_mesh *m, bool f32, struct buf *out)
{
    struct codec c = {.out = out};
    size_t corners = (size_t)m->triangle_count * 3;
    uint32_t flags = (m->normals ? MESH_HAS_NORMALS : 0u) | (m->uvs ? MESH_HAS_UVS : 0u) |
                     (f32 ? MESH_POSITIONS_F32 : 0u) | (m->colors ? MESH_HAS_COLORS : 0u) |
                     (m->alphas ? MESH_HAS_ALPHAS : 0u);
    size_t vertex = 3 * (f32 ? sizeof(float) : sizeof(double)) +
                    (m->normals ? 3 * sizeof(float) : 0) + (m->uvs ? 2 * sizeof(float) : 0) +
                    (m->colors ? 3 * sizeof(float) : 0) + (m->alphas ? sizeof(float) : 0);
    buf_reserve(out, HEAD_BYTES + 3 * sizeof(uint32_t) + m->vertex_count * vertex +
                         corners * sizeof(uint32_t));
    codec_magic(&c, mesh_magic);
    buf_put_u32(out, m->vertex_count);
    buf_put_u32(out, m->triangle_count);
    buf_put_u32(out, flags);
    put_positions(out, m, f32);
    if (m->normals)
        put_words(out, m->normals, m->vertex_count, 3, sizeof(float));
    if (m->uvs)
        put_words(out, m->uvs, m->vertex_count, 2, sizeof(float));
    if (m->colors)
        put_words(out, m->colors, m->vertex_count, 3, sizeof(float));
    if (m->alphas)
        put_words(out, m->alphas, m->vertex_count, 1, sizeof(float));
    unsigned char *at = buf_extend(out, corners * sizeof(uint32_t));
    if (at)
        filter_indices_put(m->indices, corners, at);
    return codec_end(&c);
}

uint64_t package_mesh_bytes(const struct scene_mesh *m)
{
    uint64_t vertex = 3 * sizeof(double) + (m->normals ? 3 * sizeof(float) : 0) +
                      (m->uvs ? 2 * sizeof(float) : 0) + (m->colors ? 3 * sizeof(float) : 0) +
                      (m->alphas ? sizeof(float) : 0);
    return HEAD_BYTES + 3 * sizeof(uint32_t) + m->vertex_count * vertex +
           m->triangle_count * UINT64_C(3) * sizeof(uint32_t) + CODEC_ENTRY_BYTES +
           CODEC_NAME_BYTES + strlen(m->name);
}

/* The next `count` * `item_bytes` of the reader, with memory of `room_bytes` an item for what comes
 * of them; NULL with an error noted. Nothing is allocated that the bytes left do not fill. */
static void *get_array(struct codec *c, size_t count, size_t item_bytes, size_t room_bytes,
                       const unsigned char **from)
{
    if (c->error != ERR_OK)
        return NULL;
    *from = count <= buf_left(c->in) / item_bytes ? buf_get(c->in, count * item_bytes) : NULL;
    if (!*from) {
        codec_fail(c, ERR_CORRUPT);
        return NULL;
    }
    void *room = mem_alloc_array(count, room_bytes);
    if (!room)
        codec_fail(c, ERR_NOMEM);
    return room;
}

static void *get_words(struct codec *c, size_t count, size_t columns, size_t word_bytes)
{
    const unsigned char *from;
    size_t bytes = columns * word_bytes;
    void *rows = get_array(c, count, bytes, bytes, &from);
    if (rows)
        filter_words_get(from, count, columns, word_bytes, rows);
    return rows;
}

static double *get_positions(struct codec *c, size_t count, bool f32)
{
    const unsigned char *from;
    if (!f32)
        return get_words(c, count, 3, sizeof(double));
    double *rows = get_array(c, count, 3 * sizeof(float), 3 * sizeof *rows, &from);
    if (rows)
        filter_floats_get(from, count, 3, rows);
    return rows;
}

static uint32_t *get_indices(struct codec *c, size_t count)
{
    const unsigned char *from;
    uint32_t *indices = get_array(c, count, sizeof *indices, sizeof *indices, &from);
    if (indices)
        filter_indices_get(from, count, indices);
    return indices;
}

enum err package_mesh_get(const void *data, size_t bytes, struct scene_mesh *m)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    struct codec c = {.in = &in};
    uint32_t flags = 0;
    codec_magic(&c, mesh_magic);
    codec_u32(&c, &m->vertex_count);
    codec_u32(&c, &m->triangle_count);
    codec_u32(&c, &flags);
    if (in.failed || flags > MESH_FLAGS_ALL)
        codec_fail(&c, ERR_CORRUPT);
    if (m->triangle_count > SCENE_TRIANGLES_MAX)
        codec_fail(&c, ERR_LIMIT);
    size_t vertices = m->vertex_count;
    m->positions = get_positions(&c, vertices, (flags & MESH_POSITIONS_F32) != 0);
    if (flags & MESH_HAS_NORMALS)
        m->normals = get_words(&c, vertices, 3, sizeof(float));
    if (flags & MESH_HAS_UVS)
        m->uvs = get_words(&c, vertices, 2, sizeof(float));
    if (flags & MESH_HAS_COLORS)
        m->colors = get_words(&c, vertices, 3, sizeof(float));
    if (flags & MESH_HAS_ALPHAS)
        m->alphas = get_words(&c, vertices, 1, sizeof(float));
    m->indices = get_indices(&c, (size_t)m->triangle_count * 3);
    enum err e = codec_end(&c); /* what it holds is judged by scene_valid */
    if (e != ERR_OK)
        scene_mesh_release(m);
    return e;
}

/* --- Images -------------------------------------------------------------- */

static size_t sample_bytes(enum scene_image_format format)
{
    return format == SCENE_IMAGE_F32 ? sizeof(float) : 1;
}

uint64_t package_image_chunk_bytes(const struct scene_image *image, unsigned stored)
{
    return HEAD_BYTES + 5 * sizeof(uint32_t) +
           (uint64_t)image->width * image->height * sample_bytes(image->format) *
               (uint64_t)__builtin_popcount(stored);
}

uint64_t package_image_bytes(const struct scene_image *image)
{
    return package_image_chunk_bytes(image, (1u << image->channel_count) - 1) + CODEC_ENTRY_BYTES +
           CODEC_PIECES_BYTES;
}

/* One channel of a float picture lies between the others: its words go through a row of their
 * own. */
static void put_plane_f32(const struct scene_image *image, uint32_t channel, float *row,
                          unsigned char *out)
{
    const float *samples = image->pixels;
    for (uint32_t y = 0; y < image->height; y++, out += (size_t)image->width * sizeof *row) {
        for (uint32_t x = 0; x < image->width; x++)
            row[x] = samples[((size_t)y * image->width + x) * image->channel_count + channel];
        filter_words_put(row, image->width, 1, sizeof *row, out);
    }
}

static void get_plane_f32(const unsigned char *in, uint32_t channel, float *row,
                          const struct scene_image *image)
{
    float *samples = image->pixels;
    for (uint32_t y = 0; y < image->height; y++, in += (size_t)image->width * sizeof *row) {
        filter_words_get(in, image->width, 1, sizeof *row, row);
        for (uint32_t x = 0; x < image->width; x++)
            samples[((size_t)y * image->width + x) * image->channel_count + channel] = row[x];
    }
}

static enum err put_planes(const struct scene_image *image, unsigned stored, struct buf *out)
{
    bool f32 = image->format == SCENE_IMAGE_F32;
    size_t plane = (size_t)image->width * image->height * sample_bytes(image->format);
    float *row = mem_alloc_array(f32 ? image->width : 1, sizeof *row);
    for (uint32_t k = 0; row && k < image->channel_count; k++) {
        unsigned char *at = stored >> k & 1 ? buf_extend(out, plane) : NULL;
        if (at && f32)
            put_plane_f32(image, k, row, at);
        else if (at)
            filter_plane_put((const unsigned char *)image->pixels + k, image->width, image->height,
                             image->channel_count, at);
    }
    mem_free(row);
    return row ? ERR_OK : ERR_NOMEM;
}

static void put_head(const struct scene_image *image, unsigned stored, struct buf *out)
{
    buf_put_u32(out, image->width);
    buf_put_u32(out, image->height);
    buf_put_u32(out, image->channel_count);
    buf_put_u32(out, (uint32_t)image->format);
    buf_put_u32(out, stored);
}

enum err package_image_put(const struct scene_image *image, unsigned stored, struct buf *out)
{
    struct codec c = {.out = out};
    codec_magic(&c, image_magic);
    put_head(image, stored, out);
    TL_TRY(put_planes(image, stored, out));
    return codec_end(&c);
}

/* The planes that are there into zeroed pixels; the bytes left hold all of them. */
static void get_planes(struct codec *c, unsigned stored, const struct scene_image *image)
{
    bool f32 = image->format == SCENE_IMAGE_F32;
    size_t plane = (size_t)image->width * image->height * sample_bytes(image->format);
    float *row = mem_alloc_array(f32 ? image->width : 1, sizeof *row);
    if (!row)
        codec_fail(c, ERR_NOMEM);
    for (uint32_t k = 0; row && k < image->channel_count; k++) {
        const unsigned char *at = stored >> k & 1 ? buf_get(c->in, plane) : NULL;
        if (at && f32)
            get_plane_f32(at, k, row, image);
        else if (at)
            filter_plane_get(at, image->width, image->height, image->channel_count,
                             (unsigned char *)image->pixels + k);
    }
    mem_free(row);
}

/* Sizes, format and stored channels of a picture; the codec has failed if they cannot be. */
static unsigned get_head(struct codec *c, struct scene_image *image)
{
    uint32_t stored = 0;
    codec_u32(c, &image->width);
    codec_u32(c, &image->height);
    codec_u32(c, &image->channel_count);
    codec_enum(c, &image->format, SCENE_IMAGE_U8_LINEAR);
    codec_u32(c, &stored);
    if (c->in->failed || image->width > SCENE_IMAGE_SIDE_MAX ||
        image->height > SCENE_IMAGE_SIDE_MAX || image->channel_count > 4 || stored == 0 ||
        stored >> image->channel_count)
        codec_fail(c, ERR_CORRUPT);
    return stored;
}

/* Bytes of the stored planes: at most 2^15 * 2^15 * 4 samples, no overflow. */
static size_t planes_bytes(const struct scene_image *image, unsigned stored)
{
    return (size_t)image->width * image->height * sample_bytes(image->format) *
           (size_t)__builtin_popcount(stored);
}

/* Zeroed pixels, filled from the planes, which are there. Of four channels, one may have to fill
 * all. */
static void get_pixels(struct codec *c, unsigned stored, struct scene_image *image)
{
    size_t plane = (size_t)image->width * image->height * sample_bytes(image->format);
    image->pixels = mem_calloc(plane, image->channel_count);
    if (image->pixels)
        get_planes(c, stored, image);
    else
        codec_fail(c, ERR_NOMEM);
}

enum err package_image_get(const void *data, size_t bytes, struct scene_image *image)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    struct codec c = {.in = &in};
    codec_magic(&c, image_magic);
    unsigned stored = get_head(&c, image);
    if (c.error == ERR_OK && planes_bytes(image, stored) != buf_left(&in))
        codec_fail(&c, ERR_CORRUPT);
    if (c.error != ERR_OK)
        return c.error;
    get_pixels(&c, stored, image);
    enum err e = codec_end(&c);
    if (e != ERR_OK) {
        mem_free(image->pixels);
        image->pixels = NULL;
    }
    return e;
}

/* --- Bases --------------------------------------------------------------- */

enum err package_base_put(const struct package_base *base, const digest *detail, unsigned stored,
                          struct buf *out)
{
    struct codec c = {.out = out};
    codec_magic(&c, base_magic);
    buf_put(out, detail->bytes, DIGEST_BYTES);
    put_head(&base->picture, stored, out);
    for (uint32_t i = 0; i < base->level_count; i++)
        TL_TRY(put_planes(&base->levels[i], stored, out));
    return codec_end(&c);
}

void package_base_release(struct package_base *base)
{
    for (uint32_t i = 0; i < base->level_count; i++)
        mem_free(base->levels[i].pixels);
    *base = (struct package_base){0};
}

enum err package_base_get(const void *data, size_t bytes, struct package_base *out)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    struct codec c = {.in = &in};
    struct package_base base = {0};
    digest detail;
    codec_magic(&c, base_magic);
    codec_bytes(&c, detail.bytes, DIGEST_BYTES);
    unsigned stored = get_head(&c, &base.picture);
    if (c.error == ERR_OK && !pyramid_can_be_pieces(&base.picture))
        codec_fail(&c, ERR_CORRUPT);
    struct scene_image level = base.picture;
    level.width >>= PYRAMID_PIECE_LEVELS;
    level.height >>= PYRAMID_PIECE_LEVELS;
    while (c.error == ERR_OK) {
        if (planes_bytes(&level, stored) > buf_left(&in)) {
            codec_fail(&c, ERR_CORRUPT);
            break;
        }
        struct scene_image *at = &base.levels[base.level_count++];
        *at = level;
        get_pixels(&c, stored, at);
        if (level.width == 1 && level.height == 1)
            break;
        level.width = pyramid_half(level.width);
        level.height = pyramid_half(level.height);
    }
    enum err e = codec_end(&c);
    if (e == ERR_OK)
        *out = base;
    else
        package_base_release(&base);
    return e;
}
