/* The keys "integrator", "film" and "camera": what the job and the camera get. */
#include <math.h>
#include <string.h>

#include "common/scene_loader.h"

/* --- integrator ---------------------------------------------------------- */

enum integrator_type { INTERSECTION_TEST, PATH, BDPT, PHOTON, DIRECT, AO, INTEGRATOR_TYPES };

static const char *const integrator_types[INTEGRATOR_TYPES] = {
    "intersection_test", "path", "bdpt", "photon", "direct", "ao"};

/* Which types a key has an effect on, as bits. */
#define ON(type) (1u << (type))
#define ON_PATHS (ON(PATH) | ON(BDPT) | ON(PHOTON))
#define ON_ALL   (ON(INTEGRATOR_TYPES) - 1)

static const struct {
    const char *key;
    unsigned types;
} integrator_keys[] = {
    {"type", ON_ALL},
    {"spp", ON_ALL},
    {"max_depth", ON(INTERSECTION_TEST) | ON_PATHS},
    {"rr_threshold", ON_PATHS},
    {"profile", ON_PATHS},
    {"point_light_position", ON(INTERSECTION_TEST)},
    {"point_light_flux", ON(INTERSECTION_TEST)},
    {"n_photons", ON(PHOTON)},
    {"n_iterations", ON(PHOTON)},
    {"n_near_photons", ON(PHOTON)},
    {"sampler", ON_ALL},
    {"seed", ON_ALL},
};

enum { INTEGRATOR_KEYS = sizeof integrator_keys / sizeof *integrator_keys };

static void check_integrator_keys(struct scene_loader *l, const struct json *v, int type)
{
    const char *known[INTEGRATOR_KEYS];
    for (size_t i = 0; i < INTEGRATOR_KEYS; i++) {
        known[i] = integrator_keys[i].key;
        const struct json *member = json_get_member(v, known[i]);
        if (member && !(integrator_keys[i].types & ON(type)))
            json_get_problem(&l->g, DIAG_WARNING, member, "no-effect", NULL,
                             "has no effect on the integrator %s", integrator_types[type]);
    }
    json_get_keys(&l->g, v, known, INTEGRATOR_KEYS);
}

static void load_profile(struct scene_loader *l, const struct json *v)
{
    static const char *const names[] = {
        "MIS", "NEE", "RW", "MultipleImportanceSampling", "NextEventEstimation", "RandomWalk"};
    int choice = (int)l->spec.profile;
    (void)json_get_choice(&l->g, v, "profile", names, 6, &choice);
    l->spec.profile = (enum job_profile)(choice % JOB_PROFILE_COUNT);
}

/* The integrator that renders a type; for those of the format that ask for the same light by
 * other means, the path integrator and a warning. */
static void set_integrator(struct scene_loader *l, const struct json *v, int type)
{
    static const enum job_integrator integrators[INTEGRATOR_TYPES] = {
        [INTERSECTION_TEST] = JOB_INTEGRATOR_INTERSECTION_TEST,
        [PATH] = JOB_INTEGRATOR_PATH,
        [BDPT] = JOB_INTEGRATOR_PATH,
        [PHOTON] = JOB_INTEGRATOR_PATH,
        [DIRECT] = JOB_INTEGRATOR_DIRECT,
        [AO] = JOB_INTEGRATOR_AO};
    l->spec.integrator = integrators[type];
    if (type == BDPT || type == PHOTON)
        json_get_problem(&l->g, DIAG_WARNING, json_get_member(v, "type"), "integrator-replaced",
                         NULL,
                         "\"%s\" is rendered by the path integrator: the same light by other "
                         "means",
                         integrator_types[type]);
    if (type == INTERSECTION_TEST) {
        l->spec.max_depth = 16;
        l->spec.spp = 8;
        l->spec.sampler = JOB_SAMPLER_HALTON;
    }
}

