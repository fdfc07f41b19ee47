/* tests/render/stats.h: goodness of fit, for tests of sampling.
 *
 * Header-only; tests only.
 */
#ifndef TESTS_RENDER_STATS_H
#define TESTS_RENDER_STATS_H

#include <math.h>
#include <stddef.h>

/* How many standard deviations a chi-square statistic lies above what `degrees` of freedom give
 * (Wilson and Hilferty 1931). */
static inline double stats_chi2_z(double chi2, double degrees)
{
    double spread = 2 / (9 * degrees);
    return (pow(chi2 / degrees, 1.0 / 3) - (1 - spread)) / sqrt(spread);
}

/* Compares counts with expectations; cells that expect less than five are pooled. Returns the
 * deviation as stats_chi2_z, or 0 when there is nothing to compare, or 1e9 for a count where
 * nothing at all is expected. */
static inline double stats_fit_z(const double *expected, const double *observed, size_t cells)
{
    double chi2 = 0, pooled_expected = 0, pooled_observed = 0, degrees = -1;
    for (size_t i = 0; i < cells; i++) {
        if (expected[i] < 5) {
            pooled_expected += expected[i];
            pooled_observed += observed[i];
            continue;
        }
        double d = observed[i] - expected[i];
        chi2 += d * d / expected[i];
        degrees += 1;
    }
    if (pooled_expected >= 5) {
        double d = pooled_observed - pooled_expected;
        chi2 += d * d / pooled_expected;
        degrees += 1;
    } else if (pooled_observed > 30) {
        return 1e9;
    }
    return degrees > 0 ? stats_chi2_z(chi2, degrees) : 0;
}

#endif
