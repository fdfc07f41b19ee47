#include "worker/render/sampler.h"

#include <string.h>

#include "worker/render/sampler_parts.h"
#include "worker/render/sobol.h"

static const uint16_t primes[SAMPLER_HALTON_DIMENSIONS] = {
    2,    3,    5,    7,    11,   13,   17,   19,   23,   29,   31,   37,   41,   43,   47,   53,
    59,   61,   67,   71,   73,   79,   83,   89,   97,   101,  103,  107,  109,  113,  127,  131,
    137,  139,  149,  151,  157,  163,  167,  173,  179,  181,  191,  193,  197,  199,  211,  223,
    227,  229,  233,  239,  241,  251,  257,  263,  269,  271,  277,  281,  283,  293,  307,  311,
    313,  317,  331,  337,  347,  349,  353,  359,  367,  373,  379,  383,  389,  397,  401,  409,
    419,  421,  431,  433,  439,  443,  449,  457,  461,  463,  467,  479,  487,  491,  499,  503,
    509,  521,  523,  541,  547,  557,  563,  569,  571,  577,  587,  593,  599,  601,  607,  613,
    617,  619,  631,  641,  643,  647,  653,  659,  661,  673,  677,  683,  691,  701,  709,  719,
    727,  733,  739,  743,  751,  757,  761,  769,  773,  787,  797,  809,  811,  821,  823,  827,
    829,  839,  853,  857,  859,  863,  877,  881,  883,  887,  907,  911,  919,  929,  937,  941,
    947,  953,  967,  971,  977,  983,  991,  997,  1009, 1013, 1019, 1021, 1031, 1033, 1039, 1049,
    1051, 1061, 1063, 1069, 1087, 1091, 1093, 1097, 1103, 1109, 1117, 1123, 1129, 1151, 1153, 1163,
    1171, 1181, 1187, 1193, 1201, 1213, 1217, 1223, 1229, 1231, 1237, 1249, 1259, 1277, 1279, 1283,
    1289, 1291, 1297, 1301, 1303, 1307, 1319, 1321, 1327, 1361, 1367, 1373, 1381, 1399, 1409, 1423,
    1427, 1429, 1433, 1439, 1447, 1451, 1453, 1459, 1471, 1481, 1483, 1487, 1489, 1493, 1499, 1511,
    1523, 1531, 1543, 1549, 1553, 1559, 1567, 1571, 1579, 1583, 1597, 1601, 1607, 1609, 1613, 1619,
};

static const double unit_32 = 1.0 / 4294967296.0;
static const double unit_53 = 1.0 / 9007199254740992.0;
static const double below_one = 1.0 - 1.0 / 9007199254740992.0;

struct sampler sampler_of(enum job_sampler type, uint64_t seed, uint32_t x, uint32_t y,
                          uint32_t half, uint64_t index)
{
    uint64_t pixel = (uint64_t)y << 32 | x;
    uint64_t key = sampler_mix(sampler_mix(seed + UINT64_C(0x9e3779b97f4a7c15)) ^ pixel);
    return (struct sampler){.key = sampler_mix(key + half + 1), .index = index, .type = type};
}

/* Laine and Karras's hash with Vegdahl's constants: a bit changes only the bits above it, so on
 * reversed digits it is an Owen scramble. */
static sobol_vector scramble(sobol_vector v, sobol_vector seed)
{
    v ^= v * 0x3d20adeau;
    v += seed;
    v *= (seed >> 16) | 1u;
    v ^= v * 0x05526c56u;
    v ^= v * 0x53a22864u;
    return v;
}

static uint32_t scramble_one(uint32_t v, uint32_t seed)
{
    v ^= v * 0x3d20adeau;
    v += seed;
    v *= (seed >> 16) | 1u;
    v ^= v * 0x05526c56u;
    v ^= v * 0x53a22864u;
    return v;
}

static sobol_vector reverse_bits(sobol_vector v)
{
    v = v >> 16 | v << 16;
    v = (v >> 8 & 0x00ff00ffu) | (v & 0x00ff00ffu) << 8;
    v = (v >> 4 & 0x0f0f0f0fu) | (v & 0x0f0f0f0fu) << 4;
    v = (v >> 2 & 0x33333333u) | (v & 0x33333333u) << 2;
    return (v >> 1 & 0x55555555u) | (v & 0x55555555u) << 1;
}

