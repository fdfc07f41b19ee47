/* client/metrics.h: how far a picture is from a reference.
 *
 * Pictures are width * height * 3 linear floats, interleaved. x is the picture, r the
 * reference. Values that are not finite in either are counted and left out of all sums.
 *
 *   RMSE     sqrt(mean (x - r)^2)
 *   relMSE   mean (x - r)^2 / (r^2 + 0.01 m^2), m the mean of r, over pixels and RGB
 *   trimmed  the same without the 0.1 % of pixels with the largest error
 *   MAPE     mean |x - r| / (|r| + 0.01 |m|)
 *   PSNR     10 log10(1 / MSE) of the display values: clamped to [0,1], sRGB-encoded
 *   SSIM     Wang et al. 2004 on the luma of the display values: Gaussian of 11 x 11,
 *            sigma 1.5, K1 0.01, K2 0.03, borders repeated; mean over all pixels
 *
 * Pure apart from memory; one thread per call. Tests: test_cli_metrics (against closed forms),
 * tests/e2e (against numpy).
 */
#ifndef CLIENT_METRICS_H
#define CLIENT_METRICS_H

#include "common/err.h"

struct metrics {
    double rmse, relmse, relmse_trimmed, mape, psnr, ssim;
    double max_difference; /* of one value; NaN if nothing was comparable */
    uint32_t max_x, max_y;
    uint64_t nonfinite_x, nonfinite_r; /* values */
    uint64_t values;                   /* that were compared */
    double mean_x, mean_r;
    bool identical; /* every value has the same bits */
};

/* ERR_NOMEM. */
TL_NODISCARD enum err metrics_compare(const float *x, const float *r, uint32_t width,
                                      uint32_t height, struct metrics *out);

/* relMSE's term of each pixel, mean of RGB; NaN where a value is not finite. `out` has width *
 * height. */
void metrics_error_map(const float *x, const float *r, uint32_t width, uint32_t height,
                       double *out);

/* An error on the fixed log scale 0.001 (dark blue) to 1 (yellow), white for NaN; 8-bit RGB. */
void metrics_heat(double error, unsigned char rgb[3]);

#endif
