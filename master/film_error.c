/* What a film says of its own error: see film.h and docs/ERROR.md. */
#include <math.h>

#include "common/dmath.h"
#include "common/mem.h"
#include "master/film_impl.h"

/* Two-sided 95 % of a normal distribution. */
static const double Z_95 = 1.959964;

enum {
    GROUP = 4, /* side of the groups whose pixels share paths */
    GROUPS = (GRID_SQUARE / GROUP) * (GRID_SQUARE / GROUP), /* of a square */
    NEAR = 2, /* pixels on each side by which a noisy pixel's level is judged */
};

/* A pixel whose halves differ by less than this share of it (variance over square) is its own
 * level. */
static const double NOISY = 0.1;
/* Noise curves 1 / level upwards: by once the variance where it is Gaussian and uncorrelated with
 * the pixel, by none where it comes in rare hits. Measured over eight scenes. */
static const double CURVE = 0.15;
/* A level is doubtful when what the darker half and the neighbours show is so many times less; by
 * how much the error then grows with that ratio's logarithm. At edges of things that both halves
 * saw nearby it grows less: any part of such a pixel may be covered, as likely. */
static const double DOUBT = 3, UNSEEN = 1.6, EDGE_UNSEEN = 0.8;
/* A noisy pixel under its neighbours' median is dark by chance: its level is put so far up to
 * theirs, of the logarithm of at most so much. */
static const double CHANCE = 0.6, CHANCE_MAX = 2;
/* A hit is brighter than all that both halves saw nearby by so much, or so much: then it is rarer
 * than what there is shows, and its pixel darker than its level. By how much noisy pixels have more
 * error: with hits no brighter, brighter, much brighter (those stand out, and the darker half is
 * their level already). Not where so large a share of the pixels nearby has half as bright a half:
 * what is seen everywhere is not rare. Measured over thirty scenes. */
static const double BRIGHTER = 2, MUCH_BRIGHTER = 16, COMMON = 0.5;
static const double RARE[] = {1.2, 1.65, 1.4}, NOT_RARE = 1.05;

/* The film's values row by row: what the neighbours of a pixel say needs them so. */
struct field {
    uint32_t width, height; /* of the crop */
    float *value;           /* of each channel */
    float *product;         /* A B of each channel: on average the square of the true value */
    float *darker;          /* of each channel's halves: what both saw */
    float *term;            /* of relMSE, mean over the channels */
    float *difference;      /* of the halves' means, its square on average the mean's variance */
};

static void field_release(struct field *f)
{
    mem_free(f->value);
    mem_free(f->product);
    mem_free(f->darker);
    mem_free(f->term);
    mem_free(f->difference);
}

static enum err field_init(struct field *f, const struct film *film)
{
    size_t pixels = film->pixels;
    *f = (struct field){.width = film->grid->crop.width, .height = film->grid->crop.height};
    f->value = mem_alloc_array(pixels, FILM_CHANNELS * sizeof(float));
    f->product = mem_alloc_array(pixels, FILM_CHANNELS * sizeof(float));
    f->darker = mem_alloc_array(pixels, FILM_CHANNELS * sizeof(float));
    f->term = mem_alloc_array(pixels, sizeof(float));
    f->difference = mem_alloc_array(pixels, sizeof(float));
    if (f->value && f->product && f->darker && f->term && f->difference)
        return ERR_OK;
    field_release(f);
    return ERR_NOMEM;
}

/* One pixel of the film: its halves' means, and where it lies. */
struct sight {
    uint64_t at;   /* in the field */
    double na, nb; /* samples of the halves */
    double a[FILM_CHANNELS], b[FILM_CHANNELS];
};

/* Calls `visit` for each pixel. */
static void each_pixel(const struct film *f, void (*visit)(void *ctx, const struct sight *s),
                       void *ctx)
{
    const struct job_crop *crop = &f->grid->crop;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(f->grid, cell);
        struct sight s = {.na = (double)film_half_samples(f, 0, cell),
                          .nb = (double)film_half_samples(f, 1, cell)};
        uint64_t i = f->cell_offset[cell];
        for (uint32_t y = r.y - crop->y; y < r.y - crop->y + r.height; y++) {
            for (uint32_t x = r.x - crop->x; x < r.x - crop->x + r.width; x++, i++) {
                s.at = (uint64_t)y * crop->width + x;
                for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
                    s.a[c] = f->sum[0][c * f->pixels + i] / s.na;
                    s.b[c] = f->sum[1][c * f->pixels + i] / s.nb;
                }
                visit(ctx, &s);
            }
        }
    }
}

