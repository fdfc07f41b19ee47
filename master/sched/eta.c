#include "master/sched/eta.h"

/* 10 % of a normal distribution lie above mean + Z80 x sd, 10 % below mean - Z80 x sd. */
static const double Z80 = 1.2816;

/* A cell's cost in one block against another: other samples, other neighbours in the caches. */
static const double CV_REPEAT = 0.03;

/* Standard deviation of a uniform distribution over its width. */
static const double SD_UNIFORM = 0.289;

/* Threads stop and start, units wait: what the pace itself is uncertain by. */
static const double CV_PACE = 0.015;

void eta_spread_add(struct eta_spread *s, double x)
{
    s->count++;
    double delta = x - s->mean;
    s->mean += delta / (double)s->count;
    s->m2 += delta * (x - s->mean);
}

double eta_spread_cv(const struct eta_spread *s)
{
    if (s->count < 2 || s->mean <= 0.0)
        return 0.0;
    return __builtin_sqrt(s->m2 / (double)(s->count - 1)) / s->mean;
}

bool eta_left(const struct eta *e, double *low_s, double *high_s)
{
    if (e->spread.count < ETA_UNITS_MIN || e->elapsed_s < ETA_SECONDS_MIN || e->threads <= 0.0)
        return false;
    double cv = eta_spread_cv(&e->spread);
    double units = e->unknown_units > 0 ? (double)e->unknown_units : 1.0;

    /* The mean of what was measured is itself a guess of the mean of what was not; a spread that
     * is large is skewed too, and its measure falls short of it. */
    double sd_unknown = e->unknown_s * cv * (1.0 + 0.25 * cv) *
                        __builtin_sqrt(1.0 / (double)e->spread.count + 1.0 / units);
    double sd_known = e->known_s * CV_REPEAT;
    double sd_pace = (e->known_s + e->unknown_s) * CV_PACE;
    double sd = __builtin_sqrt(sd_unknown * sd_unknown + sd_known * sd_known + sd_pace * sd_pace);
    double left_s = e->known_s + e->unknown_s;

    /* Units that are out are longer than those that are done: a long one is out for longer. */
    double out = e->threads < units ? e->threads : units;
    left_s += out * e->unknown_s / units * cv * cv;

    /* Threads run out of units one by one, within about the length of a unit that is longer than
     * most; and nothing ends before the longest unit that is out. */
    double sd_tail_s = SD_UNIFORM * e->longest_open_s * (1.0 + 4.0 * cv * cv);
    double sd_s = __builtin_sqrt(sd * sd / (e->threads * e->threads) + sd_tail_s * sd_tail_s);
    double middle_s = left_s / e->threads;
    if (middle_s < e->longest_open_s)
        middle_s = e->longest_open_s;
    double low = middle_s - Z80 * sd_s, high = middle_s + Z80 * sd_s;
    *low_s = low > 0.0 ? low : 0.0;
    *high_s = high > *low_s ? high : *low_s;
    return true;
}
