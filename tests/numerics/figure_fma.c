/* The seed's test as a compiler makes it by itself for a processor with fused operations: products
 * and sums contracted, -ffp-contract=fast (rows.cmake). */
#include "tests/numerics/figure_methods.h"

#include <math.h>

#define MOLLER_TRUMBORE figure_moller_trumbore_fma
#include "tests/numerics/figure_moller_trumbore.h"
