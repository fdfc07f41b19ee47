/* A package back to a scene: the root's list of chunks, then its tables, then each chunk, as
 * hostile bytes. Owns the half-read scene until it is whole; no state, any thread. */
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/package_codec.h"
#include "common/package_split.h"
#include "common/texel.h"

void package_index_release(struct package_index *index)
{
    mem_free(index->entries);
    mem_free(index->pieces);
    mem_free(index->piece_entries);
    *index = (struct package_index){0};
}

/* --- The root ------------------------------------------------------------ */

/* Counts of a root, in its order. */
struct counts {
    uint32_t meshes, images, pieces;
};

static enum package_kind kind_of(const struct counts *n, size_t i)
{
    return i < n->meshes ? PACKAGE_MESH : i < n->meshes + n->images ? PACKAGE_IMAGE : PACKAGE_PIECE;
}

static void get_index(struct codec *c, const struct counts *n, struct package_index *index)
{
    size_t count = (size_t)n->meshes + n->images + n->pieces;
    if (n->meshes > SCENE_MESHES_MAX || n->images > SCENE_TEXTURES_MAX ||
        n->pieces > PACKAGE_CHUNKS_MAX)
        codec_fail(c, ERR_LIMIT);
    if (c->in->failed || count > buf_left(c->in) / CODEC_ENTRY_BYTES)
        codec_fail(c, ERR_CORRUPT);
    index->entries = c->error == ERR_OK ? mem_calloc(count, sizeof *index->entries) : NULL;
    if (c->error == ERR_OK && !index->entries)
        codec_fail(c, ERR_NOMEM);
    for (size_t i = 0; c->error == ERR_OK && i < count; i++) {
        struct package_index_entry *entry = &index->entries[i];
        entry->kind = kind_of(n, i);
        codec_bytes(c, entry->name.bytes, DIGEST_BYTES);
        codec_u64(c, &entry->bytes);
        if (entry->bytes > PACKAGE_CHUNK_BYTES_MAX)
            codec_fail(c, ERR_LIMIT);
        index->bytes += entry->bytes;
        index->count++;
    }
}

/* The pieces of one image, if it has any, numbered from the first piece's entry on. */
static void get_image(struct codec *c, const struct counts *n, struct scene_image *image,
                      uint32_t *entries, size_t room, struct package_pieces *out)
{
    codec_u32(c, &image->width);
    codec_u32(c, &image->height);
    codec_u32(c, &image->channel_count);
    codec_enum(c, &image->format, SCENE_IMAGE_U8_LINEAR);
    if (c->error == ERR_OK &&
        (c->in->failed || !pyramid_can_be_pieces(image) || image->width > SCENE_IMAGE_SIDE_MAX ||
         image->height > SCENE_IMAGE_SIDE_MAX || image->channel_count == 0 ||
         image->channel_count == 2 || image->channel_count > 4))
        codec_fail(c, ERR_CORRUPT);
    if (c->error != ERR_OK)
        return;
    *out = (struct package_pieces){.across = pyramid_pieces_across(image),
                                   .down = pyramid_pieces_down(image),
                                   .entries = entries};
    if (!entries || (size_t)out->across * out->down > room)
        codec_fail(c, ERR_CORRUPT);
    for (size_t i = 0; c->error == ERR_OK && i < (size_t)out->across * out->down; i++) {
        codec_u32(c, &entries[i]);
        if (c->in->failed || entries[i] >= n->pieces)
            codec_fail(c, ERR_CORRUPT);
        entries[i] += n->meshes + n->images;
    }
}

