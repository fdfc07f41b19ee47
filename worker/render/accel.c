#include "worker/render/accel.h"

#include <emmintrin.h>
#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "worker/render/accel_parts.h"
#include "worker/render/trace_exact.h"

/* --- Boxes ---------------------------------------------------------------- */

static inline __m128 vertex_load(const struct accel_mesh *m, uint32_t vertex)
{
    const float *p = &m->positions[3 * (size_t)vertex];
    return accel_vertex_load(p);
}

/* The fourth of each is 0. */
static inline void triangle_vertices(const struct accel_mesh *m, uint32_t triangle, float v[3][4])
{
    for (size_t i = 0; i < 3; i++)
        _mm_storeu_ps(v[i], vertex_load(m, m->indices[3 * (size_t)triangle + i]));
}

void accel_triangle_ref(const struct accel_mesh *m, uint32_t triangle, struct bvh_ref *out)
{
    const uint32_t *index = &m->indices[3 * (size_t)triangle];
    __m128 a = vertex_load(m, index[0]), b = vertex_load(m, index[1]);
    __m128 c = vertex_load(m, index[2]);
    _mm_store_ps(out->lo, _mm_min_ps(_mm_min_ps(a, b), c));
    _mm_store_ps(out->hi, _mm_max_ps(_mm_max_ps(a, b), c));
}

/* A sphere's box, widened by what rounding may move a hit near its silhouette. */
static void sphere_ref(const struct accel_object *o, struct bvh_ref *out)
{
    for (int k = 0; k < 3; k++) {
        double reach = o->radius * (1.0 + 0x1p-20);
        out->lo[k] = accel_round_down(o->center[k] - reach);
        out->hi[k] = accel_round_up(o->center[k] + reach);
    }
}

enum { REFS_PER_TASK = 65536, MEASURE_PARTS = 16 };

/* Of a sixteenth of many references, or of all of few. */
struct measuring {
    const struct bvh_ref *refs;
    size_t count;
    struct measured {
        float low[4], high[4], extent[4];
    } parts[MEASURE_PARTS];
};

static void measure_part(void *arg, size_t index)
{
    struct measuring *m = arg;
    size_t parts = m->count < REFS_PER_TASK ? 1 : MEASURE_PARTS;
    size_t begin = m->count * index / parts, end = m->count * (index + 1) / parts;
    __m128 low = _mm_set1_ps(begin < end ? __FLT_MAX__ : 0.0f);
    __m128 high = _mm_sub_ps(_mm_setzero_ps(), low), most = _mm_setzero_ps();
    /* The numbers beside a box are subnormal as floats, which takes some CPUs a hundred cycles. */
    const __m128 keep = _mm_castsi128_ps(_mm_setr_epi32(-1, -1, -1, 0));
    for (size_t i = begin; i < end; i++) {
        __m128 lo = _mm_and_ps(_mm_load_ps(m->refs[i].lo), keep);
        __m128 hi = _mm_and_ps(_mm_load_ps(m->refs[i].hi), keep);
        low = _mm_min_ps(lo, low);
        high = _mm_max_ps(hi, high);
        if (!(m->refs[i].primitive & BVH_REF_OBJECT))
            most = _mm_max_ps(_mm_sub_ps(hi, lo), most);
    }
    _mm_storeu_ps(m->parts[index].low, low);
    _mm_storeu_ps(m->parts[index].high, high);
    _mm_storeu_ps(m->parts[index].extent, most);
}

/* What the answers depend on, the box of all references and its reach: the same with any
 * builder. And the largest extent of a triangle. */
