/* The body of sampler_sets_avx2.c and sampler_sets_avx512.c: values of eight samples at a time.
 *
 * The including file defines SAMPLER_SOBOL and SAMPLER_HALTON, the functions' names; the
 * instruction set is the compiler's business. The steps are those of sobol_set() and halton_value()
 * in sampler.c, one lane a sample. */
#include "worker/render/sampler_parts.h"
#include "worker/render/sobol.h"

enum { LANES = 8, INDEX_BITS = 16 };

static const double unit_32 = 1.0 / 4294967296.0;
static const double unit_53 = 1.0 / 9007199254740992.0;
static const double below_one = 1.0 - 1.0 / 9007199254740992.0;

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

/* The point is made a bit of the index at a time in place of a digit: lanes cannot look up. */
static inline void draw_sobol(const wide *key, const lanes *index, uint32_t set, uint32_t at,
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
        reals value = __builtin_convertvector(point[k], reals) * unit_32;
        memcpy(u[k] + at, &value, sizeof value);
    }
}

/* The next eight keys and indices; false if one of these is too far. */
static inline bool load(const struct sampler s[], wide *key, lanes *index)
{
    uint64_t any = 0;
    for (uint32_t i = 0; i < LANES; i++) {
        (*key)[i] = s[i].key;
        (*index)[i] = (uint32_t)s[i].index;
        any |= s[i].index;
    }
    return !(any >> INDEX_BITS);
}

uint32_t SAMPLER_SOBOL(const struct sampler s[], uint32_t count, uint32_t set, double *const u[])
{
    uint32_t at = 0;
    wide key = {0};
    lanes index = {0};
    for (; at + LANES <= count && load(s + at, &key, &index); at += LANES)
        draw_sobol(&key, &index, set, at, u);
    return at;
}

/* x / base of numbers below 2^31 base; the quotient in double never rounds up to the next
 * whole number, since its distance is at least 1 / base. */
static inline void over(const lanes *x, double base, lanes *out)
{
    reals quotient = __builtin_convertvector(*x, reals) / base;
    *out = (lanes) __builtin_convertvector(quotient, signed_lanes);
}

/* One round of the index hash. */
static inline void permute_round(lanes *v, const lanes *seed, uint32_t mask)
{
    *v ^= *seed;
    *v *= 0xe170893du;
    *v ^= *seed >> 16;
    *v ^= (*v & mask) >> 4;
    *v ^= *seed >> 8;
    *v *= 0x0929eb3fu;
    *v ^= *seed >> 23;
    *v ^= (*v & mask) >> 1;
    *v *= 1 | *seed >> 27;
    *v *= 0x6935fa69u;
    *v ^= (*v & mask) >> 11;
    *v *= 0x74dcb303u;
    *v ^= (*v & mask) >> 2;
    *v *= 0x9e501cc3u;
    *v ^= (*v & mask) >> 2;
    *v *= 0xc860a3dfu;
    *v &= mask;
    *v ^= *v >> 5;
}

static inline bool any_lane(const lanes *v)
{
    uint64_t words[LANES / 2];
    memcpy(words, v, sizeof words);
    return (words[0] | words[1]) | (words[2] | words[3]);
}

/* permute() of sampler.c; each lane walks until it is below `count`. */
static inline void permute(lanes *v, uint32_t count, const lanes *seed)
{
    uint32_t mask = count - 1;
    for (int shift = 1; shift <= 8; shift *= 2)
        mask |= mask >> shift;
    permute_round(v, seed, mask);
    for (lanes out = (lanes)(*v >= count); any_lane(&out); out = (lanes)(*v >= count)) {
        lanes again = *v;
        permute_round(&again, seed, mask);
        *v = (again & out) | (*v & ~out);
    }
    lanes sum = *v + *seed, turns;
    over(&sum, count, &turns);
    *v = sum - turns * count;
}

static inline void draw_halton(const wide *key, const lanes *at, uint32_t dimension, uint32_t base,
                               reals *out)
{
    const double scale_fine = 0x1p-16;
    wide hash = *key + (uint64_t)dimension * UINT64_C(0x9e3779b97f4a7c15);
    lanes index = *at;
    mix(&hash);
    if (base == 2) {
        mix(&hash);
        lanes seed = __builtin_convertvector(hash, lanes);
        scramble(&index, &seed);
        reverse(&index);
        *out = __builtin_convertvector(index, reals) * unit_32;
        return;
    }
    double scale = 1.0, inverse = 1.0 / base;
    reals sum = {0};
    /* Of an index below 2^16 no digit is left then. */
    while (scale > scale_fine) {
        lanes rest;
        over(&index, base, &rest);
        lanes digit = index - rest * base, permuted = digit,
              seed = __builtin_convertvector(hash >> 32, lanes);
        scale *= inverse;
        permute(&permuted, base, &seed);
        sum += scale * __builtin_convertvector(permuted, reals);
        hash += __builtin_convertvector(digit, wide) + 1;
        mix(&hash);
        index = rest;
    }
    *out = sum + scale * (__builtin_convertvector(hash >> 11, reals) * unit_53);
}

uint32_t SAMPLER_HALTON(const struct sampler s[], uint32_t count, uint32_t dimension, uint32_t base,
                        double u[])
{
    uint32_t at = 0;
    wide key = {0};
    lanes index = {0};
    for (; at + LANES <= count && load(s + at, &key, &index); at += LANES) {
        reals value;
        draw_halton(&key, &index, dimension, base, &value);
        for (uint32_t i = 0; i < LANES; i++)
            u[at + i] = value[i] < below_one ? value[i] : below_one;
    }
    return at;
}
