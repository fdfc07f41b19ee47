/* The sky's map to tables of where its light comes from, for worker/render/sky.h. Memory is the
 * scene's arena. One thread. */
#include "worker/scene/scene_parts.h"

#include <emmintrin.h>

#include "common/dmath.h"
#include "worker/render/next_event.h"
#include "worker/render/warp.h"

/* Cells across the map: as many as texels, within these bounds. A picture of few texels has light
 * that changes within them. */
enum { CELLS_ACROSS_MIN = 128, CELLS_ACROSS_MAX = 2048, CELLS_ACROSS_PATTERN = 256 };

/* A share of the mean luminance that every cell has, so that a light between the places where the
 * table looked is found. */
static const double SKY_FLOOR = 0.001;

/* A sky of less light than that in the mean is drawn as a black one, each direction alike: no film
 * shows it, and where its numbers are denormal their ratios are not known. */
static const double SKY_MEAN_MIN = 1e-200;

/* So much of the cosine's own density is left to the surface's directions, where both kinds are
 * drawn: the two together, several of the sky and one of the surface, then have the density of what
 * a diffuse surface reflects. Behind the first vertex of a path, where there is one of each, half
 * would be right. */
static const double COMPENSATION = 1.0 / (1 + NEXT_EVENT_POINTS_MAX);

/* Of its light, the least that a block counts after that. */
static const double BLOCK_FLOOR = 0.02;

struct angle {
    double sine, cosine;
};

/* All blocks, a property a row: two are looked at in one vector. */
struct blocks {
    double weight[SKY_BLOCKS]; /* of the cells */
    double solid[SKY_BLOCKS];  /* as shares of the sphere */
    double middle[3]
                 [SKY_BLOCKS]; /* the mean direction of the light, in the scene; shorter than 1 */
    struct angle radius[SKY_BLOCKS]; /* no point of the block is further from that */
    struct angle widest;
};

_Static_assert(SKY_BLOCKS_ACROSS % 2 == 0 && SKY_BLOCKS_DOWN % 2 == 0, "blocks come in pairs");

/* The inverse of the transform's rotation: its columns made orthonormal, transposed. */
static void sky_rotation(const double m[16], double to_local[9])
{
    vec3 x = v3(m[0], m[4], m[8]), y = v3(m[1], m[5], m[9]), z = v3(m[2], m[6], m[10]);
    double handed = v3_dot(v3_cross(x, y), z) < 0 ? -1 : 1;
    x = v3_unit(x);
    y = v3_unit(v3_sub(y, v3_scale(x, v3_dot(x, y))));
    z = v3_scale(v3_cross(x, y), handed);
    /* A transform that flattens space has no rotation. */
    if (!(fabs(v3_dot(v3_cross(x, y), z)) > 0.5)) {
        x = v3(1, 0, 0);
        y = v3(0, 1, 0);
        z = v3(0, 0, 1);
    }
    v3_put(to_local, x);
    v3_put(to_local + 3, y);
    v3_put(to_local + 6, z);
}

/* --- Cells ---------------------------------------------------------------- */

static double luminance_at(const struct environment *sky, double x, double y)
{
    double value = rgb_luminance(environment_lookup(sky, x / sky->map.width, y / sky->map.height));
    return value > 0 ? value : 0;
}

/* Luminances along a row, at x = `from`, from + 1, ... */
static void luminances(const struct environment *sky, double from, double y, uint32_t count,
                       double *out)
{
    for (uint32_t x = 0; x < count; x++)
        out[x] = luminance_at(sky, x + from, y);
}

/* The mean luminance of each cell, from its corners and middle, to where the cumulated weights are
 * to be: that of cell x of row y at along[y * (width + 1) + x + 1]. */
static enum err measure_cells(const struct environment *sky, double *along)
{
    uint32_t width = sky->map.width;
    double *above = mem_alloc_array(3 * (size_t)(width + 1), sizeof *above);
    if (!above)
        return ERR_NOMEM;
    double *below = above + width + 1, *middle = below + width + 1;
    luminances(sky, 0, 0, width + 1, above);
    for (uint32_t y = 0; y < sky->map.height; y++) {
        double *cells = along + (size_t)y * (width + 1);
        luminances(sky, 0, y + 1.0, width + 1, below);
        luminances(sky, 0.5, y + 0.5, width, middle);
        for (uint32_t x = 0; x < width; x++)
            cells[x + 1] = (above[x] + above[x + 1] + below[x] + below[x + 1] + middle[x]) / 5;
        memcpy(above, below, (width + 1) * sizeof *above);
    }
    mem_free(above);
    return ERR_OK;
}

