/* Emitting triangles, spheres, lights without a surface and the sky to one table to draw from.
 * Owns their powers; memory is the scene's arena. One thread. */
#include "worker/scene/scene_parts.h"

#include "common/dmath.h"
#include "worker/render/warp.h"

/* The least that a light counts that is not the same everywhere, of what it would if it were. */
static const double SURFACE_FLOOR = 0.01;

/* So many lights with a place are chosen by a tree. */
enum { TREE_LIGHTS_MIN = 2 };

/* Two triangles of a mesh count as one parallelogram when the fourth corner is off by no more than
 * this many units in the last place of the coordinates. */
enum { QUAD_ULPS = 8 };

static const double FLOAT_ULP = 1.0 / 8388608.0;

/* Positions of lights are rounded in double this often at most. */
static const double POINT_ERROR = 32.0 / 9007199254740992.0;

static vec3 vertex_of(const struct render_mesh *m, size_t triangle, int corner)
{
    const float *p = m->positions + 3 * (size_t)m->indices[3 * triangle + (size_t)corner];
    return v3((double)p[0], (double)p[1], (double)p[2]);
}

/* The light that a triangle is; false when it has no area. */
static bool triangle_light(const struct render_mesh *m, size_t triangle, rgb radiance,
                           struct light *out)
{
    vec3 v0 = vertex_of(m, triangle, 0);
    vec3 e1 = v3_sub(vertex_of(m, triangle, 1), v0), e2 = v3_sub(vertex_of(m, triangle, 2), v0);
    vec3 n = v3_cross(e1, e2);
    double length = v3_length(n);
    if (!(length > 0))
        return false;
    double size = v3_abs_max(v0) + v3_abs_max(e1) + v3_abs_max(e2);
    *out = (struct light){.type = LIGHT_TRIANGLE,
                          .radiance = radiance,
                          .v0 = v0,
                          .e1 = e1,
                          .e2 = e2,
                          .n = v3_scale(n, 1 / length),
                          .area = 0.5 * length,
                          .error = POINT_ERROR * size};
    return true;
}

/* Makes `l`, the light of triangle t, that of the parallelogram with triangle t + 1, if they make
 * one and face the same way. */
static bool quad_light(const struct render_mesh *m, size_t t, struct light *l)
{
    struct light other;
    if (!triangle_light(m, t + 1, l->radiance, &other) || v3_dot(l->n, other.n) < 1 - 1e-12)
        return false;
    for (int k = 0; k < 3; k++) {
        vec3 corner = vertex_of(m, t, k);
        vec3 a = vertex_of(m, t, (k + 1) % 3), b = vertex_of(m, t, (k + 2) % 3);
        vec3 fourth = v3_sub(v3_add(a, b), corner);
        double size = v3_abs_max(a) + v3_abs_max(b) + v3_abs_max(corner);
        for (int j = 0; j < 3; j++) {
            vec3 off = v3_sub(vertex_of(m, t + 1, j), fourth);
            vec3 c = vertex_of(m, t + 1, (j + 1) % 3), d = vertex_of(m, t + 1, (j + 2) % 3);
            bool shared = v3_abs_max(v3_sub(c, b)) == 0 && v3_abs_max(v3_sub(d, a)) == 0;
            if (!shared || !(v3_abs_max(off) <= QUAD_ULPS * FLOAT_ULP * size))
                continue;
            l->type = LIGHT_QUAD;
            l->v0 = corner;
            l->e1 = v3_sub(a, corner);
            l->e2 = v3_sub(b, corner);
            l->area *= 2;
            l->error += v3_abs_max(off);
            return true;
        }
    }
    return false;
}

/* Mean luminance of a light that is not the same everywhere, from a few points; never zero, since
 * what the points miss may shine. */