static void tree_measure(const struct bvh_ref *refs, size_t count,
                         const struct accel_runner *runner, struct bvh *out, float *edge)
{
    struct measuring m = {.refs = refs, .count = count};
    bvh_run(runner, count < REFS_PER_TASK ? 1 : MEASURE_PARTS, measure_part, &m);
    struct measured *all = &m.parts[0];
    for (size_t i = 1; i < MEASURE_PARTS && count >= REFS_PER_TASK; i++)
        for (int k = 0; k < 4; k++) {
            all->low[k] = m.parts[i].low[k] < all->low[k] ? m.parts[i].low[k] : all->low[k];
            all->high[k] = m.parts[i].high[k] > all->high[k] ? m.parts[i].high[k] : all->high[k];
            all->extent[k] =
                m.parts[i].extent[k] > all->extent[k] ? m.parts[i].extent[k] : all->extent[k];
        }
    *edge = 0.0f;
    for (int k = 0; k < 3; k++) {
        out->lo[k] = all->low[k];
        out->hi[k] = all->high[k];
        out->reach =
            exact_max(out->reach, exact_max(fabs((double)all->low[k]), fabs((double)all->high[k])));
        *edge = all->extent[k] > *edge ? all->extent[k] : *edge;
    }
}

/* --- Building ------------------------------------------------------------- */

static inline void triangle_ask(const struct accel_mesh *m, uint32_t triangle)
{
    for (size_t i = 0; i < 3; i++)
        __builtin_prefetch(&m->positions[3 * (size_t)m->indices[3 * (size_t)triangle + i]]);
}

static void scene_vertices(void *ctx, const struct bvh_ref *ref, float out[3][4])
{
    const struct accel *a = ctx;
    const struct accel_object *o = &a->objects[ref->owner];
    triangle_vertices(&a->meshes[o->mesh], ref->primitive - a->triangle_first[ref->owner], out);
}

static void scene_indices(void *ctx, const struct bvh_ref *ref, uint32_t out[3])
{
    const struct accel *a = ctx;
    const struct accel_object *o = &a->objects[ref->owner];
    size_t triangle = ref->primitive - a->triangle_first[ref->owner];
    memcpy(out, &a->meshes[o->mesh].indices[3 * triangle], 3 * sizeof *out);
}

static void scene_ask(void *ctx, const struct bvh_ref *ref)
{
    const struct accel *a = ctx;
    const struct accel_object *o = &a->objects[ref->owner];
    triangle_ask(&a->meshes[o->mesh], ref->primitive - a->triangle_first[ref->owner]);
}

struct bvh_source accel_scene_source(const struct accel *a)
{
    return (struct bvh_source){scene_vertices, scene_indices, scene_ask, (void *)a};
}

static void mesh_indices(void *ctx, const struct bvh_ref *ref, uint32_t out[3])
{
    const struct accel *a = ctx;
    const uint32_t *indices = a->meshes[ref->owner].indices;
    memcpy(out, &indices[3 * (size_t)ref->primitive], 3 * sizeof *out);
}

static void mesh_vertices(void *ctx, const struct bvh_ref *ref, float out[3][4])
{
    const struct accel *a = ctx;
    triangle_vertices(&a->meshes[ref->owner], ref->primitive, out);
}

static void mesh_ask(void *ctx, const struct bvh_ref *ref)
{
    const struct accel *a = ctx;
    triangle_ask(&a->meshes[ref->owner], ref->primitive);
}

/* References to the triangles of one mesh, made on all threads. */
struct refs_job {
    const struct accel_mesh *mesh;
    struct bvh_ref *refs;
    uint32_t first, owner;
};

static void refs_some(void *arg, size_t index)
{
    const struct refs_job *job = arg;
    size_t begin = index * REFS_PER_TASK, end = begin + REFS_PER_TASK;
    for (size_t i = begin; i < end && i < job->mesh->triangle_count; i++) {
        accel_triangle_ref(job->mesh, (uint32_t)i, &job->refs[i]);
        job->refs[i].primitive = job->first + (uint32_t)i;
        job->refs[i].owner = job->owner;
    }
}

static size_t mesh_refs(const struct accel_mesh *m, uint32_t first, uint32_t owner,
                        const struct accel_runner *runner, struct bvh_ref *refs)
{
    struct refs_job job = {m, refs, first, owner};
    size_t count = m->triangle_count;
    bvh_run(runner, (count + REFS_PER_TASK - 1) / REFS_PER_TASK, refs_some, &job);
    return count;
}

