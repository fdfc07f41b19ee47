/* Where instances lie, and by how much rounding may move what is met in them: the bounds are those
 * of docs/TRACING.md, 1. Pure. Tests: test_accel_stretched.
 */
#include <math.h>

#include "worker/render/accel_parts.h"
#include "worker/render/trace_exact.h"

/* An instance's box: the corners of its mesh's box, moved. */
void accel_instance_ref(const struct accel_object *o, const struct bvh *mesh, struct bvh_ref *out)
{
    for (int k = 0; k < 3; k++) {
        const double *row = &o->to_scene[4 * k];
        double low = row[3], high = row[3], size = fabs(row[3]);
        for (int j = 0; j < 3; j++) {
            double a = row[j] * (double)mesh->lo[j], b = row[j] * (double)mesh->hi[j];
            low += exact_min(a, b);
            high += exact_max(a, b);
            size += exact_max(fabs(a), fabs(b));
        }
        out->lo[k] = accel_round_down(low - 0x1p-40 * size);
        out->hi[k] = accel_round_up(high + 0x1p-40 * size);
    }
}

/* A point that is off by s in mesh space is off by s |T| in the scene's; this is how much of
 * R = |o|max + reach that is at most, for s = R of the moved ray (docs/TRACING.md, 1). */
static double instance_stretch(const struct accel_object *o, double mesh_reach, double scene_reach)
{
    double out = 0.0, in = 0.0, offset = 0.0;
    for (int k = 0; k < 3; k++) {
        const double *to = &o->to_scene[4 * k], *from = &o->from_scene[4 * k];
        out = exact_max(fabs(to[0]) + fabs(to[1]) + fabs(to[2]), out);
        in = exact_max(fabs(from[0]) + fabs(from[1]) + fabs(from[2]), in);
        offset = exact_max(fabs(from[3]), offset);
    }
    return out * exact_max(in, (offset + mesh_reach) / scene_reach);
}

/* By how much of R a point is off that goes to mesh space and back, since one matrix is the other's
 * inverse but for rounding. */
static double instance_drift(const struct accel_object *o, double scene_reach)
{
    double most = 0.0;
    for (int k = 0; k < 3; k++) {
        const double *to = &o->to_scene[4 * k], *from = o->from_scene;
        double turn = 0.0, shift = to[3];
        for (int i = 0; i < 3; i++) {
            turn += fabs((to[0] * from[i] + to[1] * from[4 + i]) + to[2] * from[8 + i] - (k == i));
            shift += to[i] * from[4 * i + 3];
        }
        most = exact_max(most, exact_max(turn, fabs(shift) / scene_reach));
    }
    return most;
}

/* Up to STRETCH_PLAIN the slack of a moved ray stays within the padding of the scene's boxes; from
 * there on it is made smaller, as long as it stays well above the rounding of doubles. */
static const double STRETCH_PLAIN = 0x1p4, STRETCH_MAX = 0x1p21, DRIFT_MAX = 0x1p-27;

/* A transform so lopsided that even so a hit could leave the padded box. */
static bool is_lopsided(const struct accel *a, const struct accel_object *o, double reach)
{
    return !(instance_stretch(o, a->mesh_trees[o->mesh].reach, reach) <= STRETCH_MAX &&
             instance_drift(o, reach) <= DRIFT_MAX);
}

/* --- Boxes that fit -------------------------------------------------------- */

/* The corners of a turned box reach farther than what is in it. So the boxes two levels down the
 * mesh's tree are moved, in float, and what they take up together is the instance's box. */
struct moved {
    float matrix[12];    /* to the scene, rounded */
    __m128 lo[3], hi[3]; /* of a fourth of the boxes each lane */
};

/* Adds those children of a node that `which` has a bit for. */
static void moved_add(struct moved *m, const struct bvh_node *node, unsigned which)
{
    const __m128 most = _mm_set1_ps(__FLT_MAX__), least = _mm_set1_ps(-__FLT_MAX__);
    for (unsigned half = 0; half < BVH_WIDTH; half += 4) {
        __m128i bit = _mm_slli_epi32(_mm_setr_epi32(1, 2, 4, 8), (int)half);
        __m128i on = _mm_cmpeq_epi32(_mm_and_si128(_mm_set1_epi32((int)which), bit), bit);
        __m128 in = _mm_castsi128_ps(on);
        for (int k = 0; k < 3; k++) {
            const float *row = &m->matrix[4 * k];
            __m128 lo = _mm_set1_ps(row[3]), hi = lo;
            for (int j = 0; j < 3; j++) {
                int back = row[j] < 0.0f;
                __m128 by = _mm_set1_ps(row[j]);
                __m128 low = _mm_loadu_ps(&node->bounds[2 * j + back][half]);
                __m128 high = _mm_loadu_ps(&node->bounds[2 * j + 1 - back][half]);
                lo = _mm_add_ps(lo, _mm_mul_ps(by, low));
                hi = _mm_add_ps(hi, _mm_mul_ps(by, high));
            }
            lo = _mm_or_ps(_mm_and_ps(in, lo), _mm_andnot_ps(in, most));
            hi = _mm_or_ps(_mm_and_ps(in, hi), _mm_andnot_ps(in, least));
            m->lo[k] = _mm_min_ps(lo, m->lo[k]);
            m->hi[k] = _mm_max_ps(hi, m->hi[k]);
        }
    }
}

