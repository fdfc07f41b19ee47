/* Late pictures: what is missing, and how one is put in while others render. Owns the memory of
 * those that came; see scene_late.h for the threads. */
#include "worker/scene/scene_late.h"

#include "worker/scene/scene_parts.h"

struct picture {
    struct arena arena; /* of the texels */
    enum package_kind kind;
    struct texture_image image; /* of a base, the levels that it has */
    const void *piece;
    struct picture *next; /* of those in the scene */
};

struct scene_late {
    size_t missing;             /* not there yet */
    size_t end;                 /* numbers: images, then pieces */
    size_t piece_next;          /* the number of the next image's first piece, in building */
    struct picture_need *needs; /* of each number; of those that are not late, nothing is read */
    struct picture *pictures;   /* that came */
    size_t bytes;               /* held by them */
};

/* --- Building ---------------------------------------------------------------- */

static size_t piece_count(const struct late_chunk *from)
{
    return (size_t)from->pieces.across * from->pieces.down;
}

enum err scene_late_new(struct render_scene *rs, const struct scene *scene,
                        const struct late_chunk *late)
{
    size_t count = 0, pieces = 0;
    for (size_t i = 0; late && i < scene->image_count; i++) {
        count += late[i].late;
        pieces += late[i].late ? piece_count(&late[i]) : 0;
    }
    if (count == 0)
        return ERR_OK;
    rs->late = mem_calloc(1, sizeof *rs->late);
    if (!rs->late)
        return ERR_NOMEM;
    rs->late->end = scene->image_count + pieces;
    rs->late->piece_next = scene->image_count;
    rs->late->needs = mem_calloc(rs->late->end, sizeof *rs->late->needs);
    return rs->late->needs ? ERR_OK : ERR_NOMEM;
}

/* An image in pieces: its sides are known, and each piece is needed on its own. */
static enum err leave_pieces(struct render_scene *rs, const struct scene_image *picture,
                             const struct picture_need *whole, const struct late_chunk *from)
{
    struct texture_image *image = &rs->images[whole->image];
    struct scene_late *late = rs->late;
    size_t count = piece_count(from);
    texture_image_levels(picture, whole->pyramid, image);
    image->opaque = true;
    image->piece_levels = whole->pyramid ? PYRAMID_PIECE_LEVELS : 1;
    image->pieces_across = from->pieces.across;
    image->first_number = (uint32_t)late->piece_next;
    image->pieces = arena_alloc(&rs->arena, count, sizeof *image->pieces);
    if (!image->pieces)
        return ERR_NOMEM;
    for (size_t i = 0; i < count; i++) {
        const struct package_index_entry *e = &from->entries[from->pieces.entries[i]];
        struct picture_need *need = &late->needs[late->piece_next + i];
        uint32_t left, top;
        *need = *whole;
        need->number = (uint32_t)(late->piece_next + i);
        need->kind = PACKAGE_PIECE;
        need->name = e->name;
        need->bytes = e->bytes;
        need->is = pyramid_piece_at(picture, (uint32_t)i % from->pieces.across,
                                    (uint32_t)i / from->pieces.across, &left, &top);
    }
    late->piece_next += count;
    late->missing += count;
    return ERR_OK;
}

enum err scene_late_leave_out(struct render_scene *rs, const struct scene *scene, uint32_t image,
                              const struct image_use *use, const struct late_chunk *from)
{
    struct picture_need *need = &rs->late->needs[image];
    bool pieces = piece_count(from) > 0;
    *need = (struct picture_need){.number = image,
                                  .image = image,
                                  .name = from->name,
                                  .bytes = from->bytes,
                                  .kind = pieces ? PACKAGE_BASE : PACKAGE_IMAGE,
                                  .pyramid = use->pyramid,
                                  .weighed = use->weighed};
    if (pieces) {
        need->is = scene->images[image];
        TL_TRY(leave_pieces(rs, &need->is, need, from));
    }
    /* A base has nothing for look-ups at points. */
    bool absent = !pieces || use->pyramid;
    atomic_store_explicit(&rs->images[image].absent, absent, memory_order_relaxed);
    rs->late->missing += absent;
    return ERR_OK;
}

void scene_late_free(struct scene_late *late)
{
    if (!late)
        return;
    while (late->pictures) {
        struct picture *next = late->pictures->next;
        picture_free(late->pictures);
        late->pictures = next;
    }
    mem_free(late->needs);
    mem_free(late);
}

size_t scene_late_bytes(const struct scene_late *late)
{
    return late ? late->bytes : 0;
}

/* --- Pictures ---------------------------------------------------------------- */

static struct picture *picture_new(enum package_kind kind)
{
    struct picture *p = mem_calloc(1, sizeof *p);
    if (p) {
        arena_init(&p->arena);
        p->kind = kind;
    }
    return p;
}

/* Gives the picture on, or frees it. */
static enum err picture_end(struct picture *p, enum err e, struct picture **out)
{
    if (e == ERR_OK)
        *out = p;
    else
        picture_free(p);
    return e;
}

static bool is_alike(const struct scene_image *a, const struct scene_image *b)
{
    return a->width == b->width && a->height == b->height && a->format == b->format &&
           a->channel_count == b->channel_count;
}

