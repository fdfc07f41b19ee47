/* client/study_error.h: the error of a setting, taken apart into bias and variance.
 *
 * A setting is rendered several times with independent seeds; two references a and b, of seeds of
 * their own and many more samples, stand for the truth t. With w = 1 / (r^2 + 0.01 m^2), r the
 * mean of a and b and m the mean of r, and x_k the pictures:
 *
 *   relMSE of one picture   mean w (x_k - a)(x_k - b)        expects w (x - t)^2: the references'
 *   variance                mean w s^2, s^2 over k            noise falls out, being independent
 *   bias^2                  mean w ((x - a)(x - b) - s^2/K), x the mean over k; can come out
 *                           below 0, and then means: none found
 *
 * (Celarek, Jakob, Wimmer and Lehtinen 2019, "Quantifying the Error of Light Transport
 * Algorithms".) The standard error of bias^2 is taken over squares of 8 x 8 pixels, whose noise is
 * independent. Values that are not finite are counted and left out.
 *
 * Pure apart from memory; one thread. Test: test_study (against pictures made with known bias and
 * variance).
 */
#ifndef CLIENT_STUDY_ERROR_H
#define CLIENT_STUDY_ERROR_H

#include "common/err.h"

struct study_truth {
    uint32_t width, height;
    float *a, *b;  /* owned; width * height * 3 */
    float *weight; /* owned; w of each value */
    double relmse; /* of the mean of a and b: what the references themselves may be off */
};

/* Takes both pictures (mem_free). ERR_NOMEM: they are freed. */
TL_NODISCARD enum err study_truth_init(struct study_truth *t, uint32_t width, uint32_t height,
                                       float *a, float *b);
void study_truth_release(struct study_truth *t);

/* What is kept of the pictures of one setting. */
struct study_sums {
    double *first, *second; /* owned: sums of (x - r) and (x - r)^2 of each value */
    uint32_t count;
    uint64_t nonfinite;
};

/* Adds one picture; *relmse is its own. ERR_NOMEM. */
TL_NODISCARD enum err study_sums_add(struct study_sums *s, const struct study_truth *t,
                                     const float *rgb, double *relmse);
void study_sums_release(struct study_sums *s);

struct study_parts {
    double variance;        /* of one picture; NaN with fewer than two */
    double bias2, bias2_se; /* the same */
};
void study_sums_parts(const struct study_sums *s, const struct study_truth *t,
                      struct study_parts *out);

/* relMSE of one picture against the truth, without adding it. */
double study_truth_relmse(const struct study_truth *t, const float *rgb);

#endif
