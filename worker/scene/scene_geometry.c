/* Meshes and objects of a scene to what the tracer reads: floats around the scene's centre, scaled
 * by a power of two, and instances. Owns the choice of both; memory is the scene's arena. One
 * thread. */
#include "worker/scene/scene_parts.h"

#include <float.h>

#include "common/scene_plan.h"

struct box {
    double low[3], high[3];
};

static const struct box empty_box = {{DBL_MAX, DBL_MAX, DBL_MAX}, {-DBL_MAX, -DBL_MAX, -DBL_MAX}};

static void box_add(struct box *b, vec3 p)
{
    const double v[3] = {p.x, p.y, p.z};
    for (int k = 0; k < 3; k++) {
        b->low[k] = v[k] < b->low[k] ? v[k] : b->low[k];
        b->high[k] = v[k] > b->high[k] ? v[k] : b->high[k];
    }
}

/* The centre of the box and a power of two that brings its half extent into [0.5, 1). False when
 * they are no finite numbers. */
static bool box_normalise(const struct box *b, double center[3], double *scale)
{
    double extent = 0;
    for (int k = 0; k < 3; k++) {
        if (b->low[k] > b->high[k]) { /* nothing at all */
            center[0] = center[1] = center[2] = 0;
            *scale = 1;
            return true;
        }
        center[k] = 0.5 * b->low[k] + 0.5 * b->high[k];
        double half = 0.5 * b->high[k] - 0.5 * b->low[k];
        extent = half > extent ? half : extent;
    }
    int exponent = 0;
    (void)frexp(extent, &exponent);
    *scale = extent > 0 ? ldexp(1.0, exponent > -1000 ? -exponent : 1000) : 1.0;
    return isfinite(extent) && isfinite(center[0] + center[1] + center[2]);
}

/* Rows 0 to 2 of a 4x4. */
static void affine_of(const double transform[16], double out[12])
{
    memcpy(out, transform, 12 * sizeof *out);
}

static vec3 mesh_point(const struct scene_mesh *m, size_t vertex)
{
    return v3_of(m->positions + 3 * vertex);
}

/* Cofactors of the 3x3 part: how normals transform, up to the sign of the determinant, which is
 * returned. */
static double cofactors(const double m[12], double c[9])
{
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++) {
            int r1 = 4 * ((r + 1) % 3), r2 = 4 * ((r + 2) % 3);
            int k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            c[3 * r + k] = m[r1 + k1] * m[r2 + k2] - m[r1 + k2] * m[r2 + k1];
        }
    }
    return m[0] * c[0] + m[1] * c[1] + m[2] * c[2];
}

static void affine_inverse(const double m[12], double out[12])
{
    double c[9];
    double det = cofactors(m, c);
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            out[4 * r + k] = c[3 * k + r] / det;
        out[4 * r + 3] = 0;
    }
    vec3 t = affine_vector(out, v3(m[3], m[7], m[11]));
    out[3] = -t.x;
    out[7] = -t.y;
    out[11] = -t.z;
}

/* What scene_build_geometry keeps of each mesh of the scene. */
struct mesh_use {
    uint32_t uses;
    bool emits;
    bool strays;       /* has vertices that no triangle has: they have no extent */
    bool reads_colors; /* some object's material does */
    bool reads_alphas;
    const float *uvs; /* the arena's copies, once made */
    const float *colors, *alphas;
    uint32_t instanced;      /* its render mesh in mesh space, once made; else SCENE_NONE */
    double center[3], scale; /* of that space */
};

static enum err find_strays(const struct scene_mesh *m, struct mesh_use *use)
{
    if (scene_mesh_in_order(m))
        return ERR_OK;
    bool *seen = mem_calloc(m->vertex_count, sizeof *seen);
    if (!seen)
        return ERR_NOMEM;
    size_t count = 0;
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++) {
        count += !seen[m->indices[i]];
        seen[m->indices[i]] = true;
    }
    use->strays = count < m->vertex_count;
    mem_free(seen);
    return ERR_OK;
}

