#include "worker/render/shade.h"

/* The frame about n whose x axis follows dpdu as far as it can. */
static frame frame_along(vec3 n, vec3 dpdu)
{
    vec3 s = v3_mad(dpdu, n, -v3_dot(n, dpdu));
    double length2 = v3_dot(s, s);
    if (!(length2 > 0))
        return frame_of(n);
    s = v3_scale(s, 1 / sqrt(length2));
    return (frame){s, v3_cross(n, s), n};
}

/* Where on its textures a hit is looked up. */
struct look {
    const struct render_scene *scene;
    const struct surface *surface;
    const struct texture_footprint *footprint; /* or NULL */
    struct texture_lacks *lacks;
};

/* The colour of a texture at the hit; false where there is none, or not yet. */
static bool look_up(const struct look *l, uint32_t texture, rgb *out)
{
    if (texture == SCENE_NONE)
        return false;
    uint32_t met = l->lacks->met;
    *out = texture_filtered(&l->scene->textures[texture], l->surface->u, l->surface->v,
                            l->footprint, l->lacks);
    return l->lacks->met == met;
}

/* The shading normal bent by a tangent-space normal map. */
static vec3 mapped_normal(const struct look *l, const struct material *m)
{
    const struct surface *s = l->surface;
    rgb c;
    if (!look_up(l, m->normal_texture, &c))
        return s->ns;
    vec3 local = v3((2 * c.r - 1) * m->normal_scale, (2 * c.g - 1) * m->normal_scale, 2 * c.b - 1);
    frame f = frame_along(s->ns, s->dpdu);
    f.t = v3_scale(f.t, s->handed);
    vec3 n = frame_to_world(&f, local);
    double length2 = v3_dot(n, n);
    return length2 > 0 ? v3_scale(n, 1 / sqrt(length2)) : s->ns;
}

/* The normal of the surface moved along n by a map of heights (Blinn 1978), as n less the gradient
 * of the heights along the surface (Mikkelsen 2010, "Bump Mapping Unparametrized Surfaces on the
 * GPU"). Where the map has no direction or no end, n. */
static vec3 bumped_normal(const struct look *l, const struct material *m, const struct hit *hit)
{
    const struct surface *s = l->surface;
    vec3 dpdu, dpdv, n = s->ns;
    double slope[2];
    uint32_t met = l->lacks->met;
    if (m->bump_texture == SCENE_NONE || !surface_tangents(l->scene, hit, &dpdu, &dpdv))
        return n;
    texture_gradient(&l->scene->textures[m->bump_texture], s->u, s->v, l->footprint, l->lacks,
                     slope);
    if (l->lacks->met != met)
        return n;
    vec3 across = v3_cross(dpdv, n), along = v3_cross(n, dpdu);
    double scale = m->bump_scale / v3_dot(dpdu, across);
    vec3 gradient = v3_add(v3_scale(across, slope[0] * scale), v3_scale(along, slope[1] * scale));
    vec3 bumped = v3_sub(n, gradient);
    double length2 = v3_dot(bumped, bumped);
    return length2 < 1e300 ? v3_scale(bumped, 1 / sqrt(length2)) : n;
}

static double clamp01(double x)
{
    return x > 0 ? (x < 1 ? x : 1) : 0;
}

/* Metallic-roughness and transmission at the point, as glTF packs them. */
static void look_up_principled(const struct look *l, const struct material *m, struct bsdf *b)
{
    rgb t;
    b->metallic = m->metallic;
    b->roughness = m->roughness;
    b->transmission = m->transmission;
    if (look_up(l, m->metallic_roughness_texture, &t)) {
        b->roughness *= clamp01(t.g);
        b->metallic *= clamp01(t.b);
    }
    if (look_up(l, m->transmission_texture, &t))
        b->transmission *= clamp01(t.r);
}

