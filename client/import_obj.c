/* client/import_obj.c: OBJ with its material libraries, and PLY, as a whole scene.
 *
 * Parsers lie in common/; here is what meshes, groups and materials become. One thread.
 */
#include <math.h>
#include <string.h>
#include <unistd.h>

#include "client/import_model.h"
#include "common/file_io.h"
#include "common/mem.h"
#include "common/mtl_file.h"
#include "common/obj_file.h"
#include "common/obj_mesh.h"
#include "common/ply_file.h"

#define LIBRARY_BYTES_MAX (UINT64_C(64) << 20)

/* The libraries of one model, with the folder of each relative to the model's. */
struct shelf {
    struct mtl_library *libraries;
    char **folders;
    size_t count, capacity, folder_capacity;
};

static void shelf_release(struct shelf *s)
{
    for (size_t i = 0; i < s->count; i++) {
        mtl_release(&s->libraries[i]);
        mem_free(s->folders[i]);
    }
    mem_free(s->libraries);
    mem_free(s->folders);
}

/* --- Finding material libraries ------------------------------------------ */

static bool file_exists(const struct import *im, const char *path)
{
    char *joined = file_join(im->folder, path);
    bool exists = joined && access(joined, R_OK) == 0;
    mem_free(joined);
    return exists;
}

static enum err put_on_shelf(struct shelf *s, struct mtl_library *library, const char *path)
{
    char *folder = file_folder(path);
    bool good = folder &&
                mem_grow((void **)&s->libraries, s->count, &s->capacity, sizeof *s->libraries) &&
                mem_grow((void **)&s->folders, s->count, &s->folder_capacity, sizeof *s->folders);
    if (!good) {
        mem_free(folder);
        mtl_release(library);
        return ERR_NOMEM;
    }
    s->libraries[s->count] = *library;
    s->folders[s->count++] = folder;
    return ERR_OK;
}

static enum err read_library(struct import *im, struct shelf *s, const char *path)
{
    char *joined = file_join(im->folder, path);
    char *text = NULL;
    size_t bytes;
    struct mtl_library library;
    enum err e = joined ? file_read(joined, LIBRARY_BYTES_MAX, &text, &bytes) : ERR_NOMEM;
    if (e == ERR_OK) {
        im->source_bytes += bytes;
        e = mtl_read(text, bytes, joined, &library, im->problems);
        if (e == ERR_OK)
            e = put_on_shelf(s, &library, path);
    } else if (e != ERR_NOMEM) {
        import_warn(im, "unreadable-file", "its materials are shown in grey",
                    "material library \"%s\": %s", path, err_text(e));
        e = ERR_OK;
    }
    mem_free(text);
    mem_free(joined);
    return e;
}

/* The library as written; else beside the model, if it was written with the folders of another
 * machine. */
static const char *library_place(const struct import *im, const char *written)
{
    const char *slash = strrchr(written, '/');
    if (file_exists(im, written))
        return written;
    return slash && slash[1] && file_exists(im, slash + 1) ? slash + 1 : NULL;
}

static enum err find_library(struct import *im, struct shelf *s, const char *written)
{
    const char *place = library_place(im, written);
    if (place)
        return read_library(im, s, place);
    import_warn(im, "missing-mtl", "its materials are shown in grey", "no material library \"%s\"",
                written);
    return ERR_OK;
}

/* One mtllib line names one file that may hold blanks, or several files. */
static enum err find_libraries_of_line(struct import *im, struct shelf *s, char *line)
{
    for (char *c = line; *c; c++)
        if (*c == '\\')
            *c = '/';
    bool is_list = strpbrk(line, " \t") && !library_place(im, line);
    if (!is_list)
        return find_library(im, s, line);
    char *save = NULL;
    bool any = false;
    char *words = mem_strdup(line);
    if (!words)
        return ERR_NOMEM;
    for (char *w = strtok_r(words, " \t", &save); w && !any; w = strtok_r(NULL, " \t", &save))
        any = library_place(im, w) != NULL;
    mem_free(words);
    if (!any)
        return find_library(im, s, line);
    enum err e = ERR_OK;
    for (char *w = strtok_r(line, " \t", &save); w && e == ERR_OK; w = strtok_r(NULL, " \t", &save))
        e = find_library(im, s, w);
    return e;
}

