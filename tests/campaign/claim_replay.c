/* tests/campaign/claim_replay.c: what --target-error would have done, on the stored samples of many
 * seeds of a scene (claim_samples), with the master's own film, estimate, allocation and rule.
 *
 * usage: claim_replay [--errors] SPP[,SPP...] FILE...      --errors: the stated errors alone
 *
 * A job's samples are a function of pixel, seed, half and number, so a replay draws the very ones
 * that a job would have. Each seed is judged by all others: they are two references, and the
 * product of the differences to both has no part of their noise.
 *
 * For each file and SPP the target E is the scene's mean error at SPP equal samples. Lines:
 *   error  | scene | spp | true | stated over true, +- its standard error | heavy tails of seeds |
 *   target | scene | E | claims that held of claims of seeds | true over E, median | samples with
 * the pilot | work | of that pilot | allocation | the rest | looks | effective size, median |
 *
 * Work is the samples over those of a perfect allocation, which knows the variance of every square:
 * V(n) = c n^-p, c of the square and p of the picture fitted to the seeds' mean errors at every
 * step from 16 samples on; it gives each square samples in proportion to c^(1 / (1 + p)), so many
 * that the sum of V is E. Of that the pilot's part is all samples over the plan's, the allocation's
 * those of the plan over the perfect one's for the error that V gives the plan; the rest is that
 * the claim must be sure, and the steps of the looks. Scenes whose median effective size is under
 * 32 (a heavy tail, as the report says) are summed up apart.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "master/allocate.h"
#include "master/claim.h"

enum { SEEDS_MAX = 256, STEPS_MAX = 64, TARGETS_MAX = 8, STEP_FIRST = 3 };

static _Noreturn void fail(const char *file, const char *what)
{
    fprintf(stderr, "claim_replay: %s: %s\n", file, what);
    exit(5);
}

static void *need(void *memory)
{
    if (!memory)
        fail("memory", "there is none");
    return memory;
}

/* One file. */
struct bench {
    const char *name;
    struct job_spec spec;
    struct job_blocks blocks;
    struct grid grid;
    size_t pixels, values; /* of a picture: three channels */
    uint32_t seeds, file_blocks, file_pilot, steps;
    float *sums;   /* [seed][block][channel][pixel] */
    double *whole; /* [seed][channel][pixel]: mean of all samples of the estimate */
    double *first, *second, *below; /* references of the seed at hand, and what relMSE divides by */
    double *square;          /* [step][cell]: mean over the seeds of the sum of the error's terms */
    double *level;           /* c of each cell */
    double power;            /* p */
    double total[STEPS_MAX]; /* mean error at each step */
};

static uint64_t step_spp(uint32_t step)
{
    return 2 * job_ladder(step + 1);
}

static const float *block_of(const struct bench *b, uint32_t seed, uint32_t block)
{
    uint32_t at = block < b->blocks.pilot ? block : b->file_pilot + (block - b->blocks.pilot);
    return b->sums + ((size_t)seed * b->file_blocks + at) * b->values;
}

