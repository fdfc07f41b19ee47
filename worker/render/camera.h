/* worker/render/camera.h: from a point of the film to a ray.
 *
 * Film coordinates are pixels of the full picture, (0, 0) its upper left corner.
 * Rays are in scene space with unit directions. Any thread. Tests: test_surface.
 */
#ifndef WORKER_RENDER_CAMERA_H
#define WORKER_RENDER_CAMERA_H

#include "common/scene.h"
#include "worker/render/footprint.h"
#include "worker/render/vec.h"

struct camera {
    enum scene_camera_type type;
    uint32_t width, height;
    vec3 position;
    frame basis; /* s right, t up, n forward */
    double half_x,
        half_y; /* pinhole, lens: tangents of half the angles; orthographic: half sizes */
    double focus, aperture; /* thin lens, scene space */
};

/* `center` and `scale` make scene space of world space. The camera is valid: it does not look at
 * itself nor along ref_up. */
void camera_init(struct camera *c, const struct scene_camera *from, uint32_t width, uint32_t height,
                 const double center[3], double scale);

/* `lens` in [0,1)^2 is used by the thin lens only. */
void camera_ray(const struct camera *c, double x, double y, const double lens[2], vec3 *org,
                vec3 *dir);

/* What that ray stands for when its neighbours are `step` pixels away. */
void camera_footprint(const struct camera *c, double x, double y, const double lens[2], double step,
                      struct footprint *out);

#endif