/* From luminances to weights, which are times the sine, with the floor, such that their sum is the
 * mean luminance over the sphere; cumulated along each row. */
static void cumulate_cells(struct sky_map *m, double *along)
{
    size_t stride = m->width + 1;
    double sum = 0, sines = 0;
    for (uint32_t y = 0; y < m->height; y++) {
        double sine = dmath_sinpi((y + 0.5) / m->height), row = 0;
        for (uint32_t x = 1; x <= m->width; x++)
            row += along[y * stride + x];
        sines += sine * m->width;
        sum += sine * row;
    }
    bool dark = !(sum / sines > SKY_MEAN_MIN);
    m->mean = dark ? 0 : sum / sines;
    double least = dark ? 1 : SKY_FLOOR * m->mean;
    for (uint32_t y = 0; y < m->height; y++) {
        double *cells = along + y * stride, running = 0;
        double scale = dmath_sinpi((y + 0.5) / m->height) / sines;
        cells[0] = 0;
        for (uint32_t x = 1; x <= m->width; x++)
            cells[x] = running += ((dark ? 0 : cells[x]) + least) * scale;
    }
}

static void cumulate_rows(const struct sky_map *m, double *down)
{
    for (uint32_t across = 0; across < SKY_BLOCKS_ACROSS; across++) {
        double *rows = down + (size_t)across * (m->height + 1), running = 0;
        size_t left = (size_t)across * m->block_width;
        rows[0] = 0;
        for (uint32_t y = 0; y < m->height; y++) {
            const double *cells = m->along + y * (size_t)(m->width + 1) + left;
            rows[y + 1] = running += cells[m->block_width] - cells[0];
        }
    }
}

/* --- Blocks --------------------------------------------------------------- */

/* An angle that reaches as far as the directions seen so far, and the unit direction b, from unit
 * a. */
static void reach(struct angle *angle, vec3 a, vec3 b)
{
    double cosine = v3_dot(a, b);
    /* What bulges between the points of an outline: of one as short as a sixteenth of a half circle
     * less than a fiftieth of the angle. */
    cosine -= 0.03 * (1 - cosine * cosine);
    if (!(cosine < angle->cosine))
        return;
    angle->cosine = cosine > -1 ? cosine : -1;
    angle->sine = sqrt(1 - angle->cosine * angle->cosine);
}

static vec3 sky_direction(const struct environment *sky, double x, double y)
{
    double sine;
    return environment_direction(sky, x / sky->map.width, y / sky->map.height, &sine);
}

/* The directions of a map's columns at the horizon, in its own space. */
static vec3 *column_directions(const struct sky_map *m)
{
    vec3 *out = mem_alloc_array(m->width, sizeof *out);
    for (uint32_t x = 0; out && x < m->width; x++) {
        double s, c;
        warp_sincos_turn((x + 0.5) / m->width, &s, &c);
        out[x] = v3(s, 0, -c);
    }
    return out;
}

/* Sums over the cells of a block. */
static void add_block(const struct environment *sky, const vec3 *columns, uint32_t number,
                      struct blocks *out)
{
    const struct sky_map *m = &sky->map;
    uint32_t left = number % SKY_BLOCKS_ACROSS * m->block_width;
    uint32_t top = number / SKY_BLOCKS_ACROSS * m->block_height;
    vec3 moment = {0, 0, 0};
    double weight = 0, solid = 0;
    for (uint32_t y = top; y < top + m->block_height; y++) {
        const double *cells = m->along + y * (size_t)(m->width + 1) + left;
        double whole = cells[m->block_width] - cells[0];
        double sine = dmath_sinpi((y + 0.5) / m->height);
        vec3 row = v3(0, dmath_cospi((y + 0.5) / m->height) * whole, 0);
        for (uint32_t x = 0; x < m->block_width; x++)
            row = v3_mad(row, columns[left + x], (cells[x + 1] - cells[x]) * sine);
        moment = v3_add(moment, row);
        weight += whole;
        solid += sine * m->block_width;
    }
    vec3 middle = v3_scale(environment_to_scene(sky, moment), 1 / weight), unit = v3_unit(middle);
    struct angle radius = {.sine = 0, .cosine = 1};
    for (int k = 0; k < 9; k++) {
        double x = left + (k % 3) * 0.5 * m->block_width, y = top + (k / 3) * 0.5 * m->block_height;
        reach(&radius, sky_direction(sky, x, y), unit);
    }
    out->weight[number] = weight;
    out->solid[number] = solid;
    out->middle[0][number] = middle.x;
    out->middle[1][number] = middle.y;
    out->middle[2][number] = middle.z;
    out->radius[number] = radius;
    if (radius.cosine < out->widest.cosine)
        out->widest = radius;
}

