#include "common/scene_json.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/scene_loader.h"

/* --- What the parts share ------------------------------------------------ */

bool scene_load_vec3(struct scene_loader *l, const struct json *object, const char *key,
                     double out[3])
{
    return json_get_numbers(&l->g, object, key, 3, -SCENE_NUMBER_MAX, SCENE_NUMBER_MAX, out);
}

bool scene_load_color(struct scene_loader *l, const struct json *object, const char *key,
                      double out[3])
{
    const struct json *v = json_get_member(object, key);
    double grey;
    if (!v || v->type != JSON_NUMBER)
        return json_get_numbers(&l->g, object, key, 3, 0, SCENE_NUMBER_MAX, out);
    if (!json_value_number(&l->g, v, 0, SCENE_NUMBER_MAX, &grey))
        return false;
    out[0] = out[1] = out[2] = grey;
    return true;
}

bool scene_load_transform(struct scene_loader *l, const struct json *object, const char *key,
                          double out[16])
{
    double m[16];
    const struct json *v = json_get_member(object, key);
    if (!v)
        return true;
    if (!json_value_numbers(&l->g, v, 16, -SCENE_NUMBER_MAX, SCENE_NUMBER_MAX, m))
        return false;
    if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1) {
        json_get_problem(&l->g, DIAG_ERROR, v, "bad-transform",
                         "matrices are row by row, the translation at [3], [7], [11]",
                         "the last row is [%g, %g, %g, %g], expected [0, 0, 0, 1]", m[12], m[13],
                         m[14], m[15]);
        return false;
    }
    if (!scene_transform_valid(m)) {
        json_get_problem(&l->g, DIAG_ERROR, v, "bad-transform", NULL,
                         "the matrix is singular, expected one that can be inverted");
        return false;
    }
    memcpy(out, m, sizeof m);
    return true;
}

uint32_t scene_load_reference(struct scene_loader *l, const struct json *object, const char *key,
                              const struct name_table *table, const char *what)
{
    const struct json *v = json_get_member(object, key);
    const char *name;
    if (!v || !json_value_text(&l->g, v, true, &name))
        return SCENE_NONE;
    uint32_t index = name_table_find(table, name, strlen(name));
    if (index != UINT32_MAX)
        return index;
    char hint[JSON_HINT_BYTES] = "";
    if (!json_get_full(&l->g))
        json_hint_known(name, (const char *const *)table->names, table->count, hint);
    json_get_problem(&l->g, DIAG_ERROR, v,
                     strcmp(what, "material") == 0 ? "unknown-material" : "unknown-texture",
                     table->count ? hint : "there are none in this file", "no %s \"%.100s\"", what,
                     name);
    return SCENE_NONE;
}

char *scene_load_name(struct scene_loader *l, const struct json *v)
{
    if (strlen(v->key) > SCENE_NAME_BYTES_MAX) {
        json_get_problem(&l->g, DIAG_ERROR, v, "out-of-range", NULL,
                         "the name is longer than 255 bytes");
        return NULL;
    }
    char *name = mem_strdup(v->key);
    l->out_of_memory |= !name;
    return name;
}

static void missing_file(struct scene_loader *l, const struct json *v, const char *path,
                         const char *full)
{
    char hint[JSON_HINT_BYTES];
    char *other = file_other_case(full);
    size_t lead = strlen(full) - strlen(path);
    (void)snprintf(hint, sizeof hint, "looked beside %s", l->g.file ? l->g.file : "the scene");
    if (other) {
        size_t used = strlen(hint);
        (void)snprintf(hint + used, sizeof hint - used, "; \"%.200s\" exists", other + lead);
    }
    mem_free(other);
    json_get_problem(&l->g, DIAG_ERROR, v, "missing-file", hint, "no file \"%.200s\"", path);
}

char *scene_load_path(struct scene_loader *l, const struct json *v, const char *path)
{
    char *full = file_join(l->folder, path);
    if (!full) {
        l->out_of_memory = true;
        return NULL;
    }
    if (access(full, F_OK) == 0)
        return full;
    missing_file(l, v, path, full);
    mem_free(full);
    return NULL;
}

