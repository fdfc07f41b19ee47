#include "worker/render/render.h"

#include <float.h>
#include <string.h>
#include <xmmintrin.h>

#include "worker/render/first_hit.h"
#include "worker/render/accel_lazy.h"
#include "worker/render/next_event.h"
#include "worker/render/outline.h"
#include "worker/render/wave.h"

/* Round to nearest, exceptions masked, no flush to zero. */
enum { MXCSR_DEFAULT = 0x1f80 };

/* Keeps the numbers of the camera apart from those of the group at the same corner. */
static const uint64_t CAMERA_SEED = UINT64_C(0x5851f42d4c957f2d);

/* And those of twigs apart from both. */
static const uint64_t TWIG_SEED = UINT64_C(0x14057b7ef767814f);

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

size_t render_lacks(const struct render_scratch *s, const uint32_t **numbers)
{
    *numbers = s->lacks.numbers;
    return s->lacks.count;
}

/* Walks the groups of a unit, sample by sample: cells, rows of groups, groups, samples. */
struct cursor {
    const struct grid *grid;
    struct job_block block;
    uint32_t width, height; /* of the full picture */
    uint32_t side;          /* of a group */
    uint32_t cell, cell_end;
    struct grid_rect rect;
    uint64_t rect_begin; /* pixels of the unit before this cell */
    uint32_t x, y;       /* the group's corner */
    uint64_t sample;     /* in the block */
    bool probed;         /* outlines is known: outline_pixels() of the group */
    uint32_t outlines;
    bool skims; /* one sample of each group is enough: the result does not count */
};

/* Goes to the first group that meets the cell. */
static void cursor_enter_cell(struct cursor *c)
{
    c->rect = grid_cell(c->grid, c->cell);
    c->x = c->rect.x / c->side * c->side;
    c->y = c->rect.y / c->side * c->side;
}

static struct cursor cursor_of(const struct render_scene *scene, const struct grid *grid,
                               struct unit unit, struct job_block block)
{
    struct cursor c = {.grid = grid,
                       .block = block,
                       .width = scene->spec.width,
                       .height = scene->spec.height,
                       .side = wave_group_side(scene),
                       .cell = unit.cell_begin,
                       .cell_end = unit.cell_begin + unit.cell_count};
    cursor_enter_cell(&c);
    return c;
}

static void cursor_next(struct cursor *c)
{
    if (++c->sample < c->block.count && !c->skims)
        return;
    c->sample = 0;
    c->probed = false;
    c->x += c->side;
    if (c->x < c->rect.x + c->rect.width)
        return;
    c->x = c->rect.x / c->side * c->side;
    c->y += c->side;
    if (c->y < c->rect.y + c->rect.height)
        return;
    c->rect_begin += (uint64_t)c->rect.width * c->rect.height;
    if (++c->cell < c->cell_end)
        cursor_enter_cell(c);
}

/* The group cut to the picture. */
static struct grid_rect cursor_group(const struct cursor *c)
{
    uint32_t right = c->width - c->x, below = c->height - c->y;
    return (struct grid_rect){c->x, c->y, right < c->side ? right : c->side,
                              below < c->side ? below : c->side};
}

/* The pilot's sequences are scrambled on their own, as those of two more halves. */
static uint32_t sequence_of(const struct cursor *c)
{
    return c->block.half + (c->block.pilot ? 2 : 0);
}

/* The place of a pixel's sample in the sequence of its group: each pixel takes a run of its own,
 * aligned, so that its first 2^k samples are evenly spread whatever k is. Where every pixel gets
 * the same samples the runs are as long as that, and evenly spread over all pixels too. Where
 * nobody knows yet how many a pixel will get, they are RUN long; the few pixels with more of them
 * go on behind all runs, with samples 2^k to 2^(k+1) - 1 as a run each. */
static uint64_t group_index(const struct render_scene *scene, const struct cursor *c, uint64_t lane)
{
    enum { RUN = 4096 };
    const struct job_spec *spec = &scene->spec;
    uint64_t index = c->block.begin + c->sample, run = 1;
    if (spec->stop == JOB_STOP_SPP) {
        while (run < spec->spp - spec->spp / 2)
            run *= 2;
        return lane * run + index;
    }
    if (index < RUN)
        return lane * RUN + index;
    while (run <= index / 2)
        run *= 2;
    return ((uint64_t)c->side * c->side + lane) * run + (index - run);
}

