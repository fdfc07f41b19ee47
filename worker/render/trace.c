#include "worker/render/trace.h"

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

bool trace_scale(const double dir[3], double scaled[3], double *scale)
{
    double largest = 0.0;
    for (int k = 0; k < 3; k++) {
        if (!isfinite(dir[k]))
            return false;
        largest = exact_max(largest, exact_abs(dir[k]));
    }
    if (largest == 0.0)
        return false;
    uint64_t bits;
    memcpy(&bits, &largest, sizeof bits);
    int exponent = (int)(bits >> 52) - 1023;
    if (exponent < -1000) /* keeps the scale itself in range */
        exponent = -1000;
    if (exponent > 1000)
        exponent = 1000;
    *scale = power_of_two(-exponent);
    for (int k = 0; k < 3; k++)
        scaled[k] = dir[k] * *scale;
    return true;
}

void trace_ray_init(const double org[3], const double dir[3], double scale, double reach,
                    struct trace_ray *out)
{
    const float unit = 0x1p-24f;
    const float smallest = 0x1p-80f; /* a smaller component moves no ray out of a padded slab */
    uint32_t z = 0;
    double far = 0.0;
    for (uint32_t k = 0; k < 3; k++) {
        out->org[k] = org[k];
        out->dir[k] = dir[k];
        if (exact_abs(dir[k]) > exact_abs(dir[z]))
            z = k;
        far = exact_max(far, exact_abs(org[k]));
    }
    uint32_t x = z == 2 ? 0 : z + 1, y = x == 2 ? 0 : x + 1;
    out->axis[0] = x;
    out->axis[1] = y;
    out->axis[2] = z;
    out->shear[0] = dir[x] / dir[z];
    out->shear[1] = dir[y] / dir[z];
    out->shear[2] = 1.0 / dir[z];
    out->scale = scale;
    double size = far + reach;
    out->slack = 0x1p-30 * size;
    for (int k = 0; k < 3; k++)
        out->filter_org[k] = (float)org[out->axis[k]];
    out->filter_shear[0] = (float)out->shear[0];
    out->filter_shear[1] = (float)out->shear[1];
    /* The last term covers products that underflow. */
    out->filter_slope = (float)(100.0 * 0x1p-24 * size);
    out->filter_floor = (float)(256.0 * 0x1p-48 * size * size + 0x1p-140);
    /* The pad is rounded twice: a ninth unit covers that. */
    float pad = 9.0f * unit * (float)size;
    for (uint32_t k = 0; k < 3; k++) {
        bool back = signbit(dir[k]) != 0;
        float d = (float)dir[k], o = (float)org[k];
        if (!(__builtin_fabsf(d) >= smallest))
            d = back ? -smallest : smallest;
        out->inverse[k] = 1.0f / d;
        out->near_offset[k] = (back ? o - pad : o + pad) * out->inverse[k];
        out->far_offset[k] = (back ? o + pad : o - pad) * out->inverse[k];
        out->row[k] = 2 * k + (back ? 1 : 0);
    }
}
