#include "client/import_gltf.h"

#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "client/import_wire.h"
#include "common/buf.h"
#include "common/file_io.h"
#include "common/mem.h"

enum { GLB_JSON = 0x4E4F534A, GLB_BIN = 0x004E4942 };

/* Extensions that a model may require: what they say is in the picture. */
static const char *const known_extensions[] = {
    "KHR_texture_transform",
    "KHR_lights_punctual",
    "KHR_materials_unlit",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_materials_clearcoat",
    "KHR_materials_sheen",
    "KHR_materials_variants",
    "KHR_materials_pbrSpecularGlossiness",
    "EXT_mesh_gpu_instancing",
    "KHR_mesh_quantization",
    "KHR_xmp",
    "KHR_xmp_json_ld",
};

/* --- Opening ------------------------------------------------------------- */

static enum err broken_glb(struct import *im, const char *what)
{
    return import_fail(im, "bad-glb", "export the model again", "damaged GLB file: %s", what);
}

/* The JSON text of a file that is no GLB; junk under a glTF name is told from broken JSON. */
static enum err take_json(struct import *im, const char *data, size_t bytes, const char **text,
                          size_t *text_bytes)
{
    static const char mark[] = "\xEF\xBB\xBF";
    size_t skip = bytes >= 3 && memcmp(data, mark, 3) == 0 ? 3 : 0, first = skip;
    while (first < bytes && data[first] && strchr(" \t\r\n", data[first]))
        first++;
    if (first == bytes || data[first] != '{')
        return import_fail(im, "unknown-format", "export the model again",
                           "neither GLB, which starts with \"glTF\", nor glTF's JSON");
    *text = data + skip;
    *text_bytes = bytes - skip;
    return ERR_OK;
}

/* The JSON text of a GLB file, and its binary chunk. */
static enum err split_glb(struct gltf *t, const char *data, size_t bytes, const char **text,
                          size_t *text_bytes)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    (void)buf_get_u32(&in);
    uint32_t version = buf_get_u32(&in), length = buf_get_u32(&in);
    if (in.failed || length > bytes)
        return broken_glb(t->im, "it is shorter than its header says");
    if (version != 2)
        return import_fail(t->im, "gltf-version", NULL, "GLB version %u, expected 2", version);
    in = buf_reader_of(data + 12, length < 12 ? 0 : length - 12);
    for (int i = 0; buf_left(&in) >= 8; i++) {
        uint32_t chunk_bytes = buf_get_u32(&in), type = buf_get_u32(&in);
        const unsigned char *chunk = buf_get(&in, chunk_bytes);
        if (!chunk)
            return broken_glb(t->im, "a chunk is longer than the file");
        if (i == 0 && type != GLB_JSON)
            return broken_glb(t->im, "its first chunk is no JSON");
        if (i == 0) {
            *text = (const char *)chunk;
            *text_bytes = chunk_bytes;
        } else if (i == 1 && type == GLB_BIN) {
            t->bin = chunk;
            t->bin_bytes = chunk_bytes;
        }
    }
    return *text ? ERR_OK : broken_glb(t->im, "it has no JSON");
}

static enum err fill_table(struct gltf *t, enum gltf_table_id id, const struct json *v)
{
    struct gltf_table *table = &t->tables[id];
    if (!v)
        return ERR_OK;
    if (!json_get_is(&t->g, v, JSON_ARRAY))
        return ERR_INPUT;
    table->items = mem_alloc_array(v->count, sizeof *table->items);
    if (!table->items)
        return ERR_NOMEM;
    for (const struct json *e = v->first; e; e = e->next) {
        if (!json_get_is(&t->g, e, JSON_OBJECT))
            return ERR_INPUT;
        table->items[table->count++] = e;
    }
    return ERR_OK;
}

