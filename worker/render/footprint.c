#include "worker/render/footprint.h"

#include "worker/render/render_scene.h"

/* Samples that a pixel counts as having where an error or a time decides. */
static const double UNKNOWN_SAMPLES = 64;

/* A cone is no wider than this: a tangent. */
static const double SPREAD_MAX = 1;

double footprint_step(const struct job_spec *spec)
{
    return 1 / sqrt(spec->stop == JOB_STOP_SPP ? (double)spec->spp : UNKNOWN_SAMPLES);
}

void footprint_arrive(struct footprint *f, vec3 from, const struct ray *ray, const struct hit *hit)
{
    vec3 dir = v3_of(ray->dir), ng = v3_of(hit->ng);
    double way = v3_dot(v3_sub(v3_mad(v3_of(ray->org), dir, hit->t), from), dir);
    double slope = 1 / v3_dot(dir, ng);
    for (int k = 0; k < 2; k++) {
        vec3 off = v3_mad(f->org[k], f->dir[k], way);
        f->org[k] = v3_mad(off, dir, -v3_dot(off, ng) * slope);
    }
}

/* --- On the surface ------------------------------------------------------- */

/* What changes from a hit to a point beside it on the same surface. */
struct change {
    double u, v;
    vec3 n; /* of the unit normal before any map */
};

static vec3 vertex_vector(const float *vectors, const struct render_mesh *mesh,
                          const struct hit *hit, int corner)
{
    const float *p =
        vectors + 3 * (size_t)mesh->indices[3 * (size_t)hit->primitive + (size_t)corner];
    return v3((double)p[0], (double)p[1], (double)p[2]);
}

/* The changes of the weights of corners 1 and 2 over `off` in the plane of edges e1, e2. */
static void weights_of(vec3 e1, vec3 e2, vec3 off, double weight[2])
{
    double a = v3_dot(e1, e1), b = v3_dot(e1, e2), c = v3_dot(e2, e2);
    double x = v3_dot(e1, off), y = v3_dot(e2, off);
    double det = a * c - b * b;
    weight[0] = (c * x - b * y) / det;
    weight[1] = (a * y - b * x) / det;
}

static vec3 normal_change(const struct render_mesh *mesh, const struct render_object *object,
                          const struct hit *hit, const double weight[2])
{
    vec3 n[3];
    for (int k = 0; k < 3; k++) {
        n[k] = vertex_vector(mesh->normals, mesh, hit, k);
        if (object->type == ACCEL_INSTANCE)
            n[k] = affine_normal(object->from_scene, n[k]);
    }
    vec3 to1 = v3_sub(n[1], n[0]), to2 = v3_sub(n[2], n[0]);
    vec3 sum = v3_mad(v3_mad(n[0], to1, hit->b1), to2, hit->b2);
    vec3 d = v3_mad(v3_scale(to1, weight[0]), to2, weight[1]);
    double length2 = v3_dot(sum, sum);
    if (!(length2 > 0))
        return v3(0, 0, 0);
    /* Of the direction only; the side is surface.c's, which looks from the geometric normal. */
    d = v3_mad(d, sum, -v3_dot(sum, d) / length2);
    double side = v3_dot(sum, v3_of(hit->ng)) < 0 ? -1 : 1;
    return v3_scale(d, side / sqrt(length2));
}