enum err picture_make(const struct picture_need *need, const struct scene_image *from,
                      struct picture **out)
{
    bool piece = need->kind == PACKAGE_PIECE;
    TL_ASSERT(need->kind != PACKAGE_BASE);
    if (piece && !is_alike(from, &need->is))
        return ERR_CORRUPT;
    struct picture *p = picture_new(need->kind);
    if (!p)
        return ERR_NOMEM;
    struct image_use use = {.used = true, .pyramid = need->pyramid, .weighed = need->weighed};
    uint32_t levels = need->pyramid ? PYRAMID_PIECE_LEVELS : 1;
    enum err e = piece ? texture_piece_make(&p->arena, from, levels, &p->piece)
                       : texture_image_make(&p->arena, from, &use, &p->image);
    return picture_end(p, e, out);
}

static enum err make_base(const struct picture_need *need, const struct package_base *from,
                          struct picture **out)
{
    if (!is_alike(&from->picture, &need->is))
        return ERR_CORRUPT;
    for (uint32_t i = 0; i < from->level_count; i++)
        if (!scene_image_valid(&from->levels[i]))
            return ERR_CORRUPT;
    struct picture *p = picture_new(need->kind);
    if (!p)
        return ERR_NOMEM;
    texture_image_levels(&need->is, true, &p->image);
    return picture_end(p, texture_image_base(&p->arena, from, &p->image), out);
}

enum err picture_read(const struct picture_need *need, const void *data, size_t bytes,
                      struct picture **out)
{
    struct package_part part;
    struct package_base base;
    enum err e = ERR_CORRUPT;
    if (bytes != need->bytes)
        return ERR_CORRUPT;
    if (need->kind == PACKAGE_BASE) {
        TL_TRY(package_base_get(data, bytes, &base));
        e = make_base(need, &base, out);
        package_base_release(&base);
        return e;
    }
    TL_TRY(package_part_get(PACKAGE_IMAGE, data, bytes, &part));
    if (scene_image_valid(&part.image))
        e = picture_make(need, &part.image, out);
    package_part_release(&part);
    return e;
}

void picture_free(struct picture *p)
{
    if (!p)
        return;
    arena_release(&p->arena);
    mem_free(p);
}

/* --- In a scene -------------------------------------------------------------- */

size_t render_scene_late_count(const struct render_scene *rs)
{
    return rs->late ? rs->late->missing : 0;
}

size_t render_scene_late_end(const struct render_scene *rs)
{
    return rs->late ? rs->late->end : rs->image_count;
}

bool render_scene_is_one(const struct render_scene *a, const struct render_scene *b)
{
    return a->images == b->images;
}

static bool is_absent(const struct render_scene *rs, uint32_t number)
{
    if (!rs->late || number >= rs->late->end)
        return false;
    if (number < rs->image_count)
        return atomic_load_explicit(&rs->images[number].absent, memory_order_relaxed);
    const struct picture_need *need = &rs->late->needs[number];
    const struct texture_image *image = &rs->images[need->image];
    /* Those of images that nothing uses are none. */
    return need->kind == PACKAGE_PIECE &&
           !atomic_load_explicit(&image->pieces[number - image->first_number],
                                 memory_order_relaxed);
}

bool render_scene_need(const struct render_scene *rs, uint32_t number, struct picture_need *out)
{
    if (!is_absent(rs, number))
        return false;
    *out = rs->late->needs[number];
    return true;
}

/* Whoever sees that it is there sees all of it. */
static void put_piece(struct texture_image *to, uint32_t number, const struct picture *picture)
{
    atomic_store_explicit(&to->pieces[number - to->first_number], picture->piece,
                          memory_order_release);
}

/* Of a base the texels alone are put: look-ups that are under way read the sides of its levels. */
static void put_base(struct texture_image *to, const struct texture_image *from)
{
    for (uint32_t i = PYRAMID_PIECE_LEVELS; i < from->level_count; i++)
        to->levels[i].texels = from->levels[i].texels;
    atomic_store_explicit(&to->absent, false, memory_order_release);
}

static void put_image(struct texture_image *to, const struct texture_image *from)
{
    to->format = from->format;
    to->channel_count = from->channel_count;
    to->level_count = from->level_count;
    to->opaque = from->opaque;
    for (uint32_t i = 0; i < from->level_count; i++)
        to->levels[i] = from->levels[i];
    atomic_store_explicit(&to->absent, false, memory_order_release);
}

void render_scene_put(struct render_scene *rs, uint32_t number, struct picture *picture)
{
    if (!is_absent(rs, number)) {
        picture_free(picture);
        return;
    }
    struct texture_image *to = &rs->images[rs->late->needs[number].image];
    TL_ASSERT(picture->kind == rs->late->needs[number].kind);
    if (picture->kind == PACKAGE_PIECE)
        put_piece(to, number, picture);
    else if (picture->kind == PACKAGE_BASE)
        put_base(to, &picture->image);
    else
        put_image(to, &picture->image);
    picture->next = rs->late->pictures;
    rs->late->pictures = picture;
    rs->late->bytes += sizeof *picture + picture->arena.total_bytes;
    rs->late->missing--;
}