/* Which children are of that kind. */
static unsigned children_of(const struct bvh_node *node, enum bvh_kind kind)
{
    unsigned which = 0;
    for (unsigned i = 0; i < BVH_WIDTH; i++)
        which |= (unsigned)((node->child[i] & 3) == (uint32_t)kind) << i;
    return which;
}

static void moved_add_tree(struct moved *m, const struct bvh *tree)
{
    const struct bvh_node *root = bvh_node_at(tree->arena, tree->root);
    for (int k = 0; k < 3; k++) {
        m->lo[k] = _mm_set1_ps(__FLT_MAX__);
        m->hi[k] = _mm_set1_ps(-__FLT_MAX__);
    }
    moved_add(m, root, children_of(root, BVH_LEAF));
    for (unsigned nodes = children_of(root, BVH_NODE); nodes; nodes &= nodes - 1) {
        uint32_t child = root->child[__builtin_ctz(nodes)];
        const struct bvh_node *node = bvh_node_at(tree->arena, child);
        moved_add(m, node, children_of(node, BVH_LEAF) | children_of(node, BVH_NODE));
    }
}

static float least_of(__m128 a)
{
    a = _mm_min_ps(a, _mm_movehl_ps(a, a));
    return _mm_cvtss_f32(_mm_min_ss(a, _mm_shuffle_ps(a, a, 1)));
}

/* Cuts the box of accel_instance_ref to what the mesh's tree takes up. Float is off by 5 u of the
 * largest terms' sum, of which 16 u are added; where that could leave float's range, the box stays.
 */
static void ref_cut(const struct accel_object *o, const struct bvh *tree, struct bvh_ref *ref)
{
    struct moved m;
    for (int k = 0; k < 12; k++)
        m.matrix[k] = (float)o->to_scene[k];
    moved_add_tree(&m, tree);
    for (int k = 0; k < 3; k++) {
        const double *row = &o->to_scene[4 * k];
        double size = fabs(row[3]) + (fabs(row[0]) + fabs(row[1]) + fabs(row[2])) * tree->reach;
        if (!(size > 0x1p-100 && size < 0x1p100))
            continue;
        float pad = (float)(0x1p-20 * size);
        float lo = least_of(m.lo[k]) - pad;
        float hi = -least_of(_mm_xor_ps(m.hi[k], _mm_set1_ps(-0.0f))) + pad;
        ref->lo[k] = lo > ref->lo[k] ? lo : ref->lo[k];
        ref->hi[k] = hi < ref->hi[k] ? hi : ref->hi[k];
    }
}

void accel_instances_fit(const struct accel *a, struct bvh_ref *refs, size_t count, double reach)
{
    if (a->stats.instance_count == 0)
        return;
    for (size_t i = 0; i < count; i++) {
        if (!(refs[i].primitive & BVH_REF_OBJECT)) /* then its owner may be a mesh */
            continue;
        const struct accel_object *o = &a->objects[refs[i].owner];
        if (o->type != ACCEL_INSTANCE)
            continue;
        const struct bvh *tree = &a->mesh_trees[o->mesh];
        if (is_lopsided(a, o, reach)) {
            for (int k = 0; k < 3; k++) {
                refs[i].lo[k] = -0x1p60f;
                refs[i].hi[k] = 0x1p60f;
            }
        } else if ((tree->root & 3) == BVH_NODE) {
            ref_cut(o, tree, &refs[i]);
        }
    }
}

/* --- Slack ------------------------------------------------------------------ */

void accel_slacks_share(struct accel *a)
{
    for (size_t i = 0; i < a->object_count; i++) {
        const struct accel_object *o = &a->objects[i];
        if (o->type != ACCEL_INSTANCE)
            continue;
        double stretch = instance_stretch(o, a->mesh_trees[o->mesh].reach, a->scene_tree.reach);
        double share = 1.0;
        while (!(share * stretch <= STRETCH_PLAIN) && share * STRETCH_MAX > STRETCH_PLAIN)
            share *= 0.5;
        a->motions[i].slack_share = share;
        a->motions[i].filter_share = stretch <= TRACE_STRETCH_FAST ? 1.0f : NAN;
    }
}
