#include "common/job_spec.h"

#include <math.h>
#include <string.h>

#include "common/buf.h"
#include "common/json_get.h"
#include "common/json_put.h"

#define JOB_NAME(suffix, name) name,
const char *const job_integrator_names[JOB_INTEGRATOR_COUNT] = {JOB_INTEGRATORS(JOB_NAME)};
const char *const job_profile_names[JOB_PROFILE_COUNT] = {JOB_PROFILES(JOB_NAME)};
const char *const job_sampler_names[JOB_SAMPLER_COUNT] = {JOB_SAMPLERS(JOB_NAME)};
const char *const job_filter_names[JOB_FILTER_COUNT] = {JOB_FILTERS(JOB_NAME)};
const char *const job_builder_names[JOB_BUILDER_COUNT] = {JOB_BUILDERS(JOB_NAME)};
const char *const job_intersector_names[JOB_INTERSECTOR_COUNT] = {JOB_INTERSECTORS(JOB_NAME)};
const char *const job_precision_names[JOB_PRECISION_COUNT] = {JOB_PRECISIONS(JOB_NAME)};
const char *const job_light_choice_names[JOB_LIGHT_CHOICE_COUNT] = {JOB_LIGHT_CHOICES(JOB_NAME)};
const char *const job_stop_names[JOB_STOP_COUNT] = {JOB_STOPS(JOB_NAME)};
#undef JOB_NAME

/* Filters wider than this many pixels blur the picture away; parameters stay this small. */
#define FILTER_RADIUS_MAX    64.0
#define FILTER_PARAMETER_MAX 1e6

int job_choice_find(const char *const *names, int count, const char *name)
{
    for (int i = 0; i < count; i++)
        if (strcmp(names[i], name) == 0)
            return i;
    return -1;
}

void job_spec_init(struct job_spec *s)
{
    *s = (struct job_spec){
        .width = 600,
        .height = 600,
        .crop = {.width = 600, .height = 600},
        .spp = 32,
        .max_depth = 12,
        .rr_threshold = 0.1,
        .tile = 16,
        .integrator = JOB_INTEGRATOR_PATH,
        .profile = JOB_PROFILE_MIS,
        .sampler = JOB_SAMPLER_SOBOL,
        .filter = JOB_FILTER_BOX,
        .filter_radius = 0.5,
        .filter_alpha = 2,
        .filter_b = 1 / 3.0,
        .filter_c = 1 / 3.0,
        .builder = JOB_BUILDER_SAH,
        .intersector = JOB_INTERSECTOR_WOOP,
        .precision = JOB_PRECISION_EXACT,
    };
}

/* --- Validity ------------------------------------------------------------ */

static bool check(bool good, struct diag_list *problems, const char *path, const char *expected)
{
    if (!good && problems)
        diag_add(problems, DIAG_ERROR, (struct diag_place){.path = path}, "out-of-range", NULL,
                 "out of range, expected %s", expected);
    return good;
}

static bool crop_valid(const struct job_spec *s)
{
    const struct job_crop *c = &s->crop;
    return c->width >= 1 && c->height >= 1 && c->x < s->width && c->y < s->height &&
           c->width <= s->width - c->x && c->height <= s->height - c->y;
}

uint32_t job_plane_count(const struct job_spec *s)
{
    return JOB_COLOR_PLANES + aov_planes(s->aov, AOV_CENTRE) + aov_planes(s->aov, AOV_MEAN);
}

/* A cell is the least that a worker can send. */
static bool cell_fits(const struct job_spec *s)
{
    uint64_t width = s->tile < s->width ? s->tile : s->width;
    uint64_t height = s->tile < s->height ? s->tile : s->height;
    return width * height * job_plane_count(s) <= JOB_CELL_VALUES_MAX;
}

static bool within(double v, double low, double high)
{
    return isfinite(v) && v >= low && v <= high;
}

static bool choices_valid(const struct job_spec *s)
{
    return (unsigned)s->integrator < JOB_INTEGRATOR_COUNT &&
           (unsigned)s->profile < JOB_PROFILE_COUNT && (unsigned)s->sampler < JOB_SAMPLER_COUNT &&
           (unsigned)s->filter < JOB_FILTER_COUNT && (unsigned)s->builder < JOB_BUILDER_COUNT &&
           (unsigned)s->intersector < JOB_INTERSECTOR_COUNT &&
           (unsigned)s->precision < JOB_PRECISION_COUNT && (unsigned)s->stop < JOB_STOP_COUNT &&
           (unsigned)s->light_choice < JOB_LIGHT_CHOICE_COUNT;
}

