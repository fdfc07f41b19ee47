#include "client/import.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "client/import_model.h"
#include "common/file_io.h"
#include "common/json_get.h"
#include "common/mem.h"

#define MODEL_BYTES_MAX (UINT64_C(4) << 30)

enum kind { KIND_SCENE, KIND_OBJ, KIND_PLY, KIND_GLTF, KIND_OTHER };

/* --- What kind of file it is --------------------------------------------- */

static bool has_extension(const char *path, const char *extension)
{
    size_t bytes = strlen(path), tail = strlen(extension);
    return bytes >= tail && strcasecmp(path + bytes - tail, extension) == 0;
}

static bool starts_with(const char *data, size_t bytes, const char *start)
{
    size_t n = strlen(start);
    return bytes >= n && memcmp(data, start, n) == 0;
}

/* JSON that has an "asset" with a version is glTF under any name. */
static bool is_gltf_json(const char *data, size_t bytes)
{
    struct json_doc doc;
    struct diag_list ignored;
    diag_init(&ignored);
    bool is_gltf = false;
    if (json_doc_parse(&doc, data, bytes, NULL, &ignored) == ERR_OK) {
        const struct json *asset = json_get_member(doc.root, "asset");
        is_gltf = asset && json_get_member(asset, "version");
        json_doc_release(&doc);
    }
    diag_release(&ignored);
    return is_gltf;
}

static bool looks_like_json(const char *data, size_t bytes)
{
    size_t i = 0;
    while (i < bytes && strchr(" \t\r\n", data[i]) && data[i])
        i++;
    return i < bytes && data[i] == '{';
}

static enum kind kind_by_name(const char *path)
{
    if (has_extension(path, ".obj"))
        return KIND_OBJ;
    if (has_extension(path, ".ply"))
        return KIND_PLY;
    if (has_extension(path, ".gltf") || has_extension(path, ".glb"))
        return KIND_GLTF;
    return has_extension(path, ".json") ? KIND_SCENE : KIND_OTHER;
}

static enum kind kind_of(const char *path, const char *data, size_t bytes)
{
    if (starts_with(data, bytes, "glTF"))
        return KIND_GLTF;
    if (starts_with(data, bytes, "ply\n") || starts_with(data, bytes, "ply\r"))
        return KIND_PLY;
    enum kind named = kind_by_name(path);
    if (named == KIND_OBJ || named == KIND_GLTF || !looks_like_json(data, bytes))
        return named;
    return is_gltf_json(data, bytes) ? KIND_GLTF : KIND_SCENE;
}

bool import_is_model(const char *path)
{
    char *data;
    size_t bytes;
    enum kind kind = kind_by_name(path);
    if (file_read(path, MODEL_BYTES_MAX, &data, &bytes) == ERR_OK) {
        kind = kind_of(path, data, bytes);
        mem_free(data);
    }
    return kind != KIND_SCENE;
}

/* --- Reading ------------------------------------------------------------- */

static enum err read_kind(struct import *im, const char *data, size_t bytes)
{
    switch (kind_of(im->path, data, bytes)) {
    case KIND_OBJ:
        return import_obj(im, data, bytes);
    case KIND_PLY:
        return import_ply(im, data, bytes);
    case KIND_GLTF:
        return import_gltf(im, data, bytes);
    case KIND_SCENE:
        return import_fail(im, "not-a-model", "render it as it is: tilery render SCENE",
                           "a scene file, not a model");
    case KIND_OTHER:
        break;
    }
    if (bytes == 0)
        return import_fail(im, "bad-model", NULL, "the file is empty");
    return import_other(im);
}

static enum err refuse_file(struct import *im, enum err e)
{
    if (e == ERR_NOMEM)
        return e;
    if (e == ERR_LIMIT)
        return import_fail(im, "file-too-large", NULL, "over 4 GiB");
    if (e != ERR_NOT_FOUND)
        return import_fail(im, "unreadable-file", NULL, "cannot be read: %s",
                           file_read_why(im->path, e));
    char *hint = file_missing_hint(im->path);
    e = import_fail(im, "missing-file", hint, "no such file");
    mem_free(hint);
    return e;
}

enum err import_run(struct import *im, struct job_spec *spec)
{
    char *data;
    size_t bytes;
    enum err e = file_read(im->path, MODEL_BYTES_MAX, &data, &bytes);
    if (e != ERR_OK)
        return refuse_file(im, e);
    im->source_bytes += bytes;
    e = read_kind(im, data, bytes);
    mem_free(data);
    if (e == ERR_OK)
        e = import_finish(im, spec);
    if (e == ERR_LIMIT || e == ERR_CORRUPT)
        e = ERR_INPUT;
    if (e == ERR_INPUT && im->problems->error_count == 0)
        (void)import_fail(im, "bad-model", NULL, "cannot be imported");
    return e;
}

