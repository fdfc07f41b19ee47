#include "tests/bench/trace_scene.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene.h"

const char *const trace_scene_names[TRACE_SCENE_COUNT] = {
    "cornell", "ball70k", "ball1m", "open1m", "needles", "instances", "frame"};
const char *const trace_rays_names[TRACE_RAYS_COUNT] = {"camera", "bounce", "shadow", "random"};

enum { INSTANCES_SIDE = 10, TILE = 16 };

/* --- Scenes ---------------------------------------------------------------- */

static enum err add_instances(struct trace_scene *s)
{
    const double origin[3] = {0, 0, 0};
    const size_t count = INSTANCES_SIDE * INSTANCES_SIDE * INSTANCES_SIDE;
    uint64_t state = 77;
    TL_TRY(gen_ball(&s->mesh[1], 24, origin, 1.0, 0.5, 3));
    struct accel_object *objects = mem_realloc_array(s->objects, count + 1, sizeof *objects);
    if (!objects)
        return ERR_NOMEM;
    s->objects = objects;
    for (size_t i = 0; i < count; i++) {
        struct accel_object *o = &objects[1 + i];
        memset(o, 0, sizeof *o);
        o->type = ACCEL_INSTANCE;
        o->mesh = 1;
        size_t cell[3] = {i % 10, i / 10 % 10, i / 100};
        double angle = gen_random(&state), c = (1.0 - angle * angle) / (1.0 + angle * angle);
        double n = 2.0 * angle / (1.0 + angle * angle), size = 0.04 + 0.06 * gen_random(&state);
        double turn[9] = {c, -n, 0, n, c, 0, 0, 0, 1};
        for (size_t k = 0; k < 3; k++) {
            for (size_t j = 0; j < 3; j++) {
                o->to_scene[4 * k + j] = size * turn[3 * k + j];
                o->from_scene[4 * k + j] = turn[3 * j + k] / size;
            }
            o->to_scene[4 * k + 3] = -0.9 + 0.2 * (double)cell[k];
        }
        for (size_t k = 0; k < 3; k++)
            o->from_scene[4 * k + 3] = -(o->from_scene[4 * k] * o->to_scene[3] +
                                         o->from_scene[4 * k + 1] * o->to_scene[7] +
                                         o->from_scene[4 * k + 2] * o->to_scene[11]);
    }
    s->input.object_count = count + 1;
    return ERR_OK;
}

static enum err make_meshes(struct trace_scene *s, enum trace_scene_id id)
{
    const double origin[3] = {0, 0, 0};
    if (id == TRACE_CORNELL)
        return gen_cornell(&s->mesh[0]);
    if (id != TRACE_OPEN1M)
        TL_TRY(gen_room(&s->mesh[0]));
    if (id == TRACE_BALL70K)
        return gen_ball(&s->mesh[0], 76, origin, 0.6, 0.5, 1);
    if (id == TRACE_NEEDLES)
        return gen_needles(&s->mesh[0], 100000, 0.8, 0.4, 0.002, 5);
    if (id == TRACE_FRAME)
        return gen_frame(&s->mesh[0], 16, 6, 1.2);
    if (id == TRACE_INSTANCES)
        return add_instances(s);
    return gen_ball(&s->mesh[0], 289, origin, 0.6, 0.5, 1);
}

static void view_meshes(struct trace_scene *s)
{
    s->triangle_count = 0;
    for (int i = 0; i < 2; i++) {
        s->views[i] = (struct accel_mesh){s->mesh[i].positions, s->mesh[i].indices,
                                          (uint32_t)s->mesh[i].vertex_count,
                                          (uint32_t)s->mesh[i].triangle_count};
        s->triangle_count += s->mesh[i].triangle_count;
    }
    s->input.meshes = s->views;
    s->input.mesh_count = 2;
    s->input.objects = s->objects;
}

enum err trace_scene_make(struct trace_scene *s, enum trace_scene_id id)
{
    memset(s, 0, sizeof *s);
    s->objects = mem_calloc(1, sizeof *s->objects);
    if (!s->objects)
        return ERR_NOMEM;
    s->input.object_count = 1;
    enum err err = make_meshes(s, id);
    if (err)
        trace_scene_release(s);
    else
        view_meshes(s);
    return err;
}

void trace_scene_wrap(struct trace_scene *s, struct gen_mesh *mesh)
{
    static struct accel_object all = {.type = ACCEL_TRIANGLES};
    memset(s, 0, sizeof *s);
    s->mesh[0] = *mesh;
    gen_mesh_init(mesh);
    view_meshes(s);
    s->input.objects = &all;
    s->input.object_count = 1;
}

void trace_scene_release(struct trace_scene *s)
{
    gen_mesh_release(&s->mesh[0]);
    gen_mesh_release(&s->mesh[1]);
    mem_free(s->objects);
    memset(s, 0, sizeof *s);
}

/* --- Rays ------------------------------------------------------------------ */