void scene_load_name_user(struct scene_loader *l, const struct json *v, size_t from)
{
    char path[JSON_PATH_BYTES];
    if (from == l->g.problems->count)
        return;
    json_path(v, path);
    diag_name_user(l->g.problems, from, (struct diag_place){.file = l->g.file, .path = path});
}

bool scene_load_grow_bytes(struct scene_loader *l, void **items, size_t count, size_t *capacity,
                           size_t count_max, size_t item_bytes, const struct json *at)
{
    if (count >= count_max) {
        json_get_problem(&l->g, DIAG_ERROR, at, "too-many", NULL, "more than %zu of them",
                         count_max);
        return false;
    }
    if (mem_grow(items, count, capacity, item_bytes))
        return true;
    l->out_of_memory = true;
    return false;
}

/* --- What lights a scene ------------------------------------------------- */

static bool any_positive(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (v[i] > 0)
            return true;
    return false;
}

static bool image_shines(const struct scene_image *image)
{
    size_t samples = (size_t)image->width * image->height * image->channel_count;
    for (size_t i = 0; i < samples; i++) {
        bool alpha = image->channel_count == 4 && i % 4 == 3;
        double v = image->format == SCENE_IMAGE_F32
                       ? (double)((const float *)image->pixels)[i]
                       : (double)((const unsigned char *)image->pixels)[i];
        if (!alpha && v > 0)
            return true;
    }
    return false;
}

static bool environment_shines(const struct scene *s)
{
    if (s->envmap.texture == SCENE_NONE || !(s->envmap.scale > 0))
        return false;
    const struct scene_texture *t = &s->textures[s->envmap.texture];
    if (t->type == SCENE_TEXTURE_IMAGE)
        return any_positive(t->color[0], 3) && image_shines(&s->images[t->image]);
    return any_positive(t->color[0], 3) ||
           (t->type == SCENE_TEXTURE_CHECKERBOARD && any_positive(t->color[1], 3));
}

bool scene_can_be_lit(const struct scene *s, enum job_integrator integrator)
{
    if (integrator == JOB_INTEGRATOR_AO)
        return true;
    if (integrator == JOB_INTEGRATOR_INTERSECTION_TEST)
        return any_positive(s->seed_light_flux, 3);
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->emits && any_positive(o->radiance, 3))
            return true;
        if (o->material != SCENE_NONE && any_positive(s->materials[o->material].emission, 3))
            return true;
    }
    for (size_t i = 0; i < s->light_count; i++)
        if (any_positive(s->lights[i].intensity, 3))
            return true;
    return environment_shines(s);
}

/* --- The file ------------------------------------------------------------ */

/* A file of another renderer is told so once, not key by key. */
static bool is_foreign(struct scene_loader *l)
{
    const struct json *root = l->g.root;
    char keys[160] = "";
    if (!root->first || json_get_member(root, "integrator") || json_get_member(root, "film"))
        return false;
    for (const struct json *m = root->first; m; m = m->next) {
        size_t used = strlen(keys);
        (void)snprintf(keys + used, sizeof keys - used, "%s%.40s", used ? ", " : "", m->key);
    }
    json_get_problem(&l->g, DIAG_ERROR, root, "foreign-scene",
                     "scenes of other renderers are not read; import their models: tilery import",
                     "not a scene of this format: no \"integrator\" and no \"film\" in it, but %s",
                     keys);
    return true;
}

static void load_parts(struct scene_loader *l)
{
    static const char *const keys[] = {"integrator", "film",    "camera", "textures",
                                       "materials",  "objects", "lights", "environment_map"};
    const struct json *root = l->g.root;
    SCENE_LOAD_KEYS(l, root, keys);
    scene_load_integrator(l, json_get_required(&l->g, root, "integrator"));
    scene_load_film(l, json_get_required(&l->g, root, "film"));
    scene_load_camera(l, json_get_required(&l->g, root, "camera"));
    scene_load_textures(l, json_get_member(root, "textures"));
    scene_load_materials(l, json_get_member(root, "materials"));
    scene_load_objects(l, json_get_member(root, "objects"));
    scene_load_lights(l, json_get_member(root, "lights"));
    scene_load_environment(l, json_get_member(root, "environment_map"));
}

