/* Cameras, lights and instances of glTF: what hangs on its nodes besides meshes. */
#include <math.h>
#include <string.h>

#include "client/import_gltf.h"
#include "common/dmath.h"
#include "common/mem.h"

/* Light that makes white paper in the middle of the model look between a quarter and four times
 * white is taken as it is; any other is scaled to white. */
#define EXPOSURE_LOW  0.25
#define EXPOSURE_HIGH 4.0

/* Nodes of the scene shown, parents before children. */
struct place {
    uint32_t node;
    double world[16];
};

struct walk {
    struct gltf *t;
    struct place *places;
    size_t count, capacity, root_count;
    bool *seen;
    const struct json *camera; /* the one to use, and its place */
    double camera_world[16];
    size_t camera_count;
};

/* --- Transforms ---------------------------------------------------------- */

static void from_trs(const double move[3], const double turn[4], const double scale[3],
                     double m[16])
{
    double x = turn[0], y = turn[1], z = turn[2], w = turn[3];
    double length = sqrt(x * x + y * y + z * z + w * w); /* about 1: see gltf_is_rotation */
    x /= length;
    y /= length;
    z /= length;
    w /= length;
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
                         2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                         2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
    for (size_t i = 0; i < 3; i++) {
        for (size_t j = 0; j < 3; j++)
            m[4 * i + j] = r[3 * i + j] * scale[j];
        m[4 * i + 3] = move[i];
        m[12 + i] = 0;
    }
    m[15] = 1;
}

static void local_transform(struct gltf *t, const struct json *node, double m[16])
{
    const double limit = GLTF_TRANSFORM_MAX; /* gltf_check has held them to it */
    double columns[16];
    if (json_get_member(node, "matrix")) {
        for (size_t i = 0; i < 16; i++)
            columns[i] = i % 5 == 0;
        gltf_numbers(t, node, "matrix", 16, -limit, limit, columns);
        for (size_t i = 0; i < 16; i++)
            m[i] = i < 12 ? columns[4 * (i % 4) + i / 4] : (double)(i == 15);
        return;
    }
    double move[3] = {0, 0, 0}, turn[4] = {0, 0, 0, 1}, scale[3] = {1, 1, 1};
    gltf_numbers(t, node, "translation", 3, -limit, limit, move);
    gltf_numbers(t, node, "rotation", 4, -1e3, 1e3, turn);
    gltf_numbers(t, node, "scale", 3, -limit, limit, scale);
    from_trs(move, turn, scale, m);
}

/* --- The walk ------------------------------------------------------------ */

static enum err add_place(struct walk *w, const struct json *index, const double parent[16])
{
    uint64_t i;
    if (!json_value_uint(&w->t->g, index, 0, UINT32_MAX, &i))
        return ERR_INPUT;
    if (i >= w->t->tables[GLTF_NODES].count || w->seen[i])
        return ERR_OK; /* the reader of the geometry has judged it */
    if (!mem_grow((void **)&w->places, w->count, &w->capacity, sizeof *w->places))
        return ERR_NOMEM;
    double local[16];
    struct place *p = &w->places[w->count++];
    w->seen[i] = true;
    p->node = (uint32_t)i;
    local_transform(w->t, w->t->tables[GLTF_NODES].items[i], local);
    import_transform_multiply(parent, local, p->world);
    return ERR_OK;
}

static enum err add_children(struct walk *w, const struct json *list, const double world[16])
{
    if (!list)
        return ERR_OK;
    if (!json_get_is(&w->t->g, list, JSON_ARRAY))
        return ERR_INPUT;
    for (const struct json *e = list->first; e; e = e->next)
        TL_TRY(add_place(w, e, world));
    return ERR_OK;
}

static enum err list_places(struct walk *w)
{
    static const double identity[16] = {[0] = 1, [5] = 1, [10] = 1, [15] = 1};
    const struct gltf_table *scenes = &w->t->tables[GLTF_SCENES];
    uint32_t index;
    if (scenes->count == 0)
        return ERR_OK;
    const struct json *scene = gltf_reference(w->t, w->t->g.root, "scene", GLTF_SCENES, &index);
    if (!scene)
        scene = scenes->items[0];
    TL_TRY(add_children(w, json_get_member(scene, "nodes"), identity));
    w->root_count = w->count;
    for (size_t i = 0; i < w->count; i++) {
        const struct json *node = w->t->tables[GLTF_NODES].items[w->places[i].node];
        double world[16];
        memcpy(world, w->places[i].world, sizeof world);
        TL_TRY(add_children(w, json_get_member(node, "children"), world));
    }
    return ERR_OK;
}

