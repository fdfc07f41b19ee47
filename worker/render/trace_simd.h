/* worker/render/trace_simd.h: the few vector words the kernels are written in.
 *
 * f8: eight floats (child boxes), f4: four floats (a block's filter), and with AVX2 d4:
 * four doubles (a ray's axes). Chosen by the instruction set the including file is
 * compiled for. f8 and f4 may fuse (their errors are bounded either way), f4 not where it decides;
 * d4 never does, so its bits are those of scalars. min and max are a < b ? a : b and a > b ? a : b:
 * an `a` that is not a number gives b.
 */
#ifndef WORKER_RENDER_TRACE_SIMD_H
#define WORKER_RENDER_TRACE_SIMD_H

#include <immintrin.h>

typedef __m128 f4;

/* Which of four lanes; a comparison is false where a number is not one. */
#ifdef __AVX512VL__
typedef __mmask8 m4;

static inline m4 f4_less(f4 a, f4 b)
{
    return _mm_cmp_ps_mask(a, b, _CMP_LT_OS);
}
/* m and a < b */
static inline m4 f4_and_less(m4 m, f4 a, f4 b)
{
    return _mm_mask_cmp_ps_mask(m, a, b, _CMP_LT_OS);
}
static inline unsigned m4_bits(m4 m)
{
    return m;
}
#else
typedef __m128 m4;

static inline m4 f4_less(f4 a, f4 b)
{
    return _mm_cmplt_ps(a, b);
}
static inline m4 f4_and_less(m4 m, f4 a, f4 b)
{
    return _mm_and_ps(m, _mm_cmplt_ps(a, b));
}
static inline unsigned m4_bits(m4 m)
{
    return (unsigned)_mm_movemask_ps(m);
}
#endif

static inline f4 f4_less_mask(f4 a, f4 b)
{
    return _mm_cmplt_ps(a, b);
}

static inline f4 f4_negative(f4 a)
{
    return _mm_xor_ps(a, _mm_set1_ps(-0.0f));
}
static inline f4 f4_abs(f4 a)
{
    return _mm_andnot_ps(_mm_set1_ps(-0.0f), a);
}

#ifdef __AVX2__

typedef __m256 f8;
typedef __m256d d4;

static inline f8 f8_splat(float x)
{
    return _mm256_set1_ps(x);
}
static inline f8 f8_load(const float *p)
{
    return _mm256_load_ps(p);
}
/* a * b - c */
static inline f8 f8_mulsub(f8 a, f8 b, f8 c)
{
    return _mm256_fmsub_ps(a, b, c);
}
static inline f8 f8_min(f8 a, f8 b)
{
    return _mm256_min_ps(a, b);
}
static inline f8 f8_max(f8 a, f8 b)
{
    return _mm256_max_ps(a, b);
}
#ifdef __AVX512VL__
typedef __mmask8 m8;

static inline m8 f8_less_equal(f8 a, f8 b)
{
    return _mm256_cmp_ps_mask(a, b, _CMP_LE_OQ);
}
static inline unsigned m8_bits(m8 m)
{
    return m;
}
#else
typedef __m256 m8;

static inline m8 f8_less_equal(f8 a, f8 b)
{
    return _mm256_cmp_ps(a, b, _CMP_LE_OQ);
}
static inline unsigned m8_bits(m8 m)
{
    return (unsigned)_mm256_movemask_ps(m);
}
#endif
static inline d4 d4_splat(double x)
{
    return _mm256_set1_pd(x);
}
static inline d4 d4_add(d4 a, d4 b)
{
    return _mm256_add_pd(a, b);
}
static inline d4 d4_sub(d4 a, d4 b)
{
    return _mm256_sub_pd(a, b);
}
static inline d4 d4_mul(d4 a, d4 b)
{
    return _mm256_mul_pd(a, b);
}
static inline d4 d4_div(d4 a, d4 b)
{
    return _mm256_div_pd(a, b);
}
static inline d4 d4_max(d4 a, d4 b)
{
    return _mm256_max_pd(a, b);
}
static inline d4 d4_and(d4 a, d4 b)
{
    return _mm256_and_pd(a, b);
}
static inline d4 d4_less(d4 a, d4 b)
{
    return _mm256_cmp_pd(a, b, _CMP_LT_OQ);
}
static inline d4 d4_less_equal(d4 a, d4 b)
{
    return _mm256_cmp_pd(a, b, _CMP_LE_OQ);
}
static inline unsigned d4_mask(d4 a)
{
    return (unsigned)_mm256_movemask_pd(a);
}

#else /* SSE2 */

typedef struct {
    __m128 a, b;
} f8;

#define PAIR(type, op, x, y) ((type){op((x).a, (y).a), op((x).b, (y).b)})

