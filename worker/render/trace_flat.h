/* worker/render/trace_flat.h: one ray against all triangles of a scene that has few.
 *
 * Included by one .c file per instruction set, AVX2 at least, which defines TRACE_KERNEL
 * (the name of its table) and TRACE_NAME. The float filter of trace_leaf.h takes a vector
 * of triangles at a time, each with its own bound; of those that are left, four at a time
 * are decided in double, a lane each. Until all of that is done there is no branch that
 * depends on what the ray meets: wrong guesses are most of what a tree costs here. The
 * bits are those of trace_exact.h. Pure; any thread. Bounds: docs/TRACING.md.
 */
#include "worker/render/accel_parts.h"

#include <math.h>
#include <string.h>

#include "worker/render/trace_exact.h"
#include "worker/render/trace_ready.h"

/* --- In float ---------------------------------------------------------------- */

#ifdef __AVX512VL__

enum { FLAT_LANES = 16 };
typedef __m512 fw;
#define FW(op) _mm512_##op

/* Lanes that are certainly of both signs. */
static inline uint32_t flat_mixed(fw least, fw most, fw error)
{
    __mmask16 m = _mm512_cmp_ps_mask(error, most, _CMP_LT_OQ);
    fw low = _mm512_add_ps(least, error);
    return _mm512_mask_cmp_ps_mask(m, low, _mm512_setzero_ps(), _CMP_LT_OQ);
}

#else

enum { FLAT_LANES = 8 };
typedef __m256 fw;
#define FW(op) _mm256_##op

static inline uint32_t flat_mixed(fw least, fw most, fw error)
{
    fw m = _mm256_cmp_ps(error, most, _CMP_LT_OQ), low = _mm256_add_ps(least, error);
    m = _mm256_and_ps(m, _mm256_cmp_ps(low, _mm256_setzero_ps(), _CMP_LT_OQ));
    return (uint32_t)_mm256_movemask_ps(m);
}

#endif

/* The triangles that Woop's test in double could accept, as bits. */
static inline uint64_t flat_filter(const struct accel_flat *f, const struct trace_ray *r)
{
    fw ox = FW(set1_ps)(r->filter_org[0]), oy = FW(set1_ps)(r->filter_org[1]);
    fw oz = FW(set1_ps)(r->filter_org[2]);
    fw sx = FW(set1_ps)(r->filter_shear[0]), sy = FW(set1_ps)(r->filter_shear[1]);
    fw slope = FW(set1_ps)(r->filter_slope), least_error = FW(set1_ps)(r->filter_floor);
    uint64_t mixed = 0;
#pragma GCC unroll 4
    for (uint32_t at = 0; at < f->count; at += FLAT_LANES) {
        fw x[3], y[3];
        for (int i = 0; i < 3; i++) {
            const float(*v)[FLAT_MAX] = f->filter[i];
            fw z = FW(sub_ps)(oz, FW(load_ps)(&v[r->axis[2]][at]));
            x[i] = FW(fnmadd_ps)(sx, z, FW(sub_ps)(ox, FW(load_ps)(&v[r->axis[0]][at])));
            y[i] = FW(fnmadd_ps)(sy, z, FW(sub_ps)(oy, FW(load_ps)(&v[r->axis[1]][at])));
        }
        fw u = FW(fmsub_ps)(x[2], y[1], FW(mul_ps)(y[2], x[1]));
        fw v = FW(fmsub_ps)(x[0], y[2], FW(mul_ps)(y[0], x[2]));
        fw w = FW(fmsub_ps)(x[1], y[0], FW(mul_ps)(y[1], x[0]));
        fw error = FW(fmadd_ps)(slope, FW(load_ps)(&f->edge[at]), least_error);
        fw least = FW(min_ps)(u, FW(min_ps)(v, w)), most = FW(max_ps)(u, FW(max_ps)(v, w));
        mixed |= (uint64_t)flat_mixed(least, most, error) << at;
    }
    return ~mixed & UINT64_MAX >> (FLAT_MAX - f->count);
}