static double surface_luminance(const struct light *l)
{
    enum { SIDE = 4 };
    double sum = 0;
    for (int k = 0; k < SIDE * SIDE; k++) {
        double u = (k % SIDE + 0.5) / SIDE, v = (k / SIDE + 0.5) / SIDE, b1, b2;
        warp_triangle(u, v, &b1, &b2);
        rgb sent = l->type == LIGHT_SPHERE ? light_sphere_emission(l, warp_sphere(u, v))
                                           : light_emission(l, b1, b2);
        sum += rgb_luminance(sent);
    }
    double floor_value = SURFACE_FLOOR * rgb_luminance(l->radiance);
    double mean = sum / (SIDE * SIDE);
    return mean > floor_value ? mean : floor_value;
}

/* The picture in which the opacity of an object differs from point to point; NULL: in none. */
static const struct texture *opacity_picture(const struct render_scene *rs,
                                             const struct render_object *o)
{
    const struct material *m = &rs->materials[o->material];
    if (!m->has_alpha || m->texture == SCENE_NONE)
        return NULL;
    const struct texture *t = &rs->textures[m->texture];
    return t->type == SCENE_TEXTURE_IMAGE && !t->image->opaque ? t : NULL;
}

/* The opacities of the vertices of an object, if they count. */
static const float *opacity_vertices(const struct render_scene *rs, const struct render_object *o)
{
    const struct material *m = &rs->materials[o->material];
    bool counts = o->type != ACCEL_SPHERE && m->has_alpha && m->vertex_colors;
    return counts ? rs->meshes[o->mesh].alphas : NULL;
}

/* What an object sends out where it emits all it can: its opacity is a part of that if it is the
 * same everywhere. */
static rgb radiance_of(const struct render_scene *rs, const struct render_object *o)
{
    const struct material *m = &rs->materials[o->material];
    if (!m->has_alpha || opacity_picture(rs, o) || opacity_vertices(rs, o))
        return o->radiance;
    return rgb_scale(o->radiance, material_opacity(m, 1));
}

/* What differs over an object; its corners are for the triangles to set. False if nothing. */
static bool surface_of(const struct render_scene *rs, const struct render_object *o,
                       struct light_surface *out)
{
    *out = (struct light_surface){.color = opacity_picture(rs, o),
                                  .has_alphas = opacity_vertices(rs, o),
                                  .has_colors = o->emission_colors};
    if (o->emission_texture != SCENE_NONE)
        out->emission = &rs->textures[o->emission_texture];
    if (out->color || out->has_alphas)
        out->material = &rs->materials[o->material];
    return out->emission || out->material || out->has_colors;
}

/* Sets what is a triangle's own. */
static void set_corners(const struct render_mesh *m, size_t triangle, struct light_surface *s)
{
    for (size_t k = 0; k < 3; k++) {
        size_t vertex = m->indices[3 * triangle + k];
        if (m->uvs) {
            s->uv[2 * k] = m->uvs[2 * vertex];
            s->uv[2 * k + 1] = m->uvs[2 * vertex + 1];
        }
        if (s->has_alphas)
            s->alphas[k] = m->alphas[vertex];
        if (s->has_colors)
            memcpy(s->colors + 3 * k, m->colors + 3 * vertex, 3 * sizeof *s->colors);
    }
}

/* Appends the lights of an emitting mesh; light_of[triangle] names each triangle's. */
static enum err add_mesh_lights(struct render_scene *rs, const struct render_object *o,
                                uint32_t *light_of)
{
    struct light_table *table = &rs->lights;
    const struct render_mesh *m = &rs->meshes[o->mesh];
    rgb radiance = radiance_of(rs, o);
    bool twosided = o->emission_twosided;
    struct light_surface all, *surfaces = NULL;
    if (surface_of(rs, o, &all)) {
        surfaces = arena_alloc(&rs->arena, m->triangle_count, sizeof *surfaces);
        if (!surfaces)
            return ERR_NOMEM;
    }
    for (size_t t = 0; t < m->triangle_count; t++) {
        struct light *l = &table->lights[table->count];
        light_of[t] = SCENE_NONE;
        if (!triangle_light(m, t, radiance, l))
            continue;
        l->twosided = twosided;
        light_of[t] = (uint32_t)table->count;
        if (surfaces) {
            surfaces[t] = all;
            set_corners(m, t, &surfaces[t]);
            l->surface = &surfaces[t];
        } else if (t + 1 < m->triangle_count && quad_light(m, t, l)) {
            light_of[++t] = (uint32_t)table->count;
        }
        table->count++;
    }
    return ERR_OK;
}

