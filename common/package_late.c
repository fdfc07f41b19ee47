/* The rule of late pictures. No state, any thread. */
#include "common/package_late.h"

#include <string.h>

/* The picture that a texture shows is wanted at once. `late` is of the images. */
static void keep_first(const struct scene *s, uint32_t texture, bool *late)
{
    if (texture != SCENE_NONE && s->textures[texture].type == SCENE_TEXTURE_IMAGE)
        late[s->textures[texture].image] = false;
}

size_t package_late_choose(const struct scene *tables, const struct package_index *index,
                           bool *late)
{
    TL_ASSERT(index->count == tables->mesh_count + tables->image_count);
    bool *images = late + tables->mesh_count;
    memset(late, 0, tables->mesh_count * sizeof *late);
    for (size_t i = 0; i < tables->image_count; i++)
        images[i] = index->entries[tables->mesh_count + i].bytes >= PACKAGE_LATE_BYTES_MIN;

    keep_first(tables, tables->envmap.texture, images);
    for (size_t i = 0; i < tables->material_count; i++) {
        const struct scene_material *m = &tables->materials[i];
        keep_first(tables, m->emission_texture, images);
        if (m->alpha_used)
            keep_first(tables, m->texture, images);
    }

    size_t count = 0;
    uint64_t sum = 0;
    for (size_t i = 0; i < tables->image_count; i++) {
        count += images[i];
        sum += images[i] ? index->entries[tables->mesh_count + i].bytes : 0;
    }
    if (count >= PACKAGE_LATE_COUNT_MIN && sum >= PACKAGE_LATE_SUM_MIN)
        return count;
    memset(late, 0, index->count * sizeof *late);
    return 0;
}
