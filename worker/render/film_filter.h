/* worker/render/film_filter.h: where in and around a pixel its samples fall.
 *
 * Filter importance sampling: a sample belongs to one pixel, its offset is drawn in
 * proportion to the filter's magnitude, and its weight carries what the drawing did
 * not, sign included; so nothing is splatted over a cell's border. The mean weight is 1.
 * Filters are separable. Any thread. Tests: test_light.
 */
#ifndef WORKER_RENDER_FILM_FILTER_H
#define WORKER_RENDER_FILM_FILTER_H

#include "common/job_spec.h"

enum { FILM_FILTER_BINS = 256 };

struct film_filter {
    enum job_filter type;
    double radius, alpha, b, c;
    double integral;                  /* of the 1D filter over [-radius, radius] */
    double cdf[FILM_FILTER_BINS + 1]; /* of the bins' magnitudes; unused by box and tent */
};

void film_filter_init(struct film_filter *f, const struct job_spec *spec);

/* The filter at a distance from the pixel's centre, along one axis. */
double film_filter_value(const struct film_filter *f, double x);

/* Offset from the pixel's centre along one axis, and its weight. */
double film_filter_sample(const struct film_filter *f, double u, double *weight);

#endif
