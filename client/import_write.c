#include "client/import_write.h"

#include <string.h>

#include "common/dmath.h"
#include "common/file_io.h"
#include "common/json_put.h"
#include "common/mem.h"

/* --- Values -------------------------------------------------------------- */

static void put_array(struct buf *b, const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        buf_printf(b, i ? ", " : "[");
        json_put_number(b, v[i]);
    }
    buf_printf(b, "]");
}

/* Members that follow another: `, "key": value`. */
static void put_number(struct buf *b, const char *key, double v)
{
    buf_printf(b, ", \"%s\": ", key);
    json_put_number(b, v);
}

static void put_numbers(struct buf *b, const char *key, const double *v, size_t count)
{
    buf_printf(b, ", \"%s\": ", key);
    put_array(b, v, count);
}

static void put_text(struct buf *b, const char *key, const char *text)
{
    buf_printf(b, ", \"%s\": ", key);
    json_put_text(b, text);
}

/* The same when the value is not the default. */
static void put_other(struct buf *b, const char *key, double v, double usual)
{
    if (v != usual)
        put_number(b, key, v);
}

static void put_other_color(struct buf *b, const char *key, const double v[3], double usual)
{
    if (v[0] != usual || v[1] != usual || v[2] != usual)
        put_numbers(b, key, v, 3);
}

static void put_texture_use(const struct import_writer *w, struct buf *b, const char *key,
                            uint32_t texture)
{
    if (texture != SCENE_NONE)
        put_text(b, key, w->im->scene.textures[texture].name);
}

/* --- The view ------------------------------------------------------------ */

static void put_view(struct import_writer *w)
{
    struct buf *b = &w->json;
    const struct scene_camera *c = &w->im->scene.camera;
    buf_printf(b,
               "{\n  \"integrator\": {\"type\": \"path\", \"spp\": %llu, \"max_depth\": %u},\n"
               "  \"film\": {\"resolution\": [%u, %u]},\n  \"camera\": {\"position\": ",
               (unsigned long long)w->spec->spp, w->spec->max_depth, w->spec->width,
               w->spec->height);
    put_array(b, c->position, 3);
    put_numbers(b, "look_at", c->look_at, 3);
    put_numbers(b, "ref_up", c->ref_up, 3);
    put_number(b, "fov", c->fov);
    if (c->type == SCENE_CAMERA_ORTHOGRAPHIC) {
        put_text(b, "type", "orthographic");
        put_number(b, "ortho_height", c->ortho_height);
    }
    buf_printf(b, "},\n");
}

/* --- Textures and materials ---------------------------------------------- */

static void put_image_texture(const struct import_writer *w, struct buf *b,
                              const struct scene_texture *t)
{
    static const char *const wraps[] = {"repeat", "clamp", "mirror"};
    static const double same[6] = {1, 0, 0, 0, 1, 0};
    const struct import_source *source = import_source_of(w->im, t->image);
    bool is_data = source && source->use == IMAGE_DATA;
    buf_printf(b, "{\"type\": \"image\"");
    put_text(b, "path", w->image_paths[t->image]);
    if (is_data)
        put_text(b, "encoding", "linear");
    if (t->filter != SCENE_FILTER_MIPMAP)
        put_text(b, "filter", t->filter == SCENE_FILTER_NEAREST ? "nearest" : "bilinear");
    if (t->wrap[0] != SCENE_WRAP_REPEAT || t->wrap[1] != SCENE_WRAP_REPEAT)
        buf_printf(b, ", \"wrap\": [\"%s\", \"%s\"]", wraps[t->wrap[0]], wraps[t->wrap[1]]);
    if (memcmp(t->uv_matrix, same, sizeof same) != 0) {
        buf_printf(b, ", \"tex_coordinate_generator\": {\"type\": \"uvmapping2d\"");
        put_numbers(b, "matrix", t->uv_matrix, 6);
        buf_printf(b, "}");
    }
    buf_printf(b, "}");
}

static void put_textures(struct import_writer *w)
{
    const struct scene *s = &w->im->scene;
    struct buf *b = &w->json;
    if (s->texture_count == 0)
        return;
    buf_printf(b, "  \"textures\": {");
    for (size_t i = 0; i < s->texture_count; i++) {
        const struct scene_texture *t = &s->textures[i];
        buf_printf(b, i ? ",\n    " : "\n    ");
        json_put_text(b, t->name);
        buf_printf(b, ": ");
        if (t->type == SCENE_TEXTURE_IMAGE) {
            put_image_texture(w, b, t);
        } else {
            buf_printf(b, "{\"type\": \"constant\"");
            put_numbers(b, "color", t->color[0], 3);
            buf_printf(b, "}");
        }
    }
    buf_printf(b, "\n  },\n");
}

