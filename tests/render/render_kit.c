#include "tests/render/render_kit.h"

#include <string.h>

#include "common/mem.h"
#include "worker/scene/scene_build.h"

static void *append(void *array, size_t *count, size_t bytes)
{
    void *grown = mem_realloc_array(array, *count + 1, bytes);
    TL_ASSERT(grown);
    memset((char *)grown + *count * bytes, 0, bytes);
    (*count)++;
    return grown;
}

uint32_t kit_material(struct scene *s, enum scene_material_type type, struct scene_material **out)
{
    s->materials = append(s->materials, &s->material_count, sizeof *s->materials);
    struct scene_material *m = &s->materials[s->material_count - 1];
    scene_material_init(m);
    m->type = type;
    m->name = mem_strdup("material");
    m->texture = SCENE_NONE;
    for (int k = 0; k < 3; k++)
        m->color[k] = 1;
    if (out)
        *out = m;
    return (uint32_t)(s->material_count - 1);
}

uint32_t kit_diffuse(struct scene *s, double r, double g, double b)
{
    struct scene_material *m;
    uint32_t index = kit_material(s, SCENE_MATERIAL_DIFFUSE, &m);
    m->color[0] = r;
    m->color[1] = g;
    m->color[2] = b;
    return index;
}

uint32_t kit_constant_texture(struct scene *s, double value)
{
    s->textures = append(s->textures, &s->texture_count, sizeof *s->textures);
    struct scene_texture *t = &s->textures[s->texture_count - 1];
    scene_texture_init(t);
    t->name = mem_strdup("texture");
    t->type = SCENE_TEXTURE_CONSTANT;
    for (int k = 0; k < 3; k++)
        t->color[0][k] = value;
    return (uint32_t)(s->texture_count - 1);
}

uint32_t kit_image_texture(struct scene *s, uint32_t image, enum scene_texture_filter filter)
{
    uint32_t texture = kit_constant_texture(s, 1);
    struct scene_texture *t = &s->textures[texture];
    char *name = t->name;
    scene_image_texture_init(t);
    t->name = name;
    t->image = image;
    t->filter = filter;
    return texture;
}

static struct scene_object *object(struct scene *s, enum scene_object_type type, uint32_t material)
{
    s->objects = append(s->objects, &s->object_count, sizeof *s->objects);
    struct scene_object *o = &s->objects[s->object_count - 1];
    scene_object_init(o);
    o->type = type;
    o->mesh = SCENE_NONE;
    o->material = material;
    return o;
}

uint32_t kit_sphere(struct scene *s, double x, double y, double z, double radius, uint32_t material)
{
    struct scene_object *o = object(s, SCENE_OBJECT_SPHERE, material);
    o->center[0] = x;
    o->center[1] = y;
    o->center[2] = z;
    o->radius = radius;
    return (uint32_t)(s->object_count - 1);
}

uint32_t kit_mesh(struct scene *s, const double *positions, uint32_t vertex_count,
                  const uint32_t *indices, uint32_t triangle_count, uint32_t material)
{
    s->meshes = append(s->meshes, &s->mesh_count, sizeof *s->meshes);
    struct scene_mesh *m = &s->meshes[s->mesh_count - 1];
    m->name = mem_strdup("mesh");
    m->vertex_count = vertex_count;
    m->triangle_count = triangle_count;
    m->positions = mem_alloc_array(vertex_count, 3 * sizeof *m->positions);
    m->indices = mem_alloc_array(triangle_count, 3 * sizeof *m->indices);
    TL_ASSERT(m->name && m->positions && m->indices);
    memcpy(m->positions, positions, (size_t)vertex_count * 3 * sizeof *positions);
    memcpy(m->indices, indices, (size_t)triangle_count * 3 * sizeof *indices);
    struct scene_object *o = object(s, SCENE_OBJECT_MESH, material);
    o->mesh = (uint32_t)(s->mesh_count - 1);
    return (uint32_t)(s->object_count - 1);
}

