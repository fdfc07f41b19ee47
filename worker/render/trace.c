#include "worker/render/trace.h"

#include <emmintrin.h>
#include <math.h>
#include <string.h>

#include "worker/render/trace_exact.h"

/* 2^e for -1022 <= e <= 1023. */
static double power_of_two(int e)
{
    uint64_t bits = (uint64_t)(e + 1023) << 52;
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* The float side, all axes at once. */
static inline void slabs_ready(struct trace_ray *r, __m128 org, __m128 dir, float pad_size)
{
    const __m128 sign = _mm_set1_ps(-0.0f);
    /* A smaller component moves no ray out of a padded slab. */
    const __m128 smallest = _mm_set1_ps(0x1p-80f);
    __m128 signs = _mm_and_ps(dir, sign);
    __m128 size = _mm_max_ps(_mm_andnot_ps(sign, dir), smallest);
    __m128 inverse = _mm_div_ps(_mm_set1_ps(1.0f), _mm_or_ps(size, signs));
    __m128 pad = _mm_or_ps(_mm_set1_ps(pad_size), signs);
    float out[3][4];
    _mm_storeu_ps(out[0], inverse);
    _mm_storeu_ps(out[1], _mm_mul_ps(_mm_add_ps(org, pad), inverse));
    _mm_storeu_ps(out[2], _mm_mul_ps(_mm_sub_ps(org, pad), inverse));
    memcpy(r->inverse, out[0], sizeof r->inverse);
    memcpy(r->near_offset, out[1], sizeof r->near_offset);
    memcpy(r->far_offset, out[2], sizeof r->far_offset);
    uint32_t back = (uint32_t)_mm_movemask_ps(signs);
    for (uint32_t k = 0; k < 3; k++)
        r->row[k] = TRACE_ROW * (2 * k + (back >> k & 1));
}

bool trace_ray_init(const double org[3], const double dir[3], double outer, double reach,
                    double pad, struct trace_ray *out)
{
    static const uint32_t after[3] = {1, 2, 0};
    const uint64_t infinite = UINT64_C(0x7ff) << 52;
    /* As integers, sizes order like the numbers; what is not finite is largest. */
    uint64_t size_bits[3];
    memcpy(size_bits, dir, sizeof size_bits);
    for (int k = 0; k < 3; k++)
        size_bits[k] &= INT64_MAX;
    uint32_t z = size_bits[1] >= size_bits[0] ? 1 : 0;
    uint64_t largest = size_bits[1] >= size_bits[0] ? size_bits[1] : size_bits[0];
    z = size_bits[2] >= largest ? 2 : z;
    largest = size_bits[2] >= largest ? size_bits[2] : largest;
    if (largest == 0 || largest >= infinite)
        return false;
    int exponent = (int)(largest >> 52) - 1023;
    exponent = exponent < -1000 ? -1000 : exponent > 1000 ? 1000 : exponent; /* 2^-e is finite */
    double scale = power_of_two(-exponent), far = 0.0;
    uint32_t x = after[z], y = after[x];
    for (uint32_t k = 0; k < 3; k++) {
        out->org[k] = org[k];
        out->dir[k] = dir[k] * scale;
        far = exact_max(far, exact_abs(org[k]));
    }
    out->rescale = scale;
    out->unscale = power_of_two(exponent);
    out->scale = outer * scale;
    out->axis[0] = x;
    out->axis[1] = y;
    out->axis[2] = z;
    out->shear[0] = dir[x] / dir[z];
    out->shear[1] = dir[y] / dir[z];
    out->shear[2] = 1.0 / out->dir[z];
    for (uint32_t k = 0; k < 3; k++)
        out->porg[k] = org[out->axis[k]];
    double size = far + reach;
    out->slack = 0x1p-30 * size;
    for (int k = 0; k < 3; k++)
        out->filter_org[k] = (float)out->porg[k];
    out->filter_shear[0] = (float)out->shear[0];
    out->filter_shear[1] = (float)out->shear[1];
    out->filter_shear[2] = (float)out->shear[2];
    out->filter_slack = (float)(0x1p-20 * size);
    out->filter_shear[3] = -out->filter_shear[2];
    out->filter_spread = 13.8f * __builtin_fabsf(out->filter_shear[2]);
    out->filter_depth = 2.0f * __builtin_fabsf(out->filter_shear[2]) * out->filter_slack;
    out->filter_slope = (float)(100.0 * 0x1p-24 * size);
    /* 256 u^2 R^2; the last term covers products that underflow. */
    out->filter_floor = out->filter_slack * out->filter_slack + 0x1p-105f;
    /* The pad is rounded twice: a ninth unit covers that. */
    slabs_ready(out, _mm_setr_ps((float)org[0], (float)org[1], (float)org[2], 0.0f),
                _mm_setr_ps((float)out->dir[0], (float)out->dir[1], (float)out->dir[2], 0.0f),
                (float)(pad * 0x1p-24 * size));
    if (pad == TRACE_PAD_FAST && size > TRACE_FAR_FAST * reach)
        out->filter_slack = NAN;
    return true;
}