/* No normal of a table is further from its grid point n at x, y than this. */
static struct angle table_radius(double x, double y, vec3 n)
{
    double half = 1.0 / (SKY_GRID - 1);
    struct angle radius = {.sine = 0, .cosine = 1};
    for (int k = 0; k < 9; k++) {
        double nx = x + (k % 3 - 1) * half, ny = y + (k / 3 - 1) * half;
        if (fabs(nx) <= 1 && fabs(ny) <= 1)
            reach(&radius, sky_unfolded(nx, ny), n);
    }
    return radius;
}

/* Sine of the sum of two angles, 1 if that is more than a right one. */
static double sine_of_sum(const struct angle *a, const struct angle *b)
{
    bool narrow = a->cosine * b->cosine > a->sine * b->sine;
    return narrow ? a->sine * b->cosine + a->cosine * b->sine : 1;
}

/* Of a block near the horizon, whose light has the cosine q: as if it spread evenly by the radii
 * about its mean. */
static double mean_cosine(double q, double spread)
{
    if (fabs(q) < spread)
        return (q + spread) * (q + spread) / (4 * spread);
    return q > 0 ? q : 0;
}

/* The mean cosine of the light of each block at normals as far as `radius` from n. 0 only if no
 * such normal sees any of the block. */
static void mean_cosines(const struct blocks *b, vec3 n, const struct angle *radius, double *out)
{
    __m128d band = _mm_set1_pd(sine_of_sum(&b->widest, radius)), none = _mm_setzero_pd();
    __m128d nx = _mm_set1_pd(n.x), ny = _mm_set1_pd(n.y), nz = _mm_set1_pd(n.z);
    for (uint32_t i = 0; i < SKY_BLOCKS; i += 2) {
        __m128d q = _mm_add_pd(_mm_mul_pd(nx, _mm_loadu_pd(b->middle[0] + i)),
                               _mm_mul_pd(ny, _mm_loadu_pd(b->middle[1] + i)));
        q = _mm_add_pd(q, _mm_mul_pd(nz, _mm_loadu_pd(b->middle[2] + i)));
        __m128d size = _mm_max_pd(q, _mm_sub_pd(none, q));
        _mm_storeu_pd(out + i, _mm_max_pd(q, none));
        /* Most blocks lie far from the horizon, to one side of it. */
        if (_mm_movemask_pd(_mm_cmplt_pd(size, band)) == 0)
            continue;
        double both[2];
        _mm_storeu_pd(both, q);
        for (uint32_t k = 0; k < 2; k++)
            out[i + k] = mean_cosine(both[k], sine_of_sum(&b->radius[i + k], radius));
    }
}

/* Cumulates weights to shares; returns their sum. Where nothing is seen nothing is drawn. */
static double cumulate(const double *weights, uint32_t count, double *sums)
{
    double sum = 0;
    sums[0] = 0;
    for (uint32_t i = 0; i < count; i++)
        sums[i + 1] = sum += weights[i];
    double scale = sum > 0 ? 1 / sum : 0;
    for (uint32_t i = 1; i <= count; i++) {
        double share = sums[i] * scale;
        sums[i] = share < 1 ? share : 1;
    }
    /* The last is 1, and what has no weight at the end begins there. */
    for (uint32_t i = count; i > 0 && weights[i - 1] <= 0; i--)
        sums[i - 1] = 1;
    sums[0] = 0;
    sums[count] = 1;
    return sum;
}

/* How blocks are drawn that are seen under these mean cosines. */
static void choose_blocks(const struct blocks *b, const double *cosines, double compensation,
                          struct sky_choice *out)
{
    __m128d light = _mm_setzero_pd(), solid = light;
    for (uint32_t i = 0; i < SKY_BLOCKS; i += 2) {
        __m128d cosine = _mm_loadu_pd(cosines + i);
        light = _mm_add_pd(light, _mm_mul_pd(cosine, _mm_loadu_pd(b->weight + i)));
        solid = _mm_add_pd(solid, _mm_mul_pd(cosine, _mm_loadu_pd(b->solid + i)));
    }
    light = _mm_add_pd(light, _mm_unpackhi_pd(light, light));
    solid = _mm_add_pd(solid, _mm_unpackhi_pd(solid, solid));
    __m128d less = _mm_set1_pd(compensation * _mm_cvtsd_f64(light) / _mm_cvtsd_f64(solid));
    double rows[SKY_BLOCKS_DOWN], shares[SKY_BLOCKS_ACROSS];
    for (uint32_t y = 0; y < SKY_BLOCKS_DOWN; y++) {
        for (uint32_t x = 0; x < SKY_BLOCKS_ACROSS; x += 2) {
            uint32_t i = y * SKY_BLOCKS_ACROSS + x;
            __m128d weight = _mm_loadu_pd(b->weight + i);
            __m128d share = _mm_sub_pd(weight, _mm_mul_pd(less, _mm_loadu_pd(b->solid + i)));
            share = _mm_max_pd(share, _mm_mul_pd(weight, _mm_set1_pd(BLOCK_FLOOR)));
            _mm_storeu_pd(shares + x, _mm_mul_pd(share, _mm_loadu_pd(cosines + i)));
        }
        rows[y] = cumulate(shares, SKY_BLOCKS_ACROSS, out->column[y]);
    }
    (void)cumulate(rows, SKY_BLOCKS_DOWN, out->row);
}

