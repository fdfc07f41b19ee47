#include "client/study_stats.h"

#include <math.h>
#include <string.h>

#define LAW_SLOWEST 0.5
#define LAW_FASTEST 2.0

double stats_t95(uint32_t count)
{
    /* Exact up to 10 degrees of freedom; then Hill's expansion around the normal quantile, whose
     * first two terms are within 0.1 % (Abramowitz and Stegun 26.7.5). */
    static const double exact[] = {0,      12.7062, 4.3027, 3.1824, 2.7764, 2.5706,
                                   2.4469, 2.3646,  2.3060, 2.2622, 2.2281};
    static const double z = 1.959964;
    TL_ASSERT(count >= 2);
    uint32_t freedom = count - 1;
    if (freedom < sizeof exact / sizeof *exact)
        return exact[freedom];
    double n = freedom, z3 = z * z * z, z5 = z3 * z * z;
    return z + (z3 + z) / (4 * n) + (5 * z5 + 16 * z3 + 3 * z) / (96 * n * n);
}

/* Half the width of the interval of log(mean); NaN if there is none. */
static double log_width(const double *v, uint32_t count, double mean)
{
    double squares = 0;
    for (uint32_t i = 0; i < count; i++)
        squares += (v[i] - mean) * (v[i] - mean);
    if (count < 2 || !(mean > 0))
        return (double)NAN;
    return stats_t95(count) * sqrt(squares / (count - 1) / count) / mean;
}

static double mean_of(const double *v, uint32_t count)
{
    double sum = 0;
    for (uint32_t i = 0; i < count; i++)
        sum += v[i];
    return count ? sum / count : (double)NAN;
}

static struct stats_interval around(double value, double width)
{
    return (struct stats_interval){
        .value = value, .low = value * exp(-width), .high = value * exp(width)};
}

struct stats_interval stats_mean(const double *v, uint32_t count)
{
    double mean = mean_of(v, count);
    return around(mean, log_width(v, count, mean));
}

struct stats_interval stats_cost(const double *v, uint32_t count)
{
    if (count == 0)
        return around((double)NAN, (double)NAN);
    return around(stats_median(v, count), log_width(v, count, mean_of(v, count)));
}

double stats_median(const double *v, uint32_t count)
{
    double sorted[STATS_MEDIAN_MAX];
    TL_ASSERT(count >= 1 && count <= STATS_MEDIAN_MAX);
    memcpy(sorted, v, count * sizeof *v);
    for (uint32_t i = 1; i < count; i++) {
        double moving = sorted[i];
        uint32_t at = i;
        for (; at > 0 && sorted[at - 1] > moving; at--)
            sorted[at] = sorted[at - 1];
        sorted[at] = moving;
    }
    return count % 2 ? sorted[count / 2] : (sorted[count / 2 - 1] + sorted[count / 2]) / 2;
}

struct stats_interval stats_gain(struct stats_work base, struct stats_work ours, uint32_t count)
{
    double sum = 0, squares = 0;
    for (uint32_t i = 0; i < count; i++) {
        double ratio = base.cost[i] * base.error[i] / (ours.cost[i] * ours.error[i]);
        double gain = ratio > 0 && isfinite(ratio) ? log(ratio) : (double)NAN;
        sum += gain;
        squares += gain * gain;
    }
    if (count == 0)
        return around((double)NAN, (double)NAN);
    double mean = sum / count, rest = fmax(0, squares - count * mean * mean);
    double width = count < 2 ? (double)NAN : stats_t95(count) * sqrt(rest / (count - 1) / count);
    return around(exp(mean), isnan(mean) ? (double)NAN : width);
}

void stats_front(const double *cost, const double *error, size_t count, bool *front)
{
    for (size_t i = 0; i < count; i++) {
        front[i] = cost[i] > 0 && error[i] > 0 && isfinite(cost[i]) && isfinite(error[i]);
        for (size_t k = 0; front[i] && k < count; k++) {
            bool real = cost[k] > 0 && error[k] > 0;
            bool better = cost[k] <= cost[i] && error[k] <= error[i] &&
                          (cost[k] < cost[i] || error[k] < error[i]);
            front[i] = !(real && better);
        }
    }
}

bool stats_law_fit(const double *n, const double *error, size_t count, struct stats_law *out)
{
    double sx = 0, sy = 0, sxx = 0, sxy = 0;
    size_t used = 0;
    for (size_t i = 0; i < count; i++) {
        if (!(n[i] > 0) || !(error[i] > 0) || !isfinite(error[i]))
            continue;
        double x = log(n[i]), y = log(error[i]);
        sx += x;
        sy += y;
        sxx += x * x;
        sxy += x * y;
        used++;
    }
    if (used == 0)
        return false;
    double points = (double)used, spread = points * sxx - sx * sx;
    double p = used >= 2 && spread > 1e-9 ? -(points * sxy - sx * sy) / spread : 1;
    p = p < LAW_SLOWEST ? LAW_SLOWEST : p > LAW_FASTEST ? LAW_FASTEST : p;
    out->p = p;
    out->a = exp((sy + p * sx) / points);
    return true;
}

double stats_law_at(const struct stats_law *law, double n)
{
    return law->a * pow(n, -law->p);
}

double stats_law_solve(const struct stats_law *law, double error)
{
    return pow(law->a / error, 1 / law->p);
}