/* Takes refs. Without a builder a tree is only measured. */
static enum err tree_build(struct accel *a, struct bvh_ref *refs, size_t count,
                           const struct accel_runner *runner, const struct bvh_source *source,
                           struct bvh *out)
{
    struct bvh box = {0}, made = {.root = BVH_EMPTY};
    struct bvh_how how = {.median = a->options.builder == JOB_BUILDER_MEDIAN,
                          .spatial = a->options.builder == JOB_BUILDER_SBVH,
                          .compact = a->options.compact,
                          .isa = a->options.isa,
                          .runner = runner,
                          .place = out == &a->scene_tree && a->lazy ? &a->lazy->place : NULL};
    enum err err = ERR_OK;
    tree_measure(refs, count, runner, &box, &how.edge);
    if (how.place && how.place->edge > how.edge)
        how.edge = how.place->edge;
    accel_instances_fit(a, refs, count, box.reach);
    if (a->options.builder == JOB_BUILDER_NONE)
        mem_free(refs);
    else
        err = bvh_new(refs, count, &how, source, &made);
    if (err)
        return err;
    memcpy(made.lo, box.lo, sizeof box.lo);
    memcpy(made.hi, box.hi, sizeof box.hi);
    made.reach = box.reach;
    made.measured = true;
    *out = made;
    return ERR_OK;
}

static enum err mesh_tree_build(struct accel *a, uint32_t mesh, const struct accel_runner *runner)
{
    const struct accel_mesh *m = &a->meshes[mesh];
    struct bvh_ref *refs = bvh_alloc(m->triangle_count, sizeof *refs);
    if (!refs)
        return ERR_NOMEM;
    size_t count = mesh_refs(m, 0, mesh, runner, refs);
    struct bvh_source source = {mesh_vertices, mesh_indices, mesh_ask, a};
    return tree_build(a, refs, count, runner, &source, &a->mesh_trees[mesh]);
}

static size_t object_refs(const struct accel *a, uint32_t number, const struct accel_runner *runner,
                          const struct accel_lazy_plan *plan, struct bvh_ref *refs)
{
    const struct accel_object *o = &a->objects[number];
    const struct accel_lazy_box *box = a->lazy ? &plan->boxes[number] : NULL;
    if (box && box->lazy) {
        memcpy(refs->lo, box->lo, sizeof refs->lo);
        memcpy(refs->hi, box->hi, sizeof refs->hi);
    } else if (o->type == ACCEL_TRIANGLES) {
        return mesh_refs(&a->meshes[o->mesh], a->triangle_first[number], number, runner, refs);
    } else if (o->type == ACCEL_SPHERE) {
        sphere_ref(o, refs);
    } else if (a->meshes[o->mesh].triangle_count) {
        accel_instance_ref(o, &a->mesh_trees[o->mesh], refs);
    } else {
        return 0;
    }
    refs->primitive = BVH_REF_OBJECT | number;
    refs->owner = number;
    return 1;
}

static enum err scene_tree_build(struct accel *a, const struct accel_runner *runner,
                                 const struct accel_lazy_plan *plan)
{
    size_t limit = a->triangle_first[a->object_count] + a->object_count, count = 0;
    struct bvh_ref *refs = bvh_alloc(limit, sizeof *refs);
    if (!refs)
        return ERR_NOMEM;
    for (uint32_t i = 0; i < a->object_count; i++)
        count += object_refs(a, i, runner, plan, &refs[count]);
    struct bvh_source source = accel_scene_source(a);
    return tree_build(a, refs, count, runner, &source, &a->scene_tree);
}

static enum err trees_build(struct accel *a, const struct accel_runner *runner,
                            const struct accel_lazy_plan *plan)
{
    for (uint32_t i = 0; i < a->object_count; i++) {
        const struct accel_object *o = &a->objects[i];
        struct bvh *tree = o->type == ACCEL_INSTANCE ? &a->mesh_trees[o->mesh] : NULL;
        if (tree && !tree->measured && a->meshes[o->mesh].triangle_count)
            TL_TRY(mesh_tree_build(a, o->mesh, runner));
    }
    return scene_tree_build(a, runner, plan);
}