/* What ends the job has what it needs. */
static bool stop_valid(const struct job_spec *s, struct diag_list *problems)
{
    bool good = true;
    if (s->stop == JOB_STOP_ERROR)
        good &= check(s->target_error > 0 && isfinite(s->target_error), problems, "$.target_error",
                      "a number over 0");
    if (s->stop == JOB_STOP_TIME)
        good &= check(s->time_limit_s > 0 && s->time_limit_s <= JOB_TIME_LIMIT_MAX_S, problems,
                      "$.time_limit", "over 0, at most 10000000 seconds");
    if (s->stop != JOB_STOP_SPP)
        good &= check(s->spp >= JOB_ADAPTIVE_SPP_MIN && s->spp <= JOB_ADAPTIVE_SPP_MAX, problems,
                      "$.spp", "4 to 2^32 where samples differ from square to square");
    return good;
}

static bool tags_valid(const struct tags *t)
{
    char list[TAG_LIST_BYTES];
    struct tags same;
    if (t->count > TAGS_MAX)
        return false;
    tags_list(t, list);
    return tags_parse(list, &same, NULL);
}

bool job_spec_valid(const struct job_spec *s, struct diag_list *problems)
{
    const double limit = FILTER_PARAMETER_MAX;
    bool good = true;
    good &= check(s->width >= 1 && s->width <= JOB_SIDE_MAX, problems, "$.width", "1 to 65535");
    good &= check(s->height >= 1 && s->height <= JOB_SIDE_MAX, problems, "$.height", "1 to 65535");
    good &= check(crop_valid(s), problems, "$.crop", "x, y, width, height within the picture");
    good &= check(s->spp >= 1 && s->spp <= JOB_SPP_MAX, problems, "$.spp", "1 to 2^40");
    good &= check(s->max_depth >= 1 && s->max_depth <= JOB_DEPTH_MAX, problems, "$.max_depth",
                  "1 to 1048576");
    good &= check(within(s->rr_threshold, 0, limit), problems, "$.rr_threshold", "0 to 1000000");
    good &= check(s->tile >= 1 && s->tile <= JOB_TILE_MAX, problems, "$.tile", "1 to 65535");
    good &= check(cell_fits(s), problems, "$.tile",
                  "cells of at most 16777216 pixels, fewer with AOVs");
    good &= check(s->filter_radius > 0 && s->filter_radius <= FILTER_RADIUS_MAX, problems,
                  "$.filter_radius", "over 0, at most 64 pixels");
    good &= check(within(s->verify, 0, 1), problems, "$.verify", "a share from 0 to 1");
    good &= check(within(s->filter_alpha, 0, limit), problems, "$.filter_alpha", "0 to 1000000");
    good &= check(within(s->filter_b, -limit, limit), problems, "$.filter_b", "a finite number");
    good &= check(within(s->filter_c, -limit, limit), problems, "$.filter_c", "a finite number");
    good &= check(s->aov >> AOV_COUNT == 0, problems, "$.aov", "known AOVs");
    good &= check(tags_valid(&s->tags), problems, "$.tags", "at most 8 different words");
    good &= check(choices_valid(s), problems, "$",
                  "known integrator, profile, sampler, filter, "
                  "builder, intersector, precision, light choice and stop");
    return stop_valid(s, problems) && good;
}

/* --- JSON ---------------------------------------------------------------- */

static void put_number(struct buf *b, const char *key, double v)
{
    buf_printf(b, ",\"%s\":", key);
    json_put_number(b, v);
}

