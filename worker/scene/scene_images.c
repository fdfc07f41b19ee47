/* Images of a scene to what shading reads: tiled copies, and pyramids of averages where a texture
 * is filtered. Memory is the scene's arena, or a late picture's own. One thread an image. */
#include "worker/scene/scene_parts.h"

#include <string.h>

#include "common/pyramid.h"
#include "common/scene_plan.h"
#include "common/texel.h"

/* --- Images ---------------------------------------------------------------- */

void texture_image_levels(const struct scene_image *from, bool pyramid, struct texture_image *out)
{
    uint32_t width = from->width, height = from->height;
    out->format = from->format;
    out->channel_count = from->channel_count;
    out->level_count = 0;
    for (;;) {
        texture_level_init(&out->levels[out->level_count++], width, height);
        if (!pyramid || (width == 1 && height == 1))
            return;
        width = pyramid_half(width);
        height = pyramid_half(height);
    }
}

/* Room for the texels of the levels from `first` on. */
static enum err make_room(struct arena *arena, uint32_t first, struct texture_image *out)
{
    for (uint32_t i = first; i < out->level_count; i++) {
        struct texture_level *level = &out->levels[i];
        level->texels = arena_alloc(arena, texture_level_texels(level),
                                    texel_bytes(out->format, out->channel_count));
        if (!level->texels)
            return ERR_NOMEM;
    }
    return ERR_OK;
}

static void copy_tiled(const struct scene_image *from, const struct texture_level *level)
{
    size_t bytes = texel_bytes(from->format, from->channel_count);
    unsigned char *texels = (void *)level->texels; /* nobody else has seen them yet */
    const unsigned char *row = from->pixels;
    for (uint32_t y = 0; y < from->height; y++, row += from->width * bytes)
        for (uint32_t x = 0; x < from->width; x++)
            memcpy(texels + texture_place(level, x, y) * bytes, row + x * bytes, bytes);
}

/* True if the picture has no opacity, or 1 everywhere. */
static bool is_opaque(const struct scene_image *image)
{
    const float *floats = image->pixels;
    const unsigned char *bytes = image->pixels;
    size_t count = image->channel_count < 4 ? 0 : (size_t)image->width * image->height;
    for (size_t i = 0; i < count; i++)
        if (image->format == SCENE_IMAGE_F32 ? floats[4 * i + 3] != 1 : bytes[4 * i + 3] != 255)
            return false;
    return true;
}

static void round_level(const struct pyramid_level *from, const struct texture_image *image,
                        const struct texture_level *level)
{
    const float *at = from->samples;
    void *texels = (void *)level->texels; /* nobody else has seen them yet */
    for (uint32_t y = 0; y < from->height; y++)
        for (uint32_t x = 0; x < from->width; x++, at += from->channel_count)
            pyramid_round(image->format, from->channel_count, at, texels,
                          texture_place(level, x, y));
}

static enum err fill_pyramid(const struct scene_image *from, bool weighed,
                             const struct texture_image *image)
{
    struct pyramid_level below = {0}, level;
    enum err e = ERR_OK;
    for (uint32_t l = 1; e == ERR_OK && l < image->level_count; l++) {
        e = l == 1 ? pyramid_first(from, weighed, &level) : pyramid_next(&below, weighed, &level);
        mem_free(below.samples);
        below = level;
        if (e == ERR_OK)
            round_level(&level, image, &image->levels[l]);
    }
    mem_free(below.samples);
    return e;
}

static enum err fill(const struct scene_image *from, bool weighed, struct texture_image *image)
{
    copy_tiled(from, &image->levels[0]);
    image->opaque = !weighed || is_opaque(from);
    return fill_pyramid(from, weighed, image);
}

static void mark(const struct scene *scene, uint32_t texture, bool weighed, struct image_use *uses)
{
    if (texture == SCENE_NONE || scene->textures[texture].type != SCENE_TEXTURE_IMAGE)
        return;
    const struct scene_texture *t = &scene->textures[texture];
    uses[t->image].pyramid |= t->filter == SCENE_FILTER_MIPMAP;
    uses[t->image].weighed |= weighed;
}

/* What is looked up where light scatters; opacity and the sky are looked up at points. */
static void mark_uses(const struct scene *scene, struct image_use *uses)
{
    for (size_t i = 0; i < scene->texture_count; i++)
        if (scene->textures[i].type == SCENE_TEXTURE_IMAGE)
            uses[scene->textures[i].image].used = true;
    for (size_t i = 0; i < scene->object_count; i++) {
        const struct scene_object *o = &scene->objects[i];
        if (o->material == SCENE_NONE || scene_object_is_nothing(scene, o))
            continue;
        struct scene_material m = scene_plan_material(&scene->materials[o->material], true);
        mark(scene, m.texture, m.alpha_used, uses);
        mark(scene, m.metallic_roughness_texture, false, uses);
        mark(scene, m.transmission_texture, false, uses);
        mark(scene, m.emission_texture, false, uses);
        mark(scene, m.normal_texture, false, uses);
        mark(scene, m.bump_texture, false, uses);
    }
}