static enum err choose_at_normals(const struct environment *sky, double compensation,
                                  struct sky_choice *choices)
{
    struct blocks *b = mem_alloc(sizeof *b);
    vec3 *columns = column_directions(&sky->map);
    if (!b || !columns) {
        mem_free(b);
        mem_free(columns);
        return ERR_NOMEM;
    }
    double cosines[SKY_BLOCKS];
    b->widest = (struct angle){.sine = 0, .cosine = 1};
    for (uint32_t i = 0; i < SKY_BLOCKS; i++) {
        add_block(sky, columns, i, b);
        cosines[i] = 1;
    }
    choose_blocks(b, cosines, compensation, &choices[SKY_ANYWHERE]);
    for (uint32_t i = 0; i < SKY_NORMALS; i++) {
        double step = 2.0 / (SKY_GRID - 1);
        double x = (i % SKY_GRID) * step - 1, y = (double)(i / SKY_GRID) * step - 1;
        vec3 n = sky_unfolded(x, y);
        struct angle radius = table_radius(x, y, n);
        mean_cosines(b, n, &radius, cosines);
        choose_blocks(b, cosines, compensation, &choices[i]);
    }
    mem_free(b);
    mem_free(columns);
    return ERR_OK;
}

/* --- The map -------------------------------------------------------------- */

static enum err tabulate(struct render_scene *rs, struct environment *sky)
{
    struct sky_map *m = &sky->map;
    uint32_t width = sky->texture->type == SCENE_TEXTURE_IMAGE
                         ? sky->texture->image->levels[0].width
                         : CELLS_ACROSS_PATTERN;
    width = width < CELLS_ACROSS_MIN ? CELLS_ACROSS_MIN : width;
    width = width > CELLS_ACROSS_MAX ? CELLS_ACROSS_MAX : width;
    m->block_width = (width + SKY_BLOCKS_ACROSS - 1) / SKY_BLOCKS_ACROSS;
    m->block_height = m->block_width;
    m->width = m->block_width * SKY_BLOCKS_ACROSS;
    m->height = m->block_height * SKY_BLOCKS_DOWN;
    double *along = arena_alloc(&rs->arena, (m->width + 1) * (size_t)m->height, sizeof *along);
    double *down =
        arena_alloc(&rs->arena, SKY_BLOCKS_ACROSS * (size_t)(m->height + 1), sizeof *down);
    struct sky_choice *choices = arena_alloc(&rs->arena, SKY_TABLES, sizeof *choices);
    if (!along || !down || !choices)
        return ERR_NOMEM;
    TL_TRY(measure_cells(sky, along));
    cumulate_cells(m, along);
    m->along = along;
    cumulate_rows(m, down);
    m->down = down;
    m->choices = choices;
    bool both = rs->spec.profile == JOB_PROFILE_MIS;
    return choose_at_normals(sky, both ? COMPENSATION : 0, choices);
}

enum err scene_build_sky(struct render_scene *rs, const struct scene *scene)
{
    const struct scene_envmap *from = &scene->envmap;
    struct environment *sky = &rs->lights.environment;
    if (from->texture == SCENE_NONE)
        return ERR_OK;
    sky->present = true;
    sky->factor = rgb_grey(from->scale);
    sky_rotation(from->transform, sky->to_local);
    const struct texture *texture = &rs->textures[from->texture];
    if (texture->type == SCENE_TEXTURE_CONSTANT) {
        sky->factor = rgb_scale(texture->color[0], from->scale);
        return ERR_OK;
    }
    /* Its own copy: the poles are not each other's neighbours. */
    struct texture *copy = arena_alloc(&rs->arena, 1, sizeof *copy);
    if (!copy)
        return ERR_NOMEM;
    *copy = *texture;
    copy->wrap[1] = SCENE_WRAP_CLAMP;
    sky->texture = copy;
    return tabulate(rs, sky);
}