static struct sampler group_sampler(const struct render_scene *scene, const struct cursor *c,
                                    uint32_t x, uint32_t y)
{
    uint64_t lane = (uint64_t)(y - c->y) * c->side + (x - c->x);
    return sampler_of(scene->spec.sampler, scene->spec.seed, c->x, c->y, sequence_of(c),
                      group_index(scene, c, lane));
}

/* What paths have alike when they start. */
static void init_path(struct render_scratch *w, uint32_t index, uint32_t x, uint32_t y)
{
    struct path *path = &w->paths[index];
    w->samplers[index] = path->own;
    path->x = x;
    path->y = y;
    path->radiance = path->twigs = rgb_grey(0);
    path->beta = rgb_grey(1);
    path->n = v3(0, 0, 0);
    path->eta2 = path->carried = path->share = 1;
    path->pdf = 0;
    path->candidates = 1;
    path->through.points = 0;
    path->asked = 0;
    path->twig = false;
}

/* Makes the sample of a pixel of the group at the cursor a path, as yet without a ray. */
static void start_path(const struct render_scene *scene, const struct cursor *c, uint32_t x,
                       uint32_t y, struct render_scratch *w)
{
    const struct job_spec *spec = &scene->spec;
    uint32_t index = w->path_count++;
    struct path *path = &w->paths[index];
    path->own = sampler_of(spec->sampler, spec->seed ^ CAMERA_SEED, x, y, sequence_of(c),
                           c->block.begin + c->sample);
    path->sampler = group_sampler(scene, c, x, y);
    init_path(w, index, x, y);
    w->reuse[index].state = REUSE_NONE;
}

/* Adds the twigs of the last path, a sequence over the samples of its pixel. */
static void start_twigs(const struct render_scene *scene, const struct cursor *c,
                        struct render_scratch *w)
{
    const struct job_spec *spec = &scene->spec;
    uint32_t owner = w->path_count - 1, x = w->paths[owner].x, y = w->paths[owner].y;
    w->paths[owner].share = 1.0 / (OUTLINE_TWIGS + 1);
    for (uint32_t k = 0; k < OUTLINE_TWIGS; k++) {
        uint32_t index = --w->twig_begin;
        struct path *path = &w->paths[index];
        path->own = sampler_of(spec->sampler, spec->seed ^ TWIG_SEED, x, y, sequence_of(c),
                               (c->block.begin + c->sample) * OUTLINE_TWIGS + k);
        path->sampler = path->own;
        init_path(w, index, x, y);
        path->twig = true;
        path->owner = owner;
        path->share = 1.0 / (OUTLINE_TWIGS + 1);
        w->reuse[index].state = REUSE_ALONE;
    }
}
/* Draws the film point of path `index` from two numbers, and sets its camera ray, number `slot`. */
static void aim_path(const struct render_scene *scene, struct render_scratch *w, uint32_t slot,
                     uint32_t index, double u_x, double u_y)
{
    struct path *path = &w->paths[index];
    double u[SAMPLER_SET_VALUES] = {0}, weight_x, weight_y;
    double film_x = path->x + 0.5 + film_filter_sample(&scene->filter, u_x, &weight_x);
    double film_y = path->y + 0.5 + film_filter_sample(&scene->filter, u_y, &weight_y);
    path->filter_weight = weight_x * weight_y;
    if (scene->camera.type == SCENE_CAMERA_THIN_LENS)
        sampler_set(&w->samplers[index], WAVE_SET_LENS, u);
    vec3 dir;
    camera_ray(&scene->camera, film_x, film_y, u, &path->org, &dir);
    if (scene->has_filtered)
        camera_footprint(&scene->camera, film_x, film_y, u, scene->footprint_step,
                         &w->footprints[index]);
    wave_continue(w, slot, index, path->org, dir);
}

/* Gives paths begin..end their camera rays, from number `slot` on. `lights`: one point on a light
 * is drawn at vertex 0, whose numbers are the first two, which are spread best. */
static void aim_paths(const struct render_scene *scene, struct render_scratch *w, uint32_t slot,
                      uint32_t begin, uint32_t end, bool lights)
{
    double(*u)[WAVE_PATHS] = w->vertex_u;
    double *const values[SAMPLER_SET_VALUES] = {u[0] + begin, u[1] + begin, u[2] + begin,
                                                u[3] + begin};
    sampler_sets(w->samplers + begin, end - begin, WAVE_SET_CAMERA, lights ? 4 : 2, values);
    int film = lights ? 2 : 0;
    for (uint32_t i = begin; i < end; i++) {
        w->paths[i].light_u[0] = u[0][i];
        w->paths[i].light_u[1] = u[1][i];
        aim_path(scene, w, slot + (i - begin), i, u[film][i], u[film + 1][i]);
    }
}