static void put_principled(const struct import_writer *w, struct buf *b,
                           const struct scene_material *m)
{
    put_other_color(b, "color", m->color, 1);
    put_texture_use(w, b, "texture_name", m->texture);
    put_other(b, "metallic", m->metallic, 0);
    put_other(b, "roughness", m->roughness, 1);
    put_texture_use(w, b, "metallic_roughness_texture", m->metallic_roughness_texture);
    put_other(b, "eta", m->eta, 1.5);
    put_other(b, "specular", m->specular, 1);
    put_other_color(b, "specular_color", m->specular_color, 1);
    put_other_color(b, "emission", m->emission, 0);
    put_texture_use(w, b, "emission_texture", m->emission_texture);
    put_texture_use(w, b, "normal_texture", m->normal_texture);
    put_other(b, "normal_scale", m->normal_scale, 1);
    put_other(b, "transmission", m->transmission, 0);
    put_texture_use(w, b, "transmission_texture", m->transmission_texture);
    put_other(b, "clearcoat", m->clearcoat, 0);
    put_other(b, "clearcoat_roughness", m->clearcoat_roughness, 0);
    put_other_color(b, "sheen_color", m->sheen_color, 0);
    put_other(b, "sheen_roughness", m->sheen_roughness, 0);
    put_other(b, "alpha", m->alpha, 1);
    if (m->alpha_used)
        put_text(b, "alpha_mode", m->alpha_cutoff < 0 ? "blend" : "mask");
    if (m->alpha_used && m->alpha_cutoff >= 0)
        put_number(b, "alpha_cutoff", m->alpha_cutoff);
    if (m->twosided)
        buf_printf(b, ", \"twosided\": true");
    if (m->vertex_colors)
        buf_printf(b, ", \"vertex_colors\": true");
    if (m->emission_vertex_colors)
        buf_printf(b, ", \"emission_vertex_colors\": true");
    if (m->emission_twosided && (m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0))
        buf_printf(b, ", \"emission_twosided\": true");
    if (m->backface_culling)
        buf_printf(b, ", \"backface_culling\": true");
}

/* The importers make these kinds only. */
static void put_material(const struct import_writer *w, struct buf *b,
                         const struct scene_material *m)
{
    switch (m->type) {
    case SCENE_MATERIAL_MIRROR:
        buf_printf(b, "{\"type\": \"mirror\"");
        put_numbers(b, "R", m->R, 3);
        break;
    case SCENE_MATERIAL_GLASS:
        buf_printf(b, "{\"type\": \"glass\"");
        put_number(b, "eta", m->eta);
        put_numbers(b, "R", m->R, 3);
        put_numbers(b, "T", m->T, 3);
        break;
    case SCENE_MATERIAL_PRINCIPLED:
        buf_printf(b, "{\"type\": \"principled\"");
        put_principled(w, b, m);
        break;
    default:
        TL_ASSERT(m->type == SCENE_MATERIAL_DIFFUSE);
        buf_printf(b, "{\"type\": \"diffuse\"");
        put_texture_use(w, b, "texture_name", m->texture);
        put_numbers(b, "color", m->color, 3);
        if (m->twosided)
            buf_printf(b, ", \"twosided\": true");
        if (m->vertex_colors)
            buf_printf(b, ", \"vertex_colors\": true");
        break;
    }
    put_texture_use(w, b, "bump_texture", m->bump_texture);
    if (m->bump_texture != SCENE_NONE)
        put_number(b, "bump_scale", m->bump_scale);
    buf_printf(b, "}");
}

static void put_materials(struct import_writer *w)
{
    const struct scene *s = &w->im->scene;
    struct buf *b = &w->json;
    buf_printf(b, "  \"materials\": {");
    for (size_t i = 0; i < s->material_count; i++) {
        buf_printf(b, i ? ",\n    " : "\n    ");
        json_put_text(b, s->materials[i].name);
        buf_printf(b, ": ");
        put_material(w, b, &s->materials[i]);
    }
    buf_printf(b, "\n  },\n");
}

/* --- Objects and lights -------------------------------------------------- */

