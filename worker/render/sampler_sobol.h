/* The body of sampler_sets_avx2.c and sampler_sets_avx512.c: sobol sets of eight samples at a time.
 *
 * The including file defines SAMPLER_SOBOL, the function's name; its instruction set is the
 * compiler's business, for it is all integers and one exact product. The steps are those of
 * sobol_set() in sampler.c, one lane a sample; the point is made a bit of the index at a time in
 * place of a digit, for lanes cannot look up. */
#include "worker/render/sampler_parts.h"
#include "worker/render/sobol.h"

enum { LANES = 8, INDEX_BITS = 16 };

typedef uint64_t wide __attribute__((vector_size(8 * LANES)));
typedef uint32_t lanes __attribute__((vector_size(4 * LANES)));
typedef int32_t signed_lanes __attribute__((vector_size(4 * LANES)));
typedef double reals __attribute__((vector_size(8 * LANES)));

static inline void mix(wide *v)
{
    *v ^= *v >> 32;
    *v *= UINT64_C(0xe9846af9b1a615d);
    *v ^= *v >> 32;
    *v *= UINT64_C(0xe9846af9b1a615d);
    *v ^= *v >> 28;
}

static inline void scramble(lanes *v, const lanes *seed)
{
    *v ^= *v * 0x3d20adeau;
    *v += *seed;
    *v *= (*seed >> 16) | 1u;
    *v ^= *v * 0x05526c56u;
    *v ^= *v * 0x53a22864u;
}

/* Of the low 16 bits. */
static inline void reverse_low(lanes *v)
{
    *v = (*v >> 8 & 0x00ffu) | (*v & 0x00ffu) << 8;
    *v = (*v >> 4 & 0x0f0fu) | (*v & 0x0f0fu) << 4;
    *v = (*v >> 2 & 0x3333u) | (*v & 0x3333u) << 2;
    *v = (*v >> 1 & 0x5555u) | (*v & 0x5555u) << 1;
}

static inline void reverse(lanes *v)
{
    *v = *v >> 16 | *v << 16;
    *v = (*v >> 8 & 0x00ff00ffu) | (*v & 0x00ff00ffu) << 8;
    *v = (*v >> 4 & 0x0f0f0f0fu) | (*v & 0x0f0f0f0fu) << 4;
    *v = (*v >> 2 & 0x33333333u) | (*v & 0x33333333u) << 2;
    *v = (*v >> 1 & 0x55555555u) | (*v & 0x55555555u) << 1;
}

static inline void draw(const wide *key, const lanes *index, uint32_t set, uint32_t at,
                        double *const u[])
{
    wide hash0 = *key + (uint64_t)set * UINT64_C(0x9e3779b97f4a7c15);
    mix(&hash0);
    wide hash1 = hash0 ^ UINT64_C(0x6a09e667f3bcc909), hash2 = hash0 ^ UINT64_C(0xbb67ae8584caa73b);
    mix(&hash1);
    mix(&hash2);
    const lanes seeds[SAMPLER_SET_VALUES] = {
        __builtin_convertvector(hash1, lanes), __builtin_convertvector(hash1 >> 32, lanes),
        __builtin_convertvector(hash2, lanes), __builtin_convertvector(hash2 >> 32, lanes)};
    lanes shuffled = *index, seed = __builtin_convertvector(hash0, lanes);
    reverse_low(&shuffled);
    scramble(&shuffled, &seed);
    reverse_low(&shuffled);
    lanes point[SAMPLER_SET_VALUES] = {shuffled};
    for (int bit = 0; bit < INDEX_BITS; bit++) {
        const sobol_vector *column = &sobol_digits[bit / 4][1 << bit % 4];
        lanes mask = (lanes)((signed_lanes)(shuffled << (31 - bit)) >> 31);
        for (int k = 1; k < SAMPLER_SET_VALUES; k++)
            point[k] ^= mask & (*column)[k];
    }
    for (int k = 0; k < SAMPLER_SET_VALUES; k++) {
        scramble(&point[k], &seeds[k]);
        reverse(&point[k]);
        reals value = __builtin_convertvector(point[k], reals) * (1.0 / 4294967296.0);
        memcpy(u[k] + at, &value, sizeof value);
    }
}

uint32_t SAMPLER_SOBOL(const struct sampler s[], uint32_t count, uint32_t set, double *const u[])
{
    uint32_t at = 0;
    for (; at + LANES <= count; at += LANES) {
        wide key;
        lanes index;
        uint64_t any = 0;
        for (uint32_t i = 0; i < LANES; i++) {
            key[i] = s[at + i].key;
            index[i] = (uint32_t)s[at + i].index;
            any |= s[at + i].index;
        }
        if (any >> INDEX_BITS)
            break;
        draw(&key, &index, set, at, u);
    }
    return at;
}