static void bench_read(struct bench *b, const char *path)
{
    uint32_t head[5];
    FILE *in = fopen(path, "rb");
    if (!in || fread(head, sizeof head, 1, in) != 1)
        fail(path, "cannot be read");
    *b = (struct bench){
        .name = path, .seeds = head[2], .file_blocks = head[3], .file_pilot = head[4]};
    job_spec_init(&b->spec);
    b->spec.width = head[0];
    b->spec.height = head[1];
    b->spec.crop = (struct job_crop){.width = head[0], .height = head[1]};
    b->spec.stop = JOB_STOP_ERROR;
    b->spec.tile = GRID_SQUARE;
    b->steps = (b->file_blocks - b->file_pilot) / 2;
    if (b->seeds < 3 || b->seeds > SEEDS_MAX || b->steps <= STEP_FIRST + 1 || b->steps > STEPS_MAX)
        fail(path, "has too few seeds or samples, or too many");
    b->spec.spp = step_spp(b->steps - 1);
    b->blocks = job_spec_blocks(&b->spec);
    b->pixels = (size_t)head[0] * head[1];
    b->values = 3 * b->pixels;
    size_t count = (size_t)b->seeds * b->file_blocks * b->values;
    b->sums = need(mem_alloc_array(count, sizeof *b->sums));
    if (fread(b->sums, sizeof *b->sums, count, in) != count)
        fail(path, "is cut off");
    (void)fclose(in);
    if (grid_init(&b->grid, &b->spec) != ERR_OK)
        need(NULL);
    b->whole = need(mem_calloc(b->seeds * b->values, sizeof(double)));
    b->first = need(mem_calloc(b->values, sizeof(double)));
    b->second = need(mem_calloc(b->values, sizeof(double)));
    b->below = need(mem_calloc(b->values, sizeof(double)));
    b->square = need(mem_calloc((size_t)b->steps * b->grid.cell_count, sizeof(double)));
    b->level = need(mem_calloc(b->grid.cell_count, sizeof(double)));
    for (uint32_t seed = 0; seed < b->seeds; seed++)
        for (uint32_t block = b->blocks.pilot; block < b->blocks.count; block++)
            for (size_t i = 0; i < b->values; i++)
                b->whole[seed * b->values + i] +=
                    (double)block_of(b, seed, block)[i] / (double)b->spec.spp;
}

static void bench_release(struct bench *b)
{
    mem_free(b->sums);
    mem_free(b->whole);
    mem_free(b->first);
    mem_free(b->second);
    mem_free(b->below);
    mem_free(b->square);
    mem_free(b->level);
    grid_release(&b->grid);
}

/* --- Truth ---------------------------------------------------------------- */

/* References for one seed: the others', by turns in the first and the second. */
static void refer(struct bench *b, uint32_t seed)
{
    double counts[2] = {0, 0}, mean = 0;
    memset(b->first, 0, b->values * sizeof(double));
    memset(b->second, 0, b->values * sizeof(double));
    for (uint32_t other = 0, turn = 0; other < b->seeds; other++) {
        if (other == seed)
            continue;
        double *to = turn ? b->second : b->first;
        for (size_t i = 0; i < b->values; i++)
            to[i] += b->whole[other * b->values + i];
        counts[turn]++;
        turn ^= 1;
    }
    for (size_t i = 0; i < b->values; i++) {
        double both = (b->first[i] + b->second[i]) / (counts[0] + counts[1]);
        b->below[i] = both * both;
        mean += both / (double)b->values;
        b->first[i] /= counts[0];
        b->second[i] /= counts[1];
    }
    for (size_t i = 0; i < b->values; i++)
        b->below[i] += 0.01 * mean * mean;
}

/* Adds each cell's sum of the true terms of a picture [channel][pixel]; returns the relMSE. */
static double true_error(const struct bench *b, const double *picture, double *cells)
{
    double sum = 0;
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++) {
        struct grid_rect r = grid_cell(&b->grid, cell);
        double terms = 0;
        for (size_t c = 0; c < 3; c++) {
            for (uint32_t y = r.y; y < r.y + r.height; y++) {
                for (uint32_t x = r.x; x < r.x + r.width; x++) {
                    size_t i = c * b->pixels + (size_t)y * b->spec.width + x;
                    terms += (picture[i] - b->first[i]) * (picture[i] - b->second[i]) / b->below[i];
                }
            }
        }
        sum += terms / 3;
        if (cells)
            cells[cell] += terms / 3;
    }
    return sum / (double)b->pixels;
}