static enum err find_libraries(struct import *im, const struct obj_model *model, struct shelf *s)
{
    for (size_t i = 0; i < model->library_count; i++) {
        char *line = mem_strdup(model->libraries[i]);
        enum err e = line ? find_libraries_of_line(im, s, line) : ERR_NOMEM;
        mem_free(line);
        if (e != ERR_OK)
            return e;
    }
    return ERR_OK;
}

static const struct mtl_material *find_material(const struct shelf *s, const char *name,
                                                const char **folder)
{
    for (size_t i = 0; i < s->count; i++)
        for (size_t j = 0; j < s->libraries[i].count; j++)
            if (strcmp(s->libraries[i].materials[j].name, name) == 0) {
                *folder = s->folders[i];
                return &s->libraries[i].materials[j];
            }
    return NULL;
}

/* --- Textures ------------------------------------------------------------ */

/* A map's picture beside its library, else beside the model. */
static enum err map_image(struct import *im, const char *folder, const char *path,
                          enum image_use use, uint32_t *image)
{
    char *beside = strcmp(folder, ".") == 0 ? mem_strdup(path) : file_join(folder, path);
    if (!beside)
        return ERR_NOMEM;
    const char *name = strrchr(path, '/');
    const char *chosen = beside;
    if (!file_exists(im, beside)) {
        if (file_exists(im, path))
            chosen = path;
        else if (name && file_exists(im, name + 1))
            chosen = name + 1;
    }
    enum err e = import_image_file(im, chosen, use, image);
    mem_free(beside);
    return e;
}

/* SCENE_NONE in *out when there is no map or it cannot be had. */
static enum err map_texture(struct import *im, const char *folder, const struct mtl_map *map,
                            enum image_use use, uint32_t *out)
{
    *out = SCENE_NONE;
    if (!map->path)
        return ERR_OK;
    struct scene_texture t;
    scene_image_texture_init(&t);
    TL_TRY(map_image(im, folder, map->path, use, &t.image));
    if (t.image == SCENE_NONE)
        return ERR_OK;
    t.uv_matrix[0] = map->scale[0];
    t.uv_matrix[2] = map->offset[0];
    t.uv_matrix[4] = map->scale[1];
    t.uv_matrix[5] = map->offset[1];
    t.wrap[0] = t.wrap[1] = map->clamp ? SCENE_WRAP_CLAMP : SCENE_WRAP_REPEAT;
    return import_add_texture(im, &t, map->path, out);
}

static enum err take_relief(struct import *im, const char *folder, const struct mtl_material *m,
                            struct scene_material *out)
{
    if (m->maps[MTL_MAP_NORMAL].path) {
        out->normal_scale = m->maps[MTL_MAP_NORMAL].bump;
        return map_texture(im, folder, &m->maps[MTL_MAP_NORMAL], IMAGE_DATA, &out->normal_texture);
    }
    uint32_t t;
    TL_TRY(map_texture(im, folder, &m->maps[MTL_MAP_BUMP], IMAGE_DATA, &t));
    if (t == SCENE_NONE)
        return ERR_OK;
    if (import_is_normal_map(&im->scene.images[im->scene.textures[t].image])) {
        out->normal_texture = t;
        out->normal_scale = m->maps[MTL_MAP_BUMP].bump;
    } else {
        out->bump_texture = t;
        out->bump_scale = m->maps[MTL_MAP_BUMP].bump;
    }
    return ERR_OK;
}

/* Green and blue of one picture are our roughness and metalness. A grey map_Pr gives roughness
 * where nothing is metal; one picture for both is taken to be packed so. Others are left out. */