/* Numbers the triangles of plain objects; ERR_LIMIT when there are too many. */
static enum err number_triangles(struct accel *a)
{
    uint64_t next = 0;
    for (size_t i = 0; i < a->object_count; i++) {
        const struct accel_object *o = &a->objects[i];
        a->triangle_first[i] = (uint32_t)next;
        a->stats.sphere_count += o->type == ACCEL_SPHERE;
        a->stats.instance_count += o->type == ACCEL_INSTANCE;
        if (o->type == ACCEL_TRIANGLES)
            next += a->meshes[o->mesh].triangle_count;
        if (next > BVH_PRIMITIVES_MAX)
            return ERR_LIMIT;
    }
    a->triangle_first[a->object_count] = (uint32_t)next;
    a->stats.triangle_count = next;
    return ERR_OK;
}

static void count_tree(struct accel *a, const struct bvh *b)
{
    a->stats.node_count += b->node_count;
    a->stats.leaf_count += b->leaf_count;
    a->stats.bytes += b->bytes;
    if (b->depth_max > a->stats.depth_max)
        a->stats.depth_max = b->depth_max;
}

static enum err copy_input(struct accel *a, const struct accel_input *input)
{
    a->mesh_count = input->mesh_count;
    a->object_count = input->object_count;
    a->meshes = mem_alloc_array(input->mesh_count, sizeof *a->meshes);
    a->objects = mem_alloc_array(input->object_count, sizeof *a->objects);
    a->triangle_first = mem_calloc(input->object_count + 1, sizeof *a->triangle_first);
    a->mesh_trees = mem_calloc(input->mesh_count, sizeof *a->mesh_trees);
    if (!a->meshes || !a->objects || !a->triangle_first || !a->mesh_trees)
        return ERR_NOMEM;
    if (input->mesh_count)
        memcpy(a->meshes, input->meshes, input->mesh_count * sizeof *a->meshes);
    if (input->object_count)
        memcpy(a->objects, input->objects, input->object_count * sizeof *a->objects);
    for (size_t i = 0; i < input->mesh_count; i++)
        a->mesh_trees[i].root = BVH_EMPTY;
    return ERR_OK;
}

static enum err motions_make(struct accel *a)
{
    if (a->stats.instance_count == 0)
        return ERR_OK;
    a->motions = mem_alloc_aligned(a->object_count * sizeof *a->motions, 64);
    if (!a->motions)
        return ERR_NOMEM;
    memset(a->motions, 0, a->object_count * sizeof *a->motions);
    for (size_t i = 0; i < a->object_count; i++) {
        const struct accel_object *o = &a->objects[i];
        struct accel_motion *m = &a->motions[i];
        if (o->type != ACCEL_INSTANCE)
            continue;
        m->tree = &a->mesh_trees[o->mesh];
        for (size_t k = 0; k < 12; k++) {
            m->from_scene[k % 4][k / 4] = o->from_scene[k];
            if (k % 4 < 3)
                m->to_scene[k % 4][k / 4] = o->to_scene[k];
        }
    }
    return ERR_OK;
}

/* Lets compact trees of one mesh find its vertices at once. */
static void trees_link(struct accel *a)
{
    uint32_t plain = 0, mesh = 0;
    for (size_t i = 0; i < a->object_count; i++)
        if (a->objects[i].type == ACCEL_TRIANGLES) {
            plain++;
            mesh = a->objects[i].mesh;
        }
    if (plain == 1)
        a->scene_tree.positions = a->meshes[mesh].positions;
    for (size_t i = 0; i < a->mesh_count; i++)
        a->mesh_trees[i].positions = a->meshes[i].positions;
}

