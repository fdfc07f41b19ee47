/* worker/render/sobol.h: the first four dimensions of the Sobol sequence.
 *
 * Direction numbers of Joe and Kuo (2008, new-joe-kuo-6). Pure; any thread. Test:
 * test_sampler rebuilds the table from the recurrence.
 */
#ifndef WORKER_RENDER_SOBOL_H
#define WORKER_RENDER_SOBOL_H

#include <stdint.h>

typedef uint32_t sobol_vector __attribute__((vector_size(16)));

/* [i][d]: the point of index d << 4 i, its binary digits reversed (bit 0 is worth 1/2), so that
 * XOR over the eight hexadecimal digits of an index gives the point of the index. */
extern const sobol_vector sobol_digits[8][16];

#endif