static inline f8 f8_splat(float x)
{
    return (f8){_mm_set1_ps(x), _mm_set1_ps(x)};
}
static inline f8 f8_load(const float *p)
{
    return (f8){_mm_load_ps(p), _mm_load_ps(p + 4)};
}
static inline f8 f8_mulsub(f8 a, f8 b, f8 c)
{
    return (f8){_mm_sub_ps(_mm_mul_ps(a.a, b.a), c.a), _mm_sub_ps(_mm_mul_ps(a.b, b.b), c.b)};
}
static inline f8 f8_min(f8 a, f8 b)
{
    return PAIR(f8, _mm_min_ps, a, b);
}
static inline f8 f8_max(f8 a, f8 b)
{
    return PAIR(f8, _mm_max_ps, a, b);
}
typedef unsigned m8;

static inline m8 f8_less_equal(f8 a, f8 b)
{
    return (unsigned)_mm_movemask_ps(_mm_cmple_ps(a.a, b.a)) |
           (unsigned)_mm_movemask_ps(_mm_cmple_ps(a.b, b.b)) << 4;
}
static inline unsigned m8_bits(m8 m)
{
    return m;
}
#undef PAIR

#endif

#if defined(__FMA__) && !defined(TRACE_FAST)

/* c - a * b */
static inline f4 f4_nmuladd(f4 a, f4 b, f4 c)
{
    return _mm_fnmadd_ps(a, b, c);
}
static inline f4 f4_mulsub(f4 a, f4 b, f4 c)
{
    return _mm_fmsub_ps(a, b, c);
}
static inline f4 f4_muladd(f4 a, f4 b, f4 c)
{
    return _mm_fmadd_ps(a, b, c);
}

#else

static inline f4 f4_nmuladd(f4 a, f4 b, f4 c)
{
    return _mm_sub_ps(c, _mm_mul_ps(a, b));
}
static inline f4 f4_mulsub(f4 a, f4 b, f4 c)
{
    return _mm_sub_ps(_mm_mul_ps(a, b), c);
}
static inline f4 f4_muladd(f4 a, f4 b, f4 c)
{
    return _mm_add_ps(_mm_mul_ps(a, b), c);
}

#endif

/* --- The children a ray meets, in order ------------------------------------
 *
 * A key is the entry distance (not negative, so its bits order as the number does)
 * with the child's slot in the low three bits, which are masked off again before a
 * key is compared with a hit. children_sort writes the keys and references of the
 * met children to the top of a stack, the nearest last, may scribble eight entries
 * wide, and returns the nearest one's reference. */
enum { KEY_SLOT_MASK = 7 };

#ifdef __AVX2__

/* children_reverse[n][i] = n - 1 - i */
static const int32_t children_reverse[9][8] __attribute__((aligned(32))) = {
    {7, 6, 5, 4, 3, 2, 1, 0}, {0, 7, 6, 5, 4, 3, 2, 1}, {1, 0, 7, 6, 5, 4, 3, 2},
    {2, 1, 0, 7, 6, 5, 4, 3}, {3, 2, 1, 0, 7, 6, 5, 4}, {4, 3, 2, 1, 0, 7, 6, 5},
    {5, 4, 3, 2, 1, 0, 7, 6}, {6, 5, 4, 3, 2, 1, 0, 7}, {7, 6, 5, 4, 3, 2, 1, 0},
};

/* Four lanes that rise and then fall, or fall and then rise: sorted. */
static inline __m128i sort_bitonic(__m128i k)
{
    __m128i s = _mm_shuffle_epi32(k, _MM_SHUFFLE(1, 0, 3, 2));
    k = _mm_unpacklo_epi64(_mm_min_epu32(k, s), _mm_max_epu32(k, s));
    s = _mm_shuffle_epi32(k, _MM_SHUFFLE(2, 3, 0, 1));
    return _mm_blend_epi32(_mm_min_epu32(k, s), _mm_max_epu32(k, s), 0xa);
}

/* Each half sorted by itself. */
static inline __m256i sort_halves(__m256i k)
{
    __m256i s = _mm256_shuffle_epi32(k, _MM_SHUFFLE(1, 0, 3, 2));
    k = _mm256_unpacklo_epi64(_mm256_min_epu32(k, s), _mm256_max_epu32(k, s));
    s = _mm256_shuffle_epi32(k, _MM_SHUFFLE(2, 3, 0, 1));
    k = _mm256_blend_epi32(_mm256_min_epu32(k, s), _mm256_max_epu32(k, s), 0xaa);
    s = _mm256_shuffle_epi32(k, _MM_SHUFFLE(3, 1, 2, 0));
    return _mm256_blend_epi32(_mm256_min_epu32(k, s), _mm256_max_epu32(k, s), 0xcc);
}

#ifndef __AVX512VL__
/* Byte i of entry m: the lane that belongs in lane i when the lanes of mask m go first. */
extern const uint64_t trace_compress_table[256];
#endif