/* Trees from what was saved, which is taken; without any, and freed, when it does not hold. */
static void trees_restore(struct accel *a, void *saved, size_t saved_bytes,
                          const struct accel_runner *runner)
{
    if (!saved)
        return;
    if (a->options.builder != JOB_BUILDER_NONE &&
        accel_trees_load(a, saved, saved_bytes, runner) == ERR_OK) {
        a->saved = saved;
        return;
    }
    accel_trees_forget(a);
    mem_free(saved);
}

/* Where trees come from: one of both, or neither. */
struct source {
    void *saved; /* taken once the input is copied */
    size_t saved_bytes;
    const struct accel_lazy_plan *plan;
    const struct accel_locks *locks;
};

static enum err build(struct accel *a, const struct accel_input *input,
                      const struct accel_runner *runner, struct source *from)
{
    a->scene_tree.root = BVH_EMPTY;
    TL_TRY(copy_input(a, input));
    TL_TRY(number_triangles(a));
    TL_TRY(motions_make(a));
    if (from->plan)
        TL_TRY(accel_lazy_begin(a, from->plan, from->locks));
    trees_restore(a, from->saved, from->saved_bytes, runner);
    from->saved = NULL;
    if (!a->saved)
        TL_TRY(trees_build(a, runner, from->plan));
    trees_link(a);
    accel_slacks_share(a);
    TL_TRY(accel_flat_make(a));
    count_tree(a, &a->scene_tree);
    a->stats.sah_cost = a->scene_tree.sah_cost;
    a->stats.sah_binary = a->scene_tree.sah_binary;
    for (size_t i = 0; i < a->mesh_count; i++)
        count_tree(a, &a->mesh_trees[i]);
    return ERR_OK;
}

/* The widest kernel that this CPU has and the options allow. */
static const struct trace_kernel *kernel_choose(const struct accel_options *o)
{
    static const struct trace_kernel *const kernels[3][3] = {
        {&trace_sse2, &trace_avx2, &trace_avx512},
        {&trace_sse2_fast, &trace_avx2_fast, &trace_avx512_fast},
        {&trace_sse2_compact, &trace_avx2_compact, &trace_avx512_compact}};
    if (o->builder == JOB_BUILDER_NONE || o->intersector == JOB_INTERSECTOR_MOLLER_TRUMBORE)
        return &trace_plain;
    int form = o->compact ? 2 : o->precision == JOB_PRECISION_FAST;
    enum accel_isa isa = o->isa == ACCEL_ISA_AUTO ? ACCEL_ISA_AVX512 : o->isa;
    bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (isa >= ACCEL_ISA_AVX512 && avx2 && __builtin_cpu_supports("avx512f") &&
        __builtin_cpu_supports("avx512vl"))
        return kernels[form][2];
    if (isa >= ACCEL_ISA_AVX2 && avx2)
        return kernels[form][1];
    return kernels[form][0];
}

/* From how much slack on boxes are better met in double. Float's pad is 9 u R: half a per cent of
 * the scene's half extent there, a fraction of a triangle in scenes of millions. */
static double far_slack_of(const struct accel *a)
{
    bool triangles = a->options.precision != JOB_PRECISION_FAST;
    for (size_t i = 0; i < a->object_count; i++)
        triangles = triangles && a->objects[i].type == ACCEL_TRIANGLES;
    double extent = 0.0;
    for (int k = 0; k < 3; k++) {
        double size = (double)a->scene_tree.hi[k] - (double)a->scene_tree.lo[k];
        extent = size > extent ? size : extent;
    }
    return triangles ? 0x1p-30 * TRACE_FAR * 0.5 * extent : (double)INFINITY;
}

static enum err accel_make(const struct accel_input *input, const struct accel_options *options,
                           const struct accel_runner *runner, struct source from,
                           struct accel **out)
{
    struct accel *a = mem_calloc(1, sizeof *a);
    if (!a) {
        mem_free(from.saved);
        return ERR_NOMEM;
    }
    a->options = *options;
    if (options->precision == JOB_PRECISION_FAST || options->builder == JOB_BUILDER_NONE)
        a->options.compact = false;
    a->kernel = kernel_choose(&a->options);
    a->pad = options->precision == JOB_PRECISION_FAST ? TRACE_PAD_FAST : TRACE_PAD;
    enum err err = build(a, input, runner, &from);
    mem_free(from.saved);
    if (err) {
        accel_free(a);
        return err;
    }
    a->far_slack = far_slack_of(a);
    *out = a;
    return ERR_OK;
}