static void put(float out[8], const double org[3], const double dir[3], float tnear, float tfar)
{
    for (int k = 0; k < 3; k++) {
        out[k] = (float)org[k];
        out[4 + k] = (float)dir[k];
    }
    out[3] = tnear;
    out[7] = tfar;
}

/* Pixels in squares, as a renderer takes them. */
static void camera_ray(enum trace_scene_id scene, uint32_t side, size_t i, float out[8])
{
    uint32_t row = side / TILE, tile = (uint32_t)(i / (TILE * TILE)), in = i % (TILE * TILE);
    double x = (tile % row * TILE + in % TILE + 0.5) / side * 2.0 - 1.0;
    double y = (tile / row * TILE + in / TILE + 0.5) / side * 2.0 - 1.0;
    double centre = scene == TRACE_CORNELL ? 1.0 : 0.0, size = scene == TRACE_OPEN1M ? 0.2 : 0.27;
    double org[3] = {0, centre, 4.6}, dir[3] = {x * size, y * size, -1.0};
    double length = sqrt(dir[0] * dir[0] + dir[1] * dir[1] + dir[2] * dir[2]);
    for (int k = 0; k < 3; k++)
        dir[k] /= length;
    put(out, org, dir, 0.0f, __builtin_inff());
}

/* A direction around n with density cos / pi: a point of the unit sphere added to n. */
static void cosine_direction(const double n[3], uint64_t *state, double out[3])
{
    double s[3], ss, length = 0.0;
    do {
        ss = 0.0;
        for (int k = 0; k < 3; k++) {
            s[k] = 2.0 * gen_random(state) - 1.0;
            ss += s[k] * s[k];
        }
    } while (ss > 1.0 || ss < 1e-4);
    for (int k = 0; k < 3; k++) {
        out[k] = n[k] + s[k] / sqrt(ss) * 0.999999;
        length += out[k] * out[k];
    }
    for (int k = 0; k < 3; k++)
        out[k] /= sqrt(length);
}

/* From the hit of a camera ray: a bounce, or the segment to a point of a lamp. */
static bool second_ray(const struct accel *a, enum trace_scene_id scene, enum trace_rays_id kind,
                       const float from[8], uint64_t *state, float out[8])
{
    struct trace_rays one = {(float(*)[8])(uintptr_t)from, 1};
    struct ray camera = trace_rays_get(&one, 0);
    struct hit hit;
    accel_closest(a, &camera, &hit);
    if (hit.object == SCENE_NONE)
        return false;
    double org[3], dir[3], length = 0.0, side = 0.0;
    for (int k = 0; k < 3; k++) {
        length += hit.ng[k] * hit.ng[k];
        side += hit.ng[k] * camera.dir[k];
    }
    for (int k = 0; k < 3; k++) {
        hit.ng[k] *= (side > 0.0 ? -1.0 : 1.0) / sqrt(length);
        org[k] = camera.org[k] + hit.t * camera.dir[k] + 1e-5 * hit.ng[k];
    }
    if (kind == TRACE_BOUNCE) {
        cosine_direction(hit.ng, state, dir);
        put(out, org, dir, 0.0f, __builtin_inff());
        return true;
    }
    double top = scene == TRACE_CORNELL ? 1.98 : 0.98;
    double lamp[3] = {0.5 * gen_random(state) - 0.25, top, 0.5 * gen_random(state) - 0.25};
    for (int k = 0; k < 3; k++)
        dir[k] = lamp[k] - org[k];
    put(out, org, dir, 0.0f, 0.9999f);
    return true;
}

static void random_ray(enum trace_scene_id scene, uint64_t *state, float out[8])
{
    double from[3], dir[3], shift = scene == TRACE_CORNELL ? 1.0 : 0.0;
    for (int k = 0; k < 3; k++) {
        from[k] = 2.0 * gen_random(state) - 1.0 + (k == 1 ? shift : 0.0);
        dir[k] = 2.0 * gen_random(state) - 1.0 + (k == 1 ? shift : 0.0) - from[k];
    }
    put(out, from, dir, 0.0f, 1.0f);
}

enum err trace_rays_make(struct trace_rays *r, const struct accel *a, enum trace_scene_id scene,
                         enum trace_rays_id kind, uint32_t side)
{
    size_t total = (size_t)side * side;
    uint64_t state = 1234567 + (uint64_t)kind;
    r->count = 0;
    r->ray = mem_alloc_array(total, sizeof *r->ray);
    if (!r->ray)
        return ERR_NOMEM;
    for (size_t i = 0; i < total; i++) {
        float camera[8];
        camera_ray(scene, side, i, camera);
        if (kind == TRACE_CAMERA)
            memcpy(r->ray[r->count++], camera, sizeof camera);
        else if (kind == TRACE_RANDOM)
            random_ray(scene, &state, r->ray[r->count++]);
        else if (second_ray(a, scene, kind, camera, &state, r->ray[r->count]))
            r->count++;
    }
    return ERR_OK;
}

void trace_rays_release(struct trace_rays *r)
{
    mem_free(r->ray);
    r->ray = NULL;
    r->count = 0;
}
