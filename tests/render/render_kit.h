/* tests/render/render_kit.h: scenes made in code, and their pictures, for the tests of light.
 *
 * Every kit_* function fails the test at once on an error. One thread.
 */
#ifndef TESTS_RENDER_RENDER_KIT_H
#define TESTS_RENDER_RENDER_KIT_H

#include "common/job_spec.h"
#include "common/scene.h"
#include "worker/render/render.h"

/* Appends an element with defaults; returns its index. The pointer is to the element. */
uint32_t kit_material(struct scene *s, enum scene_material_type type, struct scene_material **out);
uint32_t kit_diffuse(struct scene *s, double r, double g, double b);
uint32_t kit_constant_texture(struct scene *s, double value);
uint32_t kit_image_texture(struct scene *s, uint32_t image, enum scene_texture_filter filter);
uint32_t kit_sphere(struct scene *s, double x, double y, double z, double radius,
                    uint32_t material);

/* Corners in order; the normal is (b - a) x (d - a). */
uint32_t kit_quad(struct scene *s, const double corners[12], uint32_t material);
/* A mesh object from vertices and triangles; copies both. */
uint32_t kit_mesh(struct scene *s, const double *positions, uint32_t vertex_count,
                  const uint32_t *indices, uint32_t triangle_count, uint32_t material);
void kit_emit(struct scene *s, uint32_t object, double r, double g, double b);
struct scene_light *kit_light(struct scene *s, enum scene_light_type type);

/* The sky, of one radiance. */
void kit_constant_sky(struct scene *s, double radiance);

/* The Cornell box of the source report; `area_light` under its ceiling. */
enum kit_cornell_objects { KIT_BOXES = 1, KIT_AREA_LIGHT = 2, KIT_DISC = 4, KIT_GLASS_SPHERE = 8 };
void kit_cornell(struct scene *s, int objects);

/* A spec of a small square picture. */
struct job_spec kit_spec(uint32_t side, uint64_t spp);

/* A finished picture: mean radiance in double, and each half's. Planar RGB. */
struct kit_picture {
    uint32_t width, height;
    double *mean, *half[2];
    struct render_counters counters;
};

/* Renders the whole crop in units of `cells_per_unit` (0: all in one). */
struct kit_picture kit_render(const struct scene *s, const struct job_spec *spec,
                              uint32_t cells_per_unit);
/* The same of a scene that is built for the spec. */
struct kit_picture kit_render_built(const struct render_scene *scene, const struct job_spec *spec,
                                    uint32_t cells_per_unit);
void kit_picture_free(struct kit_picture *p);

/* Mean over the picture and channels. */
double kit_picture_mean(const struct kit_picture *p);

/* Mean of the picture and the variance of that mean, from 8 seeds; returns how many samples were no
 * numbers. */
uint64_t kit_estimate(const struct scene *s, struct job_spec spec, double *mean, double *variance);

#endif