enum err accel_new(const struct accel_input *input, const struct accel_options *options,
                   const struct accel_runner *runner, struct accel **out)
{
    return accel_make(input, options, runner, (struct source){.saved = NULL}, out);
}

enum err accel_new_saved(const struct accel_input *input, const struct accel_options *options,
                         const struct accel_runner *runner, void *saved, size_t saved_bytes,
                         struct accel **out)
{
    struct source from = {.saved = saved, .saved_bytes = saved_bytes};
    return accel_make(input, options, runner, from, out);
}

enum err accel_new_lazy(const struct accel_input *input, const struct accel_options *options,
                        const struct accel_runner *runner, const struct accel_lazy_plan *plan,
                        const struct accel_locks *locks, struct accel **out)
{
    struct source from = {.plan = plan, .locks = locks};
    TL_ASSERT(plan->lazy_count > 0 && plan->object_count == input->object_count);
    return accel_make(input, options, runner, from, out);
}

void accel_free(struct accel *a)
{
    if (!a)
        return;
    accel_lazy_end(a);
    if (a->saved)
        accel_trees_forget(a);
    mem_free(a->saved);
    bvh_release(&a->scene_tree);
    for (size_t i = 0; a->mesh_trees && i < a->mesh_count; i++)
        bvh_release(&a->mesh_trees[i]);
    mem_free(a->mesh_trees);
    mem_free(a->flat);
    mem_free(a->motions);
    mem_free(a->triangle_first);
    mem_free(a->objects);
    mem_free(a->meshes);
    mem_free(a);
}

void accel_stats_get(const struct accel *a, struct accel_stats *out)
{
    *out = a->stats;
    accel_lazy_count(a, out);
}

/* --- Rays and hits -------------------------------------------------------- */

bool accel_ray(const struct accel *a, const struct ray *ray, struct trace_ray *out, double *tmin,
               double *tmax)
{
    if (!isfinite(ray->org[0]) || !isfinite(ray->org[1]) || !isfinite(ray->org[2]) ||
        !(ray->tmin < ray->tmax) ||
        !trace_ray_init(ray->org, ray->dir, 1.0, a->scene_tree.reach, a->pad, out))
        return false;
    *tmin = ray->tmin * out->unscale;
    *tmax = ray->tmax * out->unscale;
    return true;
}

