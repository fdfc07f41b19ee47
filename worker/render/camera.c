#include "worker/render/camera.h"

#include "common/dmath.h"
#include "worker/render/warp.h"

/* The unit vector along v, which is not 0. Brought to about 1 by a power of two first, so that
 * squares neither vanish nor overflow; exact, so that no bit depends on it. */
static vec3 unit_of_any_size(vec3 v)
{
    int exponent;
    (void)frexp(v3_abs_max(v), &exponent);
    return v3_unit(v3(ldexp(v.x, -exponent), ldexp(v.y, -exponent), ldexp(v.z, -exponent)));
}

void camera_init(struct camera *c, const struct scene_camera *from, uint32_t width, uint32_t height,
                 const double center[3], double scale)
{
    vec3 forward = unit_of_any_size(v3_sub(v3_of(from->look_at), v3_of(from->position)));
    vec3 right = unit_of_any_size(v3_cross(forward, v3_of(from->ref_up)));
    double aspect = (double)width / (double)height;
    double half = from->type == SCENE_CAMERA_ORTHOGRAPHIC ? from->ortho_height * scale * 0.5
                                                          : dmath_tan(from->fov * (VEC_PI / 360));
    *c = (struct camera){
        .type = from->type,
        .width = width,
        .height = height,
        .position = v3_scale(v3_sub(v3_of(from->position), v3_of(center)), scale),
        .basis = {right, v3_cross(right, forward), forward},
        .half_x = half * aspect,
        .half_y = half,
        .focus = from->focal_length * scale,
        .aperture = from->aperture_radius * scale,
    };
}

/* The whole sphere: forward in the middle of the picture, up at the top row. */
static vec3 panorama_direction(const struct camera *c, double x, double y)
{
    double sp, cp, st, ct;
    dmath_sincos((x / c->width - 0.5) * (2 * VEC_PI), &sp, &cp);
    dmath_sincos(y / c->height * VEC_PI, &st, &ct);
    return frame_to_world(&c->basis, v3(st * sp, ct, st * cp));
}

void camera_ray(const struct camera *c, double x, double y, const double lens[2], vec3 *org,
                vec3 *dir)
{
    double px = (2 * x / c->width - 1) * c->half_x;
    double py = (1 - 2 * y / c->height) * c->half_y;
    *org = c->position;
    switch (c->type) {
    case SCENE_CAMERA_PINHOLE:
        *dir = v3_unit(frame_to_world(&c->basis, v3(px, py, 1)));
        break;
    case SCENE_CAMERA_THIN_LENS: {
        double lx, ly;
        warp_disk(lens[0], lens[1], &lx, &ly);
        lx *= c->aperture;
        ly *= c->aperture;
        *org = v3_add(*org, frame_to_world(&c->basis, v3(lx, ly, 0)));
        vec3 to_focus = v3(px * c->focus - lx, py * c->focus - ly, c->focus);
        *dir = v3_unit(frame_to_world(&c->basis, to_focus));
        break;
    }
    case SCENE_CAMERA_ORTHOGRAPHIC:
        *org = v3_add(*org, frame_to_world(&c->basis, v3(px, py, 0)));
        *dir = c->basis.n;
        break;
    case SCENE_CAMERA_PANORAMA:
        *dir = panorama_direction(c, x, y);
        break;
    }
}

void camera_footprint(const struct camera *c, double x, double y, const double lens[2], double step,
                      struct footprint *out)
{
    vec3 org, dir;
    camera_ray(c, x, y, lens, &org, &dir);
    for (int k = 0; k < 2; k++) {
        camera_ray(c, k ? x : x + step, k ? y + step : y, lens, &out->org[k], &out->dir[k]);
        out->org[k] = v3_sub(out->org[k], org);
        out->dir[k] = v3_sub(out->dir[k], dir);
    }
}
