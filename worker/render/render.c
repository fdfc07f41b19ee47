#include "worker/render/render.h"

#include <xmmintrin.h>

#include "worker/render/shade.h"
#include "worker/render/wave.h"

/* Round to nearest, exceptions masked, no flush to zero. */
enum { MXCSR_DEFAULT = 0x1f80 };

enum err render_scratch_new(struct render_scratch **out)
{
    struct render_scratch *s = mem_alloc_aligned(sizeof *s, 64);
    if (!s)
        return ERR_NOMEM;
    *out = s;
    return ERR_OK;
}

void render_scratch_free(struct render_scratch *s)
{
    mem_free(s);
}

/* Sets a ray to go on behind the surface that it hit. `end` is where a shadow ray ends, or NULL. */
static void pass_through(const struct render_scene *scene, const struct hit *hit, struct ray *ray,
                         const double *end)
{
    struct surface s;
    surface_of_hit(scene, hit, &s);
    vec3 dir = v3_of(ray->dir);
    vec3 org = surface_offset(s.p, s.ng, s.error, dir);
    v3_put(ray->org, org);
    if (end)
        v3_put(ray->dir, v3_sub(v3_of(end), org));
}

/* Rays that alpha lets through, drawn by opacity, one at a time: such surfaces are few. */
static void pass_rays(const struct render_scene *scene, struct render_scratch *w)
{
    for (uint32_t i = 0; i < w->active_count; i++) {
        struct path *path = &w->paths[w->active[i]];
        while (w->hits[i].object != SCENE_NONE) {
            double opacity = shade_opacity(scene, &w->hits[i]);
            double u[SAMPLER_SET_VALUES] = {0};
            if (opacity < 1)
                sampler_set(&path->sampler, WAVE_SET_PASS + path->passes, u);
            if (u[0] < opacity || path->passes >= WAVE_PASSES_MAX)
                break;
            path->passes++;
            pass_through(scene, &w->hits[i], &w->rays[i], NULL);
            accel_closest(scene->accel, &w->rays[i], &w->hits[i]);
            w->ray_count++;
        }
    }
}

void wave_trace(const struct render_scene *scene, struct render_scratch *w)
{
    accel_closest_batch(scene->accel, w->rays, w->active_count, w->hits);
    w->ray_count += w->active_count;
    if (scene->has_alpha)
        pass_rays(scene, w);
}

void wave_shadow(struct render_scratch *w, uint32_t path, vec3 org, vec3 target, bool distant,
                 vec3 wi, rgb radiance)
{
    struct ray *ray = &w->shadow_rays[w->shadow_count];
    v3_put(ray->org, org);
    v3_put(ray->dir, distant ? wi : v3_sub(target, org));
    ray->tmin = 0;
    ray->tmax = distant ? INFINITY : 1;
    w->shadow_path[w->shadow_count] = path;
    w->shadow_radiance[w->shadow_count] = radiance;
    w->shadow_count++;
}

/* What alpha leaves of the light along shadow ray i, which something blocks. */
static double transmittance(const struct render_scene *scene, struct render_scratch *w, uint32_t i)
{
    struct ray *ray = &w->shadow_rays[i];
    double left = 1, end[3];
    for (int k = 0; k < 3; k++)
        end[k] = ray->org[k] + ray->dir[k];
    for (int passes = 0; passes < WAVE_PASSES_MAX; passes++) {
        struct hit hit;
        accel_closest(scene->accel, ray, &hit);
        w->ray_count++;
        if (hit.object == SCENE_NONE)
            return left;
        left *= 1 - shade_opacity(scene, &hit);
        if (!(left > 0))
            return 0;
        pass_through(scene, &hit, ray, isinf(ray->tmax) ? NULL : end);
    }
    return 0;
}

static void look_through(const struct render_scene *scene, struct render_scratch *w)
{
    for (uint32_t i = 0; i < w->shadow_count; i++) {
        if (!w->occluded[i])
            continue;
        double left = transmittance(scene, w, i);
        w->occluded[i] = left == 0;
        w->shadow_radiance[i] = rgb_scale(w->shadow_radiance[i], left);
    }
}

void wave_gather(const struct render_scene *scene, struct render_scratch *w)
{
    accel_occluded_batch(scene->accel, w->shadow_rays, w->shadow_count, w->occluded);
    w->ray_count += w->shadow_count;
    if (scene->has_alpha)
        look_through(scene, w);
    for (uint32_t i = 0; i < w->shadow_count; i++) {
        if (w->occluded[i])
            continue;
        struct path *path = &w->paths[w->shadow_path[i]];
        path->radiance = rgb_add(path->radiance, w->shadow_radiance[i]);
    }
    w->shadow_count = 0;
}

/* Walks the samples of a unit in the order of their sums: cells, rows, pixels, samples. */
struct cursor {
    const struct grid *grid;
    struct job_block block;
    uint32_t cell, cell_end;
    struct grid_rect rect;
    uint32_t column, row; /* in the rect */
    uint64_t sample;      /* in the block */
};

static struct cursor cursor_of(const struct grid *grid, struct unit unit, struct job_block block)
{
    return (struct cursor){.grid = grid,
                           .block = block,
                           .cell = unit.cell_begin,
                           .cell_end = unit.cell_begin + unit.cell_count,
                           .rect = grid_cell(grid, unit.cell_begin)};
}