char *job_spec_to_json(const struct job_spec *s)
{
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"width\":%u,\"height\":%u,\"crop\":[%u,%u,%u,%u],\"spp\":%llu", s->width,
               s->height, s->crop.x, s->crop.y, s->crop.width, s->crop.height,
               (unsigned long long)s->spp);
    buf_printf(&b, ",\"seed\":\"%llu\",\"max_depth\":%u,\"tile\":%u", (unsigned long long)s->seed,
               s->max_depth, s->tile);
    put_number(&b, "verify", s->verify);
    put_number(&b, "rr_threshold", s->rr_threshold);
    buf_printf(&b, ",\"integrator\":\"%s\",\"profile\":\"%s\",\"sampler\":\"%s\",\"filter\":\"%s\"",
               job_integrator_names[s->integrator], job_profile_names[s->profile],
               job_sampler_names[s->sampler], job_filter_names[s->filter]);
    put_number(&b, "filter_radius", s->filter_radius);
    put_number(&b, "filter_alpha", s->filter_alpha);
    put_number(&b, "filter_b", s->filter_b);
    put_number(&b, "filter_c", s->filter_c);
    buf_printf(&b, ",\"builder\":\"%s\",\"intersector\":\"%s\",\"precision\":\"%s\"",
               job_builder_names[s->builder], job_intersector_names[s->intersector],
               job_precision_names[s->precision]);
    buf_printf(&b, ",\"light_choice\":\"%s\"", job_light_choice_names[s->light_choice]);
    char aovs[AOV_LIST_BYTES];
    aov_list(s->aov, aovs);
    if (s->aov != 0)
        buf_printf(&b, ",\"aov\":\"%s\"", aovs);
    char tags[TAG_LIST_BYTES];
    tags_list(&s->tags, tags);
    if (s->tags.count > 0)
        buf_printf(&b, ",\"tags\":\"%s\"", tags);
    if (s->stop != JOB_STOP_SPP)
        buf_printf(&b, ",\"stop\":\"%s\"", job_stop_names[s->stop]);
    if (s->target_error > 0)
        put_number(&b, "target_error", s->target_error);
    if (s->time_limit_s > 0)
        put_number(&b, "time_limit", s->time_limit_s);
    buf_put_u8(&b, '}');
    buf_put_u8(&b, 0);
    if (buf_status(&b) == ERR_OK)
        return (char *)b.data;
    buf_release(&b);
    return NULL;
}

static void read_choices(struct json_get *g, struct job_spec *s)
{
    int integrator = (int)s->integrator, profile = (int)s->profile, sampler = (int)s->sampler;
    int filter = (int)s->filter, builder = (int)s->builder;
    int intersector = (int)s->intersector, precision = (int)s->precision, stop = (int)s->stop;
    int light_choice = (int)s->light_choice;
    const struct {
        const char *key;
        const char *const *names;
        int count, *value;
    } choices[] = {
        {"integrator", job_integrator_names, JOB_INTEGRATOR_COUNT, &integrator},
        {"profile", job_profile_names, JOB_PROFILE_COUNT, &profile},
        {"sampler", job_sampler_names, JOB_SAMPLER_COUNT, &sampler},
        {"filter", job_filter_names, JOB_FILTER_COUNT, &filter},
        {"builder", job_builder_names, JOB_BUILDER_COUNT, &builder},
        {"intersector", job_intersector_names, JOB_INTERSECTOR_COUNT, &intersector},
        {"precision", job_precision_names, JOB_PRECISION_COUNT, &precision},
        {"light_choice", job_light_choice_names, JOB_LIGHT_CHOICE_COUNT, &light_choice},
        {"stop", job_stop_names, JOB_STOP_COUNT, &stop},
    };
    for (size_t i = 0; i < sizeof choices / sizeof *choices; i++)
        (void)json_get_choice(g, g->root, choices[i].key, choices[i].names, choices[i].count,
                              choices[i].value);
    s->integrator = (enum job_integrator)integrator;
    s->profile = (enum job_profile)profile;
    s->sampler = (enum job_sampler)sampler;
    s->filter = (enum job_filter)filter;
    s->builder = (enum job_builder)builder;
    s->intersector = (enum job_intersector)intersector;
    s->precision = (enum job_precision)precision;
    s->light_choice = (enum job_light_choice)light_choice;
    s->stop = (enum job_stop)stop;
}

static void read_crop(struct json_get *g, struct job_spec *s)
{
    double crop[4] = {0, 0, s->width, s->height};
    if (!json_get_numbers(g, g->root, "crop", 4, 0, JOB_SIDE_MAX, crop))
        return;
    for (int i = 0; i < 4; i++)
        if (crop[i] != trunc(crop[i]))
            json_get_problem(g, DIAG_ERROR, json_get_member(g->root, "crop"), "out-of-range", NULL,
                             "expected four whole numbers");
    s->crop = (struct job_crop){(uint32_t)crop[0], (uint32_t)crop[1], (uint32_t)crop[2],
                                (uint32_t)crop[3]};
}