/* --- In double --------------------------------------------------------------- */

/* Four triangles, a lane each. */
struct flat_four {
    uint32_t row[5]; /* in the table; the fifth: no triangle */
    d4 t, v, w, det;
    unsigned hit;     /* lanes that are hit within the ray's ends */
    unsigned careful; /* lanes to be decided by exact_woop instead */
};

/* Takes the next four of *left; instead of those there are not, the row behind the last. Returns
 * which lanes are triangles. */
static inline unsigned flat_take(uint64_t *left, uint32_t row[5])
{
    unsigned count = (unsigned)__builtin_popcountll(*left);
    for (int i = 0; i < 4; i++) {
        row[i] = (uint32_t)_tzcnt_u64(*left); /* FLAT_MAX of nothing */
        *left &= *left - 1;
    }
    row[4] = FLAT_MAX;
    return 15u >> (4 - (count < 4 ? count : 4));
}

/* An axis of the four, relative to the origin, by vertex; and the rows' fourth numbers. */
static inline void flat_axis(const struct accel_flat *f, const uint32_t row[5],
                             const struct trace_ray *r, bool few, int k, d4 out[4])
{
    uint32_t axis = r->axis[k];
    if (few) {
        for (int i = 0; i < 3; i++)
            out[i] = d4_sub(_mm256_load_pd(f->four[axis][i]), d4_splat(r->porg[k]));
        out[3] = _mm256_load_pd(f->four[axis][3]);
        return;
    }
    d4 a = _mm256_load_pd(f->v[row[0]][axis]), b = _mm256_load_pd(f->v[row[1]][axis]);
    d4 c = _mm256_load_pd(f->v[row[2]][axis]), d = _mm256_load_pd(f->v[row[3]][axis]);
    d4 ab02 = _mm256_unpacklo_pd(a, b), cd02 = _mm256_unpacklo_pd(c, d);
    d4 ab13 = _mm256_unpackhi_pd(a, b), cd13 = _mm256_unpackhi_pd(c, d);
    d4 org = d4_splat(r->porg[k]);
    out[0] = d4_sub(_mm256_permute2f128_pd(ab02, cd02, 0x20), org);
    out[1] = d4_sub(_mm256_permute2f128_pd(ab13, cd13, 0x20), org);
    out[2] = d4_sub(_mm256_permute2f128_pd(ab02, cd02, 0x31), org);
    out[3] = _mm256_permute2f128_pd(ab13, cd13, 0x31);
}

static inline d4 flat_any_less(d4 a, d4 b, d4 c, d4 limit)
{
    d4 of_two = _mm256_or_pd(d4_less(a, limit), d4_less(b, limit));
    return _mm256_or_pd(of_two, d4_less(c, limit));
}

/* z of the hits, held within their vertices' depths: exact_depth. */
static inline d4 flat_depth(d4 u, const struct flat_four *h, const d4 z[3])
{
    d4 sum = d4_add(d4_add(d4_mul(u, z[0]), d4_mul(h->v, z[1])), d4_mul(h->w, z[2]));
    d4 first = _mm256_min_pd(_mm256_min_pd(z[0], z[1]), z[2]);
    d4 last = d4_max(d4_max(z[0], z[1]), z[2]);
    return _mm256_min_pd(d4_max(d4_div(sum, h->det), first), last);
}

/* exact_woop of those of the four that `lanes` has; where det is large enough, exact_near needs no
 * look. */