/* True if vertices of the job's paths look for lights. */
static bool looks_for_lights(const struct render_scene *scene)
{
    return scene->spec.integrator == JOB_INTEGRATOR_PATH ||
           scene->spec.integrator == JOB_INTEGRATOR_DIRECT;
}

/* Adds the group at the cursor; false if there is no room. */
static bool add_paths(const struct render_scene *scene, struct cursor *c, struct render_scratch *w)
{
    struct grid_rect g = cursor_group(c);
    if (!c->probed && scene->lights.any_lamp && looks_for_lights(scene))
        c->outlines = outline_pixels(scene, w, g);
    c->probed = true;
    uint32_t twigs = OUTLINE_TWIGS * (uint32_t)__builtin_popcount(c->outlines);
    if (w->path_count + g.width * g.height + twigs > w->twig_begin)
        return false;
    w->groups[w->group_count++] = w->path_count;
    for (uint32_t i = 0; i < g.width * g.height; i++) {
        start_path(scene, c, g.x + i % g.width, g.y + i / g.width, w);
        if (c->outlines >> i & 1)
            start_twigs(scene, c, w);
    }
    cursor_next(c);
    return true;
}

static void fill_wave(const struct render_scene *scene, struct cursor *c, struct render_scratch *w)
{
    w->path_count = w->group_count = w->shadow_count = 0;
    w->twig_begin = WAVE_PATHS;
    while (c->cell < c->cell_end && add_paths(scene, c, w))
        ;
    w->groups[w->group_count] = w->path_count;
    bool lights = looks_for_lights(scene);
    aim_paths(scene, w, 0, 0, w->path_count, lights && next_event_points(scene, true) == 1);
    aim_paths(scene, w, w->path_count, w->twig_begin, WAVE_PATHS, lights);
    w->active_count = w->path_count + (WAVE_PATHS - w->twig_begin);
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

/* The sums of the group being added up. */
struct sums {
    struct cursor at;
    rgb pixels[WAVE_GROUP_PATHS];
    double means[WAVE_GROUP_PATHS][AOV_MEAN_PLANES_MAX];
    uint32_t centre_count, mean_count; /* AOV planes of either kind */
    uint64_t plane;                    /* pixels in a plane */
    float *out;
};

/* The place of a pixel in the unit's planes; false when it is not of the cell. */
static bool place_of(const struct cursor *c, uint32_t x, uint32_t y, uint64_t *place)
{
    const struct grid_rect *r = &c->rect;
    if (x < r->x || x - r->x >= r->width || y < r->y || y - r->y >= r->height)
        return false;
    *place = c->rect_begin + (uint64_t)(y - r->y) * r->width + (x - r->x);
    return true;
}

static void count_nonfinite(const struct render_scene *scene, const struct path *path,
                            const struct cursor *c, struct render_counters *counters)
{
    uint64_t place;
    if (!place_of(c, path->x, path->y, &place))
        return;
    if (counters->nonfinite++ == 0) {
        counters->nonfinite_pixel = (uint64_t)path->y * scene->spec.width + path->x;
        counters->nonfinite_sample = job_sample_number(c->block.half, c->block.begin + c->sample);
    }
}

/* True for numbers of which `count` can be added up in the film's floats. */
static bool fits_film(rgb v, uint64_t count)
{
    double limit = (double)FLT_MAX / (double)count;
    return fabs(v.r) < limit && fabs(v.g) < limit && fabs(v.b) < limit;
}

static void add_means(struct sums *sums, uint32_t pixel, const double *values, double weight)
{
    for (uint32_t k = 0; k < sums->mean_count; k++)
        sums->means[pixel][k] += values[k] * weight;
}

/* Writes a pixel of the group, of which the block's last sample is in the sums. */
static void put_pixel(struct sums *sums, uint32_t pixel, uint64_t place)
{
    const rgb *color = &sums->pixels[pixel];
    sums->out[place] = (float)color->r;
    sums->out[sums->plane + place] = (float)color->g;
    sums->out[2 * sums->plane + place] = (float)color->b;
    float *means = sums->out + (JOB_COLOR_PLANES + sums->centre_count) * sums->plane;
    for (uint32_t k = 0; k < sums->mean_count; k++)
        means[k * sums->plane + place] = (float)sums->means[pixel][k];
}

/* Adds the paths of one sample of a group, from `begin` on; behind the last sample, writes the
 * pixels. */
static void add_group(const struct render_scene *scene, const struct render_scratch *w,
                      uint32_t begin, uint32_t count, struct sums *sums,
                      struct render_counters *counters)
{
    const struct path *paths = w->paths + begin;
    bool last = sums->at.sample + 1 == sums->at.block.count;
    for (uint32_t i = 0; i < count; i++) {
        rgb value = rgb_add(rgb_scale(paths[i].radiance, paths[i].filter_weight), paths[i].twigs);
        if (fits_film(value, sums->at.block.count))
            sums->pixels[i] = rgb_add(sums->pixels[i], value);
        else
            count_nonfinite(scene, &paths[i], &sums->at, counters);
        add_means(sums, i, w->means[begin + i], paths[i].filter_weight);
        uint64_t place;
        if (!last)
            continue;
        if (place_of(&sums->at, paths[i].x, paths[i].y, &place))
            put_pixel(sums, i, place);
        sums->pixels[i] = rgb_grey(0);
        memset(sums->means[i], 0, sizeof sums->means[i]);
    }
    cursor_next(&sums->at);
}

/* The unit's AOVs of kind CENTRE: zeros in all blocks but the first, of the pilot and of the
 * estimate. */
static void put_centres(const struct render_scene *scene, const struct grid *grid, struct unit unit,
                        struct render_scratch *w, const struct sums *sums)
{
    float *planes = sums->out + JOB_COLOR_PLANES * sums->plane;
    if (sums->at.block.begin != 0 || sums->at.block.half != 0) {
        memset(planes, 0, sums->centre_count * sums->plane * sizeof *planes);
        return;
    }
    uint64_t place = 0;
    for (uint32_t i = 0; i < unit.cell_count; i++) {
        struct grid_rect rect = grid_cell(grid, unit.cell_begin + i);
        first_hit_centres(scene, w, rect, planes, sums->plane, place);
        place += (uint64_t)rect.width * rect.height;
    }
}

static void add_wave(const struct render_scene *scene, const struct render_scratch *w,
                     struct sums *sums, struct render_counters *counters)
{
    for (uint32_t g = 0; g < w->group_count; g++)
        add_group(scene, w, w->groups[g], w->groups[g + 1] - w->groups[g], sums, counters);
}

enum err render_unit(const struct render_scene *scene, const struct grid *grid, struct unit unit,
                     struct render_scratch *scratch, const atomic_bool *stop, float *out,
                     struct render_counters *counters)
{
    struct job_blocks blocks = job_spec_blocks(&scene->spec);
    TL_ASSERT(grid_has_unit(grid, &blocks, unit));
    struct job_block block = job_block_at(&blocks, unit.block);
    struct cursor cursor = cursor_of(scene, grid, unit, block);
    struct sums sums = {.at = cursor,
                        .plane = grid_pixels(grid, unit.cell_begin, unit.cell_count),
                        .centre_count = aov_planes(scene->spec.aov, AOV_CENTRE),
                        .mean_count = aov_planes(scene->spec.aov, AOV_MEAN),
                        .out = out};
    *counters = (struct render_counters){.samples = sums.plane * block.count,
                                         .nonfinite_pixel = UINT64_MAX};
    scratch->ray_count = 0;
    scratch->lacks.count = scratch->lacks.met = 0;
    uint64_t failures = accel_failures(scene->accel);
    unsigned int mxcsr = _mm_getcsr();
    _mm_setcsr(MXCSR_DEFAULT);
    enum err e = ERR_OK;
    while (cursor.cell < cursor.cell_end) {
        if (stop && atomic_load_explicit(stop, memory_order_relaxed)) {
            e = ERR_CANCELLED;
            break;
        }
        fill_wave(scene, &cursor, scratch);
        wave_trace(scene, scratch);
        if (sums.mean_count > 0)
            first_hit_means(scene, scratch);
        integrate(scene, scratch);
        cursor.skims = scratch->lacks.count > 0;
        if (!cursor.skims)
            add_wave(scene, scratch, &sums, counters);
    }
    if (e == ERR_OK && scratch->lacks.count > 0)
        e = ERR_NOT_FOUND;
    if (e == ERR_OK && sums.centre_count > 0)
        put_centres(scene, grid, unit, scratch, &sums);
    _mm_setcsr(mxcsr);
    counters->rays = scratch->ray_count;
    if (e == ERR_OK && accel_failures(scene->accel) != failures)
        return ERR_NOMEM;
    return e;
}
