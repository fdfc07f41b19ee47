#include "worker/scene/scene_build.h"

#include "common/scene_plan.h"
#include "worker/scene/scene_locks.h"
#include "worker/scene/scene_parts.h"

/* Below, building takes less time than finding. */
enum { KEPT_TRIANGLES_MIN = 20000 };

static uint64_t triangles_of(const struct accel_input *input)
{
    uint64_t triangles = 0;
    for (size_t i = 0; i < input->mesh_count; i++)
        triangles += input->meshes[i].triangle_count;
    return triangles;
}

/* Saved trees or, where there are none that hold, built ones, which are offered. */
static enum err find_or_build(struct render_scene *rs, const struct accel_input *input,
                              const struct accel_options *options,
                              const struct accel_runner *runner, const struct scene_trees *trees)
{
    uint64_t triangles = triangles_of(input);
    digest key;
    void *saved = NULL;
    size_t bytes = 0;
    bool kept = trees && triangles >= KEPT_TRIANGLES_MIN && options->builder != JOB_BUILDER_NONE;
    if (kept) {
        TL_TRY(accel_trees_key(input, options, runner, &key));
        (void)trees->find(trees->ctx, &key, triangles, &saved, &bytes);
    }
    bool found = saved != NULL;
    TL_TRY(accel_new_saved(input, options, runner, saved, bytes, &rs->accel));
    if (!kept || accel_is_restored(rs->accel))
        return ERR_OK;
    if (found)
        trees->drop(trees->ctx, &key);
    trees->keep(trees->ctx, &key, rs->accel);
    return ERR_OK;
}

/* Trees that wait for their first ray, if that pays; else rs->accel stays NULL. */
static enum err try_lazy(struct render_scene *rs, const struct accel_input *input,
                         const struct accel_options *options, const struct scene_building *how)
{
    struct accel_lazy_plan plan;
    if (how->lazy_triangles_min == 0)
        return ERR_OK;
    TL_TRY(accel_lazy_choose(input, options, how->runner, how->lazy_triangles_min, &plan));
    if (plan.lazy_count == 0)
        return ERR_OK;
    enum err e = ERR_NOMEM;
    rs->locks = scene_locks_new();
    if (rs->locks) {
        struct accel_locks locks = scene_locks_of(rs->locks);
        e = accel_new_lazy(input, options, how->runner, &plan, &locks, &rs->accel);
    }
    accel_lazy_plan_release(&plan);
    return e == ERR_LIMIT ? ERR_OK : e; /* then all at once */
}

/* The tree's view of the meshes and objects. */
static enum err build_accel(struct render_scene *rs, const struct scene_building *how)
{
    struct accel_mesh *meshes = mem_calloc(rs->mesh_count, sizeof *meshes);
    struct accel_object *objects = mem_calloc(rs->object_count, sizeof *objects);
    enum err e = ERR_NOMEM;
    if (!meshes || !objects)
        goto out;
    for (size_t i = 0; i < rs->mesh_count; i++) {
        const struct render_mesh *m = &rs->meshes[i];
        meshes[i] =
            (struct accel_mesh){m->positions, m->indices, m->vertex_count, m->triangle_count};
    }
    for (size_t i = 0; i < rs->object_count; i++) {
        const struct render_object *o = &rs->objects[i];
        objects[i] = (struct accel_object){.type = o->type, .mesh = o->mesh, .radius = o->radius};
        v3_put(objects[i].center, o->center);
        memcpy(objects[i].to_scene, o->to_scene, sizeof o->to_scene);
        memcpy(objects[i].from_scene, o->from_scene, sizeof o->from_scene);
    }
    struct accel_input input = {meshes, rs->mesh_count, objects, rs->object_count};
    struct accel_options options = {.builder = rs->spec.builder,
                                    .intersector = rs->spec.intersector,
                                    .precision = rs->spec.precision,
                                    .compact = triangles_of(&input) >= SCENE_COMPACT_TRIANGLES_MIN};
    e = try_lazy(rs, &input, &options, how);
    if (e == ERR_OK && !rs->accel)
        e = find_or_build(rs, &input, &options, how->runner, how->trees);
out:
    mem_free(meshes);
    mem_free(objects);
    return e;
}

