/* worker/render/trace_wait.h: objects whose trees may wait for their first ray (accel_lazy.h).
 *
 * Such an object goes to the bottom of a ray's stack until nothing else is left, so that
 * what is built already may stop the ray before. Included by trace_kernel.h alone. Any thread.
 */
#ifndef WORKER_RENDER_TRACE_WAIT_H
#define WORKER_RENDER_TRACE_WAIT_H

#include <string.h>

#include "worker/render/trace_leaf.h"

enum { PUT_OFF_MAX = 32 }; /* objects of a ray that wait at once */

/* Where the ray enters the object's box, as a key of the stack. */
static inline uint32_t waiting_key(const struct accel *a, uint32_t number,
                                   const struct trace_ray *r, float from)
{
    const float *box = a->lazy->boxes[number];
    for (int k = 0; k < 3; k++) {
        float near = box[r->row[k] / TRACE_ROW] * r->inverse[k] - r->near_offset[k];
        from = near > from ? near : from;
    }
    return float_bits(from) & ~(uint32_t)KEY_SLOT_MASK;
}

/* Puts an object that has no tree yet at the bottom of the stack, whose first *put_off entries are
 * such, the farthest lowest: what is built may stop the ray before. False: nothing but farther ones
 * is left, or too many are put off. */
static __attribute__((noinline)) bool put_off_object(const struct accel *a,
                                                     const struct trace_ray *r, float from,
                                                     uint32_t ref, uint32_t *keys, uint32_t *refs,
                                                     uint32_t *top, uint32_t *put_off)
{
    *put_off = *put_off < *top ? *put_off : *top;
    uint32_t key = waiting_key(a, ref >> BVH_KIND_BITS, r, from), at = *put_off;
    bool nearest = at == 0 || keys[at - 1] >= key;
    if ((*top == at && nearest) || at == PUT_OFF_MAX)
        return false;
    while (at > 0 && keys[at - 1] < key)
        at--;
    memmove(refs + at + 1, refs + at, (*top - at) * sizeof *refs);
    memmove(keys + at + 1, keys + at, (*top - at) * sizeof *keys);
    refs[at] = ref;
    keys[at] = key;
    ++*put_off;
    ++*top;
    return true;
}

enum waiting { WAITING_NOT, WAITING_READY, WAITING_PUT_OFF };

/* An object that may have a tree of its own in the scene's arena. READY: go on with *ref, its root;
 * PUT_OFF: go on with the stack; NOT: it is of another kind. */
static inline enum waiting object_waits(const struct accel *a, const struct trace_ray *r,
                                        float from, uint32_t *ref, uint32_t *keys, uint32_t *refs,
                                        uint32_t *top, uint32_t *put_off)
{
    uint32_t root = accel_lazy_root(a, *ref >> BVH_KIND_BITS);
    if (root == ACCEL_NOT_LAZY)
        return WAITING_NOT;
    if (root == ACCEL_UNBUILT) {
        if (put_off_object(a, r, from, *ref, keys, refs, top, put_off))
            return WAITING_PUT_OFF;
        root = accel_lazy_build(a, *ref >> BVH_KIND_BITS);
    }
    *ref = root;
    return WAITING_READY;
}

#endif
