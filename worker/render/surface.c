#include "worker/render/surface.h"

#include "common/dmath.h"

/* Half a unit in the last place of a double near 1. */
#define UNIT_ROUNDOFF (1.0 / 9007199254740992.0)

enum {
    /* Roundings that a position goes through: interpolation, transform, offset. */
    POSITION_ROUNDINGS = 16,
    /* Those of the intersection test, whose error grows with the triangle's longest edge over
     * its height. */
    SHAPE_ROUNDINGS = 32,
};

struct triangle {
    vec3 v[3];
    uint32_t index[3];
    double b[3];
};

static struct triangle triangle_of(const struct render_mesh *mesh, const struct hit *hit)
{
    struct triangle t;
    t.b[1] = hit->b1;
    t.b[2] = hit->b2;
    t.b[0] = 1.0 - hit->b1 - hit->b2;
    for (int k = 0; k < 3; k++) {
        t.index[k] = mesh->indices[3 * (size_t)hit->primitive + (size_t)k];
        const float *p = mesh->positions + 3 * (size_t)t.index[k];
        t.v[k] = v3((double)p[0], (double)p[1], (double)p[2]);
    }
    return t;
}

static vec3 triangle_point(const struct triangle *t)
{
    return v3_mad(v3_mad(v3_scale(t->v[0], t->b[0]), t->v[1], t->b[1]), t->v[2], t->b[2]);
}

/* Longest edge squared over twice the area, times the longest edge: how far a rounding of the
 * test moves the plane of the triangle. */
static double shape_length(vec3 e1, vec3 e2, double area2)
{
    vec3 e3 = v3_sub(e2, e1);
    double a = v3_dot(e1, e1), b = v3_dot(e2, e2), c = v3_dot(e3, e3);
    double longest2 = a > b ? a : b;
    longest2 = longest2 > c ? longest2 : c;
    return longest2 / area2 * sqrt(longest2);
}

static vec3 vertex_normal(const float *normals, const struct triangle *t)
{
    vec3 n = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        const float *p = normals + 3 * (size_t)t->index[k];
        n = v3_mad(n, v3((double)p[0], (double)p[1], (double)p[2]), t->b[k]);
    }
    return n;
}

/* Interpolated normals that vanish or are not numbers fall back to the geometric one; the result
 * is on the geometric normal's side. */
static vec3 shading_normal(vec3 n, vec3 ng)
{
    double length2 = v3_dot(n, n);
    if (!(length2 > 0) || !(length2 < 1e300))
        return ng;
    n = v3_scale(n, 1.0 / sqrt(length2));
    return v3_dot(n, ng) < 0 ? v3_neg(n) : n;
}

/* Surface coordinates, and the direction in which u grows if it is wanted. */
static void triangle_uv(const float *uvs, const struct triangle *t, struct surface *s)
{
    double uv[3][2];
    s->u = s->v = 0;
    for (int k = 0; k < 3; k++) {
        uv[k][0] = (double)uvs[2 * (size_t)t->index[k]];
        uv[k][1] = (double)uvs[2 * (size_t)t->index[k] + 1];
        s->u += t->b[k] * uv[k][0];
        s->v += t->b[k] * uv[k][1];
    }
    double du1 = uv[1][0] - uv[0][0], dv1 = uv[1][1] - uv[0][1];
    double du2 = uv[2][0] - uv[0][0], dv2 = uv[2][1] - uv[0][1];
    double det = du1 * dv2 - du2 * dv1;
    vec3 e1 = v3_sub(t->v[1], t->v[0]), e2 = v3_sub(t->v[2], t->v[0]);
    s->handed = det < 0 ? -1 : 1;
    if (det != 0)
        s->dpdu = v3_scale(v3_sub(v3_scale(e1, dv2), v3_scale(e2, dv1)), det < 0 ? -1 : 1);
}

static rgb vertex_color(const float *colors, const struct triangle *t)
{
    rgb c = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        const float *p = colors + 3 * (size_t)t->index[k];
        c = rgb_add(c, rgb_scale((rgb){(double)p[0], (double)p[1], (double)p[2]}, t->b[k]));
    }
    /* A weight may be under 0 by a rounding. */
    return (rgb){c.r > 0 ? c.r : 0, c.g > 0 ? c.g : 0, c.b > 0 ? c.b : 0};
}

static void surface_of_triangle(const struct render_scene *scene,
                                const struct render_object *object, const struct hit *hit,
                                struct surface *s)
{
    const struct render_mesh *mesh = &scene->meshes[object->mesh];
    const struct material *material = &scene->materials[object->material];
    struct triangle t = triangle_of(mesh, hit);
    bool instance = object->type == ACCEL_INSTANCE;
    s->p = triangle_point(&t);
    double size = v3_abs_max(t.v[0]) + v3_abs_max(t.v[1]) + v3_abs_max(t.v[2]);
    vec3 normal = v3_of(hit->ng);
    double area2 = v3_length(normal);
    s->ng = v3_scale(normal, 1.0 / area2);
    vec3 e1 = v3_sub(t.v[1], t.v[0]), e2 = v3_sub(t.v[2], t.v[0]);
    if (instance) {
        const double *m = object->to_scene;
        double norm = 0;
        for (int r = 0; r < 3; r++) {
            double sum = fabs(m[4 * r]) + fabs(m[4 * r + 1]) + fabs(m[4 * r + 2]);
            norm = sum > norm ? sum : norm;
        }
        size = size * norm + v3_abs_max(v3(m[3], m[7], m[11]));
        s->p = affine_point(m, s->p);
        e1 = affine_vector(m, e1);
        e2 = affine_vector(m, e2);
    }
    s->error =
        UNIT_ROUNDOFF * (POSITION_ROUNDINGS * size + SHAPE_ROUNDINGS * shape_length(e1, e2, area2));
    s->ns = s->ng;
    if (mesh->normals) {
        vec3 n = vertex_normal(mesh->normals, &t);
        if (instance)
            n = affine_normal(object->from_scene, n);
        s->ns = shading_normal(n, s->ng);
    }
    if (material->vertex_colors)
        s->color = mesh->colors ? vertex_color(mesh->colors, &t) : rgb_grey(1);
    if (material->needs_uv) {
        s->u = s->v = 0;
        s->dpdu = e1;
        s->handed = 1;
        if (mesh->uvs)
            triangle_uv(mesh->uvs, &t, s);
        if (mesh->uvs && instance)
            s->dpdu = affine_vector(object->to_scene, s->dpdu);
    }
}