static void transform_point(const double m[12], const double p[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = ((m[4 * k] * p[0] + m[4 * k + 1] * p[1]) + m[4 * k + 2] * p[2]) + m[4 * k + 3];
}

static void transform_vector(const double m[12], const double v[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (m[4 * k] * v[0] + m[4 * k + 1] * v[1]) + m[4 * k + 2] * v[2];
}

bool accel_instance_ray(const struct accel *a, uint32_t object, const struct trace_ray *ray,
                        struct trace_ray *out, double *rescale)
{
    const struct accel_object *o = &a->objects[object];
    double org[3], dir[3];
    transform_point(o->from_scene, ray->org, org);
    transform_vector(o->from_scene, ray->dir, dir);
    if (!isfinite(org[0]) || !isfinite(org[1]) || !isfinite(org[2]) ||
        !trace_ray_init(org, dir, ray->scale, a->mesh_trees[o->mesh].reach, a->pad, out))
        return false;
    out->slack *= a->motions[object].slack_share;
    out->filter_slack *= a->motions[object].filter_share;
    *rescale = out->rescale;
    return true;
}

static void cross(const double a[3], const double b[3], double out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

static void leaf_vertices(const struct bvh_leaf *leaf, uint32_t lane, float v[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            v[i][k] = leaf->v[i][k][lane];
}

static void mesh_triangle(const struct accel_mesh *m, uint32_t triangle, float v[3][3])
{
    float wide[3][4];
    triangle_vertices(m, triangle, wide);
    for (int i = 0; i < 3; i++)
        memcpy(v[i], wide[i], sizeof v[i]);
}

/* `ray` is in the space of the vertices, and read only when the best hit has no leaf. */
static void triangle_hit(const struct accel *a, const struct trace_ray *ray, const float v[3][3],
                         const struct trace_best *best, struct hit *out)
{
    double e1[3], e2[3], t;
    for (int k = 0; k < 3; k++) {
        e1[k] = (double)v[1][k] - (double)v[0][k];
        e2[k] = (double)v[2][k] - (double)v[0][k];
    }
    const struct accel_object *o = &a->objects[out->object];
    if (o->type == ACCEL_INSTANCE) {
        double local1[3], local2[3];
        memcpy(local1, e1, sizeof e1);
        memcpy(local2, e2, sizeof e2);
        transform_vector(o->to_scene, local1, e1);
        transform_vector(o->to_scene, local2, e2);
    }
    cross(e1, e2, out->ng);
    if (best->leaf) {
        out->b1 = best->v / best->det;
        out->b2 = best->w / best->det;
        return;
    }
    if (a->options.intersector == JOB_INTERSECTOR_MOLLER_TRUMBORE) {
        bool hit = exact_moller_trumbore(ray, v, &t, &out->b1, &out->b2);
        TL_DASSERT(hit);
        (void)hit;
        return;
    }
    struct exact_edges e;
    bool hit = exact_woop(ray, v, &e, &t);
    TL_DASSERT(hit);
    (void)hit;
    out->b1 = e.v / e.det;
    out->b2 = e.w / e.det;
}

void accel_hit(const struct accel *a, const struct trace_ray *ray, const struct trace_best *best,
               struct hit *out)
{
    out->t = best->t * ray->scale;
    out->object = best->object;
    out->primitive = best->primitive;
    if (best->object == SCENE_NONE) {
        out->object = accel_triangle_object(a, best->primitive);
        out->primitive = best->primitive - a->triangle_first[out->object];
    }
    const struct accel_object *o = &a->objects[out->object];
    if (o->type == ACCEL_SPHERE) {
        out->b1 = out->b2 = 0.0;
        for (int k = 0; k < 3; k++)
            out->ng[k] = (ray->org[k] - o->center[k]) + best->t * ray->dir[k];
        return;
    }
    float v[3][3];
    if (best->leaf) /* still in cache, which the mesh may not be */
        leaf_vertices(best->leaf, best->lane, v);
    else
        mesh_triangle(&a->meshes[o->mesh], out->primitive, v);
    struct trace_ray inner;
    double rescale;
    if (!best->leaf && o->type == ACCEL_INSTANCE &&
        accel_instance_ray(a, out->object, ray, &inner, &rescale))
        ray = &inner;
    triangle_hit(a, ray, v, best, out);
}

/* --- Queries -------------------------------------------------------------- */

void accel_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    a->kernel->closest(a, ray, out);
}

bool accel_occluded(const struct accel *a, const struct ray *ray)
{
    return a->kernel->occluded(a, ray);
}

void accel_closest_batch(const struct accel *a, const struct ray *rays, size_t count,
                         struct hit *hits)
{
    a->kernel->closest_batch(a, rays, NULL, count, hits);
}

void accel_occluded_batch(const struct accel *a, const struct ray *rays, size_t count,
                          uint8_t *occluded)
{
    a->kernel->occluded_batch(a, rays, NULL, count, occluded);
}

void accel_closest_masked(const struct accel *a, const struct ray *rays, const uint8_t *active,
                          size_t count, struct hit *hits)
{
    a->kernel->closest_batch(a, rays, active, count, hits);
}

void accel_occluded_masked(const struct accel *a, const struct ray *rays, const uint8_t *active,
                           size_t count, uint8_t *occluded)
{
    a->kernel->occluded_batch(a, rays, active, count, occluded);
}

const char *accel_isa_name(const struct accel *a)
{
    return a->kernel->name;
}
