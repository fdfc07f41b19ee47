/* How much memory a scene takes in a worker, by what its plan keeps. Owns the bytes that trees and
 * tables were measured to take; no state, any thread. */
#include "common/scene_plan.h"

#include <float.h>

/* Of the wide tree: blocks of four triangles at 160 bytes, seldom full, and their nodes. Measured
 * on the models of docs/SPECIALISE.md. */
static const double TREE_BYTES_PER_TRIANGLE = 55;

/* With blocks of 64 bytes (docs/TRACING.md). */
static const double COMPACT_BYTES_PER_TRIANGLE = 29;

/* A light's row in the table, with its place in the distribution; of a sky that is a picture per
 * cell, of which there are as many across as texels within the bounds, and for its choice at
 * normals. */
enum {
    LIGHT_BYTES = 344,
    SKY_BYTES_PER_CELL = 8,
    SKY_CELLS_MIN = 128,
    SKY_CELLS_MAX = 2048,
    SKY_CHOICE_BYTES = 1300000,
};

/* What tables are cut from comes in blocks of this; rows of them. */
enum { BLOCK_BYTES = 1 << 18, OBJECT_BYTES = 480, MATERIAL_BYTES = 832, TEXTURE_BYTES = 176 };

static bool object_emits(const struct scene *s, const struct scene_object *o)
{
    const double *e = o->material == SCENE_NONE ? NULL : s->materials[o->material].emission;
    return o->emits || (e && (e[0] > 0 || e[1] > 0 || e[2] > 0));
}

static bool is_instanced(const struct scene *s, const struct scene_plan *p,
                         const struct scene_object *o)
{
    return p->meshes[o->mesh].uses > 1 && !object_emits(s, o) &&
           s->meshes[o->mesh].triangle_count >= SCENE_INSTANCE_TRIANGLES_MIN;
}

static uint64_t image_bytes(const struct scene_image *image, unsigned read)
{
    uint64_t channels = image->channel_count;
    if (channels == 4 && !(read & SCENE_CHANNEL_A))
        channels = 3;
    if (channels == 3 && (read & (read - 1)) == 0)
        channels = 1;
    return (uint64_t)image->width * image->height * channels *
           (image->format == SCENE_IMAGE_F32 ? sizeof(float) : 1);
}

/* Levels of averages take a third more. */
static bool has_pyramid(const struct scene *s, const struct scene_plan *p, size_t image)
{
    for (uint32_t i = 0; i < s->texture_count; i++) {
        const struct scene_texture *t = &s->textures[i];
        if (p->textures[i] && t->type == SCENE_TEXTURE_IMAGE && t->image == image &&
            t->filter == SCENE_FILTER_MIPMAP && i != s->envmap.texture)
            return true;
    }
    return false;
}

/* Positions, normals and indices of one placement of a mesh. */
static uint64_t placed_bytes(const struct scene_mesh *m)
{
    return m->vertex_count * (m->normals ? UINT64_C(24) : UINT64_C(12)) +
           m->triangle_count * UINT64_C(12);
}

static void add_objects(const struct scene *s, const struct scene_plan *p,
                        struct scene_plan_memory *out)
{
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (!p->objects[i])
            continue;
        bool mesh = o->type == SCENE_OBJECT_MESH;
        if (object_emits(s, o))
            out->lights += LIGHT_BYTES * (mesh ? s->meshes[o->mesh].triangle_count : UINT64_C(1));
        if (!mesh || is_instanced(s, p, o))
            continue;
        out->triangles += s->meshes[o->mesh].triangle_count;
        out->geometry += placed_bytes(&s->meshes[o->mesh]);
    }
}

static void add_meshes(const struct scene *s, const struct scene_plan *p,
                       struct scene_plan_memory *out)
{
    for (size_t i = 0; i < s->mesh_count; i++) {
        const struct scene_mesh *m = &s->meshes[i];
        if (p->meshes[i].uvs)
            out->geometry += m->vertex_count * UINT64_C(8);
        if (p->meshes[i].colors)
            out->geometry += m->vertex_count * UINT64_C(12);
        if (p->meshes[i].alphas)
            out->geometry += m->vertex_count * UINT64_C(4);
        if (p->meshes[i].uses < 2 || m->triangle_count < SCENE_INSTANCE_TRIANGLES_MIN)
            continue;
        out->triangles += m->triangle_count;
        out->geometry += placed_bytes(m);
    }
}

