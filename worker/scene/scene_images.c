/* Images of a scene to what shading reads: tiled copies, and pyramids of averages where a texture
 * is filtered. Memory is the scene's arena, or a late picture's own. One thread an image. */
#include "worker/scene/scene_parts.h"

#include <string.h>

#include "common/scene_plan.h"
#include "worker/render/srgb_table.h"

/* --- Texels ---------------------------------------------------------------- */

static size_t sample_bytes(enum scene_image_format format)
{
    return format == SCENE_IMAGE_F32 ? sizeof(float) : 1;
}

/* The code whose light is nearest, the lower of two. */
static unsigned char srgb_code(double light)
{
    unsigned low = 0, high = 255;
    while (low < high) {
        unsigned middle = (low + high) / 2;
        if (light - srgb_table[middle] <= srgb_table[middle + 1] - light)
            high = middle;
        else
            low = middle + 1;
    }
    return (unsigned char)low;
}

static void put_texel(const struct texture_image *image, void *texels, size_t place,
                      const float *linear)
{
    uint32_t count = image->channel_count;
    for (uint32_t k = 0; k < count; k++) {
        double v = (double)linear[k];
        unsigned char *byte = (unsigned char *)texels + place * count + k;
        if (image->format == SCENE_IMAGE_F32)
            ((float *)texels)[place * count + k] = linear[k];
        else if (image->format == SCENE_IMAGE_U8_SRGB && k < 3)
            *byte = srgb_code(v);
        else
            *byte = (unsigned char)(v * 255 + 0.5);
    }
}

/* --- Averages -------------------------------------------------------------- */

/* A level in linear light, row by row. */
struct plane {
    uint32_t width, height;
    float *samples;
};

/* What of a row or column of `from` falls into place i of `to` < from: at most three neighbours,
 * by the share of each that lies in it. Every sample is shared out whole, so means stay. */
struct share {
    uint32_t first, count;
    double weight[3];
};

static struct share share_of(uint32_t i, uint32_t from, uint32_t to)
{
    if (from == to)
        return (struct share){i, 1, {1}};
    struct share s = {.first = 2 * i, .count = 2, .weight = {0.5, 0.5}};
    if (from % 2 == 0)
        return s;
    s.count = 3;
    s.weight[0] = (double)(to - i) / from;
    s.weight[1] = (double)to / from;
    s.weight[2] = (double)(i + 1) / from;
    return s;
}

/* Where a level above comes from: the picture itself, or floats. */
struct source {
    const struct texture_image *image;
    const struct plane *plane; /* NULL: level 0 of the image */
};

static void source_sample(const struct source *s, uint32_t x, uint32_t y, double c[4])
{
    if (!s->plane) {
        texture_texel(s->image, &s->image->levels[0], x, y, c);
        return;
    }
    uint32_t count = s->image->channel_count;
    const float *p = s->plane->samples + ((size_t)y * s->plane->width + x) * count;
    c[3] = 1;
    for (uint32_t k = 0; k < count; k++)
        c[k] = (double)p[k];
}

/* One sample of the next level. Weighed, a colour counts as much as can be seen of it; where
 * nothing can, all count the same. */
static void average(const struct source *from, struct share across, struct share down, bool weighed,
                    float *out)
{
    double plain[4] = {0}, seen[3] = {0}, opacity = 0, whole = 0;
    for (uint32_t j = 0; j < down.count; j++) {
        for (uint32_t i = 0; i < across.count; i++) {
            double c[4], w = across.weight[i] * down.weight[j];
            source_sample(from, across.first + i, down.first + j, c);
            for (int k = 0; k < 4; k++)
                plain[k] += c[k] * w;
            for (int k = 0; k < 3; k++)
                seen[k] += c[k] * w * c[3];
            opacity += w * c[3];
            whole += w;
        }
    }
    /* All opaque is the plain mean, bit for bit. */
    bool by_opacity = weighed && opacity > 0 && opacity < whole;
    for (uint32_t k = 0; k < from->image->channel_count; k++)
        out[k] = (float)(by_opacity && k < 3 ? seen[k] / opacity : plain[k]);
}

/* Fills level `number` from the one above: `above` if it has samples, else the picture. */
static enum err fill_level(struct texture_image *image, uint32_t number, const struct plane *above,
                           bool weighed, struct plane *out)
{
    const struct texture_level *last = &image->levels[number - 1];
    const struct texture_level *level = &image->levels[number];
    uint32_t channels = image->channel_count, width = level->width, height = level->height;
    void *texels = (void *)level->texels; /* nobody else has seen them yet */
    *out = (struct plane){width, height,
                          mem_alloc_array((size_t)width * height * channels, sizeof(float))};
    if (!out->samples)
        return ERR_NOMEM;
    struct source from = {image, above->samples ? above : NULL};
    for (uint32_t y = 0; y < height; y++) {
        struct share down = share_of(y, last->height, height);
        for (uint32_t x = 0; x < width; x++) {
            float *at = out->samples + ((size_t)y * width + x) * channels;
            average(&from, share_of(x, last->width, width), down, weighed, at);
            put_texel(image, texels, texture_place(level, x, y), at);
        }
    }
    return ERR_OK;
}

/* Each level comes from the one above before that was rounded to the picture's format. */
static enum err fill_pyramid(struct texture_image *image, bool weighed)
{
    struct plane above = {0};
    enum err e = ERR_OK;
    for (uint32_t l = 1; e == ERR_OK && l < image->level_count; l++) {
        struct plane next;
        e = fill_level(image, l, &above, weighed, &next);
        mem_free(above.samples);
        above = next;
    }
    mem_free(above.samples);
    return e;
}

/* --- Images ---------------------------------------------------------------- */

/* Room for the texels of all levels. */
static enum err make_room(struct arena *arena, const struct scene_image *from, bool pyramid,
                          struct texture_image *out)
{
    size_t bytes = sample_bytes(from->format) * from->channel_count;
    uint32_t width = from->width, height = from->height;
    *out = (struct texture_image){.format = from->format, .channel_count = from->channel_count};
    for (;;) {
        struct texture_level *level = &out->levels[out->level_count++];
        texture_level_init(level, width, height);
        level->texels = arena_alloc(arena, texture_level_texels(level), bytes);
        if (!level->texels)
            return ERR_NOMEM;
        if (!pyramid || (width == 1 && height == 1))
            return ERR_OK;
        width = width > 1 ? width / 2 : 1;
        height = height > 1 ? height / 2 : 1;
    }
}

static void copy_tiled(const struct scene_image *from, const struct texture_image *image)
{
    size_t bytes = sample_bytes(from->format) * from->channel_count;
    const struct texture_level *level = &image->levels[0];
    unsigned char *texels = (void *)level->texels;
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

static enum err fill(const struct scene_image *from, bool weighed, struct texture_image *image)
{
    copy_tiled(from, image);
    image->opaque = !weighed || is_opaque(from);
    return fill_pyramid(image, weighed);
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
    TL_TRY(make_room(arena, from, use->pyramid, out));
    return fill(from, use->weighed, out);
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
    if (f->images[i].level_count > 0 &&
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
        if (how->late && how->late[i].late)
            scene_late_leave_out(rs, i, &uses[i]);
        else
            e = make_room(&rs->arena, &scene->images[i], uses[i].pyramid, &rs->images[i]);
    }
    if (e == ERR_OK)
        e = fill_all(rs, scene, uses, how->runner);
    mem_free(uses);
    return e;
}