/* From the child's count of nodes to places: before several roots assimp has one of its own. The
 * child works in float, so its places of objects give way to those of the file. */
static void place_objects(struct walk *w)
{
    struct gltf *t = w->t;
    uint32_t roots_before = w->root_count > 1;
    for (size_t i = 0; i < t->object_node_count; i++) {
        uint32_t node = t->object_nodes[i];
        if (node == SCENE_NONE || node < roots_before || node - roots_before >= w->count) {
            t->object_nodes[i] = SCENE_NONE;
            continue;
        }
        t->object_nodes[i] = node - roots_before;
        const double *world = w->places[node - roots_before].world;
        if (scene_transform_valid(world))
            memcpy(t->im->scene.objects[i].transform, world,
                   sizeof t->im->scene.objects[i].transform);
    }
}

/* --- Cameras ------------------------------------------------------------- */

/* The first that looks in perspective, else the first. */
static void consider_camera(struct walk *w, const struct place *p)
{
    const struct json *node = w->t->tables[GLTF_NODES].items[p->node];
    uint32_t index;
    const struct json *c = gltf_reference(w->t, node, "camera", GLTF_CAMERAS, &index);
    if (!c)
        return;
    w->camera_count++;
    if (w->camera &&
        (json_get_member(w->camera, "perspective") || !json_get_member(c, "perspective")))
        return;
    w->camera = c;
    memcpy(w->camera_world, p->world, sizeof w->camera_world);
}

static void set_lens(struct walk *w, struct scene_camera *c)
{
    const struct json *wide = json_get_member(w->camera, "perspective");
    const struct json *flat = json_get_member(w->camera, "orthographic");
    double angle = 0, mag[2] = {1, 1};
    if (wide) {
        gltf_number(w->t, wide, "yfov", 0, 3.1, &angle);
        gltf_number(w->t, wide, "aspectRatio", 0, 1e3, &w->t->im->aspect);
        c->fov = angle * (180 / DMATH_PI);
        return;
    }
    gltf_number(w->t, flat, "xmag", 1e-9, 1e9, &mag[0]);
    gltf_number(w->t, flat, "ymag", 1e-9, 1e9, &mag[1]);
    c->type = SCENE_CAMERA_ORTHOGRAPHIC;
    c->ortho_height = 2 * mag[1];
    w->t->im->aspect = mag[0] / mag[1];
}

static void take_camera(struct walk *w)
{
    static const double origin[3] = {0, 0, 0}, ahead[3] = {0, 0, -1}, up[3] = {0, 1, 0};
    struct import *im = w->t->im;
    struct scene_camera c;
    if (!w->camera)
        return;
    scene_camera_init(&c);
    set_lens(w, &c);
    import_transform_point(w->camera_world, origin, c.position);
    import_transform_point(w->camera_world, ahead, c.look_at);
    import_transform_vector(w->camera_world, up, c.ref_up);
    if (!import_camera_valid(&c)) {
        im->aspect = 0;
        import_warn(im, "left-out", NULL, "its camera cannot be used");
        return;
    }
    im->scene.camera = c;
    im->has_camera = true;
    if (w->camera_count > 1)
        import_warn(im, "left-out", NULL, "of its %zu cameras the first is used", w->camera_count);
}

/* --- Lights -------------------------------------------------------------- */

static void set_cone(struct gltf *t, const struct json *v, struct scene_light *l)
{
    double inner = 0, outer = DMATH_PI / 4;
    gltf_number(t, json_get_member(v, "spot"), "innerConeAngle", 0, DMATH_PI / 2, &inner);
    gltf_number(t, json_get_member(v, "spot"), "outerConeAngle", 0, DMATH_PI / 2, &outer);
    l->cos_outer = dmath_cos(outer);
    l->cos_inner = inner < outer ? dmath_cos(inner) : l->cos_outer;
}