struct scene_plan_memory scene_plan_memory(const struct scene *scene, const struct scene_plan *p)
{
    struct scene_plan_memory out = {0};
    add_objects(scene, p, &out);
    add_meshes(scene, p, &out);
    for (size_t i = 0; i < scene->image_count; i++) {
        uint64_t bytes = p->channels[i] ? image_bytes(&scene->images[i], p->channels[i]) : 0;
        out.images += bytes && has_pyramid(scene, p, i) ? bytes + bytes / 3 : bytes;
    }
    out.lights += scene->light_count * LIGHT_BYTES;
    const struct scene_texture *sky =
        scene->envmap.texture == SCENE_NONE ? NULL : &scene->textures[scene->envmap.texture];
    if (sky && sky->type == SCENE_TEXTURE_IMAGE) {
        const struct scene_image *image = &scene->images[sky->image];
        uint64_t cells = image->width < SKY_CELLS_MAX ? image->width : SKY_CELLS_MAX;
        cells = cells > SKY_CELLS_MIN ? cells : SKY_CELLS_MIN;
        out.lights += cells * cells / 2 * SKY_BYTES_PER_CELL + SKY_CHOICE_BYTES;
    }
    bool compact = out.triangles >= SCENE_COMPACT_TRIANGLES_MIN;
    out.tree = (uint64_t)((double)out.triangles *
                          (compact ? COMPACT_BYTES_PER_TRIANGLE : TREE_BYTES_PER_TRIANGLE));
    uint64_t rows = OBJECT_BYTES * scene->object_count + MATERIAL_BYTES * scene->material_count +
                    TEXTURE_BYTES * scene->texture_count;
    uint64_t tables = rows + out.geometry + out.images + out.lights;
    out.total = out.tree + (tables > BLOCK_BYTES ? tables : BLOCK_BYTES);
    return out;
}

/* --- Trees that wait for a ray ------------------------------------------- */

struct box {
    double low[3], high[3];
};

static const struct box nothing = {{DBL_MAX, DBL_MAX, DBL_MAX}, {-DBL_MAX, -DBL_MAX, -DBL_MAX}};

static void box_add(struct box *b, const double p[3])
{
    for (int k = 0; k < 3; k++) {
        b->low[k] = p[k] < b->low[k] ? p[k] : b->low[k];
        b->high[k] = p[k] > b->high[k] ? p[k] : b->high[k];
    }
}

static double box_area(const struct box *b)
{
    double x = b->high[0] - b->low[0], y = b->high[1] - b->low[1], z = b->high[2] - b->low[2];
    return x * y + y * z + z * x;
}

static struct box box_of(const struct scene_object *o, const struct scene_mesh *m)
{
    struct box b = nothing;
    for (size_t v = 0; v < m->vertex_count; v++) {
        const double *p = m->positions + 3 * v;
        double at[3];
        for (int r = 0; r < 3; r++) {
            const double *row = o->transform + (size_t)r * 4;
            at[r] = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
        }
        box_add(&b, at);
    }
    return b;
}

/* Triangles that lie in the scene's own space. */
static uint64_t plain_triangles(const struct scene *s, const struct scene_plan *p, size_t object)
{
    const struct scene_object *o = &s->objects[object];
    bool plain = p->objects[object] && o->type == SCENE_OBJECT_MESH && !is_instanced(s, p, o);
    return plain ? s->meshes[o->mesh].triangle_count : 0;
}

struct scene_plan_lazy scene_plan_lazy(const struct scene *scene, const struct scene_plan *p)
{
    struct scene_plan_lazy out = {0};
    struct box all = nothing;
    uint64_t total = 0;
    double areas = 0;
    for (size_t i = 0; i < scene->object_count; i++)
        total += plain_triangles(scene, p, i);
    for (size_t i = 0; i < scene->object_count; i++) {
        uint64_t triangles = plain_triangles(scene, p, i);
        if (triangles < SCENE_LAZY_TRIANGLES_MIN ||
            triangles > total / SCENE_LAZY_SHARE_MAX_INVERSE)
            continue;
        const struct scene_object *o = &scene->objects[i];
        struct box b = box_of(o, &scene->meshes[o->mesh]);
        box_add(&all, b.low);
        box_add(&all, b.high);
        areas += box_area(&b);
        out.objects++;
        out.triangles += triangles;
    }
    bool pays = scene_lazy_pays(out.objects, out.triangles, total, areas, box_area(&all));
    return pays ? out : (struct scene_plan_lazy){0};
}