/* What the pixels are weighed by. */
struct judge {
    struct field field;
    double total;   /* of all values */
    double floor_m; /* 0.01 of the mean's square */
};

static void note_product(void *ctx, const struct sight *s)
{
    struct judge *j = ctx;
    for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
        double x = (s->na * s->a[c] + s->nb * s->b[c]) / (s->na + s->nb);
        j->field.value[s->at * FILM_CHANNELS + c] = (float)x;
        j->field.product[s->at * FILM_CHANNELS + c] = (float)(s->a[c] * s->b[c]);
        j->field.darker[s->at * FILM_CHANNELS + c] = (float)(s->a[c] < s->b[c] ? s->a[c] : s->b[c]);
        j->total += x;
    }
}

/* The pixels near one, itself among them. */
struct window {
    uint32_t x0, y0, x1, y1; /* the last ones belong to it */
};
enum { WINDOW_MAX = (2 * NEAR + 1) * (2 * NEAR + 1) };

static struct window window_of(const struct field *f, uint64_t at)
{
    uint32_t x = (uint32_t)(at % f->width), y = (uint32_t)(at / f->width);
    return (struct window){.x0 = x > NEAR ? x - NEAR : 0,
                           .y0 = y > NEAR ? y - NEAR : 0,
                           .x1 = f->width - x > NEAR ? x + NEAR : f->width - 1,
                           .y1 = f->height - y > NEAR ? y + NEAR : f->height - 1};
}

/* Mean of A B, not under 0. */
static double product_near(const struct field *f, uint64_t at, uint64_t channel)
{
    struct window w = window_of(f, at);
    double sum = 0;
    for (uint64_t row = w.y0; row <= w.y1; row++)
        for (uint64_t column = w.x0; column <= w.x1; column++)
            sum += (double)f->product[(row * f->width + column) * FILM_CHANNELS + channel];
    return sum > 0 ? sum / ((double)(w.x1 - w.x0 + 1) * (w.y1 - w.y0 + 1)) : 0;
}

/* The brightest that both halves saw. */
static double brightest_near(const struct field *f, uint64_t at, uint64_t channel)
{
    struct window w = window_of(f, at);
    float most = 0;
    for (uint64_t row = w.y0; row <= w.y1; row++) {
        for (uint64_t column = w.x0; column <= w.x1; column++) {
            float value = f->darker[(row * f->width + column) * FILM_CHANNELS + channel];
            most = value > most ? value : most;
        }
    }
    return (double)most;
}

/* The share of the pixels whose brighter half is at least half of `brighter`: 2 x less the darker
 * half, where the halves are as large. */
static double share_near(const struct field *f, uint64_t at, uint64_t channel, double brighter)
{
    struct window w = window_of(f, at);
    uint32_t as_bright = 0;
    for (uint64_t row = w.y0; row <= w.y1; row++) {
        for (uint64_t column = w.x0; column <= w.x1; column++) {
            uint64_t i = (row * f->width + column) * FILM_CHANNELS + channel;
            as_bright += 2 * (double)f->value[i] - (double)f->darker[i] >= brighter / 2;
        }
    }
    return as_bright / ((double)(w.x1 - w.x0 + 1) * (w.y1 - w.y0 + 1));
}

/* Median of the values. */
static double median_near(const struct field *f, uint64_t at, uint64_t channel)
{
    struct window w = window_of(f, at);
    float sorted[WINDOW_MAX];
    uint32_t count = 0;
    for (uint64_t row = w.y0; row <= w.y1; row++) {
        for (uint64_t column = w.x0; column <= w.x1; column++) {
            float value = f->value[(row * f->width + column) * FILM_CHANNELS + channel];
            uint32_t place = count++;
            for (; place > 0 && sorted[place - 1] > value; place--)
                sorted[place] = sorted[place - 1];
            sorted[place] = value;
        }
    }
    return (double)sorted[count / 2];
}

static double over(double variance, double level)
{
    return level > 0 ? variance / level : 0;
}

/* By how much a dark pixel that few samples saw bright has more error than its level says. Where
 * all of a half's light came in one hit, nothing tells how rare such hits are. Were all
 * chances alike (the edge of a light lies anywhere in a pixel), the mean over the levels from
 * `low` to `high` would be a logarithm of their ratio; where light comes by other ways small
 * chances are more frequent. */
static double unseen(double low, double high, bool edge)
{
    if (!(low > 0 && high > DOUBT * low))
        return 1;
    return 1 + (edge ? EDGE_UNSEEN : UNSEEN) * dmath_log(high / low);
}