/* The chosen lanes first, in order. */
static inline __m256i lanes_compress(__m256i a, unsigned mask)
{
#ifdef __AVX512VL__
    return _mm256_mask_compress_epi32(_mm256_set1_epi32(-1), (__mmask8)mask, a);
#else
    __m256i lanes = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)trace_compress_table[mask]));
    return _mm256_permutevar8x32_epi32(a, lanes);
#endif
}

/* The keys of met children, the others' all ones; and whether those are behind them. AVX2 would
 * have to wait long for that, twice as long as for another step of the sort. */
#ifdef __AVX512VL__
enum { KEYS_MET_FIRST = 1 };
static inline __m256i keys_met(__m256i key, m8 met)
{
    return lanes_compress(key, met);
}
#else
enum { KEYS_MET_FIRST = 0 };
static inline __m256i keys_met(__m256i key, m8 met)
{
    return _mm256_blendv_epi8(_mm256_set1_epi32(-1), key, _mm256_castps_si256(met));
}
#endif

static inline __m128i lanes_permute(__m128i a, __m128i lanes)
{
    return _mm_castps_si128(_mm_permutevar_ps(_mm_castsi128_ps(a), lanes));
}

static inline uint32_t children_sort(f8 near, m8 met, unsigned count, const uint32_t *child,
                                     uint32_t *keys, uint32_t *refs)
{
    __m256i slots = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    __m256i child8 = _mm256_load_si256((const __m256i *)child);
    __m256i key = _mm256_or_si256(
        _mm256_andnot_si256(_mm256_set1_epi32(KEY_SLOT_MASK), _mm256_castps_si256(near)), slots);
    key = sort_halves(keys_met(key, met));
    __m128i low = _mm256_castsi256_si128(key), high = _mm256_extracti128_si256(key, 1);
    high = _mm_shuffle_epi32(high, _MM_SHUFFLE(0, 1, 2, 3));
    __m128i key4 = KEYS_MET_FIRST && count <= 4 ? low : sort_bitonic(_mm_min_epu32(low, high));
    if (__builtin_expect(count > 4, 0)) {
        key = _mm256_set_m128i(sort_bitonic(_mm_max_epu32(low, high)), key4);
        __m256i ref = _mm256_permutevar8x32_epi32(child8, key);
        __m256i reverse = _mm256_load_si256((const __m256i *)children_reverse[count]);
        _mm256_storeu_si256((__m256i *)keys, _mm256_permutevar8x32_epi32(key, reverse));
        _mm256_storeu_si256((__m256i *)refs, _mm256_permutevar8x32_epi32(ref, reverse));
        return (uint32_t)_mm_cvtsi128_si32(_mm256_castsi256_si128(ref));
    }
    /* Narrow stores stay within a cache line more often. */
    __m128i ref4 =
        _mm256_castsi256_si128(_mm256_permutevar8x32_epi32(child8, _mm256_castsi128_si256(key4)));
    __m128i reverse4 = _mm_load_si128((const __m128i *)children_reverse[count]);
    _mm_storeu_si128((__m128i *)keys, lanes_permute(key4, reverse4));
    _mm_storeu_si128((__m128i *)refs, lanes_permute(ref4, reverse4));
    return (uint32_t)_mm_cvtsi128_si32(ref4);
}

/* Any order will do: the references of the met children. Returns the last one's, read from where it
 * comes from, so that the walk does not wait for the rest. */
static inline uint32_t children_list(unsigned mask, const uint32_t *child, uint32_t *refs)
{
    __m256i ref = lanes_compress(_mm256_load_si256((const __m256i *)child), mask);
    _mm256_storeu_si256((__m256i *)refs, ref);
    return child[31 - __builtin_clz(mask)];
}

#else

static inline uint32_t children_sort(f8 near, m8 mask, unsigned count, const uint32_t *child,
                                     uint32_t *keys, uint32_t *refs)
{
    uint32_t bits[8];
    _mm_storeu_si128((__m128i *)bits, _mm_castps_si128(near.a));
    _mm_storeu_si128((__m128i *)(bits + 4), _mm_castps_si128(near.b));
    unsigned used = 0;
    for (; mask; mask &= mask - 1) {
        unsigned slot = (unsigned)__builtin_ctz(mask), at = used++;
        uint32_t key = (bits[slot] & ~(uint32_t)KEY_SLOT_MASK) | slot;
        for (; at > 0 && keys[at - 1] < key; at--) {
            keys[at] = keys[at - 1];
            refs[at] = refs[at - 1];
        }
        keys[at] = key;
        refs[at] = child[slot];
    }
    return refs[count - 1];
}

static inline uint32_t children_list(unsigned mask, const uint32_t *child, uint32_t *refs)
{
    uint32_t last = child[31 - __builtin_clz(mask)];
    for (; mask; mask &= mask - 1)
        *refs++ = child[__builtin_ctz(mask)];
    return last;
}

#endif

#endif