static enum err fill_tables(struct gltf *t)
{
    static const char *const keys[GLTF_TABLE_COUNT] = {
        [GLTF_ACCESSORS] = "accessors", [GLTF_BUFFER_VIEWS] = "bufferViews",
        [GLTF_BUFFERS] = "buffers",     [GLTF_CAMERAS] = "cameras",
        [GLTF_IMAGES] = "images",       [GLTF_LIGHTS] = "lights",
        [GLTF_MATERIALS] = "materials", [GLTF_MESHES] = "meshes",
        [GLTF_NODES] = "nodes",         [GLTF_SAMPLERS] = "samplers",
        [GLTF_SCENES] = "scenes",       [GLTF_TEXTURES] = "textures"};
    enum err worst = ERR_OK;
    for (int i = 0; i < GLTF_TABLE_COUNT; i++) {
        const struct json *holder =
            i == GLTF_LIGHTS ? gltf_extension(t->g.root, "KHR_lights_punctual") : t->g.root;
        enum err e = fill_table(t, (enum gltf_table_id)i, json_get_member(holder, keys[i]));
        if (e == ERR_NOMEM)
            return e;
        worst = e != ERR_OK ? e : worst;
    }
    return worst;
}

enum err gltf_open(struct gltf *t, struct import *im, const char *data, size_t bytes)
{
    const char *text = NULL;
    size_t text_bytes = 0;
    *t = (struct gltf){.im = im};
    if (bytes >= 4 && memcmp(data, "glTF", 4) == 0)
        TL_TRY(split_glb(t, data, bytes, &text, &text_bytes));
    else
        TL_TRY(take_json(im, data, bytes, &text, &text_bytes));
    TL_TRY(json_get_open(&t->g, text, text_bytes, im->path, im->problems));
    enum err e = json_get_is(&t->g, t->g.root, JSON_OBJECT) ? fill_tables(t) : ERR_INPUT;
    if (e != ERR_OK)
        gltf_close(t);
    return e;
}

void gltf_close(struct gltf *t)
{
    for (size_t i = 0; t->buffers && i < t->tables[GLTF_BUFFERS].count; i++)
        mem_free(t->buffers[i].owned);
    mem_free(t->buffers);
    for (int i = 0; i < GLTF_TABLE_COUNT; i++)
        mem_free(t->tables[i].items);
    mem_free(t->order);
    mem_free(t->material_of);
    mem_free(t->emission);
    mem_free(t->uv_sets);
    mem_free(t->object_nodes);
    json_get_close(&t->g);
}

/* --- Getters ------------------------------------------------------------- */

const struct json *gltf_reference(struct gltf *t, const struct json *v, const char *key,
                                  enum gltf_table_id table, uint32_t *index)
{
    const struct json *member = json_get_member(v, key);
    return member ? gltf_entry(t, member, table, index) : NULL;
}

const struct json *gltf_entry(struct gltf *t, const struct json *member, enum gltf_table_id table,
                              uint32_t *index)
{
    uint64_t i;
    if (!json_value_uint(&t->g, member, 0, UINT32_MAX - 1, &i))
        return NULL;
    if (i >= t->tables[table].count) {
        json_get_problem(&t->g, DIAG_ERROR, member, "bad-index", NULL,
                         "%llu is out of range, expected under %zu", (unsigned long long)i,
                         t->tables[table].count);
        return NULL;
    }
    *index = (uint32_t)i;
    return t->tables[table].items[i];
}

const struct json *gltf_extension(const struct json *v, const char *name)
{
    return json_get_member(json_get_member(v, "extensions"), name);
}

static double clamped(double v, double low, double high)
{
    return v < low ? low : v > high ? high : v;
}

void gltf_number(struct gltf *t, const struct json *v, const char *key, double low, double high,
                 double *out)
{
    gltf_numbers(t, v, key, 0, low, high, out);
}

void gltf_numbers(struct gltf *t, const struct json *v, const char *key, size_t count, double low,
                  double high, double *out)
{
    const struct json *member = json_get_member(v, key);
    double values[16];
    const double limit = SCENE_NUMBER_MAX;
    bool good =
        member && (count == 0 ? json_value_number(&t->g, member, -limit, limit, values)
                              : json_value_numbers(&t->g, member, count, -limit, limit, values));
    for (size_t i = 0; good && i < (count ? count : 1); i++)
        out[i] = clamped(values[i], low, high);
}