static void mesh_bounds(const struct scene_mesh *m, const struct mesh_use *use,
                        const double to_world[12], struct box *b)
{
    size_t corners = (size_t)m->triangle_count * 3;
    if (use->strays)
        for (size_t i = 0; i < corners; i++)
            box_add(b, affine_point(to_world, mesh_point(m, m->indices[i])));
    else
        for (size_t v = 0; v < m->vertex_count; v++)
            box_add(b, affine_point(to_world, mesh_point(m, v)));
}

static struct box scene_bounds(const struct scene *scene, const struct mesh_use *uses)
{
    struct box b = empty_box;
    for (size_t i = 0; i < scene->object_count; i++) {
        const struct scene_object *o = &scene->objects[i];
        if (scene_object_is_nothing(scene, o))
            continue;
        if (o->type == SCENE_OBJECT_SPHERE) {
            vec3 r = v3(o->radius, o->radius, o->radius);
            box_add(&b, v3_sub(v3_of(o->center), r));
            box_add(&b, v3_add(v3_of(o->center), r));
            continue;
        }
        double to_world[12];
        affine_of(o->transform, to_world);
        mesh_bounds(&scene->meshes[o->mesh], &uses[o->mesh], to_world, &b);
    }
    return b;
}

/* A mesh being written out: vertices go through to_world, then to `center` and `scale`. */
struct placement {
    double to_world[12];
    double center[3], scale;
};

static const float *place_positions(struct render_scene *rs, const struct scene_mesh *m,
                                    const struct placement *at)
{
    float *out = arena_alloc(&rs->arena, m->vertex_count, 3 * sizeof *out);
    for (size_t v = 0; out && v < m->vertex_count; v++) {
        vec3 p = affine_point(at->to_world, mesh_point(m, v));
        p = v3_scale(v3_sub(p, v3_of(at->center)), at->scale);
        out[3 * v] = (float)p.x;
        out[3 * v + 1] = (float)p.y;
        out[3 * v + 2] = (float)p.z;
    }
    return out;
}

static const float *place_normals(struct render_scene *rs, const struct scene_mesh *m,
                                  const struct placement *at)
{
    double c[9];
    double sign = cofactors(at->to_world, c) < 0 ? -1 : 1;
    float *out = arena_alloc(&rs->arena, m->vertex_count, 3 * sizeof *out);
    for (size_t v = 0; out && v < m->vertex_count; v++) {
        const float *f = m->normals + 3 * v;
        vec3 n = v3((double)f[0], (double)f[1], (double)f[2]);
        n = v3(c[0] * n.x + c[1] * n.y + c[2] * n.z, c[3] * n.x + c[4] * n.y + c[5] * n.z,
               c[6] * n.x + c[7] * n.y + c[8] * n.z);
        double largest = v3_abs_max(n);
        if (!(largest > 0))
            continue;
        n = v3_scale(v3_unit(v3_scale(n, 1 / largest)), sign);
        out[3 * v] = (float)n.x;
        out[3 * v + 1] = (float)n.y;
        out[3 * v + 2] = (float)n.z;
    }
    return out;
}

static vec3 float_point(const float *positions, uint32_t vertex)
{
    const float *p = positions + 3 * (size_t)vertex;
    return v3((double)p[0], (double)p[1], (double)p[2]);
}

static void turn_face(uint32_t corners[3])
{
    uint32_t swap = corners[1];
    corners[1] = corners[2];
    corners[2] = swap;
}

/* Faces keep their side under a transform that mirrors. The format's winding rule: one that
 * disagrees with its first vertex's normal is turned. */
static const uint32_t *place_indices(struct render_scene *rs, const struct scene_mesh *m,
                                     bool mirrored, const float *positions, const float *normals)
{
    uint32_t *out = arena_alloc(&rs->arena, m->triangle_count, 3 * sizeof *out);
    if (!out)
        return NULL;
    memcpy(out, m->indices, (size_t)m->triangle_count * 3 * sizeof *out);
    for (size_t t = 0; mirrored && t < m->triangle_count; t++)
        turn_face(out + 3 * t);
    for (size_t t = 0; normals && t < m->triangle_count; t++) {
        uint32_t *i = out + 3 * t;
        vec3 v0 = float_point(positions, i[0]);
        vec3 ng = v3_cross(v3_sub(float_point(positions, i[1]), v0),
                           v3_sub(float_point(positions, i[2]), v0));
        if (v3_dot(ng, float_point(normals, i[0])) < 0)
            turn_face(i);
    }
    return out;
}