/* By how much a noisy pixel has more error than its level says, since its hits are rarer than they
 * look. A half's excess is at least one sample's; `hit` is that sample, if it is one. */
static double rare(double hit, double brightest)
{
    return RARE[hit < BRIGHTER * brightest ? 0 : hit < MUCH_BRIGHTER * brightest ? 1 : 2];
}

/* The level of a noisy pixel whose neighbours' median is `median`, over its own. */
static double chance(double own, double median)
{
    if (!(own > 0 && median > own))
        return 1;
    double ratio = median / own;
    return dmath_pow(ratio < CHANCE_MAX ? ratio : CHANCE_MAX, CHANCE);
}

/* A channel's term of relMSE. The square of the true value, the level, is not known. A spike raises
 * the pixel as well as its error, and so would hide behind itself: where the halves differ much,
 * the true value is rather what they, multiplied, say here and nearby, unless the pixel is darker
 * still. Near a bright thing that is too much for a dark pixel of which a few samples saw the
 * thing: what the darker half and most neighbours show is the least that it may be. */
static double term_of(const struct judge *j, const struct sight *s, uint64_t c, double x,
                      double variance)
{
    double own = x * x + CURVE * variance, e = j->floor_m;
    if (!(variance > NOISY * x * x))
        return over(variance, own + e);
    double near = product_near(&j->field, s->at, c);
    double high = near < own ? near : own;
    double median = median_near(&j->field, s->at, c);
    double darker = s->a[c] < s->b[c] ? s->a[c] : s->b[c];
    darker = darker > median ? darker : median;
    double low = darker * darker, product = s->a[c] * s->b[c];
    low = low > product ? low : product;
    low = low < high ? low : high;
    double hit = fabs(s->a[c] - s->b[c]) * (s->na + s->nb) / 2;
    double brighter = s->a[c] > s->b[c] ? s->a[c] : s->b[c];
    double brightest = brightest_near(&j->field, s->at, c);
    bool common = share_near(&j->field, s->at, c, brighter) >= COMMON;
    return over(variance, high + e) * unseen(low + e, high + e, hit < MUCH_BRIGHTER * brightest) *
           (common ? NOT_RARE : rare(hit, brightest)) / chance(own + e, median * median + e);
}

static void note_term(void *ctx, const struct sight *s)
{
    struct judge *j = ctx;
    double n = s->na + s->nb, weight = s->na * s->nb / (n * n), term = 0, difference = 0;
    for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
        double x = (s->na * s->a[c] + s->nb * s->b[c]) / n, apart = s->a[c] - s->b[c];
        term += term_of(j, s, c, x, weight * apart * apart) / FILM_CHANNELS;
        difference += apart / FILM_CHANNELS;
    }
    j->field.term[s->at] = (float)term;
    j->field.difference[s->at] = (float)(sqrt(weight) * difference);
}

/* Fills the field; false: not known. */
static bool judge_film(const struct film *f, struct judge *j, double *mean)
{
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++)
        if (film_half_samples(f, 0, cell) == 0 || film_half_samples(f, 1, cell) == 0)
            return false;
    *j = (struct judge){0};
    if (field_init(&j->field, f) != ERR_OK)
        return false;
    each_pixel(f, note_product, j);
    *mean = j->total / ((double)f->pixels * FILM_CHANNELS);
    j->floor_m = 0.01 * *mean * *mean;
    each_pixel(f, note_term, j);
    return true;
}

/* Sums over the pixels and groups of the picture. */
struct sums {
    double term, squares; /* of the terms, and of each one's square */
    /* Of products of two pixels' terms in a group: of all pairs, and with a minus where the halves
     * differ in opposite senses. */
    double pairs, agreement;
    double mean_variance, mean_fourth; /* of the sum of the values; and of fourth powers */
    double worst;                      /* mean term of a square */
    uint32_t worst_x, worst_y;
};

/* Of one group. */
struct group {
    double term, squares, signed_term, difference;
};

static void add_groups(const struct group *groups, struct sums *sums)
{
    for (uint32_t i = 0; i < GROUPS; i++) {
        const struct group *g = &groups[i];
        double variance = g->difference * g->difference;
        sums->term += g->term;
        sums->squares += g->squares;
        sums->pairs += g->term * g->term - g->squares;
        sums->agreement += g->signed_term * g->signed_term - g->squares;
        sums->mean_variance += variance;
        sums->mean_fourth += variance * variance;
    }
}

