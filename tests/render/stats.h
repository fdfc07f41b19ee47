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

/* How many standard deviations one of `tests` normal values must exceed for all of them together to
 * do so by chance with probability `alpha` (Sidak 1967); one-sided. */
static inline double stats_sidak_z(double alpha, double tests)
{
    double one = -expm1(log1p(-alpha) / tests), low = 0, high = 38;
    for (int i = 0; i < 100; i++) {
        double z = 0.5 * (low + high);
        if (0.5 * erfc(z / sqrt(2)) > one)
            low = z;
        else
            high = z;
    }
    return high;
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

/* Continued fraction of the incomplete beta function, by Lentz's method (Abramowitz and Stegun
 * 26.5.8). */
static inline double stats_beta_fraction(double a, double b, double x)
{
    const double tiny = 1e-300;
    double c = 1, d = 1 - (a + b) * x / (a + 1);
    d = 1 / (fabs(d) > tiny ? d : tiny);
    double result = d;
    for (int k = 2; k < 800; k++) {
        /* Odd and even terms in turn; the first one, d1, is in the start. */
        double m = (double)(k / 2);
        double term = k % 2 ? -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
                            : m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
        d = 1 + term * d;
        c = 1 + term / c;
        d = 1 / (fabs(d) > tiny ? d : tiny);
        c = fabs(c) > tiny ? c : tiny;
        result *= d * c;
        if (fabs(d * c - 1) < 1e-13)
            break;
    }
    return result;
}

/* P(|T| > |t|) for Student's t of `degrees` of freedom, > 0. */
static inline double stats_t_two_sided(double t, double degrees)
{
    double a = 0.5 * degrees, b = 0.5, x = degrees / (degrees + t * t);
    if (!(x < 1))
        return 1;
    double front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log(x) + b * log1p(-x));
    if (x < (a + 1) / (a + b + 2))
        return front * stats_beta_fraction(a, b, x) / a;
    return 1 - front * stats_beta_fraction(b, a, 1 - x) / b;
}

#endif
