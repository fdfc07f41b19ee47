/* The keys "objects", "lights" and "environment_map". */
#include <math.h>
#include <string.h>

#include "common/dmath.h"
#include "common/file_io.h"
#include "common/mem.h"
#include "common/model_file.h"
#include "common/scene_loader.h"

/* --- Meshes -------------------------------------------------------------- */

static uint32_t read_mesh(struct scene_loader *l, const struct json *v, const char *path)
{
    struct scene *s = &l->scene;
    struct scene_mesh mesh;
    char *full = scene_load_path(l, v, path);
    if (!full)
        return SCENE_NONE;
    size_t problems_before = l->g.problems->count;
    enum err e = model_read_mesh(full, full, &mesh, l->g.problems);
    scene_load_name_user(l, v, problems_before);
    s->source_bytes += file_length(full);
    mem_free(full);
    l->out_of_memory |= e == ERR_NOMEM;
    if (e != ERR_OK)
        return SCENE_NONE;
    char *name = mem_strndup(path, SCENE_NAME_BYTES_MAX);
    if (name &&
        scene_load_grow(l, s->meshes, s->mesh_count, l->mesh_capacity, SCENE_MESHES_MAX, v)) {
        mem_free(mesh.name);
        mesh.name = name;
        (void)model_fix_winding(&mesh);
        s->meshes[s->mesh_count] = mesh;
        return (uint32_t)s->mesh_count++;
    }
    l->out_of_memory |= !name;
    mem_free(name);
    scene_mesh_release(&mesh);
    return SCENE_NONE;
}

/* Each file is read once, however many objects show it. */
static uint32_t load_mesh(struct scene_loader *l, const struct json *v, const char *path)
{
    uint32_t known = name_table_find(&l->meshes, path, strlen(path)), place;
    if (known != UINT32_MAX)
        return l->mesh_of[known];
    if (!mem_grow((void **)&l->mesh_of, l->meshes.count, &l->mesh_of_capacity,
                  sizeof *l->mesh_of) ||
        name_table_add(&l->meshes, path, strlen(path), &place) != ERR_OK) {
        l->out_of_memory = true;
        return SCENE_NONE;
    }
    l->mesh_of[place] = read_mesh(l, v, path);
    return l->mesh_of[place];
}

/* --- objects ------------------------------------------------------------- */

static void load_mesh_object(struct scene_loader *l, const struct json *v, struct scene_object *o)
{
    static const char *const keys[] = {"type",      "path",          "transform",
                                       "translate", "material_name", "light"};
    double translate[3] = {0, 0, 0};
    const char *path;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)scene_load_transform(l, v, "transform", o->transform);
    (void)scene_load_vec3(l, v, "translate", translate);
    for (size_t i = 0; i < 3; i++)
        o->transform[4 * i + 3] += translate[i];
    const struct json *where = json_get_required(&l->g, v, "path");
    if (where && json_value_text(&l->g, where, false, &path))
        o->mesh = load_mesh(l, where, path);
}

static void load_sphere(struct scene_loader *l, const struct json *v, struct scene_object *o)
{
    static const char *const keys[] = {"type", "center",        "radius",
                                       "path", "material_name", "light"};
    SCENE_LOAD_KEYS(l, v, keys);
    if (json_get_required(&l->g, v, "center"))
        (void)scene_load_vec3(l, v, "center", o->center);
    double radius = o->radius;
    if (!json_get_number(&l->g, v, "radius", -SCENE_NUMBER_MAX, SCENE_NUMBER_MAX, &radius))
        return;
    if (radius > 0)
        o->radius = radius;
    else
        json_get_problem(&l->g, DIAG_ERROR, json_get_member(v, "radius"), "out-of-range", NULL,
                         "%.10g is out of range, expected over 0", radius);
}

static void load_area_light(struct scene_loader *l, const struct json *v, struct scene_object *o)
{
    static const char *const keys[] = {"type", "radiance"};
    static const char *const types[] = {"area"};
    int type = 0;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)json_get_choice(&l->g, v, "type", types, 1, &type);
    (void)scene_load_color(l, v, "radiance", o->radiance);
    o->emits = true;
}

static void load_object(struct scene_loader *l, const struct json *v, struct scene_object *o)
{
    static const char *const types[] = {"mesh", "sphere"};
    int type;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    const struct json *which = json_get_required(&l->g, v, "type");
    if (!which || !json_value_choice(&l->g, which, types, 2, &type))
        return;
    o->type = (enum scene_object_type)type;
    if (o->type == SCENE_OBJECT_MESH)
        load_mesh_object(l, v, o);
    else
        load_sphere(l, v, o);
    o->material = scene_load_reference(l, v, "material_name", &l->materials, "material");
    load_area_light(l, json_get_member(v, "light"), o);
    if (!json_get_member(v, "material_name") && !json_get_member(v, "light"))
        json_get_problem(&l->g, DIAG_ERROR, v, "no-material", NULL,
                         "the object has neither \"material_name\" nor \"light\", expected one "
                         "of them or both");
}