static void put_object(const struct import_writer *w, struct buf *b, const struct scene_object *o)
{
    static const double same[16] = {[0] = 1, [5] = 1, [10] = 1, [15] = 1};
    buf_printf(b, "{\"type\": \"mesh\"");
    put_text(b, "path", w->mesh_paths[o->mesh]);
    if (memcmp(o->transform, same, sizeof same) != 0)
        put_numbers(b, "transform", o->transform, 16);
    if (o->material != SCENE_NONE)
        put_text(b, "material_name", w->im->scene.materials[o->material].name);
    if (o->emits || o->material == SCENE_NONE) {
        static const double black[3] = {0, 0, 0};
        buf_printf(b, ", \"light\": {\"type\": \"area\"");
        put_numbers(b, "radiance", o->emits ? o->radiance : black, 3);
        buf_printf(b, "}");
    }
    buf_printf(b, "}");
}

static void put_objects(struct import_writer *w)
{
    const struct scene *s = &w->im->scene;
    buf_printf(&w->json, "  \"objects\": [");
    for (size_t i = 0; i < s->object_count; i++) {
        buf_printf(&w->json, i ? ",\n    " : "\n    ");
        put_object(w, &w->json, &s->objects[i]);
    }
    buf_printf(&w->json, "\n  ]");
}

static void put_light(struct buf *b, const struct scene_light *l)
{
    static const char *const types[] = {"point", "spot", "directional"};
    const double degrees = 180 / DMATH_PI;
    buf_printf(b, "{\"type\": \"%s\"", types[l->type]);
    if (l->type == SCENE_LIGHT_DIRECTIONAL) {
        put_numbers(b, "direction", l->direction, 3);
        put_numbers(b, "irradiance", l->intensity, 3);
    } else {
        put_numbers(b, "position", l->position, 3);
        put_numbers(b, "intensity", l->intensity, 3);
    }
    if (l->type == SCENE_LIGHT_SPOT) {
        double outer = dmath_acos(l->cos_outer) * degrees,
               inner = dmath_acos(l->cos_inner) * degrees;
        put_numbers(b, "direction", l->direction, 3);
        put_number(b, "outer_angle", outer > 1e-6 ? outer : 1e-6);
        put_number(b, "inner_angle", inner < outer ? inner : outer);
    }
    buf_printf(b, "}");
}

static void put_lights(struct import_writer *w)
{
    const struct scene *s = &w->im->scene;
    struct buf *b = &w->json;
    for (size_t i = 0; i < s->light_count; i++) {
        buf_printf(b, i ? ",\n    " : ",\n  \"lights\": [\n    ");
        put_light(b, &s->lights[i]);
    }
    if (s->light_count > 0)
        buf_printf(b, "\n  ]");
    if (s->envmap.texture != SCENE_NONE) {
        buf_printf(b, ",\n  \"environment_map\": {\"scale\": ");
        json_put_number(b, s->envmap.scale);
        put_text(b, "texture_name", s->textures[s->envmap.texture].name);
        buf_printf(b, "}");
    }
    buf_printf(b, "\n}\n");
}

/* --- The scene file ------------------------------------------------------ */

static char *stem_of(const char *path)
{
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    const char *dot = strrchr(name, '.');
    return mem_strndup(name, dot && dot > name ? (size_t)(dot - name) : strlen(name));
}

static enum err write_all(struct import_writer *w)
{
    TL_TRY(import_write_files(w));
    put_view(w);
    put_textures(w);
    put_materials(w);
    put_objects(w);
    put_lights(w);
    TL_TRY(buf_status(&w->json));
    enum err e = file_write(w->path, w->json.data, w->json.bytes);
    if (e != ERR_OK && e != ERR_NOMEM)
        w->failed = mem_strdup(w->path);
    return e;
}

static void release_paths(char **paths, size_t count)
{
    for (size_t i = 0; paths && i < count; i++)
        mem_free(paths[i]);
    mem_free(paths);
}

enum err import_write(const struct import *im, const struct job_spec *spec, const char *path,
                      char **failed)
{
    struct import_writer w = {
        .im = im, .spec = spec, .path = path, .folder = file_folder(path), .stem = stem_of(path)};
    buf_init(&w.json);
    enum err e = w.folder && w.stem ? write_all(&w) : ERR_NOMEM;
    release_paths(w.mesh_paths, im->scene.mesh_count);
    release_paths(w.image_paths, im->scene.image_count);
    buf_release(&w.json);
    mem_free(w.folder);
    mem_free(w.stem);
    *failed = w.failed;
    return e;
}
