/* What a film says of its own error: see film.h and docs/ERROR.md. */
#include <math.h>

#include "common/mem.h"
#include "master/film_impl.h"

enum {
    GROUP = 4, /* side of the groups whose pixels share paths */
    GROUPS = (GRID_SQUARE / GROUP) * (GRID_SQUARE / GROUP), /* of a square */
    NEAR = 2, /* pixels on each side by which a noisy pixel's level is judged */
};

/* A pixel whose halves differ by less than this share of it (variance over square) is its own
 * level. */
static const double NOISY = 0.1;

/* The film's values row by row: what the neighbours of a pixel say needs them so. */
struct field {
    uint32_t width, height; /* of the crop */
    float *product;         /* A B of each channel: on average the square of the true value */
    float *term;            /* of relMSE, mean over the channels */
    float *difference;      /* of the halves' means, its square on average the mean's variance */
};

static void field_release(struct field *f)
{
    mem_free(f->product);
    mem_free(f->term);
    mem_free(f->difference);
}

static enum err field_init(struct field *f, const struct film *film)
{
    size_t pixels = film->pixels;
    *f = (struct field){.width = film->grid->crop.width, .height = film->grid->crop.height};
    f->product = mem_alloc_array(pixels, FILM_CHANNELS * sizeof(float));
    f->term = mem_alloc_array(pixels, sizeof(float));
    f->difference = mem_alloc_array(pixels, sizeof(float));
    if (f->product && f->term && f->difference)
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
        j->field.product[s->at * FILM_CHANNELS + c] = (float)(s->a[c] * s->b[c]);
        j->total += (s->na * s->a[c] + s->nb * s->b[c]) / (s->na + s->nb);
    }
}

/* Mean of A B over the pixel and those near it. */
static double level_near(const struct field *f, uint64_t at, uint64_t channel)
{
    uint32_t x = (uint32_t)(at % f->width), y = (uint32_t)(at / f->width);
    uint32_t x0 = x > NEAR ? x - NEAR : 0, y0 = y > NEAR ? y - NEAR : 0;
    uint32_t x1 = f->width - x > NEAR ? x + NEAR : f->width - 1;
    uint32_t y1 = f->height - y > NEAR ? y + NEAR : f->height - 1;
    double sum = 0;
    for (uint64_t row = y0; row <= y1; row++)
        for (uint64_t column = x0; column <= x1; column++)
            sum += (double)f->product[(row * f->width + column) * FILM_CHANNELS + channel];
    return sum / ((double)(x1 - x0 + 1) * (y1 - y0 + 1));
}

/* The term of relMSE of one pixel and channel. A spike raises the pixel as well as its error, and
 * so would hide behind itself: where the halves differ much, the true value is rather what they,
 * multiplied, say here and nearby, unless the pixel is darker still. */
static double term_of(const struct judge *j, const struct sight *s, uint64_t c)
{
    double n = s->na + s->nb, weight = s->na * s->nb / (n * n);
    double x = (s->na * s->a[c] + s->nb * s->b[c]) / n, apart = s->a[c] - s->b[c];
    double variance = weight * apart * apart, level = x * x;
    if (variance > NOISY * level) {
        double near = level_near(&j->field, s->at, c);
        near = near > 0 ? near : 0;
        level = near < level ? near : level;
    }
    double below = level + j->floor_m;
    return below > 0 ? variance / below : 0;
}

static void note_term(void *ctx, const struct sight *s)
{
    struct judge *j = ctx;
    double n = s->na + s->nb, term = 0, difference = 0;
    for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
        term += term_of(j, s, c) / FILM_CHANNELS;
        difference += (s->a[c] - s->b[c]) / FILM_CHANNELS;
    }
    j->field.term[s->at] = (float)term;
    j->field.difference[s->at] = (float)(sqrt(s->na * s->nb) / n * difference);
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

/* Sums over the groups of one square, and over the picture. */
struct sums {
    double term, term_squares; /* of groups */
    double variance;           /* of the sum of the terms */
    double mean_variance;      /* of the sum of the values */
    double worst;              /* mean term of a square */
    uint32_t worst_x, worst_y;
    uint64_t degrees; /* groups less squares */
};

static void add_square(const struct film *f, const struct field *field, uint32_t sx, uint32_t sy,
                       struct sums *sums)
{
    const struct job_crop *crop = &f->grid->crop;
    double term[GROUPS] = {0}, difference[GROUPS] = {0}, total = 0, spread = 0;
    uint32_t pixels[GROUPS] = {0}, groups = 0, area = 0;
    uint32_t x0 = sx > crop->x ? sx : crop->x, y0 = sy > crop->y ? sy : crop->y;
    for (uint32_t y = y0; y < sy + GRID_SQUARE && y < crop->y + crop->height; y++) {
        for (uint32_t x = x0; x < sx + GRID_SQUARE && x < crop->x + crop->width; x++) {
            uint32_t g = (y - sy) / GROUP * (GRID_SQUARE / GROUP) + (x - sx) / GROUP;
            uint64_t at = (uint64_t)(y - crop->y) * field->width + (x - crop->x);
            term[g] += (double)field->term[at];
            difference[g] += (double)field->difference[at];
            pixels[g]++;
        }
    }
    for (uint32_t g = 0; g < GROUPS; g++) {
        groups += pixels[g] > 0;
        area += pixels[g];
        total += term[g];
        sums->term_squares += term[g] * term[g];
        sums->mean_variance += difference[g] * difference[g];
    }
    for (uint32_t g = 0; g < GROUPS; g++) {
        double apart = pixels[g] ? term[g] - total * pixels[g] / area : 0;
        spread += apart * apart;
    }
    /* One group knows nothing of its spread: as large as itself. */
    sums->variance += groups > 1 ? spread * groups / (groups - 1) : total * total;
    sums->degrees += groups - 1;
    sums->term += total;
    if (total / area > sums->worst) {
        sums->worst = total / area;
        sums->worst_x = x0;
        sums->worst_y = y0;
    }
}

/* Student's 97.5 % quantile (Abramowitz and Stegun 26.7.5, two terms); few groups know little. */
static double student_quantile(double degrees)
{
    const double z = 1.959964, z3 = z * z * z, z5 = z3 * z * z;
    return z + (z3 + z) / (4 * degrees) + (5 * z5 + 16 * z3 + 3 * z) / (96 * degrees * degrees);
}

static struct film_error error_of(const struct sums *s, double pixels, double mean)
{
    double quantile = student_quantile(s->degrees > 0 ? (double)s->degrees : 1);
    double relmse = s->term / pixels, deviation = sqrt(s->variance) / pixels;
    double mean_error = quantile * sqrt(s->mean_variance) / pixels;
    double low = relmse - quantile * deviation;
    return (struct film_error){
        .known = isfinite(relmse) && isfinite(mean),
        .relmse = relmse,
        .relmse_low = low > 0 ? low : 0,
        .relmse_high = relmse + quantile * deviation,
        .relmse_deviation = deviation,
        .mean = mean,
        .mean_low = mean - mean_error,
        .mean_high = mean + mean_error,
        .effective = s->term_squares > 0 ? s->term * s->term / s->term_squares : 0,
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