/* Mean errors at every step, and the law that is fitted to them. */
static void measure(struct bench *b)
{
    double *picture = need(mem_alloc_array(b->values, sizeof *picture));
    for (uint32_t seed = 0; seed < b->seeds; seed++) {
        refer(b, seed);
        memset(picture, 0, b->values * sizeof *picture);
        for (uint32_t step = 0; step < b->steps; step++) {
            double before = step ? (double)step_spp(step - 1) : 0, now = (double)step_spp(step);
            const float *one = block_of(b, seed, b->blocks.pilot + 2 * step);
            const float *two = block_of(b, seed, b->blocks.pilot + 2 * step + 1);
            for (size_t i = 0; i < b->values; i++)
                picture[i] = (picture[i] * before + (double)one[i] + (double)two[i]) / now;
            b->total[step] +=
                true_error(b, picture, b->square + (size_t)step * b->grid.cell_count) / b->seeds;
        }
    }
    mem_free(picture);
    double n = 0, x = 0, y = 0, xx = 0, xy = 0;
    for (uint32_t step = STEP_FIRST; step < b->steps; step++) {
        double u = log((double)step_spp(step)), v = log(b->total[step]);
        n++, x += u, y += v, xx += u * u, xy += u * v;
    }
    double power = -(n * xy - x * y) / (n * xx - x * x);
    b->power = power < 1 ? 1 : power < 2 ? power : 2;
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++)
        for (uint32_t step = STEP_FIRST; step < b->steps; step++)
            b->level[cell] += fmax(b->square[(size_t)step * b->grid.cell_count + cell], 0) /
                              b->seeds * pow((double)step_spp(step), b->power) / n;
}

/* Mean samples of the perfect allocation for an error. All squares are of one size. */
static double perfect(const struct bench *b, double error)
{
    double cells = b->grid.cell_count, shares = 0, sum = 0;
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++) {
        double share = pow(b->level[cell], 1 / (1 + b->power));
        shares += share / cells;
        sum += share > 0 ? b->level[cell] * pow(share, -b->power) : 0;
    }
    return shares * pow(sum / (error * (double)b->pixels), 1 / b->power);
}

/* --- Replay --------------------------------------------------------------- */

/* Gives the film what it lacks up to the limits. */
static void render(const struct bench *b, uint32_t seed, struct film *f, const uint16_t *limits)
{
    for (uint32_t block = 0; block < b->blocks.count; block++) {
        const float *from = block_of(b, seed, block);
        for (uint32_t cell = 0; cell < b->grid.cell_count; cell++) {
            struct unit unit = {cell, 1, block};
            if (block >= limits[cell] || film_has_any(f, unit))
                continue;
            struct grid_rect r = grid_cell(&b->grid, cell);
            size_t area = (size_t)r.width * r.height;
            float *values = need(mem_alloc_array(area, 3 * sizeof *values));
            for (size_t c = 0; c < 3; c++)
                for (size_t i = 0; i < area; i++)
                    values[c * area + i] =
                        from[c * b->pixels + (r.y + i / r.width) * b->spec.width + r.x +
                             i % r.width];
            if (film_add(f, unit, values) != ERR_OK)
                need(NULL);
        }
    }
}

/* What became of one seed. */
struct outcome {
    bool claimed;
    uint32_t looks;
    double spp, planned; /* with the pilot and without it */
    double true_error, stated, effective;
    double efficiency; /* planned over the perfect allocation's for the error of V */
    bool heavy;
};

static void finish(const struct bench *b, const struct film *f, const uint16_t *limits,
                   struct outcome *o)
{
    double *picture = need(mem_alloc_array(b->values, sizeof *picture));
    float *rgb = need(mem_alloc_array(b->values, sizeof *rgb));
    struct film_error e;
    film_picture(f, rgb);
    for (size_t i = 0; i < b->pixels; i++)
        for (size_t c = 0; c < 3; c++)
            picture[c * b->pixels + i] = (double)rgb[3 * i + c];
    o->true_error = true_error(b, picture, NULL);
    film_error_estimate(f, &e);
    o->stated = e.relmse;
    o->effective = e.effective;
    o->heavy = e.effective < FILM_EFFECTIVE_MIN;
    double error = 0, cells = b->grid.cell_count;
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++) {
        double spp = (double)job_blocks_samples(&b->blocks, limits[cell]);
        spp = spp > 0 ? spp : (double)job_pilot_samples(&b->blocks); /* it is the picture */
        o->planned += spp / cells;
        error += b->level[cell] * pow(spp, -b->power) / (double)b->pixels;
    }
    o->efficiency = o->planned / perfect(b, error);
    mem_free(picture);
    mem_free(rgb);
}

