#include "worker/render/accel_lazy.h"

#include <string.h>

#include "common/scene_lazy.h"
#include "worker/render/accel_parts.h"

/* --- Choosing -------------------------------------------------------------- */

struct measuring {
    const struct accel_input *input;
    struct accel_lazy_box *boxes;
};

static void measure(void *arg, size_t number)
{
    const struct measuring *m = arg;
    const struct accel_object *o = &m->input->objects[number];
    struct accel_lazy_box *box = &m->boxes[number];
    const struct accel_mesh *mesh = &m->input->meshes[o->mesh];
    if (o->type != ACCEL_TRIANGLES || mesh->triangle_count == 0)
        return;
    for (int k = 0; k < 3; k++) {
        box->lo[k] = __FLT_MAX__;
        box->hi[k] = -__FLT_MAX__;
    }
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        _Alignas(16) struct bvh_ref ref;
        accel_triangle_ref(mesh, i, &ref);
        for (int k = 0; k < 3; k++) {
            float extent = ref.hi[k] - ref.lo[k];
            box->edge = extent > box->edge ? extent : box->edge;
            box->lo[k] = ref.lo[k] < box->lo[k] ? ref.lo[k] : box->lo[k];
            box->hi[k] = ref.hi[k] > box->hi[k] ? ref.hi[k] : box->hi[k];
        }
    }
}

static double box_area(const float lo[3], const float hi[3])
{
    double x = (double)hi[0] - (double)lo[0], y = (double)hi[1] - (double)lo[1];
    double z = (double)hi[2] - (double)lo[2];
    return x * y + y * z + z * x;
}

/* A mesh that two objects have needs the numbers of both in its tree. */
static enum err find_shared(const struct accel_input *input, bool **out)
{
    bool *seen = mem_calloc(input->mesh_count, sizeof *seen);
    bool *shared = mem_calloc(input->mesh_count, sizeof *shared);
    if (!seen || !shared) {
        mem_free(seen);
        mem_free(shared);
        return ERR_NOMEM;
    }
    for (size_t i = 0; i < input->object_count; i++) {
        if (input->objects[i].type == ACCEL_SPHERE)
            continue;
        uint32_t mesh = input->objects[i].mesh;
        shared[mesh] |= seen[mesh];
        seen[mesh] = true;
    }
    mem_free(seen);
    *out = shared;
    return ERR_OK;
}

/* Marks those that are large enough; their boxes' areas and the box of them all. */
static void mark(const struct accel_input *input, const bool *shared, uint32_t triangles_min,
                 uint64_t total, struct accel_lazy_plan *plan, double *areas, double *all)
{
    float lo[3] = {__FLT_MAX__, __FLT_MAX__, __FLT_MAX__};
    float hi[3] = {-__FLT_MAX__, -__FLT_MAX__, -__FLT_MAX__};
    *areas = 0;
    for (size_t i = 0; i < input->object_count; i++) {
        const struct accel_object *o = &input->objects[i];
        struct accel_lazy_box *box = &plan->boxes[i];
        if (o->type != ACCEL_TRIANGLES || shared[o->mesh])
            continue;
        uint64_t count = input->meshes[o->mesh].triangle_count;
        if (count < triangles_min || count > total / SCENE_LAZY_SHARE_MAX_INVERSE)
            continue;
        box->lazy = true;
        plan->lazy_count++;
        plan->lazy_triangles += count;
        *areas += box_area(box->lo, box->hi);
        for (int k = 0; k < 3; k++) {
            lo[k] = box->lo[k] < lo[k] ? box->lo[k] : lo[k];
            hi[k] = box->hi[k] > hi[k] ? box->hi[k] : hi[k];
        }
    }
    *all = box_area(lo, hi);
}

enum err accel_lazy_choose(const struct accel_input *input, const struct accel_options *options,
                           const struct accel_runner *runner, uint32_t triangles_min,
                           struct accel_lazy_plan *out)
{
    uint64_t total = 0, large = 0;
    *out = (struct accel_lazy_plan){.object_count = input->object_count};
    for (size_t i = 0; i < input->object_count; i++) {
        if (input->objects[i].type != ACCEL_TRIANGLES)
            continue;
        uint32_t count = input->meshes[input->objects[i].mesh].triangle_count;
        total += count;
        large += count >= triangles_min;
    }
    if (large < SCENE_LAZY_OBJECTS_MIN || options->builder != JOB_BUILDER_SAH ||
        options->intersector != JOB_INTERSECTOR_WOOP || options->precision != JOB_PRECISION_EXACT)
        return ERR_OK;
    struct accel_lazy_plan plan = {.object_count = input->object_count};
    bool *shared = NULL;
    plan.boxes = mem_calloc(input->object_count, sizeof *plan.boxes);
    if (!plan.boxes)
        return ERR_NOMEM;
    enum err e = find_shared(input, &shared);
    if (e == ERR_OK) {
        struct measuring m = {input, plan.boxes};
        double areas, all;
        bvh_run(runner, input->object_count, measure, &m);
        mark(input, shared, triangles_min, total, &plan, &areas, &all);
        mem_free(shared);
        if (scene_lazy_pays(plan.lazy_count, plan.lazy_triangles, total, areas, all)) {
            *out = plan;
            return ERR_OK;
        }
    }
    mem_free(plan.boxes);
    return e;
}

