/* client/flip.h: the difference that a person sees when flipping between two pictures.
 *
 * HDR-FLIP: Andersson, Nilsson, Shirley, Akenine-Moeller 2021, "Visualizing Errors in Rendered
 * High Dynamic Range Images" (Eurographics Short Papers), over LDR-FLIP: Andersson et al.
 * 2020 (HPG). Seen at 67 pixels per degree, tone-mapped by ACES at as many exposures as the
 * reference asks for; the largest error of a pixel counts. 0: the same; 1: black against
 * white. Negative and non-finite values count as black. Within 5e-6 of the package flip-evaluator
 * in the mean (tests/numerics/flip_peer.py).
 *
 * Pure apart from memory; one thread per call. Test: tests/e2e against the authors' program's
 * figures; test_cli_metrics for closed forms.
 */
#ifndef CLIENT_FLIP_H
#define CLIENT_FLIP_H

#include "common/err.h"

struct flip {
    double mean, p95;                     /* over pixels */
    double exposure_start, exposure_stop; /* in stops */
    uint32_t exposure_count;
};

/* Pictures as in metrics.h. ERR_NOMEM. */
TL_NODISCARD enum err flip_compare(const float *test, const float *reference, uint32_t width,
                                   uint32_t height, struct flip *out);

#endif