static enum err add_sphere_light(struct render_scene *rs, const struct render_object *o)
{
    struct light *l = &rs->lights.lights[rs->lights.count++];
    struct light_surface all, *surface = NULL;
    if (surface_of(rs, o, &all)) {
        surface = arena_alloc(&rs->arena, 1, sizeof *surface);
        if (!surface)
            return ERR_NOMEM;
        *surface = all;
    }
    *l = (struct light){.type = LIGHT_SPHERE,
                        .radiance = radiance_of(rs, o),
                        .surface = surface,
                        .v0 = o->center,
                        .radius = o->radius,
                        .area = 4 * VEC_PI * o->radius * o->radius,
                        .error = POINT_ERROR * (v3_abs_max(o->center) + o->radius)};
    return ERR_OK;
}

static struct light punctual_light(const struct render_scene *rs, const struct scene_light *from)
{
    double scale2 = rs->scale * rs->scale;
    bool distant = from->type == SCENE_LIGHT_DIRECTIONAL;
    vec3 at = v3_scale(v3_sub(v3_of(from->position), v3_of(rs->center)), rs->scale);
    return (struct light){.type = distant                          ? LIGHT_DISTANT
                                  : from->type == SCENE_LIGHT_SPOT ? LIGHT_SPOT
                                                                   : LIGHT_POINT,
                          .radiance = rgb_scale(rgb_of(from->intensity), distant ? 1 : scale2),
                          .v0 = at,
                          .n = distant || from->type == SCENE_LIGHT_SPOT
                                   ? v3_unit(v3_of(from->direction))
                                   : v3(0, 0, 1),
                          .cos_inner = from->cos_inner,
                          .cos_outer = from->cos_outer};
}

/* Rough flux into the scene, whose radius is about 1: only its ratios matter. */
static double light_power(const struct light *l, const struct environment *sky)
{
    double value = rgb_luminance(l->radiance);
    switch (l->type) {
    case LIGHT_POINT:
        return 4 * VEC_PI * value;
    case LIGHT_SPOT:
        return 2 * VEC_PI * (1 - 0.5 * (l->cos_inner + l->cos_outer)) * value;
    case LIGHT_DISTANT:
        return VEC_PI * value;
    case LIGHT_ENVIRONMENT: {
        double mean = sky->texture ? sky->map.mean : 1;
        return 4 * VEC_PI * VEC_PI * value * mean;
    }
    default:
        return VEC_PI * l->area * (l->surface ? surface_luminance(l) : value) *
               (l->twosided ? 2 : 1);
    }
}

/* Space for the lights and for each emitting object's primitives. */
static enum err allocate(struct render_scene *rs, const struct scene *scene,
                         uint32_t **object_lights)
{
    size_t primitives = 0;
    for (size_t i = 0; i < rs->object_count; i++) {
        struct render_object *o = &rs->objects[i];
        if (rgb_is_black(radiance_of(rs, o)))
            continue;
        o->light_begin = (uint32_t)primitives;
        primitives += o->type == ACCEL_SPHERE ? 1 : rs->meshes[o->mesh].triangle_count;
        if (primitives >= SCENE_NONE)
            return ERR_LIMIT;
    }
    *object_lights = arena_alloc(&rs->arena, primitives, sizeof **object_lights);
    rs->lights.lights =
        arena_alloc(&rs->arena, primitives + scene->light_count + 1, sizeof *rs->lights.lights);
    rs->object_lights = *object_lights;
    return *object_lights && rs->lights.lights ? ERR_OK : ERR_NOMEM;
}

/* Along the axis of a light with a place. */
static double light_intensity(const struct light *l, double power)
{
    switch (l->type) {
    case LIGHT_POINT:
    case LIGHT_SPOT:
        return rgb_luminance(l->radiance);
    case LIGHT_SPHERE:
        return power / (4 * VEC_PI);
    default:
        return power / (l->twosided ? 2 * VEC_PI : VEC_PI);
    }
}