static struct change triangle_change(const struct render_scene *scene,
                                     const struct render_object *object, const struct hit *hit,
                                     vec3 off)
{
    const struct render_mesh *mesh = &scene->meshes[object->mesh];
    struct change out = {0};
    vec3 v0 = vertex_vector(mesh->positions, mesh, hit, 0);
    vec3 e1 = v3_sub(vertex_vector(mesh->positions, mesh, hit, 1), v0);
    vec3 e2 = v3_sub(vertex_vector(mesh->positions, mesh, hit, 2), v0);
    if (object->type == ACCEL_INSTANCE) {
        e1 = affine_vector(object->to_scene, e1);
        e2 = affine_vector(object->to_scene, e2);
    }
    double weight[2];
    weights_of(e1, e2, off, weight);
    if (mesh->normals)
        out.n = normal_change(mesh, object, hit, weight);
    if (mesh->uvs) {
        const uint32_t *index = mesh->indices + 3 * (size_t)hit->primitive;
        const float *uv[3];
        for (int k = 0; k < 3; k++)
            uv[k] = mesh->uvs + 2 * (size_t)index[k];
        for (int k = 0; k < 2; k++) {
            out.u += weight[k] * ((double)uv[k + 1][0] - (double)uv[0][0]);
            out.v += weight[k] * ((double)uv[k + 1][1] - (double)uv[0][1]);
        }
    }
    return out;
}

/* At a pole the whole circle of u is near: no number, which textures take for everything. */
static struct change sphere_change(const struct render_object *object, const struct hit *hit,
                                   vec3 off)
{
    vec3 n = v3_unit(v3_of(hit->ng));
    struct change out = {.n = v3_scale(off, 1 / object->radius)};
    double across2 = n.x * n.x + n.y * n.y;
    out.u = (n.x * out.n.y - n.y * out.n.x) / (across2 * 2 * VEC_PI);
    out.v = -out.n.z / (sqrt(across2) * VEC_PI);
    return out;
}

static struct change change_of(const struct render_scene *scene, const struct hit *hit, vec3 off)
{
    const struct render_object *object = &scene->objects[hit->object];
    return object->type == ACCEL_SPHERE ? sphere_change(object, hit, off)
                                        : triangle_change(scene, object, hit, off);
}

void footprint_uv(const struct render_scene *scene, const struct hit *hit,
                  const struct footprint *f, struct texture_footprint *out)
{
    for (int k = 0; k < 2; k++) {
        struct change c = change_of(scene, hit, f->org[k]);
        out->u[k] = c.u;
        out->v[k] = c.v;
    }
}

/* --- Onwards -------------------------------------------------------------- */

void footprint_mirror(const struct render_scene *scene, const struct hit *hit, vec3 n, vec3 dir,
                      struct footprint *f)
{
    double cosine = v3_dot(dir, n);
    for (int k = 0; k < 2; k++) {
        vec3 dn = change_of(scene, hit, f->org[k]).n;
        double change = v3_dot(f->dir[k], n) + v3_dot(dir, dn);
        f->dir[k] = v3_mad(v3_mad(f->dir[k], dn, -2 * cosine), n, -2 * change);
    }
}

void footprint_refract(const struct render_scene *scene, const struct hit *hit, vec3 n, vec3 dir,
                       vec3 wi, double eta, struct footprint *f)
{
    /* wi = ratio dir - mu n, with n against dir. */
    double cosine = v3_dot(dir, n), side = cosine > 0 ? -1 : 1;
    double ratio = cosine > 0 ? eta : 1 / eta;
    n = v3_scale(n, side);
    cosine *= side;
    double behind = v3_dot(wi, n);
    double mu = ratio * cosine - behind;
    for (int k = 0; k < 2; k++) {
        vec3 dn = v3_scale(change_of(scene, hit, f->org[k]).n, side);
        double change = v3_dot(f->dir[k], n) + v3_dot(dir, dn);
        double dmu = (ratio - ratio * ratio * cosine / behind) * change;
        f->dir[k] = v3_mad(v3_mad(v3_scale(f->dir[k], ratio), dn, -mu), n, -dmu);
    }
}

void footprint_scatter(vec3 wi, double pdf, double step, struct footprint *f)
{
    double spread = step / sqrt(pdf);
    spread = spread < SPREAD_MAX ? spread : SPREAD_MAX;
    frame about = frame_of(wi);
    f->dir[0] = v3_scale(about.s, spread);
    f->dir[1] = v3_scale(about.t, spread);
}