/* Which images are in pieces, and in which: the bytes left have room for all their numbers. */
static void get_images(struct codec *c, const struct counts *n, struct scene *s,
                       struct package_index *index)
{
    size_t used = 0, room = c->error == ERR_OK ? buf_left(c->in) / sizeof(uint32_t) : 0;
    if (c->error != ERR_OK)
        return;
    s->images = mem_calloc(n->images, sizeof *s->images);
    index->pieces = mem_calloc(n->images, sizeof *index->pieces);
    index->piece_entries = n->pieces > 0 ? mem_alloc_array(room, sizeof(uint32_t)) : NULL;
    if (!s->images || !index->pieces || (n->pieces > 0 && !index->piece_entries)) {
        codec_fail(c, ERR_NOMEM);
        return;
    }
    s->image_count = n->images;
    for (size_t i = 0; c->error == ERR_OK && i < n->images; i++) {
        bool pieces = false;
        codec_bool(c, &pieces);
        if (!pieces)
            continue;
        struct package_pieces *p = &index->pieces[i];
        get_image(c, n, &s->images[i], index->piece_entries ? index->piece_entries + used : NULL,
                  room - used, p);
        used += (size_t)p->across * p->down;
        index->entries[n->meshes + i].kind = PACKAGE_BASE;
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

/* The tables and the index of a root; meshes have their names, images in pieces their sizes. */
static enum err get_root(const void *root, size_t bytes, struct scene *s,
                         struct package_index *index)
{
    struct buf_reader in = buf_reader_of(root, bytes);
    struct codec c = {.in = &in};
    struct counts n = {0};
    if (bytes > PACKAGE_ROOT_BYTES_MAX)
        return ERR_LIMIT;
    codec_magic(&c, "TLYR");
    codec_u32(&c, &n.meshes);
    codec_u32(&c, &n.images);
    codec_u32(&c, &n.pieces);
    get_index(&c, &n, index);
    get_mesh_names(&c, n.meshes, s);
    get_images(&c, &n, s, index);
    if (c.error == ERR_OK)
        codec_scene(&c, s);
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

static enum err check_base(const void *data, size_t bytes)
{
    struct package_base base;
    TL_TRY(package_base_get(data, bytes, &base));
    package_base_release(&base);
    return ERR_OK;
}

enum err package_part_get(enum package_kind kind, const void *data, size_t bytes,
                          struct package_part *out)
{
    *out = (struct package_part){0};
    TL_TRY(kind == PACKAGE_MESH   ? package_mesh_get(data, bytes, &out->mesh)
           : kind == PACKAGE_BASE ? check_base(data, bytes)
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

/* What a scene is read from. */
struct reading {
    const struct package_index *index;
    struct package_part *parts; /* or NULL */
    const bool *late;           /* or NULL */
    package_fetch *fetch;
    void *ctx;
};

static enum err fetch_entry(const struct reading *r, size_t i, const unsigned char **data,
                            size_t *bytes)
{
    TL_TRY(r->fetch(r->ctx, i, &r->index->entries[i], data, bytes));
    return *bytes == r->index->entries[i].bytes ? ERR_OK : ERR_CORRUPT;
}

/* The piece of an entry: the part's, or fetched, then *own. */
static enum err piece_of(const struct reading *r, size_t entry, struct scene_image *out, bool *own)
{
    const unsigned char *data = NULL;
    size_t bytes = 0;
    *own = !(r->parts && r->parts[entry].there);
    if (!*own) {
        *out = r->parts[entry].image;
        return ERR_OK;
    }
    TL_TRY(fetch_entry(r, entry, &data, &bytes));
    return package_image_get(data, bytes, out);
}

/* Into its place of the picture, whose rows reach below it. */
static enum err lay_piece(const struct scene_image *image, uint32_t x, uint32_t y,
                          const struct scene_image *piece)
{
    uint32_t left, top;
    struct scene_image there = pyramid_piece_at(image, x, y, &left, &top);
    if (piece->width != there.width || piece->height != there.height ||
        piece->format != there.format || piece->channel_count != there.channel_count)
        return ERR_CORRUPT;
    size_t texel = texel_bytes(image->format, image->channel_count), row = piece->width * texel;
    unsigned char *to =
        (unsigned char *)image->pixels + ((size_t)top * image->width + left) * texel;
    for (uint32_t i = 0; i < piece->height; i++, to += image->width * texel)
        memcpy(to, (const unsigned char *)piece->pixels + i * row, row);
    return ERR_OK;
}

/* A row of pieces, below those that are there. The picture grows by it once its bytes have come. */
static enum err get_row(const struct reading *r, const struct package_pieces *p, uint32_t y,
                        struct scene_image *image)
{
    enum { ACROSS_MAX = SCENE_IMAGE_SIDE_MAX >> PYRAMID_PIECE_SHIFT };
    struct scene_image pieces[ACROSS_MAX] = {{0}};
    bool own[ACROSS_MAX] = {0};
    enum err e = ERR_OK;
    for (uint32_t x = 0; e == ERR_OK && x < p->across; x++) {
        e = piece_of(r, p->entries[(size_t)y * p->across + x], &pieces[x], &own[x]);
        own[x] = own[x] && e == ERR_OK;
    }
    uint32_t left, top;
    uint32_t height = pyramid_piece_at(image, 0, y, &left, &top).height;
    void *grown = NULL;
    if (e == ERR_OK) {
        grown = mem_realloc_array(image->pixels, (size_t)top + height,
                                  image->width * texel_bytes(image->format, image->channel_count));
        e = grown ? ERR_OK : ERR_NOMEM;
    }
    if (grown)
        image->pixels = grown;
    for (uint32_t x = 0; x < p->across; x++) {
        if (e == ERR_OK)
            e = lay_piece(image, x, y, &pieces[x]);
        if (own[x])
            mem_free(pieces[x].pixels);
    }
    return e;
}

static enum err get_pieces(const struct reading *r, const struct package_pieces *p,
                           struct scene_image *image)
{
    for (uint32_t y = 0; y < p->down; y++)
        TL_TRY(get_row(r, p, y, image));
    return ERR_OK;
}

static enum err get_entry(struct scene *s, const struct reading *r, size_t i)
{
    const unsigned char *data = NULL;
    size_t bytes = 0;
    if (r->index->entries[i].kind == PACKAGE_BASE)
        return get_pieces(r, &r->index->pieces[i - s->mesh_count], &s->images[i - s->mesh_count]);
    if (r->parts && r->parts[i].there) {
        take_part(s, i, &r->parts[i]);
        return ERR_OK;
    }
    TL_TRY(fetch_entry(r, i, &data, &bytes));
    return get_chunk(s, i, data, bytes);
}

static enum err get_chunks(struct scene *s, const struct reading *r)
{
    for (size_t i = 0; i < s->mesh_count + s->image_count; i++)
        if (!r->late || !r->late[i])
            TL_TRY(get_entry(s, r, i));
    return scene_valid_without(s, r->late ? r->late + s->mesh_count : NULL) ? ERR_OK : ERR_CORRUPT;
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
        e = get_chunks(&s, &(struct reading){&index, parts, late, fetch, ctx});
    package_index_release(&index);
    if (e == ERR_OK)
        *out = s;
    else
        scene_release(&s);
    return e;
}