enum err import_model(const char *path, struct scene *scene, struct job_spec *spec,
                      struct diag_list *problems)
{
    struct import im;
    struct job_spec made;
    TL_TRY(import_init(&im, path, problems));
    enum err e = import_run(&im, &made);
    if (e == ERR_OK) {
        *scene = im.scene;
        scene->source_bytes = im.source_bytes;
        *spec = made;
        scene_init(&im.scene);
    }
    import_release(&im);
    return e;
}

/* --- What every model needs ---------------------------------------------- */

static void tell_left_out(struct import *im)
{
    if (im->point_count + im->line_count > 0)
        import_warn(im, "left-out", NULL,
                    "points and lines have no surface and are left out: %llu points, %llu lines",
                    (unsigned long long)im->point_count, (unsigned long long)im->line_count);
    if (im->unsmoothed_count > 0)
        import_warn(im, "left-out", "export the model with its normals",
                    "smoothing groups without normals are left out: %llu faces are flat",
                    (unsigned long long)im->unsmoothed_count);
}

static enum err refuse_empty(struct import *im)
{
    return import_fail(im, "no-face", "export the model with its faces",
                       "no face in it: it holds %llu vertices, %llu points and %llu lines",
                       (unsigned long long)im->vertex_count, (unsigned long long)im->point_count,
                       (unsigned long long)im->line_count);
}

/* As many pixels as the default picture, in the camera's shape. */
static void shape_picture(const struct import *im, struct job_spec *spec)
{
    job_spec_init(spec);
    if (!(im->aspect >= 0.05 && im->aspect <= 20))
        return;
    double height = spec->height;
    if (im->aspect >= 1)
        spec->width = (uint32_t)(height * im->aspect + 0.5);
    else
        spec->height = (uint32_t)(spec->width / im->aspect + 0.5);
    spec->crop = (struct job_crop){.width = spec->width, .height = spec->height};
}

/* A model's colours are meant to be seen: the materials of meshes that have them read them. */
static void show_vertex_colors(struct scene *s)
{
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->type != SCENE_OBJECT_MESH || o->material == SCENE_NONE || !s->meshes[o->mesh].colors)
            continue;
        struct scene_material *m = &s->materials[o->material];
        m->vertex_colors |=
            m->type == SCENE_MATERIAL_DIFFUSE || m->type == SCENE_MATERIAL_PRINCIPLED;
    }
    for (size_t i = 0; i < s->material_count; i++)
        s->materials[i].emission_vertex_colors &= s->materials[i].vertex_colors;
}

/* The share of the model's extent that a height of 1 stands for: formats give it no unit. */
static const double BUMP_EXTENT = 0.01;

/* Heights get a unit; normals in disguise become normals. */
static void settle_bumps(struct import *im)
{
    double low[3], high[3], extent = 0;
    import_bounds(im, low, high);
    for (int i = 0; i < 3; i++)
        extent = high[i] - low[i] > extent ? high[i] - low[i] : extent;
    for (size_t i = 0; i < im->scene.material_count; i++) {
        struct scene_material *m = &im->scene.materials[i];
        if (m->bump_texture == SCENE_NONE)
            continue;
        const struct scene_texture *t = &im->scene.textures[m->bump_texture];
        if (m->type == SCENE_MATERIAL_PRINCIPLED && m->normal_texture == SCENE_NONE &&
            t->type == SCENE_TEXTURE_IMAGE && import_is_normal_map(&im->scene.images[t->image])) {
            m->normal_texture = m->bump_texture;
            m->normal_scale = m->bump_scale;
            m->bump_texture = SCENE_NONE;
            continue;
        }
        m->bump_scale *= BUMP_EXTENT * extent;
        if (import_once(im, IMPORT_ONCE_BUMP))
            import_warn(im, "bump-unit", "change bump_scale in the scene that tilery import writes",
                        "heights of bump maps have no unit: 1 is taken as a hundredth of the "
                        "model's size");
    }
}

enum err import_finish(struct import *im, struct job_spec *spec)
{
    if (im->scene.object_count == 0)
        return refuse_empty(im);
    tell_left_out(im);
    show_vertex_colors(&im->scene);
    settle_bumps(im);
    if (!im->has_lamp && im->scene.envmap.texture == SCENE_NONE) {
        import_warn(im, "sky-added", "for a light of your own: tilery import, then edit the scene",
                    "no light in it; lit by a soft sky");
        TL_TRY(import_sky(im));
    }
    if (!im->has_camera) {
        import_warn(im, "camera-added", NULL, "no camera in it; the whole model is framed");
        import_frame(im);
    }
    import_settle_culling(im);
    shape_picture(im, spec);
    if (!scene_valid(&im->scene))
        return import_fail(im, "bad-model", NULL, "a number in it is out of range");
    return ERR_OK;
}