enum err texture_image_make(struct arena *arena, const struct scene_image *from,
                            const struct image_use *use, struct texture_image *out)
{
    *out = (struct texture_image){0};
    texture_image_levels(from, use->pyramid, out);
    TL_TRY(make_room(arena, 0, out));
    return fill(from, use->weighed, out);
}

enum err texture_image_base(struct arena *arena, const struct package_base *from,
                            struct texture_image *out)
{
    TL_ASSERT(out->level_count == PYRAMID_PIECE_LEVELS + from->level_count);
    TL_TRY(make_room(arena, PYRAMID_PIECE_LEVELS, out));
    for (uint32_t i = 0; i < from->level_count; i++)
        copy_tiled(&from->levels[i], &out->levels[PYRAMID_PIECE_LEVELS + i]);
    return ERR_OK;
}

/* A level of a piece from its linear samples. */
static void round_square(const struct scene_image *piece, uint32_t number,
                         const struct pyramid_level *from, void *texels)
{
    const float *at = from->samples;
    for (uint32_t y = 0; y < from->height; y++)
        for (uint32_t x = 0; x < from->width; x++, at += from->channel_count)
            pyramid_round(piece->format, piece->channel_count, at, texels,
                          texture_piece_place(number, x, y));
}

enum err texture_piece_make(struct arena *arena, const struct scene_image *from, uint32_t levels,
                            const void **out)
{
    size_t bytes = texel_bytes(from->format, from->channel_count);
    unsigned char *texels = arena_alloc(arena, texture_piece_texels(levels), bytes);
    const unsigned char *row = from->pixels;
    struct pyramid_level below = {0}, level;
    enum err e = texels ? ERR_OK : ERR_NOMEM;
    for (uint32_t y = 0; texels && y < from->height; y++, row += from->width * bytes)
        for (uint32_t x = 0; x < from->width; x++)
            memcpy(texels + texture_piece_place(0, x, y) * bytes, row + x * bytes, bytes);
    for (uint32_t l = 1; e == ERR_OK && l < levels; l++) {
        e = l == 1 ? pyramid_first(from, false, &level) : pyramid_next(&below, false, &level);
        mem_free(below.samples);
        below = level;
        if (e == ERR_OK)
            round_square(from, l, &level, texels);
    }
    mem_free(below.samples);
    *out = texels;
    return e;
}

/* Images with room for their texels, to be filled by any number of threads. */
struct filling {
    const struct scene *scene;
    const struct image_use *uses;
    struct texture_image *images;
    atomic_bool failed;
};

static void fill_one(void *arg, size_t i)
{
    struct filling *f = arg;
    if (f->images[i].level_count > 0 && f->images[i].levels[0].texels &&
        fill(&f->scene->images[i], f->uses[i].weighed, &f->images[i]) != ERR_OK)
        atomic_store(&f->failed, true);
}

static enum err fill_all(struct render_scene *rs, const struct scene *scene,
                         const struct image_use *uses, const struct accel_runner *runner)
{
    struct filling f = {.scene = scene, .uses = uses, .images = rs->images};
    if (runner && runner->run)
        runner->run(runner->ctx, scene->image_count, fill_one, &f);
    else
        for (size_t i = 0; i < scene->image_count; i++)
            fill_one(&f, i);
    return atomic_load(&f.failed) ? ERR_NOMEM : ERR_OK;
}

enum err scene_build_images(struct render_scene *rs, const struct scene *scene,
                            const struct scene_building *how)
{
    struct image_use *uses = mem_calloc(scene->image_count, sizeof *uses);
    rs->images = arena_alloc(&rs->arena, scene->image_count, sizeof *rs->images);
    rs->image_count = scene->image_count;
    enum err e = uses && rs->images ? scene_late_new(rs, scene, how->late) : ERR_NOMEM;
    if (e == ERR_OK)
        mark_uses(scene, uses);
    for (uint32_t i = 0; e == ERR_OK && i < scene->image_count; i++) {
        if (!uses[i].used)
            continue;
        rs->images[i].number = i;
        if (how->late && how->late[i].late) {
            e = scene_late_leave_out(rs, scene, i, &uses[i], &how->late[i]);
            continue;
        }
        texture_image_levels(&scene->images[i], uses[i].pyramid, &rs->images[i]);
        e = make_room(&rs->arena, 0, &rs->images[i]);
    }
    if (e == ERR_OK)
        e = fill_all(rs, scene, uses, how->runner);
    mem_free(uses);
    return e;
}
