/* The rule of late pictures. No state, any thread. */
#include "common/package_late.h"

#include <string.h>

/* The picture that a texture shows is wanted at once. `late` is of the images. */
static void keep_first(const struct scene *s, uint32_t texture, bool *late)
{
    if (texture != SCENE_NONE && s->textures[texture].type == SCENE_TEXTURE_IMAGE)
        late[s->textures[texture].image] = false;
}

void package_late_may(const struct scene *tables, bool *may)
{
    for (size_t i = 0; i < tables->image_count; i++)
        may[i] = true;
    keep_first(tables, tables->envmap.texture, may);
    for (size_t i = 0; i < tables->material_count; i++) {
        const struct scene_material *m = &tables->materials[i];
        keep_first(tables, m->emission_texture, may);
        if (m->alpha_used)
            keep_first(tables, m->texture, may);
    }
}

static bool in_pieces(const struct package_index *index, size_t image)
{
    return index->pieces && index->pieces[image].across > 0;
}

/* Of the pictures that are whole, all that are large or none. */
static void choose_whole(const struct scene *tables, const struct package_index *index, bool *late)
{
    const struct package_index_entry *entries = index->entries + tables->mesh_count;
    size_t count = 0;
    uint64_t sum = 0;
    for (size_t i = 0; i < tables->image_count; i++) {
        if (in_pieces(index, i))
            continue;
        late[i] = late[i] && entries[i].bytes >= PACKAGE_LATE_BYTES_MIN;
        count += late[i];
        sum += late[i] ? entries[i].bytes : 0;
    }
    bool pays = count >= PACKAGE_LATE_COUNT_MIN && sum >= PACKAGE_LATE_SUM_MIN;
    for (size_t i = 0; !pays && i < tables->image_count; i++)
        late[i] = late[i] && in_pieces(index, i);
}

/* Pieces come with the first of their pictures that is not late. */
static void choose_pieces(const struct scene *tables, const struct package_index *index, bool *late)
{
    size_t first = tables->mesh_count + tables->image_count;
    memset(late + first, 1, (index->count - first) * sizeof *late);
    for (size_t i = 0; i < tables->image_count; i++) {
        if (!in_pieces(index, i) || late[tables->mesh_count + i])
            continue;
        const struct package_pieces *p = &index->pieces[i];
        for (size_t k = 0; k < (size_t)p->across * p->down; k++)
            late[p->entries[k]] = false;
    }
}

size_t package_late_choose(const struct scene *tables, const struct package_index *index,
                           bool *late)
{
    TL_ASSERT(index->count >= tables->mesh_count + tables->image_count);
    bool *images = late + tables->mesh_count;
    memset(late, 0, tables->mesh_count * sizeof *late);
    package_late_may(tables, images);
    choose_whole(tables, index, images);
    choose_pieces(tables, index, late);
    size_t count = 0;
    for (size_t i = 0; i < tables->image_count; i++)
        count += images[i];
    return count;
}
