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

void shade_of_hit(const struct render_scene *scene, const struct hit *hit, vec3 dir,
                  struct shade *out)
{
    surface_of_hit(scene, hit, &out->surface);
    struct surface *s = &out->surface;
    const struct material *m = &scene->materials[s->material];
    vec3 wo = v3_neg(dir);
    /* A shading normal seen from behind where the surface is seen from the front, or the other
     * way about, says nothing: the geometric one takes over. */
    if ((v3_dot(wo, s->ns) > 0) != (v3_dot(wo, s->ng) > 0))
        s->ns = s->ng;
    out->frame = m->is_anisotropic ? frame_along(s->ns, s->dpdu) : frame_of(s->ns);
    out->wo = frame_to_local(&out->frame, wo);
    out->bsdf.material = m;
    out->bsdf.color = m->color;
    if (m->texture != SCENE_NONE) {
        rgb t = texture_color(&scene->textures[m->texture], s->u, s->v);
        out->bsdf.color = rgb_mul(m->color, t);
    }
}