/* What the size and the film of the job decide. */
static void aim(struct render_scene *rs)
{
    camera_init(&rs->camera, &rs->scene_camera, rs->spec.width, rs->spec.height, rs->center,
                rs->scale);
    film_filter_init(&rs->filter, &rs->spec);
    rs->footprint_step = footprint_step(&rs->spec);
}

/* True if scene_build would make the same tables and the same tree for b: what it reads of the spec
 * but for aim. */
static bool same_tables(const struct render_scene *rs, const struct job_spec *b)
{
    const struct job_spec *a = &rs->spec;
    /* A sky that is a picture is drawn in another way where its light is found in both. */
    bool mis = (a->profile == JOB_PROFILE_MIS) == (b->profile == JOB_PROFILE_MIS);
    return (mis || !rs->lights.environment.texture) && a->builder == b->builder &&
           a->intersector == b->intersector && a->precision == b->precision &&
           a->light_choice == b->light_choice && aov_has(a->aov, AOV_UV) == aov_has(b->aov, AOV_UV);
}

static enum err build(struct render_scene *rs, const struct scene *scene,
                      const struct scene_building *how)
{
    if (scene->uvs_left_out && aov_has(rs->spec.aov, AOV_UV))
        return ERR_INPUT;
    TL_TRY(scene_build_geometry(rs, scene));
    TL_TRY(scene_build_materials(rs, scene, how));
    TL_TRY(scene_build_lights(rs, scene));
    rs->scene_camera = scene->camera;
    aim(rs);
    vec3 light = v3_sub(v3_of(scene->seed_light_position), v3_of(rs->center));
    rs->seed_light_position = v3_scale(light, rs->scale);
    rs->seed_light_flux = rgb_scale(rgb_of(scene->seed_light_flux), rs->scale * rs->scale);
    return build_accel(rs, how);
}

enum err scene_build(const struct scene *scene, const struct job_spec *spec,
                     const struct accel_runner *runner, struct render_scene **out)
{
    return scene_build_as(scene, spec, &(struct scene_building){.runner = runner}, out);
}

enum err scene_build_as(const struct scene *scene, const struct job_spec *spec,
                        const struct scene_building *how, struct render_scene **out)
{
    struct render_scene *rs = mem_calloc(1, sizeof *rs);
    if (!rs)
        return ERR_NOMEM;
    arena_init(&rs->arena);
    rs->sharers = 1;
    rs->spec = *spec;
    enum err e = build(rs, scene, how);
    if (e != ERR_OK) {
        render_scene_free(rs);
        return e;
    }
    *out = rs;
    return ERR_OK;
}

enum err render_scene_share(struct render_scene *rs, const struct job_spec *spec,
                            struct render_scene **out)
{
    struct render_scene *owner = rs->owner ? rs->owner : rs;
    if (!same_tables(rs, spec))
        return ERR_VERSION;
    struct render_scene *view = mem_alloc(sizeof *view);
    if (!view)
        return ERR_NOMEM;
    *view = *owner;
    view->owner = owner;
    view->spec = *spec;
    aim(view);
    owner->sharers++;
    *out = view;
    return ERR_OK;
}

bool render_scene_free(struct render_scene *rs)
{
    if (!rs)
        return false;
    struct render_scene *owner = rs->owner ? rs->owner : rs;
    TL_ASSERT(owner->sharers > 0);
    if (rs != owner)
        mem_free(rs);
    if (--owner->sharers > 0)
        return false;
    if (owner->accel)
        accel_free(owner->accel);
    scene_locks_free(owner->locks);
    scene_late_free(owner->late);
    arena_release(&owner->arena);
    mem_free(owner);
    return true;
}

uint32_t render_scene_sharers(const struct render_scene *rs)
{
    return rs->owner ? rs->owner->sharers : rs->sharers;
}

size_t render_scene_bytes(const struct render_scene *rs)
{
    struct accel_stats stats;
    accel_stats_get(rs->accel, &stats);
    return sizeof *rs + rs->arena.total_bytes + scene_late_bytes(rs->late) + (size_t)stats.bytes;
}

struct accel *render_scene_accel(const struct render_scene *rs)
{
    return rs->accel;
}

void render_scene_stats(const struct render_scene *rs, struct accel_stats *out)
{
    accel_stats_get(rs->accel, out);
}
