#include "common/package_trim.h"

#include <string.h>

#include "common/mem.h"

static void leave(struct package_left *left, enum package_left_kind kind, uint64_t count,
                  uint64_t bytes)
{
    left[kind].count += count;
    left[kind].bytes += bytes;
}

/* --- Meshes -------------------------------------------------------------- */

void package_trim_mesh_release(struct trimmed_mesh *t)
{
    if (t->own_vertices) {
        mem_free(t->mesh.positions);
        mem_free(t->mesh.normals);
        mem_free(t->mesh.uvs);
        mem_free(t->mesh.colors);
        mem_free(t->mesh.alphas);
    }
    if (t->own_indices)
        mem_free(t->mesh.indices);
    *t = (struct trimmed_mesh){0};
}

/* New numbers in the order of first use, by which indices are told shortly; SCENE_NONE for those
 * that no triangle has. */
static uint32_t *number_vertices(const struct scene_mesh *m, uint32_t *used)
{
    uint32_t *map = mem_alloc_array(m->vertex_count, sizeof *map), next = 0;
    if (!map)
        return NULL;
    memset(map, 0xff, (size_t)m->vertex_count * sizeof *map);
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++) {
        uint32_t vertex = m->indices[i];
        if (map[vertex] == SCENE_NONE)
            map[vertex] = next++;
    }
    *used = next;
    return map;
}

static void *pick(const void *items, size_t count, size_t item_bytes, const uint32_t *map,
                  size_t kept)
{
    unsigned char *out = mem_alloc_array(kept, item_bytes);
    for (size_t v = 0; out && v < count; v++)
        if (map[v] != SCENE_NONE)
            memcpy(out + map[v] * item_bytes, (const unsigned char *)items + v * item_bytes,
                   item_bytes);
    return out;
}

static enum err renumber(struct trimmed_mesh *t, const uint32_t *map, uint32_t used)
{
    const struct scene_mesh from = t->mesh;
    struct scene_mesh *to = &t->mesh;
    size_t corners = (size_t)from.triangle_count * 3;
    t->own_vertices = t->own_indices = true;
    to->vertex_count = used;
    to->positions = pick(from.positions, from.vertex_count, 3 * sizeof(double), map, used);
    to->normals =
        from.normals ? pick(from.normals, from.vertex_count, 3 * sizeof(float), map, used) : NULL;
    to->uvs = from.uvs ? pick(from.uvs, from.vertex_count, 2 * sizeof(float), map, used) : NULL;
    to->colors =
        from.colors ? pick(from.colors, from.vertex_count, 3 * sizeof(float), map, used) : NULL;
    to->alphas =
        from.alphas ? pick(from.alphas, from.vertex_count, sizeof(float), map, used) : NULL;
    to->indices = mem_alloc_array(corners, sizeof *to->indices);
    for (size_t i = 0; to->indices && i < corners; i++)
        to->indices[i] = map[from.indices[i]];
    return to->positions && to->indices && (to->normals || !from.normals) &&
                   (to->uvs || !from.uvs) && (to->colors || !from.colors) &&
                   (to->alphas || !from.alphas)
               ? ERR_OK
               : ERR_NOMEM;
}

enum err package_trim_mesh(const struct scene_mesh *m, const struct scene_plan_mesh *plan,
                           struct package_left *left, struct trimmed_mesh *out)
{
    bool same = scene_mesh_in_order(m);
    uint32_t used = m->vertex_count, *map = NULL;
    *out = (struct trimmed_mesh){.mesh = *m};
    if (!same) {
        map = number_vertices(m, &used);
        if (!map)
            return ERR_NOMEM;
    }
    if (!plan->uvs && m->uvs) {
        out->mesh.uvs = NULL;
        leave(left, PACKAGE_LEFT_UVS, m->vertex_count, m->vertex_count * UINT64_C(8));
    }
    if (!plan->colors && m->colors) {
        out->mesh.colors = NULL;
        leave(left, PACKAGE_LEFT_COLORS, m->vertex_count, m->vertex_count * UINT64_C(12));
    }
    if (!plan->alphas && m->alphas) {
        out->mesh.alphas = NULL;
        leave(left, PACKAGE_LEFT_ALPHAS, m->vertex_count, m->vertex_count * UINT64_C(4));
    }
    enum err e = ERR_OK;
    if (used < m->vertex_count) {
        uint64_t gone = m->vertex_count - used;
        uint64_t each = 3 * sizeof(double) + (m->normals ? 3 * sizeof(float) : 0) +
                        (out->mesh.uvs ? 2 * sizeof(float) : 0) +
                        (out->mesh.colors ? 3 * sizeof(float) : 0) +
                        (out->mesh.alphas ? sizeof(float) : 0);
        leave(left, PACKAGE_LEFT_VERTICES, gone, gone * each);
    }
    if (!same)
        e = renumber(out, map, used);
    mem_free(map);
    if (e != ERR_OK)
        package_trim_mesh_release(out);
    return e;
}