static void add_square(const struct film *f, const struct field *field, uint32_t sx, uint32_t sy,
                       struct sums *sums)
{
    const struct job_crop *crop = &f->grid->crop;
    struct group groups[GROUPS] = {0};
    double total = 0, area = 0;
    uint32_t x0 = sx > crop->x ? sx : crop->x, y0 = sy > crop->y ? sy : crop->y;
    for (uint32_t y = y0; y < sy + GRID_SQUARE && y < crop->y + crop->height; y++) {
        for (uint32_t x = x0; x < sx + GRID_SQUARE && x < crop->x + crop->width; x++) {
            struct group *g = &groups[(y - sy) / GROUP * (GRID_SQUARE / GROUP) + (x - sx) / GROUP];
            uint64_t at = (uint64_t)(y - crop->y) * field->width + (x - crop->x);
            double term = (double)field->term[at], difference = (double)field->difference[at];
            g->term += term;
            g->squares += term * term;
            g->signed_term += difference < 0 ? -term : term;
            g->difference += difference;
            total += term;
            area++;
        }
    }
    add_groups(groups, sums);
    if (total / area > sums->worst) {
        sums->worst = total / area;
        sums->worst_x = x0;
        sums->worst_y = y0;
    }
}

/* Of what the terms of two pixels of a group are, multiplied, the share that is covariance. For
 * Gaussian noise of correlation r it is 2 r^2 / (1 + 2 r^2), and signs agree with the chance
 * 1/2 + asin(r) / pi: the signs tell how far the pixels share their paths. */
static double shared_of(const struct sums *s)
{
    if (!(s->pairs > 0 && s->agreement > 0))
        return 0;
    double agreement = s->agreement < s->pairs ? s->agreement / s->pairs : 1;
    double r = dmath_sinpi(agreement / 2), square = r * r;
    return 2 * square / (1 + 2 * square);
}

/* Student's 97.5 % quantile (Abramowitz and Stegun 26.7.5, two terms); few groups know little. */
static double student_quantile(double degrees)
{
    const double z = Z_95, z3 = z * z * z, z5 = z3 * z * z;
    return z + (z3 + z) / (4 * degrees) + (5 * z5 + 16 * z3 + 3 * z) / (96 * degrees * degrees);
}

/* Half of the 95 % interval of the sum of the values. Degrees of freedom: Satterthwaite's, with the
 * fourth power of a Gaussian, which is three times its variance's square. */
static double mean_error_of(const struct sums *s)
{
    double degrees =
        s->mean_fourth > 0 ? 3 * s->mean_variance * s->mean_variance / s->mean_fourth : 1;
    return student_quantile(degrees > 1 ? degrees : 1) * sqrt(s->mean_variance);
}

static struct film_error error_of(const struct sums *s, double pixels, double mean)
{
    /* The variance of a term is at most the mean of its square, and two thirds of that where noise
     * is Gaussian. */
    double variance = s->squares + shared_of(s) * s->pairs;
    double relmse = s->term / pixels, deviation = sqrt(variance) / pixels;
    double spread = relmse > 0 ? dmath_exp(Z_95 * deviation / relmse) : 1;
    double mean_error = mean_error_of(s) / pixels;
    return (struct film_error){
        .known = isfinite(relmse) && isfinite(mean),
        .relmse = relmse,
        .relmse_low = relmse / spread,
        .relmse_high = relmse * spread,
        .relmse_deviation = deviation,
        .mean = mean,
        .mean_low = mean - mean_error,
        .mean_high = mean + mean_error,
        .effective = variance > 0 ? s->term * s->term / variance : 0,
        .worst_x = s->worst_x,
        .worst_y = s->worst_y,
        .worst_relmse = s->worst,
    };
}

void film_error_estimate(const struct film *f, struct film_error *out)
{
    const struct job_crop *crop = &f->grid->crop;
    struct judge j;
    double mean;
    *out = (struct film_error){0};
    if (!judge_film(f, &j, &mean))
        return;
    struct sums sums = {.worst = -1};
    for (uint32_t y = crop->y / GRID_SQUARE * GRID_SQUARE; y < crop->y + crop->height;
         y += GRID_SQUARE)
        for (uint32_t x = crop->x / GRID_SQUARE * GRID_SQUARE; x < crop->x + crop->width;
             x += GRID_SQUARE)
            add_square(f, &j.field, x, y, &sums);
    *out = error_of(&sums, (double)f->pixels, mean);
    field_release(&j.field);
}

bool film_error_pixels(const struct film *f, float *out)
{
    struct judge j;
    double mean;
    if (!judge_film(f, &j, &mean))
        return false;
    for (uint64_t i = 0; i < f->pixels; i++)
        out[i] = j.field.term[i];
    field_release(&j.field);
    return true;
}