void scene_load_objects(struct scene_loader *l, const struct json *v)
{
    struct scene *s = &l->scene;
    if (!json_get_is(&l->g, v, JSON_ARRAY))
        return;
    for (const struct json *e = v->first; e && !l->out_of_memory; e = e->next) {
        if (!scene_load_grow(l, s->objects, s->object_count, l->object_capacity, SCENE_OBJECTS_MAX,
                             e))
            return;
        struct scene_object *o = &s->objects[s->object_count++];
        scene_object_init(o);
        load_object(l, e, o);
    }
}

/* --- lights -------------------------------------------------------------- */

/* `direction`, or from the position to `look_at`; made unit. */
static void load_direction(struct scene_loader *l, const struct json *v, struct scene_light *light)
{
    const struct json *at = json_get_member(v, "look_at");
    double d[3], largest = 0;
    bool good = true;
    if (at) {
        good = scene_load_vec3(l, v, "look_at", d);
        for (int i = 0; good && i < 3; i++)
            d[i] -= light->position[i];
    } else {
        at = json_get_required(&l->g, v, "direction");
        good = at && scene_load_vec3(l, v, "direction", d);
    }
    for (int i = 0; good && i < 3; i++)
        largest = fmax(largest, fabs(d[i]));
    if (!good)
        return;
    if (largest == 0) {
        json_get_problem(&l->g, DIAG_ERROR, at, "out-of-range", NULL,
                         "the direction is zero, expected one");
        return;
    }
    double x = d[0] / largest, y = d[1] / largest, z = d[2] / largest;
    double length = sqrt(x * x + y * y + z * z);
    light->direction[0] = x / length;
    light->direction[1] = y / length;
    light->direction[2] = z / length;
}

static void load_cone(struct scene_loader *l, const struct json *v, struct scene_light *light)
{
    double outer = 30, inner;
    (void)json_get_number(&l->g, v, "outer_angle", 1e-6, 180, &outer);
    inner = outer * 0.75;
    (void)json_get_number(&l->g, v, "inner_angle", 0, outer, &inner);
    light->cos_inner = dmath_cos(inner * (DMATH_PI / 180));
    light->cos_outer = dmath_cos(outer * (DMATH_PI / 180));
}

static void load_light(struct scene_loader *l, const struct json *v, struct scene_light *light)
{
    static const char *const types[] = {"point", "spot", "directional"};
    static const char *const point_keys[] = {"type", "position", "intensity"};
    static const char *const spot_keys[] = {"type",      "position",    "direction",  "look_at",
                                            "intensity", "outer_angle", "inner_angle"};
    static const char *const directional_keys[] = {"type", "direction", "irradiance"};
    int type;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    const struct json *which = json_get_required(&l->g, v, "type");
    if (!which || !json_value_choice(&l->g, which, types, 3, &type))
        return;
    light->type = (enum scene_light_type)type;
    if (light->type == SCENE_LIGHT_DIRECTIONAL) {
        SCENE_LOAD_KEYS(l, v, directional_keys);
        load_direction(l, v, light);
        (void)scene_load_color(l, v, "irradiance", light->intensity);
        return;
    }
    if (light->type == SCENE_LIGHT_POINT)
        SCENE_LOAD_KEYS(l, v, point_keys);
    else
        SCENE_LOAD_KEYS(l, v, spot_keys);
    if (json_get_required(&l->g, v, "position"))
        (void)scene_load_vec3(l, v, "position", light->position);
    (void)scene_load_color(l, v, "intensity", light->intensity);
    if (light->type == SCENE_LIGHT_SPOT) {
        load_direction(l, v, light);
        load_cone(l, v, light);
    }
}

void scene_load_lights(struct scene_loader *l, const struct json *v)
{
    struct scene *s = &l->scene;
    if (v && v->type == JSON_OBJECT) {
        json_get_problem(&l->g, DIAG_WARNING, v, "lights-ignored",
                         "an array of lights would be read",
                         "an object of lights was never read by any renderer and is ignored");
        return;
    }
    if (!json_get_is(&l->g, v, JSON_ARRAY))
        return;
    for (const struct json *e = v->first; e && !l->out_of_memory; e = e->next) {
        if (!scene_load_grow(l, s->lights, s->light_count, l->light_capacity, SCENE_LIGHTS_MAX, e))
            return;
        struct scene_light *light = &s->lights[s->light_count++];
        *light = (struct scene_light){
            .direction = {0, -1, 0}, .intensity = {1, 1, 1}, .cos_inner = -1, .cos_outer = -1};
        load_light(l, e, light);
    }
}

/* --- environment_map ----------------------------------------------------- */

void scene_load_environment(struct scene_loader *l, const struct json *v)
{
    static const char *const keys[] = {"texture_name", "scale", "transform"};
    struct scene_envmap *env = &l->scene.envmap;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)json_get_required(&l->g, v, "texture_name");
    env->texture = scene_load_reference(l, v, "texture_name", &l->textures, "texture");
    (void)json_get_number(&l->g, v, "scale", 0, SCENE_NUMBER_MAX, &env->scale);
    (void)scene_load_transform(l, v, "transform", env->transform);
}