static inline void flat_decide(const struct accel_flat *f, const struct trace_ray *r, bool few,
                               unsigned lanes, double tmin, double tmax, struct flat_four *h)
{
    d4 x[4], y[4], z[4], zero = _mm256_setzero_pd();
    flat_axis(f, h->row, r, few, 0, x);
    flat_axis(f, h->row, r, few, 1, y);
    flat_axis(f, h->row, r, few, 2, z);
    /* Functions of what is farther than 2^230 may not be finite. */
    double floor = r->slack < 0x1p200 ? 0x1p-52 * r->slack * r->slack : __builtin_inf();
    d4 enough = d4_add(z[3], d4_splat(floor));
    for (int i = 0; i < 3; i++) {
        x[i] = d4_sub(x[i], d4_mul(d4_splat(r->shear[0]), z[i]));
        y[i] = d4_sub(y[i], d4_mul(d4_splat(r->shear[1]), z[i]));
    }
    d4 u = d4_sub(d4_mul(x[2], y[1]), d4_mul(y[2], x[1]));
    h->v = d4_sub(d4_mul(x[0], y[2]), d4_mul(y[0], x[2]));
    h->w = d4_sub(d4_mul(x[1], y[0]), d4_mul(y[1], x[0]));
    h->det = d4_add(d4_add(u, h->v), h->w);
    d4 negative = flat_any_less(u, h->v, h->w, zero);
    d4 minus = d4_sub(zero, u);
    d4 positive = flat_any_less(minus, d4_sub(zero, h->v), d4_sub(zero, h->w), zero);
    lanes &= ~d4_mask(d4_and(negative, positive));
    if (few && !lanes) {
        h->hit = h->careful = 0;
        return;
    }
    h->careful = lanes & ~d4_mask(d4_less(enough, ready_abs(h->det)));
    h->t = d4_mul(flat_depth(u, h, z), d4_splat(r->shear[2]));
    d4 within = d4_and(d4_less(d4_splat(tmin), h->t), d4_less(h->t, d4_splat(tmax)));
    h->hit = lanes & d4_mask(within);
}

/* The first of the nearest lanes that are hit; 4 if none is. */
static inline unsigned flat_nearest(const struct flat_four *h)
{
    const __m256i bit = _mm256_setr_epi64x(1, 2, 4, 8);
    __m256i is = _mm256_and_si256(_mm256_set1_epi64x(h->hit), bit);
    is = _mm256_cmpeq_epi64(is, bit);
    d4 t = _mm256_blendv_pd(d4_splat(__builtin_inf()), h->t, _mm256_castsi256_pd(is));
    d4 least = _mm256_min_pd(t, _mm256_permute2f128_pd(t, t, 1));
    least = _mm256_min_pd(least, _mm256_permute_pd(least, 5));
    return (unsigned)__builtin_ctz((d4_mask(d4_less_equal(t, least)) & h->hit) | 16);
}

/* --- With care --------------------------------------------------------------- */