static void loader_release(struct scene_loader *l)
{
    scene_release(&l->scene);
    name_table_release(&l->textures);
    name_table_release(&l->materials);
    name_table_release(&l->meshes);
    name_table_release(&l->images);
    mem_free(l->mesh_of);
    mem_free(l->image_of);
    json_get_close(&l->g);
}

static enum err load(struct scene_loader *l)
{
    struct diag_list *problems = l->g.problems;
    size_t errors_before = problems->error_count;
    if (!json_get_is(&l->g, l->g.root, JSON_OBJECT))
        return ERR_INPUT;
    if (is_foreign(l))
        return ERR_INPUT;
    load_parts(l);
    if (l->out_of_memory)
        return ERR_NOMEM;
    if (problems->error_count != errors_before)
        return ERR_INPUT;
    if (!scene_can_be_lit(&l->scene, l->spec.integrator)) {
        json_get_problem(&l->g, DIAG_ERROR, l->g.root, "no-light",
                         "give an object a \"light\", or the scene \"lights\" or an "
                         "\"environment_map\"",
                         "nothing in it could ever light the picture");
        return ERR_INPUT;
    }
    return job_spec_valid(&l->spec, problems) ? ERR_OK : ERR_INPUT;
}

enum err scene_json_read(const char *text, size_t bytes, const char *file, const char *folder,
                         struct scene *scene, struct job_spec *spec, struct diag_list *problems)
{
    struct scene_loader l = {.folder = folder};
    TL_TRY(json_get_open(&l.g, text, bytes, file, problems));
    scene_init(&l.scene);
    job_spec_init(&l.spec);
    enum err e = load(&l);
    if (e == ERR_OK) {
        scene_check(&l.scene);
        *scene = l.scene;
        *spec = l.spec;
        scene_init(&l.scene);
    }
    loader_release(&l);
    return e;
}

static enum err unreadable(const char *path, enum err e, struct diag_list *problems)
{
    struct diag_place place = {.file = path};
    char *hint = e == ERR_NOT_FOUND ? file_missing_hint(path) : NULL;
    if (e == ERR_NOT_FOUND)
        diag_add(problems, DIAG_ERROR, place, "missing-file", hint, "no such file");
    else if (e == ERR_LIMIT)
        diag_add(problems, DIAG_ERROR, place, "file-too-large", NULL, "over 64 MiB of JSON");
    else
        diag_add(problems, DIAG_ERROR, place, "unreadable-file", NULL, "cannot be read: %s",
                 file_read_why(path, e));
    mem_free(hint);
    return ERR_INPUT;
}

/* Bytes of the byte order mark that some editors begin UTF-8 with; RFC 8259 lets readers pass over
 * it. */
static size_t mark_bytes(const char *text, size_t bytes)
{
    static const char mark[] = {'\xef', '\xbb', '\xbf'};
    return bytes >= sizeof mark && memcmp(text, mark, sizeof mark) == 0 ? sizeof mark : 0;
}

enum err scene_json_read_file(const char *path, struct scene *scene, struct job_spec *spec,
                              struct diag_list *problems)
{
    char *text;
    size_t bytes;
    enum err e = file_read(path, JSON_BYTES_MAX, &text, &bytes);
    if (e == ERR_NOMEM)
        return e;
    if (e != ERR_OK)
        return unreadable(path, e, problems);
    char *folder = file_folder(path);
    size_t mark = mark_bytes(text, bytes);
    e = folder ? scene_json_read(text + mark, bytes - mark, path, folder, scene, spec, problems)
               : ERR_NOMEM;
    if (e == ERR_OK)
        scene->source_bytes += bytes;
    mem_free(folder);
    mem_free(text);
    return e;
}