static uint32_t reverse_16(uint32_t v)
{
    v = (v >> 8 & 0x00ffu) | (v & 0x00ffu) << 8;
    v = (v >> 4 & 0x0f0fu) | (v & 0x0f0fu) << 4;
    v = (v >> 2 & 0x3333u) | (v & 0x3333u) << 2;
    return (v >> 1 & 0x5555u) | (v & 0x5555u) << 1;
}

/* An Owen scramble of the low 16 bits of an index: aligned runs of 2^k indices stay aligned
 * runs, so each is still a net. */
static uint32_t shuffle_index(uint32_t index, uint32_t seed)
{
    uint32_t high = index >> 16;
    uint32_t low = scramble_one(reverse_16(index & 0xffff), seed ^ high * 0x9e3779b9u);
    return high << 16 | reverse_16(low & 0xffff);
}

static void sobol_set(uint64_t key, uint64_t index, uint32_t set, double u[SAMPLER_SET_VALUES])
{
    uint64_t hash0 = sampler_mix(key + (index >> 32) * UINT64_C(0xd1342543de82ef95) +
                                 (uint64_t)set * UINT64_C(0x9e3779b97f4a7c15));
    uint64_t hash1 = sampler_mix(hash0 ^ UINT64_C(0x6a09e667f3bcc909));
    uint64_t hash2 = sampler_mix(hash0 ^ UINT64_C(0xbb67ae8584caa73b));
    uint32_t i = shuffle_index((uint32_t)index, (uint32_t)hash0);
    sobol_vector point = sobol_digits[0][i & 15] ^ sobol_digits[1][i >> 4 & 15] ^
                         sobol_digits[2][i >> 8 & 15] ^ sobol_digits[3][i >> 12 & 15];
    if (i >> 16) {
        point ^= sobol_digits[4][i >> 16 & 15] ^ sobol_digits[5][i >> 20 & 15] ^
                 sobol_digits[6][i >> 24 & 15] ^ sobol_digits[7][i >> 28];
    }
    sobol_vector seeds = {(uint32_t)hash1, (uint32_t)(hash1 >> 32), (uint32_t)hash2,
                          (uint32_t)(hash2 >> 32)};
    point = reverse_bits(scramble(point, seeds));
    for (int k = 0; k < SAMPLER_SET_VALUES; k++)
        u[k] = (double)point[k] * unit_32;
}

/* A pseudo-random permutation of 0..count-1, drawn by `seed`: Kensler 2013, "Correlated
 * Multi-Jittered Sampling", the index hash with cycle walking. */
static uint32_t permute(uint32_t value, uint32_t count, uint32_t seed)
{
    uint32_t mask = count - 1;
    mask |= mask >> 1;
    mask |= mask >> 2;
    mask |= mask >> 4;
    mask |= mask >> 8;
    do {
        value ^= seed;
        value *= 0xe170893du;
        value ^= seed >> 16;
        value ^= (value & mask) >> 4;
        value ^= seed >> 8;
        value *= 0x0929eb3fu;
        value ^= seed >> 23;
        value ^= (value & mask) >> 1;
        value *= 1 | seed >> 27;
        value *= 0x6935fa69u;
        value ^= (value & mask) >> 11;
        value *= 0x74dcb303u;
        value ^= (value & mask) >> 2;
        value *= 0x9e501cc3u;
        value ^= (value & mask) >> 2;
        value *= 0xc860a3dfu;
        value &= mask;
        value ^= value >> 5;
    } while (value >= count);
    return (value + seed) % count;
}

/* Base 2: the index's bits are the digits, first digit lowest; one hash scrambles them all. Every
 * 2^32 indices start a fresh scramble. */
static double van_der_corput(uint64_t hash, uint64_t index)
{
    uint32_t seed = (uint32_t)sampler_mix(hash + (index >> 32));
    uint32_t digits = scramble_one((uint32_t)index, seed);
    digits = reverse_16(digits >> 16) | reverse_16(digits & 0xffff) << 16;
    return (double)digits * unit_32;
}