static enum err take_roughness(struct import *im, const char *folder, const struct mtl_material *m,
                               struct scene_material *out)
{
    const struct mtl_map *rough = &m->maps[MTL_MAP_PR], *metal = &m->maps[MTL_MAP_PM];
    bool packed = rough->path && metal->path && strcmp(rough->path, metal->path) == 0;
    bool is_metal = m->has_metallic && m->metallic > 0;
    bool taken = packed || (rough->path && !metal->path && !is_metal);
    if (taken)
        TL_TRY(map_texture(im, folder, rough, IMAGE_DATA, &out->metallic_roughness_texture));
    bool left_out = m->maps[MTL_MAP_KS].path || (!taken && (rough->path || metal->path));
    if (left_out && import_once(im, IMPORT_ONCE_DETAIL_MAP))
        import_warn(im, "left-out", NULL,
                    "textures of highlights (map_Ks), of metalness, and of roughness on metals are "
                    "left out; their numbers are used");
    if (out->metallic_roughness_texture == SCENE_NONE)
        return ERR_OK;
    out->roughness = m->has_roughness && m->roughness > 0 ? m->roughness : 1;
    out->metallic = !packed ? 0 : is_metal ? m->metallic : 1;
    return ERR_OK;
}

/* --- Materials ----------------------------------------------------------- */

static double largest(const double c[3])
{
    return fmax(c[0], fmax(c[1], c[2]));
}