uint32_t kit_quad(struct scene *s, const double corners[12], uint32_t material)
{
    static const uint32_t indices[6] = {0, 1, 2, 0, 2, 3};
    return kit_mesh(s, corners, 4, indices, 2, material);
}

void kit_emit(struct scene *s, uint32_t index, double r, double g, double b)
{
    struct scene_object *o = &s->objects[index];
    o->emits = true;
    o->radiance[0] = r;
    o->radiance[1] = g;
    o->radiance[2] = b;
}

struct scene_light *kit_light(struct scene *s, enum scene_light_type type)
{
    s->lights = append(s->lights, &s->light_count, sizeof *s->lights);
    struct scene_light *l = &s->lights[s->light_count - 1];
    l->type = type;
    l->direction[1] = -1;
    l->intensity[0] = l->intensity[1] = l->intensity[2] = 1;
    l->cos_inner = 0.9;
    l->cos_outer = 0.8;
    return l;
}

void kit_constant_sky(struct scene *s, double radiance)
{
    s->envmap.texture = kit_constant_texture(s, radiance);
    s->envmap.scale = 1;
}

/* A box of five quads from its four bottom corners (x, z) in order. */
static void cornell_block(struct scene *s, const double base[8], double height, double x, double z,
                          uint32_t material)
{
    double p[24];
    for (int k = 0; k < 4; k++) {
        double corner[3] = {base[2 * k] + x, 1e-4, base[2 * k + 1] + z};
        memcpy(p + 3 * k, corner, sizeof corner);
        corner[1] = height;
        memcpy(p + 12 + 3 * k, corner, sizeof corner);
    }
    static const uint32_t indices[30] = {4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6,
                                         1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7};
    /* Both orders of corners occur; the top must face up. */
    uint32_t turned[30];
    double area = 0;
    for (int k = 0; k < 4; k++) {
        int n = (k + 1) % 4;
        area += base[2 * k] * base[2 * n + 1] - base[2 * n] * base[2 * k + 1];
    }
    for (int t = 0; t < 10; t++) {
        turned[3 * t] = indices[3 * t];
        turned[3 * t + 1] = indices[3 * t + (area < 0 ? 1 : 2)];
        turned[3 * t + 2] = indices[3 * t + (area < 0 ? 2 : 1)];
    }
    kit_mesh(s, p, 8, turned, 10, material);
}

static void cornell_disc(struct scene *s)
{
    double p[96];
    uint32_t indices[90];
    for (int k = 0; k < 32; k++) {
        /* Rational points of the circle: no transcendental function needed. */
        double t = (k % 8 + 0.5) / 8, d = 1 + t * t;
        double c = (1 - t * t) / d, v = 2 * t / d;
        const double turn[4][2] = {{c, v}, {-v, c}, {-c, -v}, {v, -c}};
        p[3 * k] = 0.5 * turn[k / 8][0];
        p[3 * k + 1] = 1 + 0.5 * turn[k / 8][1];
        p[3 * k + 2] = 1;
    }
    for (uint32_t k = 0; k < 30; k++) {
        indices[3 * k] = 0;
        indices[3 * k + 1] = k + 1;
        indices[3 * k + 2] = k + 2;
    }
    struct scene_material *m;
    uint32_t material = kit_material(s, SCENE_MATERIAL_REFRACTION, &m);
    m->eta = 2;
    kit_mesh(s, p, 32, indices, 30, material);
}

static void cornell_walls(struct scene *s, uint32_t grey)
{
    static const double floor_quad[12] = {-1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1};
    static const double ceiling[12] = {-1, 2, -1, 1, 2, -1, 1, 2, 1, -1, 2, 1};
    static const double back[12] = {-1, 0, -1, 1, 0, -1, 1, 2, -1, -1, 2, -1};
    static const double left[12] = {-1, 0, -1, -1, 2, -1, -1, 2, 1, -1, 0, 1};
    static const double right[12] = {1, 0, -1, 1, 0, 1, 1, 2, 1, 1, 2, -1};
    kit_quad(s, floor_quad, grey);
    kit_quad(s, ceiling, grey);
    kit_quad(s, back, grey);
    kit_quad(s, left, kit_diffuse(s, 0.63, 0.065, 0.05));
    kit_quad(s, right, kit_diffuse(s, 0.14, 0.45, 0.091));
}

