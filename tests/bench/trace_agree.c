#include "tests/bench/trace_agree.h"

#include <math.h>
#include <string.h>

#include "common/scene.h"
#include "tests/bench/trace_judge.h"

enum { CHUNK = 1024 };

size_t trace_agree_batch(const struct accel *a, const struct trace_rays *rays, bool shadow)
{
    struct ray ray[CHUNK];
    struct hit hits[CHUNK], hit;
    uint8_t occluded[CHUNK];
    size_t differ = 0;
    for (size_t i = 0; i < rays->count; i += CHUNK) {
        size_t n = rays->count - i < CHUNK ? rays->count - i : CHUNK;
        for (size_t j = 0; j < n; j++)
            ray[j] = trace_rays_get(rays, i + j);
        if (shadow)
            accel_occluded_batch(a, ray, n, occluded);
        else
            accel_closest_batch(a, ray, n, hits);
        for (size_t j = 0; j < n; j++) {
            if (shadow) {
                differ += accel_occluded(a, &ray[j]) != (occluded[j] != 0);
                continue;
            }
            accel_closest(a, &ray[j], &hit);
            differ += hit.object != hits[j].object ||
                      (hit.object != SCENE_NONE && memcmp(&hit, &hits[j], sizeof hit) != 0);
        }
    }
    return differ;
}

/* By how much t may differ and be called the same: vertices' floats and Embree's are coarse. */
static double t_tolerance(const struct trace_scene *s, const struct ray *ray)
{
    const struct accel_mesh *m = &s->views[0];
    double far = 0.0, length = 0.0;
    for (int k = 0; k < 3; k++) {
        far = fmax(far, fabs(ray->org[k]) + fabs((double)m->positions[k]));
        length = fmax(length, fabs(ray->dir[k]));
    }
    return 1e-4 * far / length;
}

static bool closest_apart(const struct trace_scene *s, const struct ray *ray,
                          const struct hit *ours, const struct trace_peer_hit *theirs)
{
    bool hit = ours->object != SCENE_NONE;
    if (hit != (theirs->object != SCENE_NONE))
        return true;
    return hit && fabs(ours->t - (double)theirs->t) > t_tolerance(s, ray);
}

struct trace_agreement trace_agree_peer(const struct accel *a, struct trace_peer *p,
                                        const struct trace_scene *s, const struct trace_rays *rays,
                                        bool shadow, size_t judged_max)
{
    struct trace_agreement out = {0};
    judged_max = s->input.object_count == 1 ? judged_max : 0;
    for (size_t i = 0; i < rays->count; i++) {
        struct ray ray = trace_rays_get(rays, i);
        struct hit ours;
        struct trace_peer_hit theirs;
        bool blocked[2] = {false, false};
        if (shadow) {
            blocked[0] = accel_occluded(a, &ray);
            blocked[1] = trace_peer_occluded(p, rays->ray[i]);
            if (blocked[0] == blocked[1])
                continue;
        } else {
            accel_closest(a, &ray, &ours);
            trace_peer_closest(p, rays->ray[i], &theirs);
            if (!closest_apart(s, &ray, &ours, &theirs))
                continue;
        }
        if (out.apart++ >= judged_max)
            continue;
        out.judged++;
        if (shadow) {
            out.wrong += !trace_judge_occluded(s, &ray, blocked[0]);
            out.theirs += !trace_judge_occluded(s, &ray, blocked[1]);
        } else {
            uint32_t mine = ours.object != SCENE_NONE ? ours.primitive : SCENE_NONE;
            uint32_t other = theirs.object != SCENE_NONE ? theirs.primitive : SCENE_NONE;
            out.wrong += !trace_judge_closest(s, &ray, mine);
            out.theirs += !trace_judge_closest(s, &ray, other);
        }
    }
    return out;
}