/* The pilot: shares of the cells, and the first limits. True: the pilot is enough. */
static bool begin(const struct bench *b, struct film *f, double target, float *shares, double *mean,
                  uint16_t *limits)
{
    struct film_error e;
    double *terms = need(mem_calloc(2 * (size_t)b->grid.cell_count, sizeof *terms));
    double *squares = terms + b->grid.cell_count;
    float *pixels = need(mem_alloc_array(b->pixels, sizeof *pixels));
    float *scratch = need(mem_alloc_array(b->grid.cell_count, sizeof *scratch));
    film_error_estimate(f, &e);
    if (!film_error_pixels(f, pixels))
        need(NULL);
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++) {
        struct grid_rect r = grid_cell(&b->grid, cell);
        for (uint32_t y = r.y; y < r.y + r.height; y++) {
            for (uint32_t x = r.x; x < r.x + r.width; x++) {
                double term = (double)pixels[(size_t)y * b->spec.width + x];
                terms[cell] += term;
                squares[cell] += term * term;
            }
        }
    }
    allocate_shares(&b->grid, terms, squares, shares, scratch);
    bool enough = claim_stands(&e, target);
    if (!enough)
        *mean = claim_first(&b->grid, &b->blocks, terms, shares, target, limits);
    mem_free(terms);
    mem_free(pixels);
    mem_free(scratch);
    return enough;
}

/* As job_plan.c goes on. */
static struct outcome replay(struct bench *b, uint32_t seed, double target)
{
    struct outcome o = {.looks = 1};
    struct film *f;
    uint16_t limits[GRID_SQUARE * GRID_SQUARE];
    float shares[GRID_SQUARE * GRID_SQUARE];
    double mean = 0;
    refer(b, seed);
    if (film_new(&b->grid, &b->blocks, &f) != ERR_OK)
        need(NULL);
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++)
        limits[cell] = (uint16_t)b->blocks.pilot;
    render(b, seed, f, limits);
    o.claimed = begin(b, f, target, shares, &mean, limits);
    bool pilot = o.claimed, more = !o.claimed;
    while (more) {
        struct film_error e;
        if (!film_plan(f, limits, FILM_PILOT_DROPPED))
            need(NULL);
        render(b, seed, f, limits);
        film_error_estimate(f, &e);
        o.looks++;
        o.claimed = claim_stands(&e, target);
        more = !o.claimed && claim_more(&b->grid, &b->blocks, shares, &e, target, &mean, limits);
    }
    finish(b, f, limits, &o);
    o.spp = o.planned + (pilot ? 0 : (double)job_pilot_samples(&b->blocks));
    film_free(f);
    return o;
}

/* --- Tables --------------------------------------------------------------- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *v, uint32_t count)
{
    qsort(v, count, sizeof *v, compare_doubles);
    return count == 0  ? (double)NAN
           : count % 2 ? v[count / 2]
                       : (v[count / 2 - 1] + v[count / 2]) / 2;
}

/* Over scenes and targets, those of heavy tails apart. */
struct tally {
    uint32_t held, claims, runs, rows;
    double log_work, log_pilot, log_allocation;
};

static void tally_print(const char *name, const struct tally *t)
{
    if (t->rows > 0)
        printf("total  %s: %u of %u claims held (%.1f %%), %u runs; work %.2f (geometric mean of "
               "%u), of it pilot %.2f, allocation %.2f\n",
               name, t->held, t->claims, 100.0 * t->held / (t->claims ? t->claims : 1), t->runs,
               exp(t->log_work / t->rows), t->rows, exp(t->log_pilot / t->rows),
               exp(t->log_allocation / t->rows));
}