void kit_cornell(struct scene *s, int objects)
{
    static const double camera[3][3] = {{0, 1, 6.8}, {0, 1, 0}, {0, 1, 0}};
    static const double light[3] = {0, 1.5, 0.5}, flux[3] = {17, 12, 5};
    static const double lamp[12] = {-0.25, 1.98, -0.25, 0.25,  1.98, -0.25,
                                    0.25,  1.98, 0.25,  -0.25, 1.98, 0.25};
    static const double small[8] = {-0.04607, -0.573007, 0.124253, -0.003104,
                                    0.703337, -0.176177, 0.533009, -0.746079};
    static const double tall[8] = {0.0495656, 0.108948, -0.523986, -0.0906493,
                                   -0.720444, 0.473882, -0.146892, 0.673479};
    memcpy(s->camera.position, camera[0], sizeof camera[0]);
    memcpy(s->camera.look_at, camera[1], sizeof camera[1]);
    memcpy(s->camera.ref_up, camera[2], sizeof camera[2]);
    s->camera.fov = 19.5;
    memcpy(s->seed_light_position, light, sizeof light);
    memcpy(s->seed_light_flux, flux, sizeof flux);
    uint32_t grey = kit_diffuse(s, 0.725, 0.71, 0.68);
    cornell_walls(s, grey);
    if (objects & KIT_BOXES) {
        cornell_block(s, small, 0.6, -0.7, 0.6, grey);
        cornell_block(s, tall, 1.2, 0.7, -0.5, grey);
    }
    if (objects & KIT_AREA_LIGHT)
        kit_emit(s, kit_quad(s, lamp, SCENE_NONE), 17, 12, 5);
    if (objects & KIT_DISC)
        cornell_disc(s);
    if (objects & KIT_GLASS_SPHERE) {
        struct scene_material *m;
        uint32_t glass = kit_material(s, SCENE_MATERIAL_GLASS, &m);
        static const double R[3] = {0.8, 0.2, 0.7}, T[3] = {0.2, 0.7, 0.8};
        memcpy(m->R, R, sizeof R);
        memcpy(m->T, T, sizeof T);
        kit_sphere(s, 0, 0.6, 0.6, 0.5, glass);
    }
}

struct job_spec kit_spec(uint32_t side, uint64_t spp)
{
    struct job_spec spec;
    job_spec_init(&spec);
    spec.width = spec.height = side;
    spec.crop = (struct job_crop){0, 0, side, side};
    spec.spp = spp;
    return spec;
}

/* Adds a unit's planes to the half's sums, row by row of the crop. */
static void add_unit(struct kit_picture *p, const struct grid *grid, struct unit unit, int half,
                     const float *rgb)
{
    size_t plane = grid_pixels(grid, unit.cell_begin, unit.cell_count), at = 0;
    for (uint32_t c = 0; c < unit.cell_count; c++) {
        struct grid_rect r = grid_cell(grid, unit.cell_begin + c);
        for (uint32_t y = 0; y < r.height; y++) {
            for (uint32_t x = 0; x < r.width; x++, at++) {
                size_t pixel = (size_t)(r.y - grid->crop.y + y) * p->width + r.x - grid->crop.x + x;
                for (size_t k = 0; k < 3; k++)
                    p->half[half][k * p->width * p->height + pixel] += (double)rgb[k * plane + at];
            }
        }
    }
}