/* --- Pictures ------------------------------------------------------------ */

static size_t sample_bytes(const struct scene_image *image)
{
    return image->format == SCENE_IMAGE_F32 ? sizeof(float) : 1;
}

/* Where sample `channel` of a pixel lies. */
static const unsigned char *sample_at(const struct scene_image *image, size_t pixel, size_t channel)
{
    return (const unsigned char *)image->pixels +
           (pixel * image->channel_count + channel) * sample_bytes(image);
}

static bool all_opaque(const struct scene_image *image)
{
    static const float one = 1;
    static const unsigned char full = 255;
    const void *opaque = image->format == SCENE_IMAGE_F32 ? (const void *)&one : &full;
    size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++)
        if (memcmp(sample_at(image, i, 3), opaque, sample_bytes(image)) != 0)
            return false;
    return true;
}

static bool all_grey(const struct scene_image *image)
{
    size_t pixels = (size_t)image->width * image->height, bytes = sample_bytes(image);
    for (size_t i = 0; i < pixels; i++) {
        const unsigned char *p = sample_at(image, i, 0);
        if (memcmp(p, p + bytes, bytes) != 0 || memcmp(p, p + 2 * bytes, bytes) != 0)
            return false;
    }
    return true;
}

/* Channels `first`, ... of the original become all of the copy's. */
static enum err take_channels(struct scene_image *image, bool *own, size_t first, uint32_t count)
{
    struct scene_image out = *image;
    size_t pixels = (size_t)image->width * image->height, bytes = count * sample_bytes(image);
    unsigned char *copy = mem_alloc_array(pixels, bytes);
    if (!copy)
        return ERR_NOMEM;
    for (size_t i = 0; i < pixels; i++)
        memcpy(copy + i * bytes, sample_at(image, i, first), bytes);
    out.pixels = copy;
    out.channel_count = count;
    if (*own)
        mem_free(image->pixels);
    *own = true;
    *image = out;
    return ERR_OK;
}

/* The number of the only bit set, or -1. */
static int only_channel(unsigned read)
{
    for (int k = 0; k < 3; k++)
        if (read == 1u << k)
            return k;
    return -1;
}

enum err package_trim_image(const struct scene_image *image, unsigned channels_read,
                            struct package_left *left, struct scene_image *out, unsigned *stored,
                            bool *own)
{
    uint64_t plane = (uint64_t)image->width * image->height * sample_bytes(image);
    enum err e = ERR_OK;
    *out = *image;
    *own = false;
    if (out->channel_count == 4 && (!(channels_read & SCENE_CHANNEL_A) || all_opaque(out))) {
        bool read = channels_read & SCENE_CHANNEL_A;
        leave(left, read ? PACKAGE_LEFT_OPAQUE : PACKAGE_LEFT_CHANNELS, 1, plane);
        channels_read &= SCENE_CHANNELS_RGB;
        e = take_channels(out, own, 0, 3);
    }
    int only = only_channel(channels_read);
    if (e == ERR_OK && out->channel_count == 3 && only >= 0) {
        leave(left, PACKAGE_LEFT_CHANNELS, 2, 2 * plane);
        e = take_channels(out, own, (size_t)only, 1);
    } else if (e == ERR_OK && out->channel_count == 3 && all_grey(out)) {
        leave(left, PACKAGE_LEFT_GREY, 2, 2 * plane);
        e = take_channels(out, own, 0, 1);
    }
    *stored = (1u << out->channel_count) - 1;
    if (e == ERR_OK && out->channel_count > 1) {
        unsigned unread = *stored & ~channels_read;
        *stored &= ~unread;
        unsigned count = (unsigned)__builtin_popcount(unread);
        leave(left, PACKAGE_LEFT_CHANNELS, count, count * plane);
    }
    if (e != ERR_OK && *own)
        mem_free(out->pixels);
    return e;
}