static void read_aov(struct json_get *g, struct job_spec *s)
{
    const char *list = NULL;
    char bad[AOV_LIST_BYTES], all[AOV_LIST_BYTES];
    if (!json_get_text(g, g->root, "aov", &list) || !list || aov_parse(list, &s->aov, bad))
        return;
    aov_list((UINT32_C(1) << AOV_COUNT) - 1, all);
    json_get_problem(g, DIAG_ERROR, json_get_member(g->root, "aov"), "out-of-range", NULL,
                     "\"%s\" is no AOV or comes twice, expected a list of %s", bad, all);
}

static void read_tags(struct json_get *g, struct job_spec *s)
{
    const char *list = NULL;
    char bad[TAG_BYTES];
    if (json_get_text(g, g->root, "tags", &list) && list && !tags_parse(list, &s->tags, bad))
        json_get_problem(g, DIAG_ERROR, json_get_member(g->root, "tags"), "out-of-range", NULL,
                         "\"%s\" is no tag, comes twice or is one too many, expected at most %d "
                         "of " TAG_EXPECTED,
                         bad, TAGS_MAX);
}

static void read_fields(struct json_get *g, struct job_spec *s)
{
    static const char *const known[] = {
        "width",      "height",     "crop",          "spp",          "seed",    "max_depth",
        "tile",       "integrator", "rr_threshold",  "profile",      "sampler", "filter",
        "filter_b",   "filter_c",   "filter_radius", "filter_alpha", "builder", "intersector",
        "precision",  "verify",     "aov",           "light_choice", "stop",    "target_error",
        "time_limit", "tags",
    };
    const struct json *o = g->root;
    const double limit = FILTER_PARAMETER_MAX;
    json_get_keys(g, o, known, sizeof known / sizeof *known);
    (void)json_get_u32(g, o, "width", 1, JOB_SIDE_MAX, &s->width);
    (void)json_get_u32(g, o, "height", 1, JOB_SIDE_MAX, &s->height);
    read_crop(g, s);
    read_aov(g, s);
    read_tags(g, s);
    (void)json_get_u64(g, o, "spp", 1, JOB_SPP_MAX, &s->spp);
    (void)json_get_u64_text(g, o, "seed", &s->seed);
    (void)json_get_u32(g, o, "max_depth", 1, JOB_DEPTH_MAX, &s->max_depth);
    (void)json_get_u32(g, o, "tile", 1, JOB_TILE_MAX, &s->tile);
    (void)json_get_number(g, o, "verify", 0, 1, &s->verify);
    (void)json_get_number(g, o, "rr_threshold", 0, limit, &s->rr_threshold);
    (void)json_get_number(g, o, "filter_radius", 0, FILTER_RADIUS_MAX, &s->filter_radius);
    (void)json_get_number(g, o, "filter_alpha", 0, limit, &s->filter_alpha);
    (void)json_get_number(g, o, "filter_b", -limit, limit, &s->filter_b);
    (void)json_get_number(g, o, "filter_c", -limit, limit, &s->filter_c);
    (void)json_get_number(g, o, "target_error", 0, limit, &s->target_error);
    (void)json_get_number(g, o, "time_limit", 0, JOB_TIME_LIMIT_MAX_S, &s->time_limit_s);
    read_choices(g, s);
}

enum err job_spec_from_json(const char *text, size_t bytes, struct job_spec *out,
                            struct diag_list *problems)
{
    struct json_get g;
    TL_TRY(json_get_open(&g, text, bytes, NULL, problems));
    struct job_spec s;
    job_spec_init(&s);
    size_t errors_before = problems->error_count;
    if (json_get_is(&g, g.root, JSON_OBJECT))
        read_fields(&g, &s);
    json_get_close(&g);
    if (problems->error_count != errors_before || !job_spec_valid(&s, problems))
        return ERR_INPUT;
    *out = s;
    return ERR_OK;
}

/* --- Sample blocks ------------------------------------------------------- */