static void row_target(struct bench *b, double target, struct tally *ordinary, struct tally *heavy)
{
    struct tally t = {.runs = b->seeds, .rows = 1};
    double ratio[SEEDS_MAX], effective[SEEDS_MAX], spp = 0, planned = 0, looks = 0;
    double efficiency = 0;
    for (uint32_t seed = 0; seed < b->seeds; seed++) {
        struct outcome o = replay(b, seed, target);
        if (o.claimed) {
            ratio[t.claims++] = o.true_error / target;
            t.held += o.true_error <= target;
        }
        effective[seed] = o.effective;
        spp += o.spp / b->seeds;
        planned += o.planned / b->seeds;
        looks += (double)o.looks / b->seeds;
        efficiency += o.efficiency / b->seeds;
    }
    double work = spp / perfect(b, target), size = median(effective, b->seeds);
    double pilot = spp / planned;
    struct tally *to = size < FILM_EFFECTIVE_MIN ? heavy : ordinary;
    to->held += t.held;
    to->claims += t.claims;
    to->runs += t.runs;
    to->rows++;
    to->log_work += log(work);
    to->log_pilot += log(pilot);
    to->log_allocation += log(efficiency);
    printf("target | %s | %.3g | %u of %u of %u | %.2f | %.0f | %.2f | %.2f | %.2f | %.2f | %.1f | "
           "%.0f |\n",
           b->name, target, t.held, t.claims, t.runs, median(ratio, t.claims), spp, work, pilot,
           efficiency, work / pilot / efficiency, looks, size);
    (void)fflush(stdout);
}

/* The stated error of pictures of equal samples. */
static void row_error(struct bench *b, uint32_t step)
{
    double stated[SEEDS_MAX], true_error[SEEDS_MAX], sum = 0, true_sum = 0, squares = 0;
    uint32_t heavy = 0;
    uint16_t limits[GRID_SQUARE * GRID_SQUARE];
    for (uint32_t cell = 0; cell < b->grid.cell_count; cell++)
        limits[cell] = (uint16_t)(b->blocks.pilot + 2 * (step + 1));
    for (uint32_t seed = 0; seed < b->seeds; seed++) {
        struct outcome o = {0};
        struct film *f;
        refer(b, seed);
        if (film_new(&b->grid, &b->blocks, &f) != ERR_OK ||
            !film_plan(f, limits, FILM_PILOT_SKIPPED))
            need(NULL);
        render(b, seed, f, limits);
        finish(b, f, limits, &o);
        film_free(f);
        heavy += o.heavy;
        sum += stated[seed] = o.stated;
        true_sum += true_error[seed] = o.true_error;
    }
    double ratio = sum / true_sum, mean = true_sum / b->seeds;
    for (uint32_t seed = 0; seed < b->seeds; seed++)
        squares += pow((stated[seed] - ratio * true_error[seed]) / mean, 2);
    printf("error  | %s | %u | %.2e | %.3f +- %.3f | %u of %u |\n", b->name,
           (unsigned)step_spp(step), mean, ratio, sqrt(squares / (b->seeds - 1.0) / b->seeds),
           heavy, b->seeds);
    (void)fflush(stdout);
}

int main(int argc, char **argv)
{
    struct tally ordinary = {0}, heavy = {0};
    bool errors = argc > 1 && strcmp(argv[1], "--errors") == 0;
    int first = errors ? 2 : 1;
    if (argc < first + 2) {
        fprintf(stderr, "usage: claim_replay [--errors] SPP[,SPP...] FILE...\n");
        return 2;
    }
    for (int k = first + 1; k < argc; k++) {
        struct bench b;
        bench_read(&b, argv[k]);
        if (b.grid.cell_count > GRID_SQUARE * GRID_SQUARE)
            fail(argv[k], "has more than 256 squares");
        measure(&b);
        for (const char *at = argv[first]; at && *at;
             at = strchr(at, ',') ? strchr(at, ',') + 1 : NULL) {
            uint64_t spp = strtoull(at, NULL, 10);
            uint32_t step = 0;
            while (step + 1 < b.steps && step_spp(step) < spp)
                step++;
            row_error(&b, step);
            if (!errors)
                row_target(&b, b.total[step], &ordinary, &heavy);
        }
        bench_release(&b);
    }
    tally_print("ordinary", &ordinary);
    tally_print("heavy tails", &heavy);
    return 0;
}