/* Radical inverse with each digit permuted by a hash of the digits before it. Digits beyond the
 * index's own are zeros, permuted as well, as long as another index below 2^16 may tell them
 * apart; what is finer is drawn at once. */
static double halton_value(uint64_t key, uint64_t index, uint32_t dimension)
{
    const double scale_fine = 0x1p-16;
    uint32_t base = primes[dimension];
    uint64_t hash = sampler_mix(key + (uint64_t)dimension * UINT64_C(0x9e3779b97f4a7c15));
    if (base == 2)
        return van_der_corput(hash, index);
    double scale = 1.0, sum = 0;
    double inverse = 1.0 / base;
    while (index || scale > scale_fine) {
        uint32_t digit = (uint32_t)(index % base);
        index /= base;
        scale *= inverse;
        sum += scale * permute(digit, base, (uint32_t)(hash >> 32));
        hash = sampler_mix(hash + digit + 1);
    }
    sum += scale * ((double)(hash >> 11) * unit_53);
    return sum < below_one ? sum : below_one;
}

static double hash_value(uint64_t key, uint64_t index, uint64_t dimension)
{
    uint64_t h = sampler_mix(key + dimension * UINT64_C(0x9e3779b97f4a7c15));
    return (double)(sampler_mix(h ^ index * UINT64_C(0xd1342543de82ef95)) >> 11) * unit_53;
}

void sampler_some(const struct sampler *s, uint32_t set, uint32_t count, double u[])
{
    if (s->type == JOB_SAMPLER_SOBOL) {
        double all[SAMPLER_SET_VALUES];
        sobol_set(s->key, s->index, set, all);
        memcpy(u, all, count * sizeof *u);
        return;
    }
    for (uint32_t k = 0; k < count; k++) {
        uint64_t dimension = (uint64_t)set * SAMPLER_SET_VALUES + k;
        u[k] = s->type == JOB_SAMPLER_HALTON && dimension < SAMPLER_HALTON_DIMENSIONS
                   ? halton_value(s->key, s->index, (uint32_t)dimension)
                   : hash_value(s->key, s->index, dimension);
    }
}

void sampler_set(const struct sampler *s, uint32_t set, double u[SAMPLER_SET_VALUES])
{
    if (s->type == JOB_SAMPLER_SOBOL)
        sobol_set(s->key, s->index, set, u);
    else
        sampler_some(s, set, SAMPLER_SET_VALUES, u);
}

/* Halton values of the first samples, as many as are done in vectors. */
static uint32_t halton_many(const struct sampler s[], uint32_t count, uint32_t set, uint32_t values,
                            double *const u[])
{
    uint32_t done = 0;
    for (uint32_t k = 0; k < values; k++) {
        uint32_t dimension = set * SAMPLER_SET_VALUES + k, base = primes[dimension];
        done = sampler_has_avx512() ? sampler_halton_avx512(s, count, dimension, base, u[k])
                                    : sampler_halton_avx2(s, count, dimension, base, u[k]);
    }
    return done;
}

void sampler_sets(const struct sampler s[], uint32_t count, uint32_t set, uint32_t values,
                  double *const u[SAMPLER_SET_VALUES])
{
    uint32_t done = 0;
    if (count > 0 && sampler_has_avx2() && s[0].type == JOB_SAMPLER_SOBOL)
        done = sampler_has_avx512() ? sampler_sobol_avx512(s, count, set, u)
                                    : sampler_sobol_avx2(s, count, set, u);
    else if (count > 0 && sampler_has_avx2() && s[0].type == JOB_SAMPLER_HALTON &&
             set < SAMPLER_HALTON_DIMENSIONS / SAMPLER_SET_VALUES)
        done = halton_many(s, count, set, values, u);
    for (uint32_t i = done; i < count; i++) {
        double one[SAMPLER_SET_VALUES];
        sampler_some(&s[i], set, values, one);
        for (uint32_t k = 0; k < values; k++)
            u[k][i] = one[k];
    }
}