/* --- What must be understood --------------------------------------------- */

static bool is_known(const char *name)
{
    for (size_t i = 0; i < sizeof known_extensions / sizeof *known_extensions; i++)
        if (strcmp(known_extensions[i], name) == 0)
            return true;
    return false;
}

static bool is_listed(const struct json *list, const char *name)
{
    for (const struct json *e = list ? list->first : NULL; e; e = e->next)
        if (e->type == JSON_STRING && strcmp(e->text, name) == 0)
            return true;
    return false;
}

static const char *extension_hint(const char *name)
{
    if (strstr(name, "draco") || strstr(name, "meshopt"))
        return "export the model without compression of its meshes";
    if (strstr(name, "texture_"))
        return "the picture would be wrong without it; use PNG or JPEG textures";
    return "the picture would be wrong without it";
}

static enum err check_extensions(struct gltf *t)
{
    const struct json *required = json_get_member(t->g.root, "extensionsRequired");
    const struct json *used = json_get_member(t->g.root, "extensionsUsed");
    enum err e = ERR_OK;
    if (required && !json_get_is(&t->g, required, JSON_ARRAY))
        return ERR_INPUT;
    for (const struct json *v = required ? required->first : NULL; v; v = v->next) {
        const char *name;
        if (!json_value_text(&t->g, v, true, &name)) {
            e = ERR_INPUT;
        } else if (!is_known(name)) {
            json_get_problem(&t->g, DIAG_ERROR, v, "gltf-extension", extension_hint(name),
                             "%.200s is not supported", name);
            e = ERR_INPUT;
        }
    }
    if (!used || used->type != JSON_ARRAY)
        return e;
    for (const struct json *v = used->first; v && e == ERR_OK; v = v->next)
        if (v->type == JSON_STRING && !is_known(v->text) && !is_listed(required, v->text))
            json_get_problem(&t->g, DIAG_WARNING, v, "gltf-extension", NULL, "%.200s is left out",
                             v->text);
    return e;
}

/* The major version; 0 and a problem when there is none. */
static int version_of(struct gltf *t)
{
    const struct json *asset = json_get_required(&t->g, t->g.root, "asset");
    const struct json *v = asset ? json_get_required(&t->g, asset, "version") : NULL;
    const char *text;
    if (!v || !json_value_text(&t->g, v, false, &text))
        return 0;
    const struct json *least = json_get_member(asset, "minVersion");
    if (least && least->type == JSON_STRING && strcmp(least->text, "2.0") != 0) {
        json_get_problem(&t->g, DIAG_ERROR, least, "gltf-version", NULL,
                         "needs glTF %.20s, we read 2.0", least->text);
        return 0;
    }
    if ((text[0] == '1' || text[0] == '2') && text[1] == '.')
        return text[0] - '0';
    json_get_problem(&t->g, DIAG_ERROR, v, "gltf-version", NULL,
                     "glTF version \"%.20s\", expected 2.0", text);
    return 0;
}

/* --- Putting it together ------------------------------------------------- */

/* The JSON's material for one that the child named "NUMBER:NAME": the number by assimp's order,
 * unless the name is that of one other material only. The count of materials: the default. */
static size_t material_index(const struct gltf *t, const char *told)
{
    const struct gltf_table *materials = &t->tables[GLTF_MATERIALS];
    size_t number = 0, found = materials->count, same = 0;
    for (; *told >= '0' && *told <= '9' && number < SCENE_MATERIALS_MAX; told++)
        number = number * 10 + (size_t)(*told - '0');
    if (number >= t->order_count)
        return materials->count;
    const char *name = *told ? told + 1 : told;
    for (size_t i = 0; i < materials->count; i++) {
        const struct json *v = json_get_member(materials->items[i], "name");
        if (!v || v->type != JSON_STRING || strcmp(v->text, name) != 0)
            continue;
        if (i == t->order[number])
            return i;
        found = i;
        same++;
    }
    return same == 1 ? found : t->order[number];
}

