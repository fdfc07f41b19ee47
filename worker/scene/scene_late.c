/* Late pictures: what is missing, and how one is put in while others render. Owns the memory of
 * those that came; see scene_late.h for the threads. */
#include "worker/scene/scene_late.h"

#include "worker/scene/scene_parts.h"

struct picture {
    struct arena arena; /* of the texels */
    struct texture_image image;
    struct picture *next; /* of those in the scene */
};

struct scene_late {
    size_t count;               /* not there yet */
    struct picture_need *needs; /* of each image; of those that are not late, nothing is read */
    struct picture *pictures;   /* that came */
    size_t bytes;               /* held by them */
};

/* --- Building ---------------------------------------------------------------- */

enum err scene_late_new(struct render_scene *rs, const struct scene *scene,
                        const struct late_chunk *late)
{
    size_t count = 0;
    for (size_t i = 0; late && i < scene->image_count; i++)
        count += late[i].late;
    if (count == 0)
        return ERR_OK;
    rs->late = mem_calloc(1, sizeof *rs->late);
    if (!rs->late)
        return ERR_NOMEM;
    rs->late->needs = mem_calloc(scene->image_count, sizeof *rs->late->needs);
    if (!rs->late->needs)
        return ERR_NOMEM;
    for (uint32_t i = 0; i < scene->image_count; i++)
        if (late[i].late)
            rs->late->needs[i] =
                (struct picture_need){.image = i, .name = late[i].name, .bytes = late[i].bytes};
    return ERR_OK;
}

void scene_late_leave_out(struct render_scene *rs, uint32_t image, const struct image_use *use)
{
    rs->late->needs[image].pyramid = use->pyramid;
    rs->late->needs[image].weighed = use->weighed;
    rs->late->count++;
    atomic_store_explicit(&rs->images[image].absent, true, memory_order_relaxed);
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

enum err picture_make(const struct picture_need *need, const struct scene_image *from,
                      struct picture **out)
{
    struct picture *p = mem_calloc(1, sizeof *p);
    if (!p)
        return ERR_NOMEM;
    arena_init(&p->arena);
    struct image_use use = {.used = true, .pyramid = need->pyramid, .weighed = need->weighed};
    enum err e = texture_image_make(&p->arena, from, &use, &p->image);
    if (e != ERR_OK) {
        picture_free(p);
        return e;
    }
    *out = p;
    return ERR_OK;
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
    return rs->late ? rs->late->count : 0;
}

size_t render_scene_image_count(const struct render_scene *rs)
{
    return rs->image_count;
}

bool render_scene_is_one(const struct render_scene *a, const struct render_scene *b)
{
    return a->images == b->images;
}

static bool is_absent(const struct render_scene *rs, uint32_t image)
{
    return rs->late && image < rs->image_count &&
           atomic_load_explicit(&rs->images[image].absent, memory_order_relaxed);
}

bool render_scene_need(const struct render_scene *rs, uint32_t image, struct picture_need *out)
{
    if (!is_absent(rs, image))
        return false;
    *out = rs->late->needs[image];
    return true;
}

void render_scene_put(struct render_scene *rs, uint32_t image, struct picture *picture)
{
    if (!is_absent(rs, image)) {
        picture_free(picture);
        return;
    }
    struct texture_image *place = &rs->images[image];
    place->format = picture->image.format;
    place->channel_count = picture->image.channel_count;
    place->level_count = picture->image.level_count;
    place->opaque = picture->image.opaque;
    for (uint32_t i = 0; i < picture->image.level_count; i++)
        place->levels[i] = picture->image.levels[i];
    /* Whoever sees that it is there sees all of it. */
    atomic_store_explicit(&place->absent, false, memory_order_release);

    picture->next = rs->late->pictures;
    rs->late->pictures = picture;
    rs->late->bytes += sizeof *picture + picture->arena.total_bytes;
    rs->late->count--;
}
