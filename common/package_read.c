/* A package back to a scene: the root's list of chunks, then its tables, then each chunk, as
 * hostile bytes. Owns the half-read scene until it is whole; no state, any thread. */
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/package_codec.h"

void package_index_release(struct package_index *index)
{
    mem_free(index->entries);
    *index = (struct package_index){0};
}

/* --- The root ------------------------------------------------------------ */

static void get_index(struct codec *c, uint32_t mesh_count, uint32_t image_count,
                      struct package_index *index)
{
    size_t count = (size_t)mesh_count + image_count;
    if (mesh_count > SCENE_MESHES_MAX || image_count > SCENE_TEXTURES_MAX)
        codec_fail(c, ERR_LIMIT);
    if (c->in->failed || count > buf_left(c->in) / CODEC_ENTRY_BYTES)
        codec_fail(c, ERR_CORRUPT);
    index->entries = c->error == ERR_OK ? mem_calloc(count, sizeof *index->entries) : NULL;
    if (c->error == ERR_OK && !index->entries)
        codec_fail(c, ERR_NOMEM);
    for (size_t i = 0; c->error == ERR_OK && i < count; i++) {
        struct package_index_entry *entry = &index->entries[i];
        entry->kind = i < mesh_count ? PACKAGE_MESH : PACKAGE_IMAGE;
        codec_bytes(c, entry->name.bytes, DIGEST_BYTES);
        codec_u64(c, &entry->bytes);
        if (entry->bytes > PACKAGE_CHUNK_BYTES_MAX)
            codec_fail(c, ERR_LIMIT);
        index->bytes += entry->bytes;
        index->count++;
    }
}

static void get_mesh_names(struct codec *c, uint32_t mesh_count, struct scene *s)
{
    if (c->error == ERR_OK && mesh_count > buf_left(c->in) / CODEC_NAME_BYTES)
        codec_fail(c, ERR_CORRUPT);
    s->meshes = c->error == ERR_OK ? mem_calloc(mesh_count, sizeof *s->meshes) : NULL;
    if (c->error == ERR_OK && !s->meshes)
        codec_fail(c, ERR_NOMEM);
    for (; c->error == ERR_OK && s->mesh_count < mesh_count; s->mesh_count++)
        codec_name(c, &s->meshes[s->mesh_count].name);
}

/* The tables and the index of a root; meshes have their names, images nothing yet. */
static enum err get_root(const void *root, size_t bytes, struct scene *s,
                         struct package_index *index)
{
    struct buf_reader in = buf_reader_of(root, bytes);
    struct codec c = {.in = &in};
    uint32_t mesh_count = 0, image_count = 0;
    if (bytes > PACKAGE_ROOT_BYTES_MAX)
        return ERR_LIMIT;
    codec_magic(&c, "TLYR");
    codec_u32(&c, &mesh_count);
    codec_u32(&c, &image_count);
    get_index(&c, mesh_count, image_count, index);
    get_mesh_names(&c, mesh_count, s);
    if (c.error == ERR_OK)
        s->images = mem_calloc(image_count, sizeof *s->images);
    if (c.error == ERR_OK && !s->images)
        codec_fail(&c, ERR_NOMEM);
    if (c.error == ERR_OK) {
        s->image_count = image_count;
        codec_scene(&c, s);
    }
    TL_TRY(codec_end(&c));
    return scene_tables_valid(s) ? ERR_OK : ERR_CORRUPT;
}

enum err package_tables_read(const void *root, size_t bytes, struct scene *tables,
                             struct package_index *index)
{
    struct scene s;
    struct package_index list = {0};
    scene_init(&s);
    enum err e = get_root(root, bytes, &s, &list);
    if (e != ERR_OK) {
        scene_release(&s);
        package_index_release(&list);
        return e;
    }
    *tables = s;
    *index = list;
    return ERR_OK;
}

enum err package_root_read(const void *root, size_t bytes, struct package_index *out)
{
    struct scene s;
    TL_TRY(package_tables_read(root, bytes, &s, out));
    scene_release(&s);
    return ERR_OK;
}

/* --- The whole scene ----------------------------------------------------- */

static enum err get_chunk(struct scene *s, size_t i, const void *data, size_t bytes)
{
    if (i < s->mesh_count)
        return package_mesh_get(data, bytes, &s->meshes[i]);
    return package_image_get(data, bytes, &s->images[i - s->mesh_count]);
}

enum err package_part_get(enum package_kind kind, const void *data, size_t bytes,
                          struct package_part *out)
{
    *out = (struct package_part){0};
    TL_TRY(kind == PACKAGE_MESH ? package_mesh_get(data, bytes, &out->mesh)
                                : package_image_get(data, bytes, &out->image));
    out->there = true;
    return ERR_OK;
}

void package_part_release(struct package_part *part)
{
    scene_mesh_release(&part->mesh);
    mem_free(part->image.pixels);
    *part = (struct package_part){0};
}

/* The root has the mesh's name, and the chunk all the rest. */
static void take_part(struct scene *s, size_t i, struct package_part *part)
{
    if (i < s->mesh_count) {
        part->mesh.name = s->meshes[i].name;
        s->meshes[i] = part->mesh;
    } else {
        s->images[i - s->mesh_count] = part->image;
    }
    *part = (struct package_part){0};
}

static enum err get_chunks(struct scene *s, const struct package_index *index,
                           struct package_part *parts, const bool *late, package_fetch *fetch,
                           void *ctx)
{
    for (size_t i = 0; i < index->count; i++) {
        if (late && late[i])
            continue;
        if (parts && parts[i].there) {
            take_part(s, i, &parts[i]);
            continue;
        }
        const unsigned char *data = NULL;
        size_t bytes = 0;
        TL_TRY(fetch(ctx, i, &index->entries[i], &data, &bytes));
        if (bytes != index->entries[i].bytes)
            return ERR_CORRUPT;
        TL_TRY(get_chunk(s, i, data, bytes));
    }
    return scene_valid_without(s, late ? late + s->mesh_count : NULL) ? ERR_OK : ERR_CORRUPT;
}

enum err package_read(const void *root, size_t bytes, package_fetch *fetch, void *ctx,
                      struct scene *out)
{
    return package_read_parts(root, bytes, NULL, NULL, fetch, ctx, out);
}

enum err package_read_parts(const void *root, size_t bytes, struct package_part *parts,
                            const bool *late, package_fetch *fetch, void *ctx, struct scene *out)
{
    struct scene s;
    struct package_index index = {0};
    scene_init(&s);
    enum err e = get_root(root, bytes, &s, &index);
    if (e == ERR_OK)
        e = get_chunks(&s, &index, parts, late, fetch, ctx);
    package_index_release(&index);
    if (e == ERR_OK)
        *out = s;
    else
        scene_release(&s);
    return e;
}