/* Gives the geometry, whose materials are numbers, the materials of the JSON. */
static void join_materials(struct gltf *t, const struct import *geometry)
{
    struct scene *s = &t->im->scene;
    bool default_used = false;
    for (size_t i = 0; i < s->object_count; i++) {
        struct scene_object *o = &s->objects[i];
        size_t n = t->tables[GLTF_MATERIALS].count;
        if (o->material != SCENE_NONE)
            n = material_index(t, geometry->scene.materials[o->material].name);
        default_used |= n == t->tables[GLTF_MATERIALS].count;
        o->material = t->material_of[n];
        memcpy(o->radiance, t->emission[n], sizeof o->radiance);
        o->emits = o->radiance[0] > 0 || o->radiance[1] > 0 || o->radiance[2] > 0;
        for (int c = 0; c < 3; c++)
            t->im->has_lamp |= o->emits && o->radiance[c] > 1;
        if (s->materials[o->material].emission_twosided) { /* then it is the material's */
            memset(o->radiance, 0, sizeof o->radiance);
            o->emits = false;
        }
    }
    if (!default_used) /* it was added last */
        mem_free(s->materials[--s->material_count].name);
}

/* Moves meshes and objects from the child's scene to ours. */
static void take_geometry(struct gltf *t, struct import *geometry)
{
    struct scene *to = &t->im->scene, *from = &geometry->scene;
    to->meshes = from->meshes;
    to->mesh_count = from->mesh_count;
    to->objects = from->objects;
    to->object_count = from->object_count;
    t->im->mesh_capacity = to->mesh_count;
    t->im->object_capacity = to->object_count;
    t->im->vertex_count += geometry->vertex_count;
    t->im->point_count += geometry->point_count;
    t->im->line_count += geometry->line_count;
    t->object_nodes = geometry->object_nodes;
    t->object_node_count = geometry->object_node_count;
    geometry->object_nodes = NULL;
    from->meshes = NULL;
    from->objects = NULL;
    from->mesh_count = 0;
    from->object_count = 0;
    join_materials(t, geometry);
}

static char *uv_set_text(const struct gltf *t)
{
    char *text = mem_alloc(t->order_count + 2);
    if (!text)
        return NULL;
    for (size_t i = 0; i < t->order_count; i++)
        text[i] = (char)('0' + t->uv_sets[t->order[i]]);
    text[t->order_count] = '0'; /* the default material; never an empty text */
    text[t->order_count + 1] = '\0';
    return text;
}

static enum err read_geometry(struct gltf *t, uint64_t bytes)
{
    struct import geometry;
    char *uv_sets = uv_set_text(t);
    enum err e = uv_sets ? import_init(&geometry, t->im->path, t->im->problems) : ERR_NOMEM;
    if (e == ERR_OK) {
        e = import_child_run(&geometry, uv_sets, bytes);
        if (e == ERR_OK)
            take_geometry(t, &geometry);
        import_release(&geometry);
    }
    mem_free(uv_sets);
    return e;
}

static enum err import_parts(struct gltf *t, uint64_t bytes)
{
    size_t errors = t->im->problems->error_count;
    enum err e = check_extensions(t), checked = gltf_check(t, &bytes);
    if (e != ERR_OK || checked != ERR_OK)
        return e != ERR_OK ? e : checked;
    TL_TRY(gltf_order(t));
    TL_TRY(gltf_materials(t));
    if (t->im->problems->error_count != errors)
        return ERR_INPUT;
    TL_TRY(read_geometry(t, bytes));
    TL_TRY(gltf_nodes(t));
    return t->im->problems->error_count == errors ? ERR_OK : ERR_INPUT;
}

enum err import_gltf(struct import *im, const char *data, size_t bytes)
{
    struct gltf t;
    TL_TRY(gltf_open(&t, im, data, bytes));
    int version = version_of(&t);
    enum err e = version == 2 ? import_parts(&t, bytes) : ERR_INPUT;
    gltf_close(&t);
    return version == 1 ? import_other(im) : e;
}

enum err import_other(struct import *im)
{
    struct stat st;
    uint64_t bytes = stat(im->path, &st) == 0 ? (uint64_t)st.st_size : 0;
    return import_child_run(im, NULL, bytes);
}