void accel_lazy_plan_release(struct accel_lazy_plan *plan)
{
    mem_free(plan->boxes);
    *plan = (struct accel_lazy_plan){0};
}

/* --- Building -------------------------------------------------------------- */

enum err accel_lazy_begin(struct accel *a, const struct accel_lazy_plan *plan,
                          const struct accel_locks *locks)
{
    struct accel_lazy *lazy = mem_calloc(1, sizeof *lazy);
    if (!lazy)
        return ERR_NOMEM;
    a->lazy = lazy;
    lazy->locks = *locks;
    lazy->object_count = plan->lazy_count;
    lazy->roots = mem_alloc_array(a->object_count, sizeof *lazy->roots);
    lazy->boxes = mem_alloc_array(a->object_count, sizeof *lazy->boxes);
    if (!lazy->roots || !lazy->boxes)
        return ERR_NOMEM;
    float edge = 0;
    for (size_t i = 0; i < a->object_count; i++) {
        atomic_init(&lazy->roots[i], plan->boxes[i].lazy ? ACCEL_UNBUILT : ACCEL_NOT_LAZY);
        edge = plan->boxes[i].edge > edge ? plan->boxes[i].edge : edge;
        for (int k = 0; k < 3; k++) {
            lazy->boxes[i][2 * k] = plan->boxes[i].lo[k];
            lazy->boxes[i][2 * k + 1] = plan->boxes[i].hi[k];
        }
    }
    /* The most that trees over all references can take; what is not used costs no page. */
    size_t refs = (size_t)a->triangle_first[a->object_count] + a->object_count;
    return bvh_place_new(refs, edge, &lazy->place);
}

void accel_lazy_count(const struct accel *a, struct accel_stats *stats)
{
    if (!a->lazy)
        return;
    stats->lazy_count = a->lazy->object_count;
    stats->lazy_built = atomic_load(&a->lazy->built_count);
    stats->bytes += atomic_load(&a->lazy->place.units_used) * BVH_UNIT_BYTES - a->scene_tree.bytes;
}

void accel_lazy_end(struct accel *a)
{
    if (!a->lazy)
        return;
    a->scene_tree.arena = NULL; /* the place's */
    bvh_place_release(&a->lazy->place);
    mem_free(a->lazy->boxes);
    mem_free(a->lazy->roots);
    mem_free(a->lazy);
}

static enum err build_object(const struct accel *a, uint32_t number, bool median, uint32_t *root)
{
    const struct accel_mesh *m = &a->meshes[a->objects[number].mesh];
    struct bvh_ref *refs = bvh_alloc(m->triangle_count, sizeof *refs);
    struct bvh_place *place = &a->lazy->place;
    struct bvh_how how = {.median = median,
                          .compact = a->options.compact,
                          .isa = a->options.isa,
                          .edge = place->edge,
                          .place = place};
    struct bvh_source source = accel_scene_source(a);
    struct bvh tree;
    if (!refs)
        return ERR_NOMEM;
    for (uint32_t i = 0; i < m->triangle_count; i++) {
        accel_triangle_ref(m, i, &refs[i]);
        refs[i].primitive = a->triangle_first[number] + i;
        refs[i].owner = number;
    }
    TL_TRY(bvh_new(refs, m->triangle_count, &how, &source, &tree));
    *root = tree.root;
    return ERR_OK;
}

uint32_t accel_lazy_build(const struct accel *a, uint32_t number)
{
    struct accel_lazy *lazy = a->lazy;
    lazy->locks.lock(lazy->locks.ctx, number);
    uint32_t root = atomic_load_explicit(&lazy->roots[number], memory_order_acquire);
    if (root == ACCEL_UNBUILT) {
        enum err e = build_object(a, number, false, &root);
        if (e == ERR_LIMIT) /* too deep by area */
            e = build_object(a, number, true, &root);
        if (e == ERR_OK) {
            atomic_fetch_add(&lazy->built_count, 1);
            atomic_store_explicit(&lazy->roots[number], root, memory_order_release);
        } else {
            atomic_fetch_add(&lazy->failures, 1);
            root = BVH_EMPTY;
        }
    }
    lazy->locks.unlock(lazy->locks.ctx, number);
    return root;
}

uint64_t accel_failures(const struct accel *a)
{
    return a->lazy ? atomic_load(&a->lazy->failures) : 0;
}