static bool make_light(struct gltf *t, const struct json *v, const double world[16],
                       struct scene_light *l)
{
    static const char *const types[] = {"point", "spot", "directional"};
    static const double origin[3] = {0, 0, 0}, ahead[3] = {0, 0, -1};
    int type = 0;
    double color[3] = {1, 1, 1}, intensity = 1, d = 0;
    *l = (struct scene_light){.cos_inner = -1, .cos_outer = -1};
    if (!json_get_choice(&t->g, v, "type", types, 3, &type))
        return false;
    l->type = (enum scene_light_type)type;
    gltf_numbers(t, v, "color", 3, 0, 1e6, color);
    gltf_number(t, v, "intensity", 0, 1e12, &intensity);
    import_transform_point(world, origin, l->position);
    import_transform_vector(world, ahead, l->direction);
    for (int i = 0; i < 3; i++) {
        l->intensity[i] = color[i] * intensity;
        d += l->direction[i] * l->direction[i];
    }
    if (!(d > 0 && isfinite(d)))
        return false;
    for (int i = 0; i < 3; i++)
        l->direction[i] /= sqrt(d);
    if (l->type == SCENE_LIGHT_SPOT)
        set_cone(t, v, l);
    return intensity > 0 && (color[0] > 0 || color[1] > 0 || color[2] > 0);
}

static enum err take_light(struct walk *w, const struct place *p)
{
    struct gltf *t = w->t;
    const struct json *node = t->tables[GLTF_NODES].items[p->node];
    const struct json *use = gltf_extension(node, "KHR_lights_punctual");
    struct scene_light light;
    uint32_t index;
    if (!use)
        return ERR_OK;
    const struct json *v = gltf_reference(t, use, "light", GLTF_LIGHTS, &index);
    if (!v)
        return ERR_OK;
    return make_light(t, v, p->world, &light) ? import_add_light(t->im, &light) : ERR_OK;
}

/* How bright white paper in the middle of the model would be, 1 being white. */
static double exposure_of(const struct import *im)
{
    double low[3], high[3], sum = 0, radius2 = 0;
    import_bounds(im, low, high);
    for (int i = 0; i < 3; i++)
        radius2 += (high[i] - low[i]) * (high[i] - low[i]) / 4;
    for (size_t k = 0; k < im->scene.light_count; k++) {
        const struct scene_light *l = &im->scene.lights[k];
        double d2 = 0;
        for (int i = 0; i < 3; i++) {
            double d = low[i] / 2 + high[i] / 2 - l->position[i];
            d2 += d * d;
        }
        d2 = l->type == SCENE_LIGHT_DIRECTIONAL ? 1 : fmax(d2, radius2 / 4);
        sum += (l->intensity[0] + l->intensity[1] + l->intensity[2]) / 3 / d2;
    }
    return sum / DMATH_PI;
}

static void expose(struct import *im)
{
    double exposure = im->scene.light_count ? exposure_of(im) : 1;
    if (!(exposure > 0 && isfinite(exposure)) ||
        (exposure >= EXPOSURE_LOW && exposure <= EXPOSURE_HIGH))
        return;
    for (size_t k = 0; k < im->scene.light_count; k++)
        for (int i = 0; i < 3; i++)
            im->scene.lights[k].intensity[i] /= exposure;
    import_warn(im, "light-scaled", NULL,
                "its lights would show white as %.3g; all are divided by that", exposure);
}

/* --- Instances ----------------------------------------------------------- */

static enum err read_attribute(struct gltf *t, const struct json *attributes, const char *key,
                               uint32_t width, double **out, size_t *count)
{
    uint32_t accessor;
    size_t found = 0;
    *out = NULL;
    if (!gltf_reference(t, attributes, key, GLTF_ACCESSORS, &accessor))
        return ERR_OK;
    TL_TRY(gltf_accessor(t, accessor, width, out, &found));
    if (*out && (*count == 0 || found < *count))
        *count = found;
    return ERR_OK;
}