void surface_sphere_uv(vec3 n, double *u, double *v)
{
    double phi = dmath_atan2(n.y, n.x);
    double z = n.z < -1 ? -1 : n.z > 1 ? 1 : n.z;
    *u = (phi < 0 ? phi + 2 * VEC_PI : phi) / (2 * VEC_PI);
    *v = dmath_acos(z) / VEC_PI;
}

static void surface_of_sphere(const struct render_scene *scene, const struct render_object *object,
                              const struct hit *hit, struct surface *s)
{
    s->ng = v3_unit(v3_of(hit->ng));
    s->ns = s->ng;
    s->p = v3_mad(object->center, s->ng, object->radius);
    s->error = UNIT_ROUNDOFF * POSITION_ROUNDINGS * (v3_abs_max(object->center) + object->radius);
    if (scene->materials[object->material].vertex_colors)
        s->color = rgb_grey(1);
    if (scene->materials[object->material].needs_uv) {
        surface_sphere_uv(s->ng, &s->u, &s->v);
        s->dpdu = v3(-s->ng.y, s->ng.x, 0);
        s->handed = -1; /* v grows away from +z */
    }
}

void surface_of_hit(const struct render_scene *scene, const struct hit *hit, struct surface *out)
{
    const struct render_object *object = &scene->objects[hit->object];
    out->object = hit->object;
    out->primitive = hit->primitive;
    out->material = object->material;
    if (object->type == ACCEL_SPHERE)
        surface_of_sphere(scene, object, hit, out);
    else
        surface_of_triangle(scene, object, hit, out);
}

rgb surface_vertex_color(const struct render_scene *scene, const struct hit *hit)
{
    const struct render_object *object = &scene->objects[hit->object];
    const struct render_mesh *mesh =
        object->type == ACCEL_SPHERE ? NULL : &scene->meshes[object->mesh];
    if (!mesh || !mesh->colors)
        return rgb_grey(1);
    struct triangle t = triangle_of(mesh, hit);
    return vertex_color(mesh->colors, &t);
}

double surface_vertex_alpha(const struct render_scene *scene, const struct hit *hit)
{
    const struct render_object *object = &scene->objects[hit->object];
    const struct render_mesh *mesh =
        object->type == ACCEL_SPHERE ? NULL : &scene->meshes[object->mesh];
    if (!mesh || !mesh->alphas)
        return 1;
    struct triangle t = triangle_of(mesh, hit);
    double alpha = 0;
    for (int k = 0; k < 3; k++)
        alpha += (double)mesh->alphas[t.index[k]] * t.b[k];
    return alpha;
}

static bool triangle_tangents(const struct render_scene *scene, const struct render_object *object,
                              const struct hit *hit, vec3 *dpdu, vec3 *dpdv)
{
    const struct render_mesh *mesh = &scene->meshes[object->mesh];
    if (!mesh->uvs)
        return false;
    struct triangle t = triangle_of(mesh, hit);
    double d[2][2];
    for (int k = 0; k < 2; k++)
        for (int j = 0; j < 2; j++)
            d[k][j] = (double)mesh->uvs[2 * (size_t)t.index[k + 1] + (size_t)j] -
                      (double)mesh->uvs[2 * (size_t)t.index[0] + (size_t)j];
    double det = d[0][0] * d[1][1] - d[0][1] * d[1][0];
    if (!(fabs(det) > 0))
        return false;
    vec3 e1 = v3_sub(t.v[1], t.v[0]), e2 = v3_sub(t.v[2], t.v[0]);
    *dpdu = v3_scale(v3_sub(v3_scale(e1, d[1][1]), v3_scale(e2, d[0][1])), 1 / det);
    *dpdv = v3_scale(v3_sub(v3_scale(e2, d[0][0]), v3_scale(e1, d[1][0])), 1 / det);
    if (object->type == ACCEL_INSTANCE) {
        *dpdu = affine_vector(object->to_scene, *dpdu);
        *dpdv = affine_vector(object->to_scene, *dpdv);
    }
    return true;
}

bool surface_tangents(const struct render_scene *scene, const struct hit *hit, vec3 *dpdu,
                      vec3 *dpdv)
{
    const struct render_object *object = &scene->objects[hit->object];
    if (object->type != ACCEL_SPHERE)
        return triangle_tangents(scene, object, hit, dpdu, dpdv);
    vec3 n = v3_unit(v3_of(hit->ng));
    double across = sqrt(n.x * n.x + n.y * n.y);
    *dpdu = v3_scale(v3(-n.y, n.x, 0), 2 * VEC_PI * object->radius);
    *dpdv = v3_scale(v3(n.x * n.z / across, n.y * n.z / across, -across), VEC_PI * object->radius);
    return across > 0;
}