static uint64_t half_samples(uint64_t spp, uint32_t half)
{
    return half == 0 ? spp - spp / 2 : spp / 2;
}

struct job_blocks job_blocks_of(uint64_t spp)
{
    TL_ASSERT(spp >= 1 && spp <= JOB_SPP_MAX);
    uint64_t samples = half_samples(spp, 0);
    uint64_t per_half = (samples + JOB_BLOCK_SAMPLES - 1) / JOB_BLOCK_SAMPLES;
    if (per_half > JOB_BLOCKS_MAX / 2)
        per_half = JOB_BLOCKS_MAX / 2;
    return (struct job_blocks){.count = spp == 1 ? 1 : 2 * (uint32_t)per_half, .spp = spp};
}

/* The pilot: pairs of blocks, so that its first say soon how fast it goes. To an error the first
 * pair is enough: 2 samples allocate nearly as well as 16, and are dropped all the same. Where
 * there is no room for more than 4 samples, the first two. A plan has room for all. */
enum { PILOT_PAIRS = 3, PILOT_PAIRS_SHORT = 2 };
/* Samples of a half after so many blocks of the pilot. */
static const uint64_t pilot_half[PILOT_PAIRS + 1] = {0, 1, 2, 8};

uint64_t job_ladder(uint32_t blocks)
{
    enum { STRAIGHT = 4, STEP = 2, STEPS_PER_OCTAVE = 4 };
    if (blocks <= STRAIGHT)
        return (uint64_t)STEP * blocks;
    uint32_t above = blocks - STRAIGHT;
    uint64_t octave = (uint64_t)STEP * STRAIGHT << (above / STEPS_PER_OCTAVE);
    return octave + above % STEPS_PER_OCTAVE * (octave / STEPS_PER_OCTAVE);
}

struct job_blocks job_spec_blocks(const struct job_spec *s)
{
    if (s->stop == JOB_STOP_SPP)
        return job_blocks_of(s->spp);
    TL_ASSERT(s->spp >= JOB_ADAPTIVE_SPP_MIN && s->spp <= JOB_ADAPTIVE_SPP_MAX);
    uint32_t pairs = s->stop == JOB_STOP_ERROR              ? 1
                     : s->spp < 2 * pilot_half[PILOT_PAIRS] ? PILOT_PAIRS_SHORT
                                                            : PILOT_PAIRS;
    struct job_blocks b = {.spp = s->spp, .pilot = 2 * pairs};
    uint32_t per_half = 1;
    while (2 * job_ladder(per_half + 1) <= s->spp)
        per_half++;
    b.count = b.pilot + 2 * per_half;
    TL_ASSERT(b.count <= JOB_BLOCKS_MAX);
    return b;
}

static struct job_block growing_block(const struct job_blocks *b, uint32_t block)
{
    struct job_block out = {.half = block & 1, .pilot = block < b->pilot};
    uint32_t position = (out.pilot ? block : block - b->pilot) / 2;
    out.begin = out.pilot ? pilot_half[position] : job_ladder(position);
    uint64_t end = out.pilot ? pilot_half[position + 1] : job_ladder(position + 1);
    out.count = end - out.begin;
    return out;
}

struct job_block job_block_at(const struct job_blocks *b, uint32_t block)
{
    TL_ASSERT(block < b->count);
    if (b->pilot > 0)
        return growing_block(b, block);
    uint32_t half = block & 1;
    uint64_t samples = half_samples(b->spp, half), position = block / 2;
    uint64_t per_half = b->count == 1 ? 1 : b->count / 2;
    /* Shares differ by at most one; none is empty, since per_half <= samples. */
    uint64_t begin = samples * position / per_half, end = samples * (position + 1) / per_half;
    return (struct job_block){.half = half, .begin = begin, .count = end - begin};
}

uint64_t job_blocks_samples(const struct job_blocks *b, uint32_t blocks)
{
    if (blocks <= b->pilot)
        return 0;
    uint32_t own = blocks - b->pilot;
    return job_ladder((own + 1) / 2) + job_ladder(own / 2);
}

uint64_t job_pilot_samples(const struct job_blocks *b)
{
    return 2 * pilot_half[b->pilot / 2];
}

uint64_t job_sample_number(uint32_t half, uint64_t index)
{
    return 2 * index + half;
}