/* One triangle of the table by exact_woop. */
static bool flat_woop(const struct accel_flat *f, const struct trace_ray *r, uint32_t row,
                      struct exact_edges *e, double *t)
{
    float v[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            v[i][k] = f->filter[i][k][row];
    return exact_woop(r, v, e, t);
}

/* All that the filter left, one after the other; t, or tmax if none is hit. */
static __attribute__((noinline)) double flat_closest_careful(const struct accel_flat *f,
                                                             const struct trace_ray *r, double tmin,
                                                             double tmax, struct hit *out)
{
    out->object = SCENE_NONE;
    for (uint64_t left = flat_filter(f, r); left; left &= left - 1) {
        uint32_t row = (uint32_t)__builtin_ctzll(left);
        struct exact_edges e;
        double t;
        if (!flat_woop(f, r, row, &e, &t) || !(t > tmin && t < tmax))
            continue;
        tmax = t;
        out->t = t * r->scale;
        out->b1 = e.v / e.det;
        out->b2 = e.w / e.det;
        memcpy(out->ng, f->ng[row], sizeof out->ng);
        out->object = f->object[row];
        out->primitive = f->primitive[row];
    }
    return tmax;
}

static __attribute__((noinline)) bool
flat_blocks_careful(const struct accel_flat *f, const struct trace_ray *r, double tmin, double tmax)
{
    for (uint64_t left = flat_filter(f, r); left; left &= left - 1) {
        struct exact_edges e;
        double t;
        if (flat_woop(f, r, (uint32_t)__builtin_ctzll(left), &e, &t) && t > tmin && t < tmax)
            return true;
    }
    return false;
}

/* --- One ray ------------------------------------------------------------------ */

/* Writes the hit of a lane, or of none; returns its t, or `end`. */
static inline double flat_hit(const struct accel_flat *f, const struct trace_ray *r,
                              const struct flat_four *h, unsigned lane, double end, struct hit *out)
{
    double t[5], v[5], w[5], det[5];
    _mm256_storeu_pd(t, h->t);
    _mm256_storeu_pd(v, h->v);
    _mm256_storeu_pd(w, h->w);
    _mm256_storeu_pd(det, h->det);
    t[4] = end;
    v[4] = w[4] = det[4] = 1.0;
    uint32_t row = h->row[lane];
    out->t = t[lane] * r->scale;
    out->b1 = v[lane] / det[lane];
    out->b2 = w[lane] / det[lane];
    memcpy(out->ng, f->ng[row], sizeof out->ng);
    out->object = f->object[row];
    out->primitive = f->primitive[row];
    return t[lane];
}

/* Where there are no more than four triangles: no filter, and nothing to gather. */
static inline void flat_decide_all(const struct accel_flat *f, const struct trace_ray *r,
                                   double tmin, double tmax, struct flat_four *h)
{
    for (uint32_t i = 0; i < FLAT_FOUR; i++)
        h->row[i] = i;
    h->row[FLAT_FOUR] = FLAT_MAX;
    flat_decide(f, r, true, (1u << f->count) - 1, tmin, tmax, h);
}

static __attribute__((noinline)) double flat_closest_of_four(const struct accel_flat *f,
                                                             const struct trace_ray *r, double tmin,
                                                             double tmax, struct hit *out)
{
    struct flat_four h;
    flat_decide_all(f, r, tmin, tmax, &h);
    if (__builtin_expect(h.careful, 0))
        return flat_closest_careful(f, r, tmin, tmax, out);
    if (h.hit)
        return flat_hit(f, r, &h, flat_nearest(&h), tmax, out);
    out->object = SCENE_NONE;
    return tmax;
}

static __attribute__((noinline)) bool
flat_blocks_of_four(const struct accel_flat *f, const struct trace_ray *r, double tmin, double tmax)
{
    struct flat_four h;
    flat_decide_all(f, r, tmin, tmax, &h);
    return __builtin_expect(h.careful, 0) ? flat_blocks_careful(f, r, tmin, tmax) : h.hit != 0;
}

/* The nearest of the triangles; t, or tmax if none is hit. */
static inline double flat_closest(const struct accel_flat *f, const struct trace_ray *r,
                                  double tmin, double tmax, struct hit *out)
{
    if (f->count <= FLAT_FOUR)
        return flat_closest_of_four(f, r, tmin, tmax, out);
    uint64_t left = flat_filter(f, r);
    double end = tmax;
    struct flat_four h;
    if (left == 0) {
        out->object = SCENE_NONE;
        return end;
    }
    for (bool found = false;;) {
        unsigned lanes = flat_take(&left, h.row);
        flat_decide(f, r, false, lanes, tmin, end, &h);
        if (__builtin_expect(h.careful, 0)) {
            return flat_closest_careful(f, r, tmin, tmax, out);
        }
        unsigned lane = flat_nearest(&h);
        double t = end;
        if (!found || lane < 4)
            t = flat_hit(f, r, &h, lane, end, out);
        if (__builtin_expect(left == 0, 1)) /* before anything asks what the ray met */
            return t;
        if (lane < 4) {
            found = true;
            end = t;
        }
    }
}

static inline bool flat_blocks(const struct accel_flat *f, const struct trace_ray *r, double tmin,
                               double tmax)
{
    if (f->count <= FLAT_FOUR)
        return flat_blocks_of_four(f, r, tmin, tmax);
    uint64_t left = flat_filter(f, r);
    struct flat_four h;
    if (left == 0)
        return false;
    do {
        unsigned lanes = flat_take(&left, h.row);
        flat_decide(f, r, false, lanes, tmin, tmax, &h);
        if (__builtin_expect(h.careful, 0))
            return flat_blocks_careful(f, r, tmin, tmax);
    } while (__builtin_expect(left != 0, 0) && !h.hit);
    return h.hit != 0;
}

/* --- Spheres -------------------------------------------------------------------- */

/* Those of the table, after its triangles, of which *out has the nearest hit, at `end`. */
static __attribute__((noinline)) void flat_spheres_closest(const struct accel *a,
                                                           const struct trace_ray *r, double tmin,
                                                           double tmax, double end, struct hit *out)
{
    for (uint32_t i = 0; i < a->flat->sphere_count; i++) {
        uint32_t object = a->flat->spheres[i];
        const struct accel_object *o = &a->objects[object];
        double t;
        if (!exact_sphere(r, o->center, o->radius, tmin, tmax, &t) || t > end)
            continue;
        if (t == end && object > out->object)
            continue;
        end = t;
        out->t = t * r->scale;
        out->b1 = out->b2 = 0.0;
        for (int k = 0; k < 3; k++)
            out->ng[k] = (r->org[k] - o->center[k]) + t * r->dir[k];
        out->object = object;
        out->primitive = 0;
    }
}

static __attribute__((noinline)) bool
flat_spheres_block(const struct accel *a, const struct trace_ray *r, double tmin, double tmax)
{
    for (uint32_t i = 0; i < a->flat->sphere_count; i++) {
        const struct accel_object *o = &a->objects[a->flat->spheres[i]];
        double t;
        if (exact_sphere(r, o->center, o->radius, tmin, tmax, &t))
            return true;
    }
    return false;
}

/* --- Calls --------------------------------------------------------------------- */

static inline void flat_kernel_closest(const struct accel *a, const struct ray *ray,
                                       struct hit *out)
{
    struct trace_ray ready;
    double tmin, tmax;
    if (!ready_boxless_ray(a, ray, &ready, &tmin, &tmax)) {
        out->object = SCENE_NONE;
        return;
    }
    double end = flat_closest(a->flat, &ready, tmin, tmax, out);
    if (a->flat->sphere_count)
        flat_spheres_closest(a, &ready, tmin, tmax, end, out);
}

static inline bool flat_kernel_occluded(const struct accel *a, const struct ray *ray)
{
    struct trace_ray ready;
    double tmin, tmax;
    if (!ready_boxless_ray(a, ray, &ready, &tmin, &tmax))
        return false;
    if (__builtin_expect(a->flat->sphere_count != 0, 0) &&
        flat_spheres_block(a, &ready, tmin, tmax))
        return true;
    return flat_blocks(a->flat, &ready, tmin, tmax);
}

static void flat_kernel_closest_batch(const struct accel *a, const struct ray *rays,
                                      const uint8_t *active, size_t count, struct hit *hits)
{
    for (size_t i = 0; i < count; i++)
        if (!active || active[i])
            flat_kernel_closest(a, &rays[i], &hits[i]);
}

static void flat_kernel_occluded_batch(const struct accel *a, const struct ray *rays,
                                       const uint8_t *active, size_t count, uint8_t *occluded)
{
    for (size_t i = 0; i < count; i++)
        if (!active || active[i])
            occluded[i] = flat_kernel_occluded(a, &rays[i]);
}

const struct trace_kernel TRACE_KERNEL = {
    TRACE_NAME,
    flat_kernel_closest,
    flat_kernel_occluded,
    flat_kernel_closest_batch,
    flat_kernel_occluded_batch,
    NULL,
};
