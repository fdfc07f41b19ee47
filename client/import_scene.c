/* client/import_scene.c: the scene that every importer fills, and the problems it meets on the way.
 *
 * Grows the scene's arrays, names things apart and settles what the renderer refuses; what was
 * added belongs to the scene. One thread.
 */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "client/import_model.h"
#include "common/file_io.h"
#include "common/mem.h"
#include "common/model_file.h"

enum err import_init(struct import *im, const char *path, struct diag_list *problems)
{
    *im = (struct import){.path = path, .folder = file_folder(path), .problems = problems};
    scene_init(&im->scene);
    name_table_init(&im->material_names);
    name_table_init(&im->texture_names);
    name_table_init(&im->source_names);
    return im->folder ? ERR_OK : ERR_NOMEM;
}

void import_release(struct import *im)
{
    for (size_t i = 0; i < im->source_count; i++) {
        mem_free(im->sources[i].path);
        mem_free(im->sources[i].data);
    }
    mem_free(im->sources);
    mem_free(im->object_nodes);
    name_table_release(&im->material_names);
    name_table_release(&im->texture_names);
    name_table_release(&im->source_names);
    mem_free(im->folder);
    scene_release(&im->scene);
}

/* --- What to say --------------------------------------------------------- */

static void say(struct import *im, enum diag_severity severity, const char *id, const char *hint,
                const char *format, va_list args)
{
    char text[1024];
    (void)vsnprintf(text, sizeof text, format, args);
    diag_add(im->problems, severity, (struct diag_place){.file = im->path}, id, hint, "%s", text);
}

void import_warn(struct import *im, const char *id, const char *hint, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    say(im, DIAG_WARNING, id, hint, format, args);
    va_end(args);
}

enum err import_fail(struct import *im, const char *id, const char *hint, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    say(im, DIAG_ERROR, id, hint, format, args);
    va_end(args);
    return ERR_INPUT;
}

bool import_once(struct import *im, enum import_once what)
{
    uint64_t bit = UINT64_C(1) << what;
    bool first = !(im->told & bit);
    im->told |= bit;
    return first;
}

/* --- Growing tables ------------------------------------------------------ */

static enum err make_room(struct import *im, void **items, size_t count, size_t *capacity,
                          size_t item_bytes, size_t limit, const char *what)
{
    if (count >= limit) {
        (void)import_fail(im, "model-too-large", NULL, "over %zu %s", limit, what);
        return ERR_LIMIT;
    }
    return mem_grow(items, count, capacity, item_bytes) ? ERR_OK : ERR_NOMEM;
}

static void put_index(size_t index, uint32_t *out)
{
    if (out)
        *out = (uint32_t)index;
}

/* Rounding a unit vector to float leaves it a little off, so that reading a written mesh would turn
 * it again. Turned until it stays, it is the same after writing and reading; the few that swing
 * between two places are nudged. */
static void settle_normal(float n[3])
{
    for (int i = 0; i < 64; i++) {
        double x = (double)n[0], y = (double)n[1], z = (double)n[2];
        double largest = fmax(fabs(x), fmax(fabs(y), fabs(z)));
        if (!(largest > 0))
            return;
        x /= largest;
        y /= largest;
        z /= largest;
        double length = sqrt(x * x + y * y + z * z);
        const float next[3] = {(float)(x / length), (float)(y / length), (float)(z / length)};
        if (next[0] == n[0] && next[1] == n[1] && next[2] == n[2])
            return;
        memcpy(n, next, sizeof next);
        if (i % 4 == 3)
            n[i / 4 % 3] = nextafterf(n[i / 4 % 3], 0);
    }
}

enum err import_add_mesh(struct import *im, struct scene_mesh *mesh, uint32_t *out)
{
    struct scene *s = &im->scene;
    if (!mesh->name)
        mesh->name = mem_sprintf("mesh%zu", s->mesh_count);
    enum err e = mesh->name ? make_room(im, (void **)&s->meshes, s->mesh_count, &im->mesh_capacity,
                                        sizeof *s->meshes, SCENE_MESHES_MAX, "meshes")
                            : ERR_NOMEM;
    if (e != ERR_OK) {
        scene_mesh_release(mesh);
        return e;
    }
    for (size_t i = 0; mesh->normals && i < mesh->vertex_count; i++)
        settle_normal(mesh->normals + 3 * i);
    (void)model_fix_winding(mesh);
    put_index(s->mesh_count, out);
    s->meshes[s->mesh_count++] = *mesh;
    return ERR_OK;
}

enum err import_add_object(struct import *im, const struct scene_object *object)
{
    struct scene *s = &im->scene;
    TL_TRY(make_room(im, (void **)&s->objects, s->object_count, &im->object_capacity,
                     sizeof *s->objects, SCENE_OBJECTS_MAX, "objects"));
    s->objects[s->object_count++] = *object;
    return ERR_OK;
}