static enum err add_copies(struct import *im, size_t object, const struct place *p,
                           double *const trs[3], size_t count)
{
    static const double still[3] = {0, 0, 0}, upright[4] = {0, 0, 0, 1}, full[3] = {1, 1, 1};
    for (size_t i = count; i-- > 0;) {
        struct scene_object copy = im->scene.objects[object];
        double local[16];
        from_trs(trs[0] ? trs[0] + 3 * i : still, trs[1] ? trs[1] + 4 * i : upright,
                 trs[2] ? trs[2] + 3 * i : full, local);
        import_transform_multiply(p->world, local, copy.transform);
        if (!scene_transform_valid(copy.transform))
            continue;
        if (i == 0)
            im->scene.objects[object] = copy;
        else
            TL_TRY(import_add_object(im, &copy));
    }
    return ERR_OK;
}

/* The same of instances as of nodes: numbers that floats can be multiplied with, rotations of
 * length 1. The first that is not is a problem that names it. */
static bool check_copies(struct gltf *t, const struct json *attributes, double *const trs[3],
                         size_t count)
{
    static const char *const keys[3] = {"TRANSLATION", "ROTATION", "SCALE"};
    for (size_t k = 0; k < 3; k++) {
        size_t width = k == 1 ? 4 : 3;
        const struct json *at = json_get_member(attributes, keys[k]);
        double length;
        for (size_t i = 0; trs[k] && i < count; i++) {
            const double *v = trs[k] + width * i;
            if (k == 1 && !gltf_is_rotation(v, &length)) {
                json_get_problem(&t->g, DIAG_ERROR, at, "bad-transform", NULL,
                                 "of instance %zu of %zu a quaternion of length %.6g, expected 1",
                                 i + 1, count, length);
                return false;
            }
            for (size_t j = 0; j < width; j++)
                if (!(fabs(v[j]) <= GLTF_TRANSFORM_MAX)) {
                    json_get_problem(&t->g, DIAG_ERROR, at, "not-finite", NULL,
                                     "%.6g of instance %zu of %zu, must be a finite number within "
                                     "%g",
                                     v[j], i + 1, count, GLTF_TRANSFORM_MAX);
                    return false;
                }
        }
    }
    return true;
}

static enum err take_instances(struct walk *w, const struct place *p)
{
    struct gltf *t = w->t;
    const struct json *node = t->tables[GLTF_NODES].items[p->node];
    const struct json *x = gltf_extension(node, "EXT_mesh_gpu_instancing");
    const struct json *attributes = json_get_member(x, "attributes");
    double *trs[3] = {NULL, NULL, NULL};
    size_t count = 0;
    if (!attributes)
        return ERR_OK;
    enum err e = read_attribute(t, attributes, "TRANSLATION", 3, &trs[0], &count);
    if (e == ERR_OK)
        e = read_attribute(t, attributes, "ROTATION", 4, &trs[1], &count);
    if (e == ERR_OK)
        e = read_attribute(t, attributes, "SCALE", 3, &trs[2], &count);
    if (e == ERR_OK && !check_copies(t, attributes, trs, count))
        e = ERR_INPUT;
    for (size_t i = 0; i < t->object_node_count && e == ERR_OK && count > 0; i++)
        if (t->object_nodes[i] == (size_t)(p - w->places))
            e = add_copies(t->im, i, p, trs, count);
    if (count == 0 && e == ERR_OK)
        json_get_problem(&t->g, DIAG_WARNING, x, "left-out", NULL,
                         "its instances cannot be read; one is shown");
    for (int i = 0; i < 3; i++)
        mem_free(trs[i]);
    return e;
}

enum err gltf_nodes(struct gltf *t)
{
    struct walk w = {.t = t, .seen = mem_calloc(t->tables[GLTF_NODES].count + 1, sizeof(bool))};
    enum err e = w.seen ? list_places(&w) : ERR_NOMEM;
    if (e == ERR_OK)
        place_objects(&w);
    for (size_t i = 0; i < w.count && e == ERR_OK; i++) {
        consider_camera(&w, &w.places[i]);
        e = take_light(&w, &w.places[i]);
        if (e == ERR_OK)
            e = take_instances(&w, &w.places[i]);
    }
    if (e == ERR_OK) {
        take_camera(&w);
        expose(t->im);
    }
    mem_free(w.places);
    mem_free(w.seen);
    return e;
}