/* The tree, and the table that draws it or one of the lights without a place, by power. Turns
 * `powers` to intensities. */
static enum err build_tree(struct render_scene *rs, double *powers)
{
    struct light_table *t = &rs->lights;
    double *shares = mem_calloc(t->count + 1, sizeof *shares);
    t->placeless = arena_alloc(&rs->arena, t->count, sizeof *t->placeless);
    enum err e = shares && t->placeless ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; e == ERR_OK && i < t->count; i++) {
        if (light_has_place(&t->lights[i])) {
            shares[0] += powers[i];
            powers[i] = light_intensity(&t->lights[i], powers[i]);
        } else {
            t->placeless[t->placeless_count++] = (uint32_t)i;
            shares[t->placeless_count] = powers[i];
        }
    }
    if (e == ERR_OK)
        e = scene_build_light_tree(rs, powers);
    if (e == ERR_OK)
        e = distribution_1d_init(&t->choice, &rs->arena, shares, t->placeless_count + 1);
    if (e == ERR_OK) {
        t->tree.probability = distribution_1d_probability(&t->choice, 0);
        for (size_t k = 0; k < t->placeless_count; k++)
            t->lights[t->placeless[k]].probability = distribution_1d_probability(&t->choice, k + 1);
    }
    mem_free(shares);
    return e;
}

static bool wants_tree(const struct render_scene *rs, const double *powers)
{
    size_t count = 0;
    for (size_t i = 0; i < rs->lights.count; i++)
        count += light_has_place(&rs->lights.lights[i]) && powers[i] > 0;
    return rs->spec.light_choice == JOB_LIGHT_CHOICE_TREE && count >= TREE_LIGHTS_MIN;
}

/* What lights are drawn by: a tree, or a table in proportion to their power. */
static enum err build_choice(struct render_scene *rs)
{
    struct light_table *t = &rs->lights;
    if (t->count == 0)
        return ERR_OK;
    double *powers = mem_alloc_array(t->count, sizeof *powers);
    if (!powers)
        return ERR_NOMEM;
    bool uniform = rs->spec.light_choice == JOB_LIGHT_CHOICE_UNIFORM;
    for (size_t i = 0; i < t->count; i++)
        powers[i] = uniform ? 1 : light_power(&t->lights[i], &t->environment);
    if (wants_tree(rs, powers)) {
        enum err e = build_tree(rs, powers);
        mem_free(powers);
        return e;
    }
    enum err e = distribution_1d_init(&t->choice, &rs->arena, powers, t->count);
    for (size_t i = 0; e == ERR_OK && i < t->count; i++)
        t->lights[i].probability = distribution_1d_probability(&t->choice, i);
    mem_free(powers);
    return e;
}

enum err scene_build_lights(struct render_scene *rs, const struct scene *scene)
{
    struct light_table *t = &rs->lights;
    uint32_t *object_lights;
    t->environment_light = SCENE_NONE;
    TL_TRY(scene_build_sky(rs, scene));
    TL_TRY(allocate(rs, scene, &object_lights));
    for (size_t i = 0; i < rs->object_count; i++) {
        const struct render_object *o = &rs->objects[i];
        if (o->light_begin == SCENE_NONE)
            continue;
        uint32_t *light_of = object_lights + o->light_begin;
        if (o->type == ACCEL_SPHERE) {
            *light_of = (uint32_t)t->count;
            TL_TRY(add_sphere_light(rs, o));
        } else {
            TL_TRY(add_mesh_lights(rs, o, light_of));
        }
    }
    t->any_lamp = t->count > 0;
    t->any_hittable = t->count > 0 || t->environment.present;
    for (size_t i = 0; i < scene->light_count; i++)
        t->lights[t->count++] = punctual_light(rs, &scene->lights[i]);
    if (t->environment.present) {
        t->environment_light = (uint32_t)t->count;
        t->lights[t->count++] = (struct light){
            .type = LIGHT_ENVIRONMENT,
            .radiance = t->environment.texture ? rgb_grey(1) : t->environment.factor};
    }
    return build_choice(rs);
}