static void render_block(struct kit_picture *p, const struct render_scene *scene,
                         const struct grid *grid, uint32_t block, uint32_t cells_per_unit,
                         struct render_scratch *scratch, float *rgb)
{
    for (uint32_t begin = 0; begin < grid->cell_count; begin += cells_per_unit) {
        uint32_t left = grid->cell_count - begin;
        struct unit unit = {begin, left < cells_per_unit ? left : cells_per_unit, block};
        struct render_counters c;
        struct accel_stats before, after;
        render_scene_stats(scene, &before);
        uint64_t calls = mem_call_count();
        enum err e = render_unit(scene, grid, unit, scratch, NULL, rgb, &c);
        TL_ASSERT(e == ERR_OK);
        render_scene_stats(scene, &after);
        /* render_unit allocates nothing but trees that rays meet first. */
        TL_ASSERT(mem_call_count() == calls || after.lazy_built > before.lazy_built);
        p->counters.samples += c.samples;
        p->counters.rays += c.rays;
        if (p->counters.nonfinite == 0) {
            p->counters.nonfinite_pixel = c.nonfinite_pixel;
            p->counters.nonfinite_sample = c.nonfinite_sample;
        }
        p->counters.nonfinite += c.nonfinite;
        add_unit(p, grid, unit, (int)(block & 1), rgb);
    }
}

struct kit_picture kit_render(const struct scene *s, const struct job_spec *spec,
                              uint32_t cells_per_unit)
{
    struct render_scene *scene;
    enum err e = scene_build(s, spec, NULL, &scene);
    TL_ASSERT(e == ERR_OK);
    struct kit_picture p = kit_render_built(scene, spec, cells_per_unit);
    (void)render_scene_free(scene);
    return p;
}

struct kit_picture kit_render_built(const struct render_scene *scene, const struct job_spec *spec,
                                    uint32_t cells_per_unit)
{
    struct render_scratch *scratch;
    struct grid grid;
    enum err e = render_scratch_new(&scratch);
    TL_ASSERT(e == ERR_OK);
    e = grid_init(&grid, spec);
    TL_ASSERT(e == ERR_OK);
    struct kit_picture p = {.width = spec->crop.width, .height = spec->crop.height};
    size_t values = (size_t)p.width * p.height * 3;
    p.mean = mem_calloc(values, sizeof *p.mean);
    p.half[0] = mem_calloc(values, sizeof *p.mean);
    p.half[1] = mem_calloc(values, sizeof *p.mean);
    float *rgb = mem_calloc(values, sizeof *rgb);
    TL_ASSERT(p.mean && p.half[0] && p.half[1] && rgb);
    struct job_blocks blocks = job_blocks_of(spec->spp);
    if (cells_per_unit == 0)
        cells_per_unit = grid.cell_count;
    for (uint32_t b = 0; b < blocks.count; b++)
        render_block(&p, scene, &grid, b, cells_per_unit, scratch, rgb);
    double samples_b = (double)(spec->spp / 2), samples_a = (double)spec->spp - samples_b;
    for (size_t i = 0; i < values; i++) {
        p.mean[i] = (p.half[0][i] + p.half[1][i]) / (double)spec->spp;
        p.half[0][i] /= samples_a;
        p.half[1][i] /= samples_b > 0 ? samples_b : 1;
    }
    mem_free(rgb);
    grid_release(&grid);
    render_scratch_free(scratch);
    return p;
}

void kit_picture_free(struct kit_picture *p)
{
    mem_free(p->mean);
    mem_free(p->half[0]);
    mem_free(p->half[1]);
    *p = (struct kit_picture){0};
}

double kit_picture_mean(const struct kit_picture *p)
{
    double sum = 0;
    size_t values = (size_t)p->width * p->height * 3;
    for (size_t i = 0; i < values; i++)
        sum += p->mean[i];
    return sum / (double)values;
}

uint64_t kit_estimate(const struct scene *s, struct job_spec spec, double *mean, double *variance)
{
    enum { SEEDS = 8 };
    uint64_t nonfinite = 0;
    double sum = 0, sum2 = 0;
    for (uint64_t seed = 1; seed <= SEEDS; seed++) {
        spec.seed = seed;
        struct kit_picture p = kit_render(s, &spec, 0);
        nonfinite += p.counters.nonfinite;
        double v = kit_picture_mean(&p);
        sum += v;
        sum2 += v * v;
        kit_picture_free(&p);
    }
    *mean = sum / SEEDS;
    *variance = (sum2 / SEEDS - *mean * *mean) / (SEEDS - 1);
    return nonfinite;
}