double shade_opacity(const struct render_scene *scene, const struct hit *hit, vec3 dir)
{
    const struct material *m = &scene->materials[scene->objects[hit->object].material];
    bool textured = m->has_alpha && m->texture != SCENE_NONE;
    struct surface s;
    if (m->backface_culling || textured)
        surface_of_hit(scene, hit, &s);
    if (m->backface_culling && v3_dot(s.ng, dir) > 0)
        return 0;
    if (!m->has_alpha)
        return 1;
    double alpha = textured ? texture_alpha(&scene->textures[m->texture], s.u, s.v) : 1;
    if (m->vertex_colors)
        alpha *= surface_vertex_alpha(scene, hit);
    return material_opacity(m, alpha);
}

/* The squared roughness of facets of which a tilt by that cosine is the usual one (eq. 6). */
static double tilt_alpha2(double cosine)
{
    double cos2 = cosine * cosine;
    double alpha2 = 0.125 * (1 - cos2) / cos2;
    return alpha2 > 0 ? (alpha2 < 1 ? alpha2 : 1) : cos2 > 0 ? 0 : 1;
}

double shade_tilted(const struct shade *s, vec3 wi, double wi_local_z)
{
    if (wi_local_z * s->wo.z < 0)
        return 1;
    double cosine = v3_dot(s->smooth, wi), cos2 = cosine * cosine;
    if (!(cos2 > 0))
        return 0;
    double tan2 = cos2 < 1 ? (1 - cos2) / cos2 : 0;
    return 2 / (1 + sqrt(1 + s->tilt_alpha2 * tan2));
}

rgb shade_emission(const struct render_scene *scene, const struct hit *hit, const struct surface *s,
                   const struct footprint *footprint)
{
    const struct render_object *object = &scene->objects[hit->object];
    rgb color = object->emission_colors ? surface_vertex_color(scene, hit) : rgb_grey(1);
    if (object->emission_texture == SCENE_NONE)
        return color;
    struct texture_footprint uv;
    if (footprint)
        footprint_uv(scene, hit, footprint, &uv);
    const struct texture *t = &scene->textures[object->emission_texture];
    return rgb_mul(texture_filtered(t, s->u, s->v, footprint ? &uv : NULL, NULL), color);
}

void shade_of_hit(const struct render_scene *scene, const struct hit *hit, vec3 dir,
                  const struct footprint *footprint, struct texture_lacks *lacks, struct shade *out)
{
    surface_of_hit(scene, hit, &out->surface);
    struct surface *s = &out->surface;
    const struct material *m = &scene->materials[s->material];
    struct texture_footprint area;
    struct texture_lacks unheard;
    if (!lacks) {
        lacks = &unheard;
        lacks->met = lacks->count = 0;
    }
    struct look look = {.scene = scene, .surface = s, .lacks = lacks};
    if (footprint && m->filtered) {
        footprint_uv(scene, hit, footprint, &area);
        look.footprint = &area;
    }
    vec3 wo = v3_neg(dir);
    out->smooth = s->ns;
    out->tilt_alpha2 = 0;
    s->ns = mapped_normal(&look, m);
    s->ns = bumped_normal(&look, m, hit);
    /* A shading normal seen from behind where the surface is seen from the front, or the other
     * way about, says nothing: the geometric one takes over. */
    out->bent = (v3_dot(wo, s->ns) > 0) != (v3_dot(wo, s->ng) > 0);
    if (out->bent)
        s->ns = s->ng;
    else if (m->normal_texture != SCENE_NONE || m->bump_texture != SCENE_NONE)
        out->tilt_alpha2 = tilt_alpha2(v3_dot(out->smooth, s->ns));
    out->frame = m->is_anisotropic ? frame_along(s->ns, s->dpdu) : frame_of(s->ns);
    out->wo = frame_to_local(&out->frame, wo);
    out->bsdf.material = m;
    out->bsdf.color = m->color;
    rgb t;
    if (look_up(&look, m->texture, &t))
        out->bsdf.color = rgb_mul(m->color, t);
    if (m->vertex_colors)
        out->bsdf.color = rgb_mul(out->bsdf.color, s->color);
    if (m->type == SCENE_MATERIAL_PRINCIPLED)
        look_up_principled(&look, m, &out->bsdf);
}