static enum err place_mesh(struct render_scene *rs, const struct scene_mesh *m,
                           const struct placement *at, const struct mesh_use *use,
                           struct render_mesh *out)
{
    out->vertex_count = m->vertex_count;
    out->triangle_count = m->triangle_count;
    out->uvs = use->uvs;
    out->colors = use->colors;
    out->alphas = use->alphas;
    out->positions = place_positions(rs, m, at);
    if (m->normals)
        out->normals = place_normals(rs, m, at);
    if (!out->positions || (m->normals && !out->normals))
        return ERR_NOMEM;
    double c[9];
    bool mirrored = cofactors(at->to_world, c) < 0;
    out->indices = place_indices(rs, m, mirrored, out->positions, out->normals);
    return out->indices ? ERR_OK : ERR_NOMEM;
}

/* What each vertex has so many values of: one copy for all objects of the mesh, made for the first
 * that asks and kept in *shared. NULL: out of memory. */
static const float *shared_values(struct render_scene *rs, const struct scene_mesh *m,
                                  const float *values, uint32_t per_vertex, const float **shared)
{
    if (!*shared) {
        float *copy = arena_alloc(&rs->arena, m->vertex_count, per_vertex * sizeof *copy);
        if (copy)
            memcpy(copy, values, (size_t)m->vertex_count * per_vertex * sizeof *copy);
        *shared = copy;
    }
    return *shared;
}

/* Instances need an orientation-keeping transform that can be inverted with some accuracy. */
static bool wants_instance(const struct scene_object *o, const struct scene_mesh *m,
                           const struct mesh_use *use)
{
    double to_world[12], c[9];
    affine_of(o->transform, to_world);
    double det = cofactors(to_world, c);
    double norm = 0;
    for (int k = 0; k < 12; k++)
        norm = k % 4 < 3 && fabs(to_world[k]) > norm ? fabs(to_world[k]) : norm;
    return use->uses > 1 && !use->emits && m->triangle_count >= SCENE_INSTANCE_TRIANGLES_MIN &&
           det > 1e-6 * norm * norm * norm;
}

/* Mesh space to scene space: undo the mesh's own centring, then world, then the scene's. */
static void compose_instance(struct render_object *out, const struct render_scene *rs,
                             const struct scene_object *o, const struct mesh_use *use)
{
    double m[12];
    affine_of(o->transform, m);
    vec3 origin = affine_point(m, v3_of(use->center));
    origin = v3_scale(v3_sub(origin, v3_of(rs->center)), rs->scale);
    const double t[3] = {origin.x, origin.y, origin.z};
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            out->to_scene[4 * r + k] = m[4 * r + k] / use->scale * rs->scale;
        out->to_scene[4 * r + 3] = t[r];
    }
    affine_inverse(out->to_scene, out->from_scene);
}