static void cursor_next(struct cursor *c)
{
    if (++c->sample < c->block.count)
        return;
    c->sample = 0;
    if (++c->column < c->rect.width)
        return;
    c->column = 0;
    if (++c->row < c->rect.height)
        return;
    c->row = 0;
    if (++c->cell < c->cell_end)
        c->rect = grid_cell(c->grid, c->cell);
}

/* Makes the sample at the cursor a path with its camera ray. */
static void start_path(const struct render_scene *scene, const struct cursor *c,
                       struct render_scratch *w, uint32_t index)
{
    const struct job_spec *spec = &scene->spec;
    struct path *path = &w->paths[index];
    uint32_t x = c->rect.x + c->column, y = c->rect.y + c->row;
    path->sampler =
        sampler_of(spec->sampler, spec->seed, x, y, c->block.half, c->block.begin + c->sample);
    path->x = x;
    path->y = y;
    path->radiance = rgb_grey(0);
    path->beta = rgb_grey(1);
    path->eta2 = 1;
    path->pdf = 0;
    path->passes = 0;
    double u[SAMPLER_SET_VALUES], weight_x, weight_y;
    sampler_set(&path->sampler, WAVE_SET_CAMERA, u);
    double film_x = x + 0.5 + film_filter_sample(&scene->filter, u[0], &weight_x);
    double film_y = y + 0.5 + film_filter_sample(&scene->filter, u[1], &weight_y);
    path->filter_weight = weight_x * weight_y;
    path->light_u[0] = u[2];
    path->light_u[1] = u[3];
    if (scene->camera.type == SCENE_CAMERA_THIN_LENS)
        sampler_set(&path->sampler, WAVE_SET_LENS, u);
    vec3 dir;
    camera_ray(&scene->camera, film_x, film_y, u, &path->org, &dir);
    wave_continue(w, index, index, path->org, dir);
}

static void fill_wave(const struct render_scene *scene, struct cursor *c, struct render_scratch *w)
{
    uint32_t count = 0;
    for (; count < WAVE_PATHS && c->cell < c->cell_end; count++) {
        start_path(scene, c, w, count);
        cursor_next(c);
    }
    w->path_count = w->active_count = count;
    w->shadow_count = 0;
}

static void integrate(const struct render_scene *scene, struct render_scratch *w)
{
    switch (scene->spec.integrator) {
    case JOB_INTEGRATOR_INTERSECTION_TEST:
        integrate_seed(scene, w);
        break;
    case JOB_INTEGRATOR_AO:
        integrate_ao(scene, w);
        break;
    default:
        integrate_path(scene, w);
        break;
    }
}

/* The sums of the pixel being added up, and where it goes. */
struct sums {
    rgb sum;
    uint64_t samples; /* added to it so far */
    uint64_t pixel;   /* its place in the planes */
    uint64_t plane;   /* pixels in a plane */
    float *rgb;
};

static void count_nonfinite(const struct render_scene *scene, const struct path *path,
                            uint32_t half, struct render_counters *counters)
{
    if (counters->nonfinite++ == 0) {
        counters->nonfinite_pixel = (uint64_t)path->y * scene->spec.width + path->x;
        counters->nonfinite_sample = job_sample_number(half, path->sampler.index);
    }
}

/* Adds the wave's samples to their pixels, in the order of the cursor. */
static void add_wave(const struct render_scene *scene, const struct render_scratch *w,
                     const struct job_block *block, struct sums *sums,
                     struct render_counters *counters)
{
    for (uint32_t i = 0; i < w->path_count; i++) {
        const struct path *path = &w->paths[i];
        rgb value = rgb_scale(path->radiance, path->filter_weight);
        if (rgb_is_finite(value))
            sums->sum = rgb_add(sums->sum, value);
        else
            count_nonfinite(scene, path, block->half, counters);
        if (++sums->samples < block->count)
            continue;
        sums->rgb[sums->pixel] = (float)sums->sum.r;
        sums->rgb[sums->plane + sums->pixel] = (float)sums->sum.g;
        sums->rgb[2 * sums->plane + sums->pixel] = (float)sums->sum.b;
        sums->pixel++;
        sums->samples = 0;
        sums->sum = rgb_grey(0);
    }
}

enum err render_unit(const struct render_scene *scene, const struct grid *grid, struct unit unit,
                     struct render_scratch *scratch, const atomic_bool *stop, float *rgb_sums,
                     struct render_counters *counters)
{
    struct job_blocks blocks = job_blocks_of(scene->spec.spp);
    TL_ASSERT(grid_has_unit(grid, &blocks, unit));
    struct job_block block = job_block_at(&blocks, unit.block);
    struct sums sums = {.plane = grid_pixels(grid, unit.cell_begin, unit.cell_count),
                        .rgb = rgb_sums};
    struct cursor cursor = cursor_of(grid, unit, block);
    *counters = (struct render_counters){.samples = sums.plane * block.count,
                                         .nonfinite_pixel = UINT64_MAX};
    scratch->ray_count = 0;
    unsigned int mxcsr = _mm_getcsr();
    _mm_setcsr(MXCSR_DEFAULT);
    enum err e = ERR_OK;
    while (cursor.cell < cursor.cell_end) {
        if (stop && atomic_load_explicit(stop, memory_order_relaxed)) {
            e = ERR_CANCELLED;
            break;
        }
        fill_wave(scene, &cursor, scratch);
        integrate(scene, scratch);
        add_wave(scene, scratch, &block, &sums, counters);
    }
    _mm_setcsr(mxcsr);
    counters->rays = scratch->ray_count;
    return e;
}