static void set_color(double out[3], const double c[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = fmin(c[i], 1);
}

static bool is_glass(const struct mtl_material *m)
{
    return m->illum == 6 || m->illum == 7 || ((m->illum == 4 || m->illum == 9) && m->opacity < 1);
}

static bool is_mirror(const struct mtl_material *m)
{
    return (m->illum == 3 || m->illum == 5 || m->illum == 8) && largest(m->ks) >= 0.5 &&
           largest(m->kd) <= 0.2 && !m->has_roughness && (m->ns >= 100 || m->ns == 0);
}

/* Highlights: Blinn's exponent as microfacets of the same width; Ks of 1/2 is what exporters write
 * for the 4 % of common plastics. */
static void set_highlight(const struct mtl_material *m, struct scene_material *out)
{
    double alpha = sqrt(2 / (m->ns + 2));
    double ks = largest(m->ks);
    if (m->ni > 1)
        out->eta = m->ni;
    if (out->metallic_roughness_texture != SCENE_NONE) /* take_roughness has set them */
        return;
    out->roughness = m->has_roughness ? m->roughness : sqrt(alpha);
    out->metallic = m->has_metallic ? m->metallic : 0;
    if (m->has_roughness || m->has_metallic)
        return;
    if (largest(m->kd) < 0.02 && ks > 0) {
        out->metallic = 1;
        set_color(out->color, m->ks);
        return;
    }
    out->eta = 1.5;
    out->specular = fmin(2 * ks, 1);
    for (int i = 0; i < 3 && ks > 0; i++)
        out->specular_color[i] = m->ks[i] / ks;
}

static bool needs_principled(const struct mtl_material *m, const struct scene_material *out)
{
    return m->has_roughness || m->has_metallic || largest(m->ks) > 0 || out->alpha_used ||
           m->sheen > 0 || m->clearcoat > 0 || out->emission_texture != SCENE_NONE ||
           out->normal_texture != SCENE_NONE || out->metallic_roughness_texture != SCENE_NONE;
}

static void set_principled(const struct mtl_material *m, struct scene_material *out)
{
    out->type = SCENE_MATERIAL_PRINCIPLED;
    out->clearcoat = m->clearcoat;
    out->clearcoat_roughness = m->clearcoat_roughness;
    for (int i = 0; i < 3; i++)
        out->sheen_color[i] = m->sheen;
    out->sheen_roughness = m->sheen > 0 ? 0.5 : 0;
    set_highlight(m, out);
}

static void set_opacity(struct import *im, const struct mtl_material *m, struct scene_material *out)
{
    const char *alpha = m->maps[MTL_MAP_D].path, *color = m->maps[MTL_MAP_KD].path;
    if (m->opacity > 0 && m->opacity < 1) {
        out->alpha = m->opacity;
        out->alpha_used = true;
    }
    if (alpha && color && strcmp(alpha, color) == 0 && out->texture != SCENE_NONE)
        out->alpha_used = true;
    else if (alpha && import_once(im, IMPORT_ONCE_ALPHA_MAP))
        import_warn(im, "alpha-map-left-out", "put the opacity into the alpha of map_Kd",
                    "opacity maps (map_d) of their own are left out");
}

static enum err make_material(struct import *im, const char *folder, const struct mtl_material *m,
                              struct scene_material *out)
{
    scene_material_init(out);
    out->twosided = true;
    TL_TRY(take_relief(im, folder, m, out));
    if ((is_glass(m) || is_mirror(m)) && out->normal_texture != SCENE_NONE) {
        out->normal_texture = SCENE_NONE;
        if (import_once(im, IMPORT_ONCE_NORMAL_MAP))
            import_warn(im, "left-out", NULL, "normal maps of glass and mirrors are left out");
    }
    if (is_glass(m)) {
        out->type = SCENE_MATERIAL_GLASS;
        out->eta = m->ni > 1 ? m->ni : 1.5;
        set_color(out->T, m->tf);
        return ERR_OK;
    }
    if (is_mirror(m)) {
        out->type = SCENE_MATERIAL_MIRROR;
        set_color(out->R, m->ks);
        return ERR_OK;
    }
    TL_TRY(map_texture(im, folder, &m->maps[MTL_MAP_KD], IMAGE_COLOR, &out->texture));
    TL_TRY(map_texture(im, folder, &m->maps[MTL_MAP_KE], IMAGE_COLOR, &out->emission_texture));
    TL_TRY(take_roughness(im, folder, m, out));
    /* Exporters write Kd 0 or leave it out beside a picture that is meant as it is. */
    static const double white[3] = {1, 1, 1};
    bool plain = out->texture != SCENE_NONE && (!m->has_kd || largest(m->kd) <= 0);
    set_color(out->color, plain ? white : m->kd);
    set_opacity(im, m, out);
    if (out->emission_texture != SCENE_NONE)
        for (int i = 0; i < 3; i++)
            out->emission[i] = m->has_ke && largest(m->ke) > 0 ? m->ke[i] : 1;
    if (needs_principled(m, out))
        set_principled(m, out);
    return ERR_OK;
}

/* What the material emits by itself. Files without Ke mark lamps by an ambient colour that no
 * surface could have. */
static bool emission_of(const struct mtl_material *m, const struct scene_material *material,
                        double radiance[3])
{
    bool ambient = !m->has_ke && largest(m->ka) > 1;
    if (material->emission_texture != SCENE_NONE || !(ambient || largest(m->ke) > 0))
        return false;
    memcpy(radiance, ambient ? m->ka : m->ke, 3 * sizeof *radiance);
    return true;
}

/* --- The model ----------------------------------------------------------- */

/* Materials used but not found, in one sentence. */
static void tell_unknown(struct import *im, const struct shelf *s, const char *name, size_t *told)
{
    if (s->count > 0 && (*told)++ < 5)
        import_warn(im, "unknown-material", "it is shown in grey",
                    "no material \"%s\" in its libraries", name);
}

/* White under colours of its own. */
static void plain_material(bool colored, struct scene_material *out)
{
    scene_material_init(out);
    out->twosided = true;
    out->color[0] = out->color[1] = out->color[2] = colored ? 1 : 0.7;
}

static enum err add_part(struct import *im, const struct obj_model *model, const struct shelf *s,
                         uint32_t index, size_t *told)
{
    const char *name = index == OBJ_NONE ? "" : model->material_names[index];
    const char *folder = ".";
    const struct mtl_material *m = find_material(s, name, &folder);
    struct scene_object object;
    struct scene_material material;
    struct scene_mesh mesh;
    scene_object_init(&object);
    if (!m && *name)
        tell_unknown(im, s, name, told);
    plain_material(model->colors != NULL, &material);
    if (m)
        TL_TRY(make_material(im, folder, m, &material));
    object.emits = m && emission_of(m, &material, object.radiance);
    im->has_lamp |= object.emits && largest(object.radiance) > 1;
    TL_TRY(import_add_material(im, &material, *name ? name : "default", &object.material));
    TL_TRY(obj_mesh(model, index, &mesh));
    mesh.name = mem_strndup(*name ? name : "default", SCENE_NAME_BYTES_MAX);
    TL_TRY(import_add_mesh(im, &mesh, &object.mesh));
    return import_add_object(im, &object);
}

static enum err add_parts(struct import *im, const struct obj_model *model, const struct shelf *s)
{
    bool *used = mem_calloc(model->material_count + 1, sizeof *used);
    if (!used)
        return ERR_NOMEM;
    for (size_t i = 0; i < model->triangle_count; i++) {
        uint32_t m = model->triangles[i].material;
        used[m == OBJ_NONE ? model->material_count : m] = true;
    }
    size_t told = 0;
    enum err e = ERR_OK;
    for (size_t i = 0; i <= model->material_count && e == ERR_OK; i++)
        if (used[i])
            e = add_part(im, model, s, i == model->material_count ? OBJ_NONE : (uint32_t)i, &told);
    mem_free(used);
    return e;
}

/* A header that names a colour where vertices have none gives it to faces. */
static void tell_ply_face_colors(struct import *im, const char *data, size_t bytes)
{
    size_t head = bytes < 8192 ? bytes : 8192;
    const char *end = memmem(data, head, "end_header", 10);
    if (end && memmem(data, (size_t)(end - data), " red", 4))
        import_warn(im, "left-out", NULL, "colours of faces are left out");
}

/* MeshLab's name of the picture: "comment TextureFile NAME", a line of the header. You own it;
 * NULL: none, or out of memory. */
static char *ply_texture_name(const char *data, size_t bytes)
{
    static const char key[] = "comment TextureFile ";
    size_t head = bytes < 8192 ? bytes : 8192;
    const char *end = memmem(data, head, "end_header", 10);
    const char *at = end ? memmem(data, (size_t)(end - data), key, sizeof key - 1) : NULL;
    if (!at)
        return NULL;
    at += sizeof key - 1;
    size_t length = 0;
    while (at + length < end && at[length] != '\n' && at[length] != '\r' && at[length] != '\0')
        length++;
    return length ? mem_sprintf("%.*s", (int)length, at) : NULL;
}

/* The picture that the file names for its coordinates. */
static enum err ply_texture(struct import *im, const char *data, size_t bytes,
                            struct scene_material *material)
{
    char *name = ply_texture_name(data, bytes);
    if (!name)
        return ERR_OK;
    struct scene_texture t;
    scene_image_texture_init(&t);
    enum err e = map_image(im, ".", name, IMAGE_COLOR, &t.image);
    if (e == ERR_OK && t.image != SCENE_NONE) {
        e = import_add_texture(im, &t, name, &material->texture);
        for (int k = 0; k < 3; k++)
            material->color[k] = 1;
    }
    mem_free(name);
    return e;
}

enum err import_obj(struct import *im, const char *text, size_t bytes)
{
    struct obj_model model;
    struct shelf shelf = {0};
    TL_TRY(obj_read(text, bytes, im->path, &model, im->problems));
    im->vertex_count += model.position_count;
    im->point_count += model.point_count;
    im->line_count += model.line_count;
    im->unsmoothed_count += model.unsmoothed_count;
    enum err e = find_libraries(im, &model, &shelf);
    if (e == ERR_OK)
        e = add_parts(im, &model, &shelf);
    shelf_release(&shelf);
    obj_release(&model);
    return e;
}

/* True if some vertices can be seen through and some not: opacity that is meant. Many programs
 * write one number everywhere. */
static bool alphas_tell(const struct scene_mesh *m)
{
    bool clear = false, opaque = false;
    for (size_t i = 0; m->alphas && i < m->vertex_count; i++) {
        clear |= m->alphas[i] < 1;
        opaque |= m->alphas[i] > 0;
    }
    return clear && opaque;
}

enum err import_ply(struct import *im, const char *data, size_t bytes)
{
    struct scene_mesh mesh;
    struct scene_material material;
    struct scene_object object;
    scene_object_init(&object);
    TL_TRY(ply_read_mesh(data, bytes, im->path, &mesh, im->problems));
    bool has_uvs = mesh.uvs != NULL;
    plain_material(mesh.colors != NULL, &material);
    if (alphas_tell(&mesh)) {
        material.type = SCENE_MATERIAL_PRINCIPLED;
        material.distribution = SCENE_GGX;
        material.specular = 0;
        material.alpha_used = true;
    }
    if (!mesh.colors)
        tell_ply_face_colors(im, data, bytes);
    TL_TRY(import_add_mesh(im, &mesh, &object.mesh));
    if (has_uvs)
        TL_TRY(ply_texture(im, data, bytes, &material));
    TL_TRY(import_add_material(im, &material, "default", &object.material));
    return import_add_object(im, &object);
}