void scene_load_integrator(struct scene_loader *l, const struct json *v)
{
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    int type = PATH, sampler;
    if (!json_get_choice(&l->g, v, "type", integrator_types, INTEGRATOR_TYPES, &type))
        return;
    check_integrator_keys(l, v, type);
    set_integrator(l, v, type);
    struct job_spec *s = &l->spec;
    uint64_t photons;
    (void)json_get_u64(&l->g, v, "spp", 1, JOB_SPP_MAX, &s->spp);
    (void)json_get_u32(&l->g, v, "max_depth", 1, JOB_DEPTH_MAX, &s->max_depth);
    (void)json_get_number(&l->g, v, "rr_threshold", 0, 1e6, &s->rr_threshold);
    (void)scene_load_vec3(l, v, "point_light_position", l->scene.seed_light_position);
    (void)scene_load_color(l, v, "point_light_flux", l->scene.seed_light_flux);
    (void)json_get_u64(&l->g, v, "n_photons", 0, UINT64_MAX, &photons);
    (void)json_get_u64(&l->g, v, "n_iterations", 0, UINT64_MAX, &photons);
    (void)json_get_u64(&l->g, v, "n_near_photons", 0, UINT64_MAX, &photons);
    (void)json_get_u64_text(&l->g, v, "seed", &s->seed);
    load_profile(l, v);
    sampler = (int)s->sampler;
    (void)json_get_choice(&l->g, v, "sampler", job_sampler_names, JOB_SAMPLER_COUNT, &sampler);
    s->sampler = (enum job_sampler)sampler;
}

/* --- film ---------------------------------------------------------------- */

static void load_filter(struct scene_loader *l, const struct json *v)
{
    static const char *const keys[] = {"type", "radius", "alpha", "B", "C"};
    struct job_spec *s = &l->spec;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    int type = (int)s->filter;
    (void)json_get_choice(&l->g, v, "type", job_filter_names, JOB_FILTER_COUNT, &type);
    s->filter = (enum job_filter)type;
    (void)json_get_number(&l->g, v, "radius", 1e-6, 64, &s->filter_radius);
    (void)json_get_number(&l->g, v, "alpha", 0, 1e6, &s->filter_alpha);
    (void)json_get_number(&l->g, v, "B", -1e6, 1e6, &s->filter_b);
    (void)json_get_number(&l->g, v, "C", -1e6, 1e6, &s->filter_c);
}

/* An array of whole numbers. */
static bool load_pixels(struct scene_loader *l, const struct json *film, const char *key,
                        uint32_t count, uint32_t low, uint32_t *out)
{
    const struct json *v = json_get_member(film, key);
    uint64_t values[4];
    if (!v)
        return true;
    if (!json_get_is(&l->g, v, JSON_ARRAY))
        return false;
    if (v->count != count) {
        json_get_problem(&l->g, DIAG_ERROR, v, "wrong-length", NULL,
                         "expected %u numbers, found %u", count, v->count);
        return false;
    }
    bool good = true;
    for (const struct json *e = v->first; e; e = e->next)
        good = json_value_uint(&l->g, e, low, JOB_SIDE_MAX, &values[e->index]) && good;
    for (uint32_t i = 0; good && i < count; i++)
        out[i] = (uint32_t)values[i];
    return good;
}

static void load_crop(struct scene_loader *l, const struct json *v)
{
    struct job_spec *s = &l->spec;
    uint32_t crop[4] = {0, 0, s->width, s->height};
    if (!load_pixels(l, v, "crop", 4, 0, crop))
        return;
    if (crop[2] == 0 || crop[3] == 0 || crop[0] >= s->width || crop[1] >= s->height ||
        crop[2] > s->width - crop[0] || crop[3] > s->height - crop[1]) {
        json_get_problem(&l->g, DIAG_ERROR, json_get_member(v, "crop"), "out-of-range", NULL,
                         "expected x, y, width, height of a part of the %ux%u picture", s->width,
                         s->height);
        return;
    }
    s->crop = (struct job_crop){crop[0], crop[1], crop[2], crop[3]};
}