static enum err build_instance(struct render_scene *rs, const struct scene *scene,
                               const struct scene_object *o, struct mesh_use *use,
                               struct render_object *out)
{
    const struct scene_mesh *m = &scene->meshes[o->mesh];
    if (use->instanced == SCENE_NONE) {
        struct placement at = {.to_world = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
        struct box b = empty_box;
        mesh_bounds(m, use, at.to_world, &b);
        if (!box_normalise(&b, at.center, &at.scale))
            return ERR_LIMIT;
        memcpy(use->center, at.center, sizeof at.center);
        use->scale = at.scale;
        TL_TRY(place_mesh(rs, m, &at, use, &rs->meshes[rs->mesh_count]));
        use->instanced = (uint32_t)rs->mesh_count++;
    }
    out->type = ACCEL_INSTANCE;
    out->mesh = use->instanced;
    compose_instance(out, rs, o, use);
    return ERR_OK;
}

/* True if a mesh is so small where it stands that the floats around the scene's centre are coarse
 * for it: `at` then gets a centre and a scale of its own. Lamps are drawn in scene space and stay
 * there. */
static bool wants_own_space(const struct render_scene *rs, const struct scene_mesh *m,
                            const struct mesh_use *use, struct placement *at)
{
    if (use->emits || m->triangle_count == 0)
        return false;
    /* Two vertices tell of nearly every mesh that it is larger. */
    size_t corners = (size_t)m->triangle_count * 3;
    vec3 first = affine_point(at->to_world, mesh_point(m, m->indices[0]));
    vec3 last = affine_point(at->to_world, mesh_point(m, m->indices[corners - 1]));
    vec3 out = v3_sub(first, v3_of(rs->center));
    if (v3_abs_max(v3_sub(last, first)) > 4 * SCENE_OWN_SPACE_MAX * v3_abs_max(out))
        return false;
    struct box b = empty_box;
    double center[3], scale, extent = 0;
    mesh_bounds(m, use, at->to_world, &b);
    if (!box_normalise(&b, center, &scale))
        return false;
    for (int k = 0; k < 3; k++)
        extent = fmax(extent, 0.5 * b.high[k] - 0.5 * b.low[k]);
    double reach = v3_abs_max(v3_sub(v3_of(center), v3_of(rs->center)));
    if (extent >= SCENE_OWN_SPACE_MAX * reach || extent <= SCENE_OWN_SPACE_MIN * reach)
        return false;
    memcpy(at->center, center, sizeof at->center);
    at->scale = scale;
    return true;
}

/* From there to scene space: a shift, and a power of two. */
static void compose_own_space(struct render_object *out, const struct render_scene *rs,
                              const struct placement *at)
{
    double grown = rs->scale / at->scale;
    vec3 t = v3_scale(v3_sub(v3_of(at->center), v3_of(rs->center)), rs->scale);
    const double shift[3] = {t.x, t.y, t.z};
    memset(out->to_scene, 0, sizeof out->to_scene);
    memset(out->from_scene, 0, sizeof out->from_scene);
    for (int k = 0; k < 3; k++) {
        out->to_scene[5 * k] = grown;
        out->to_scene[4 * k + 3] = shift[k];
        out->from_scene[5 * k] = 1 / grown;
        out->from_scene[4 * k + 3] = -shift[k] / grown;
    }
}

/* True if the colours of a mesh's vertices make its emission differ. */
static bool reads_emission_colors(const struct scene *scene, const struct scene_object *o)
{
    return o->type == SCENE_OBJECT_MESH && !o->emits && o->material != SCENE_NONE &&
           scene->materials[o->material].emission_vertex_colors && scene->meshes[o->mesh].colors;
}

/* A material's own emission comes on top of the object's; its texture and the colours of vertices
 * count where the material alone emits: the texture on spheres and meshes with texture coordinates.
 */
static void add_material_emission(const struct scene *scene, const struct scene_object *o,
                                  struct render_object *out)
{
    if (o->material == SCENE_NONE)
        return;
    const struct scene_material *m = &scene->materials[o->material];
    out->radiance = rgb_add(out->radiance, rgb_of(m->emission));
    if (!o->emits && (o->type == SCENE_OBJECT_SPHERE || scene->meshes[o->mesh].uvs))
        out->emission_texture = m->emission_texture;
    out->emission_colors = reads_emission_colors(scene, o);
    out->emission_twosided =
        o->type == SCENE_OBJECT_MESH && !o->emits && m->emission_twosided && !m->backface_culling;
}

static enum err build_object(struct render_scene *rs, const struct scene *scene,
                             const struct scene_object *o, struct mesh_use *use,
                             struct render_object *out)
{
    out->material = o->material == SCENE_NONE ? (uint32_t)scene->material_count : o->material;
    out->light_begin = SCENE_NONE;
    out->radiance = o->emits ? rgb_of(o->radiance) : rgb_grey(0);
    out->emission_texture = SCENE_NONE;
    if (scene_object_is_nothing(scene, o)) { /* keeps its number, as a mesh without triangles */
        out->type = ACCEL_TRIANGLES;
        out->mesh = (uint32_t)rs->mesh_count++;
        return ERR_OK;
    }
    add_material_emission(scene, o, out);
    if (o->type == SCENE_OBJECT_SPHERE) {
        out->type = ACCEL_SPHERE;
        out->center = v3_scale(v3_sub(v3_of(o->center), v3_of(rs->center)), rs->scale);
        out->radius = o->radius * rs->scale;
        return ERR_OK;
    }
    const struct scene_mesh *m = &scene->meshes[o->mesh];
    if (m->uvs && !shared_values(rs, m, m->uvs, 2, &use->uvs))
        return ERR_NOMEM;
    if (m->colors && use->reads_colors && !shared_values(rs, m, m->colors, 3, &use->colors))
        return ERR_NOMEM;
    if (m->alphas && use->reads_alphas && !shared_values(rs, m, m->alphas, 1, &use->alphas))
        return ERR_NOMEM;
    if (wants_instance(o, m, use))
        return build_instance(rs, scene, o, use, out);
    struct placement at = {.scale = rs->scale};
    affine_of(o->transform, at.to_world);
    memcpy(at.center, rs->center, sizeof at.center);
    out->type = wants_own_space(rs, m, use, &at) ? ACCEL_INSTANCE : ACCEL_TRIANGLES;
    out->mesh = (uint32_t)rs->mesh_count;
    if (out->type == ACCEL_INSTANCE)
        compose_own_space(out, rs, &at);
    TL_TRY(place_mesh(rs, m, &at, use, &rs->meshes[rs->mesh_count]));
    rs->mesh_count++;
    return ERR_OK;
}

static bool object_emits(const struct scene *scene, const struct scene_object *o)
{
    if (o->emits)
        return true;
    if (o->material == SCENE_NONE)
        return false;
    const double *e = scene->materials[o->material].emission;
    return e[0] > 0 || e[1] > 0 || e[2] > 0;
}

/* What each mesh is used for. */
static enum err find_uses(const struct scene *scene, struct mesh_use *uses)
{
    for (size_t i = 0; i < scene->mesh_count; i++)
        uses[i].instanced = SCENE_NONE;
    for (size_t i = 0; i < scene->object_count; i++) {
        const struct scene_object *o = &scene->objects[i];
        if (o->type != SCENE_OBJECT_MESH || scene_object_is_nothing(scene, o))
            continue;
        if (uses[o->mesh].uses++ == 0)
            TL_TRY(find_strays(&scene->meshes[o->mesh], &uses[o->mesh]));
        uses[o->mesh].emits |= object_emits(scene, o);
        if (o->material == SCENE_NONE)
            continue;
        const struct scene_material *m = &scene->materials[o->material];
        uses[o->mesh].reads_colors |= m->vertex_colors || reads_emission_colors(scene, o);
        uses[o->mesh].reads_alphas |= m->vertex_colors && m->alpha_used;
    }
    return ERR_OK;
}

static enum err build_all(struct render_scene *rs, const struct scene *scene, struct mesh_use *uses)
{
    TL_TRY(find_uses(scene, uses));
    struct box b = scene_bounds(scene, uses);
    if (!box_normalise(&b, rs->center, &rs->scale))
        return ERR_LIMIT;
    for (size_t i = 0; i < scene->object_count; i++) {
        const struct scene_object *o = &scene->objects[i];
        struct mesh_use *use = o->type == SCENE_OBJECT_MESH ? &uses[o->mesh] : NULL;
        TL_TRY(build_object(rs, scene, o, use, &rs->objects[i]));
    }
    rs->object_count = scene->object_count;
    return ERR_OK;
}

enum err scene_build_geometry(struct render_scene *rs, const struct scene *scene)
{
    struct mesh_use *uses = mem_calloc(scene->mesh_count, sizeof *uses);
    /* At most one render mesh an object, and one more for each mesh that is instanced. */
    rs->meshes =
        arena_alloc(&rs->arena, scene->object_count + scene->mesh_count, sizeof *rs->meshes);
    rs->objects = arena_alloc(&rs->arena, scene->object_count, sizeof *rs->objects);
    enum err e = uses && rs->meshes && rs->objects ? build_all(rs, scene, uses) : ERR_NOMEM;
    mem_free(uses);
    return e;
}