enum err import_add_light(struct import *im, const struct scene_light *light)
{
    struct scene *s = &im->scene;
    TL_TRY(make_room(im, (void **)&s->lights, s->light_count, &im->light_capacity,
                     sizeof *s->lights, SCENE_LIGHTS_MAX, "lights"));
    s->lights[s->light_count++] = *light;
    im->has_lamp = true;
    return ERR_OK;
}

/* A copy of `name` cut to the limit at a character, or `stem` and a number. */
static char *copy_name(const char *name, const char *stem, size_t number)
{
    if (!name || !*name)
        return mem_sprintf("%s%zu", stem, number);
    size_t bytes = strlen(name);
    size_t room = SCENE_NAME_BYTES_MAX - 16; /* for the number that makes it distinct */
    if (bytes > room)
        for (bytes = room; bytes > 0 && ((unsigned char)name[bytes] & 0xC0) == 0x80;)
            bytes--;
    return mem_strndup(name, bytes);
}

/* Two of one name would be one in a scene file: the later gets a number. */
static char *distinct_name(struct name_table *names, const char *name, const char *stem)
{
    size_t number = names->count;
    uint32_t index;
    char *made = copy_name(name, stem, number);
    while (made && name_table_find(names, made, strlen(made)) != UINT32_MAX) {
        mem_free(made);
        char *base = copy_name(name, stem, number);
        made = base ? mem_sprintf("%s.%zu", base, number++) : NULL;
        mem_free(base);
    }
    if (made && name_table_add(names, made, strlen(made), &index) != ERR_OK) {
        mem_free(made);
        made = NULL;
    }
    return made;
}

enum err import_add_material(struct import *im, struct scene_material *material, const char *name,
                             uint32_t *out)
{
    struct scene *s = &im->scene;
    TL_TRY(make_room(im, (void **)&s->materials, s->material_count, &im->material_capacity,
                     sizeof *s->materials, SCENE_MATERIALS_MAX, "materials"));
    material->name = distinct_name(&im->material_names, name, "material");
    if (!material->name)
        return ERR_NOMEM;
    put_index(s->material_count, out);
    s->materials[s->material_count++] = *material;
    return ERR_OK;
}

enum err import_add_texture(struct import *im, struct scene_texture *texture, const char *name,
                            uint32_t *out)
{
    struct scene *s = &im->scene;
    TL_TRY(make_room(im, (void **)&s->textures, s->texture_count, &im->texture_capacity,
                     sizeof *s->textures, SCENE_TEXTURES_MAX, "textures"));
    texture->name = distinct_name(&im->texture_names, name, "texture");
    if (!texture->name)
        return ERR_NOMEM;
    put_index(s->texture_count, out);
    s->textures[s->texture_count++] = *texture;
    return ERR_OK;
}

enum err import_add_image(struct import *im, struct scene_image *image, uint32_t *out)
{
    struct scene *s = &im->scene;
    enum err e = make_room(im, (void **)&s->images, s->image_count, &im->image_capacity,
                           sizeof *s->images, SCENE_TEXTURES_MAX, "images");
    if (e != ERR_OK) {
        mem_free(image->pixels);
        return e;
    }
    put_index(s->image_count, out);
    s->images[s->image_count++] = *image;
    return ERR_OK;
}

/* --- Transforms and bounds ----------------------------------------------- */

void import_transform_point(const double m[16], const double p[3], double out[3])
{
    for (size_t i = 0; i < 3; i++)
        out[i] = m[4 * i] * p[0] + m[4 * i + 1] * p[1] + m[4 * i + 2] * p[2] + m[4 * i + 3];
}

void import_transform_vector(const double m[16], const double v[3], double out[3])
{
    for (size_t i = 0; i < 3; i++)
        out[i] = m[4 * i] * v[0] + m[4 * i + 1] * v[1] + m[4 * i + 2] * v[2];
}

void import_transform_multiply(const double a[16], const double b[16], double out[16])
{
    for (size_t i = 0; i < 4; i++)
        for (size_t j = 0; j < 4; j++) {
            double sum = 0;
            for (size_t k = 0; k < 4; k++)
                sum += a[4 * i + k] * b[4 * k + j];
            out[4 * i + j] = sum;
        }
}

static void grow(const double p[3], double low[3], double high[3])
{
    for (int i = 0; i < 3; i++) {
        low[i] = fmin(low[i], p[i]);
        high[i] = fmax(high[i], p[i]);
    }
}

void import_bounds(const struct import *im, double low[3], double high[3])
{
    for (int i = 0; i < 3; i++) {
        low[i] = HUGE_VAL;
        high[i] = -HUGE_VAL;
    }
    for (size_t o = 0; o < im->scene.object_count; o++) {
        const struct scene_object *object = &im->scene.objects[o];
        const struct scene_mesh *m = &im->scene.meshes[object->mesh];
        for (size_t i = 0; i < 3 * (size_t)m->triangle_count; i++) {
            double p[3];
            import_transform_point(object->transform, m->positions + 3 * (size_t)m->indices[i], p);
            grow(p, low, high);
        }
    }
}