void scene_load_film(struct scene_loader *l, const struct json *v)
{
    static const char *const keys[] = {"resolution", "block_side_length", "filter", "crop"};
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    uint32_t size[2] = {l->spec.width, l->spec.height};
    if (load_pixels(l, v, "resolution", 2, 1, size)) {
        l->spec.width = size[0];
        l->spec.height = size[1];
        load_crop(l, v);
    }
    (void)json_get_u32(&l->g, v, "block_side_length", 1, JOB_TILE_MAX, &l->spec.tile);
    load_filter(l, json_get_member(v, "filter"));
}

/* --- camera -------------------------------------------------------------- */

static const char *const camera_types[] = {"pinhole", "thin-lens", "orthographic", "panorama"};

static void check_view(struct scene_loader *l, const struct json *v)
{
    const struct scene_camera *c = &l->scene.camera;
    double d[3], u[3], d_max = 0, u_max = 0;
    for (int i = 0; i < 3; i++) {
        d[i] = c->look_at[i] - c->position[i];
        d_max = fmax(d_max, fabs(d[i]));
        u_max = fmax(u_max, fabs(c->ref_up[i]));
    }
    if (d_max == 0 || u_max == 0) {
        json_get_problem(&l->g, DIAG_ERROR, v, "camera-degenerate", NULL,
                         d_max == 0
                             ? "the camera looks at itself: position and look_at are the same"
                             : "ref_up is zero, expected a direction");
        return;
    }
    double dd = 0, uu = 0, cc = 0;
    for (int i = 0; i < 3; i++) {
        d[i] /= d_max;
        u[i] = c->ref_up[i] / u_max;
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double cross = d[j] * u[k] - d[k] * u[j];
        dd += d[i] * d[i];
        uu += u[i] * u[i];
        cc += cross * cross;
    }
    if (cc <= 1e-20 * dd * uu)
        json_get_problem(&l->g, DIAG_ERROR, v, "camera-degenerate",
                         "choose another ref_up, such as [0, 0, 1]",
                         "ref_up is parallel to the direction of view");
}

static void load_lens(struct scene_loader *l, const struct json *v)
{
    struct scene_camera *c = &l->scene.camera;
    int type = SCENE_CAMERA_PINHOLE;
    double focal = c->focal_length;
    (void)json_get_number(&l->g, v, "aperture_radius", 0, SCENE_NUMBER_MAX, &c->aperture_radius);
    if (c->aperture_radius > 0)
        type = SCENE_CAMERA_THIN_LENS;
    (void)json_get_choice(&l->g, v, "type", camera_types, 4, &type);
    c->type = (enum scene_camera_type)type;
    bool thin = c->type == SCENE_CAMERA_THIN_LENS;
    (void)json_get_number(&l->g, v, "focal_length", thin ? 1e-150 : -SCENE_NUMBER_MAX,
                          SCENE_NUMBER_MAX, &focal);
    c->focal_length = focal > 0 ? focal : 1; /* of no effect on the other cameras */
    (void)json_get_number(&l->g, v, "ortho_height", 1e-150, SCENE_NUMBER_MAX, &c->ortho_height);
}

void scene_load_camera(struct scene_loader *l, const struct json *v)
{
    static const char *const keys[] = {"type", "position",     "look_at",      "ref_up",
                                       "fov",  "focal_length", "ortho_height", "aperture_radius"};
    struct scene_camera *c = &l->scene.camera;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    bool placed = scene_load_vec3(l, v, "position", c->position);
    placed = scene_load_vec3(l, v, "look_at", c->look_at) && placed;
    placed = scene_load_vec3(l, v, "ref_up", c->ref_up) && placed;
    if (placed)
        check_view(l, v);
    double fov = c->fov;
    if (json_get_number(&l->g, v, "fov", -SCENE_NUMBER_MAX, SCENE_NUMBER_MAX, &fov)) {
        if (fov > 0 && fov < 180)
            c->fov = fov;
        else
            json_get_problem(&l->g, DIAG_ERROR, json_get_member(v, "fov"), "out-of-range",
                             "the vertical angle of view, in degrees",
                             "%.10g is out of range, expected over 0 and under 180", fov);
    }
    load_lens(l, v);
}
