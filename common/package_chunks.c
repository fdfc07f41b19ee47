/* The chunks of one mesh or one image: arrays and samples to bytes and back, every size and index
 * checked before it is used. Owns the layouts TLYM and TLYI; no state, any thread. */
#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/package_codec.h"

static const char mesh_magic[4] = {'T', 'L', 'Y', 'M'};
static const char image_magic[4] = {'T', 'L', 'Y', 'I'};

enum { MESH_HAS_NORMALS = 1, MESH_HAS_UVS = 2, MESH_POSITIONS_F32 = 4, MESH_FLAGS_ALL = 7 };

/* --- Meshes -------------------------------------------------------------- */

/* Most files hold floats: then four bytes a coordinate lose nothing. */
static bool fits_f32(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if ((double)(float)v[i] != v[i])
            return false;
    return true;
}

static void put_positions(struct buf *out, const struct scene_mesh *m, bool f32)
{
    size_t count = (size_t)m->vertex_count * 3;
    if (!f32) {
        buf_put(out, m->positions, count * sizeof *m->positions);
        return;
    }
    unsigned char *at = buf_extend(out, count * sizeof(float));
    for (size_t i = 0; at && i < count; i++) {
        float v = (float)m->positions[i];
        memcpy(at + i * sizeof v, &v, sizeof v);
    }
}

enum err package_mesh_put(const struct scene_mesh *m, struct buf *out)
{
    struct codec c = {.out = out};
    size_t vertices = m->vertex_count;
    bool f32 = fits_f32(m->positions, vertices * 3);
    uint32_t flags = (m->normals ? MESH_HAS_NORMALS : 0u) | (m->uvs ? MESH_HAS_UVS : 0u) |
                     (f32 ? MESH_POSITIONS_F32 : 0u);
    codec_magic(&c, mesh_magic);
    buf_put_u32(out, m->vertex_count);
    buf_put_u32(out, m->triangle_count);
    buf_put_u32(out, flags);
    put_positions(out, m, f32);
    if (m->normals)
        buf_put(out, m->normals, vertices * 3 * sizeof(float));
    if (m->uvs)
        buf_put(out, m->uvs, vertices * 2 * sizeof(float));
    buf_put(out, m->indices, (size_t)m->triangle_count * 3 * sizeof(uint32_t));
    return codec_end(&c);
}

/* Memory for `count` items copied from the reader; NULL with an error noted. Nothing is allocated
 * that the bytes left do not fill. */
static void *get_array(struct codec *c, size_t count, size_t item_bytes)
{
    if (c->error != ERR_OK)
        return NULL;
    const unsigned char *at =
        count <= buf_left(c->in) / item_bytes ? buf_get(c->in, count * item_bytes) : NULL;
    if (!at) {
        codec_fail(c, ERR_CORRUPT);
        return NULL;
    }
    void *copy = mem_alloc_array(count, item_bytes);
    if (!copy)
        codec_fail(c, ERR_NOMEM);
    else if (count)
        memcpy(copy, at, count * item_bytes);
    return copy;
}

static double *get_positions(struct codec *c, size_t count, bool f32)
{
    if (!f32)
        return get_array(c, count, sizeof(double));
    float *narrow = get_array(c, count, sizeof *narrow);
    double *wide = narrow ? mem_alloc_array(count, sizeof *wide) : NULL;
    if (narrow && !wide)
        codec_fail(c, ERR_NOMEM);
    for (size_t i = 0; wide && i < count; i++)
        wide[i] = (double)narrow[i];
    mem_free(narrow);
    return wide;
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
    m->positions = get_positions(&c, vertices * 3, (flags & MESH_POSITIONS_F32) != 0);
    if (flags & MESH_HAS_NORMALS)
        m->normals = get_array(&c, vertices * 3, sizeof(float));
    if (flags & MESH_HAS_UVS)
        m->uvs = get_array(&c, vertices * 2, sizeof(float));
    m->indices = get_array(&c, (size_t)m->triangle_count * 3, sizeof(uint32_t));
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

enum err package_image_put(const struct scene_image *image, struct buf *out)
{
    struct codec c = {.out = out};
    size_t samples = (size_t)image->width * image->height * image->channel_count;
    codec_magic(&c, image_magic);
    buf_put_u32(out, image->width);
    buf_put_u32(out, image->height);
    buf_put_u32(out, image->channel_count);
    buf_put_u32(out, (uint32_t)image->format);
    buf_put(out, image->pixels, samples * sample_bytes(image->format));
    return codec_end(&c);
}

enum err package_image_get(const void *data, size_t bytes, struct scene_image *image)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    struct codec c = {.in = &in};
    codec_magic(&c, image_magic);
    codec_u32(&c, &image->width);
    codec_u32(&c, &image->height);
    codec_u32(&c, &image->channel_count);
    codec_enum(&c, &image->format, SCENE_IMAGE_U8_LINEAR);
    if (in.failed || image->width > SCENE_IMAGE_SIDE_MAX || image->height > SCENE_IMAGE_SIDE_MAX ||
        image->channel_count > 4)
        codec_fail(&c, ERR_CORRUPT);
    /* At most 2^15 * 2^15 * 4 samples: no overflow. */
    size_t samples =
        c.error == ERR_OK ? (size_t)image->width * image->height * image->channel_count : 0;
    image->pixels = get_array(&c, samples, sample_bytes(image->format));
    enum err e = codec_end(&c);
    if (e != ERR_OK) {
        mem_free(image->pixels);
        image->pixels = NULL;
    }
    return e;
}
