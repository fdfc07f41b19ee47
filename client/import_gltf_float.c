/* glTF documents whose vertices are kept in integers, rewritten with floats.
 *
 * The core allows normalised integers for texture coordinates and weights,
 * KHR_mesh_quantization for everything; assimp 5.2.5 takes their bytes for floats. So the
 * child gives it a document in which such accessors point into one more buffer.
 */
#include <string.h>

#include "client/import_gltf.h"
#include "common/json_put.h"
#include "common/mem.h"

struct rewrite {
    struct gltf *t;
    unsigned char *width; /* of each accessor: components to make floats, 0: leave it */
    uint64_t *offset;     /* of each such accessor in the new buffer */
    uint32_t *view;       /* its new buffer view */
    uint32_t view_count;  /* new ones */
    struct buf *doc, *floats;
};

/* --- Which accessors ----------------------------------------------------- */

static bool wants_floats(const char *attribute)
{
    static const char *const stems[] = {"POSITION",  "NORMAL",   "TANGENT",
                                        "TEXCOORD_", "WEIGHTS_", "COLOR_"};
    for (size_t i = 0; i < sizeof stems / sizeof *stems; i++)
        if (strncmp(attribute, stems[i], strlen(stems[i])) == 0)
            return true;
    return false;
}

static unsigned char width_of(const struct json *accessor)
{
    const struct json *type = json_get_member(accessor, "type");
    if (!type || type->type != JSON_STRING || strncmp(type->text, "VEC", 3) != 0)
        return 0;
    return type->text[3] >= '2' && type->text[3] <= '4' ? (unsigned char)(type->text[3] - '0') : 0;
}

static void mark_attributes(struct rewrite *r, const struct json *list)
{
    for (const struct json *a = list ? list->first : NULL; a; a = a->next) {
        uint32_t index, component = 5126;
        if (!a->key || !wants_floats(a->key) || !gltf_entry(r->t, a, GLTF_ACCESSORS, &index))
            continue;
        const struct json *accessor = r->t->tables[GLTF_ACCESSORS].items[index];
        (void)json_get_u32(&r->t->g, accessor, "componentType", 0, UINT32_MAX, &component);
        if (component != 5126)
            r->width[index] = width_of(accessor);
    }
}

static void mark_all(struct rewrite *r)
{
    const struct gltf_table *meshes = &r->t->tables[GLTF_MESHES];
    for (size_t i = 0; i < meshes->count; i++) {
        const struct json *list = json_get_member(meshes->items[i], "primitives");
        for (const struct json *p = list ? list->first : NULL; p; p = p->next) {
            const struct json *targets = json_get_member(p, "targets");
            mark_attributes(r, json_get_member(p, "attributes"));
            for (const struct json *m = targets ? targets->first : NULL; m; m = m->next)
                mark_attributes(r, m);
        }
    }
}

static enum err convert(struct rewrite *r, uint32_t accessor)
{
    double *values;
    size_t count;
    TL_TRY(gltf_accessor(r->t, accessor, r->width[accessor], &values, &count));
    if (!values)
        return import_fail(r->t->im, "bad-accessor", NULL,
                           "accessor %u holds integers in a way that we do not read", accessor);
    r->offset[accessor] = r->floats->bytes;
    r->view[accessor] = (uint32_t)r->t->tables[GLTF_BUFFER_VIEWS].count + r->view_count++;
    for (size_t i = 0; i < count * r->width[accessor]; i++)
        buf_put_f32(r->floats, (float)values[i]);
    mem_free(values);
    return buf_status(r->floats);
}

/* --- The document again -------------------------------------------------- */

static uint64_t bytes_of(const struct rewrite *r, uint32_t accessor)
{
    uint64_t count = 0;
    (void)json_get_u64(&r->t->g, r->t->tables[GLTF_ACCESSORS].items[accessor], "count", 0,
                       UINT32_MAX, &count);
    return count * r->width[accessor] * sizeof(float);
}

static void put_new_accessor(struct rewrite *r, uint32_t accessor)
{
    uint64_t count = bytes_of(r, accessor) / r->width[accessor] / sizeof(float);
    buf_printf(r->doc,
               "{\"bufferView\":%u,\"componentType\":5126,\"count\":%llu,\"type\":\"VEC%u\"}",
               r->view[accessor], (unsigned long long)count, r->width[accessor]);
}

static void put_new_views(struct rewrite *r)
{
    for (uint32_t i = 0; i < r->t->tables[GLTF_ACCESSORS].count; i++)
        if (r->width[i])
            buf_printf(r->doc, ",{\"buffer\":%zu,\"byteOffset\":%llu,\"byteLength\":%llu}",
                       r->t->tables[GLTF_BUFFERS].count, (unsigned long long)r->offset[i],
                       (unsigned long long)bytes_of(r, i));
}

/* What follows the last element of a top-level array. */
static void put_additions(struct rewrite *r, const struct json *array)
{
    if (array->parent != r->t->g.root || !array->key)
        return;
    if (strcmp(array->key, "bufferViews") == 0)
        put_new_views(r);
    if (strcmp(array->key, "buffers") == 0)
        buf_printf(r->doc, ",{\"byteLength\":%zu,\"uri\":\"%s\"}", r->floats->bytes,
                   GLTF_FLOATS_NAME);
}

static void put_scalar(struct buf *b, const struct json *v)
{
    if (v->type == JSON_NULL)
        buf_printf(b, "null");
    else if (v->type == JSON_BOOL)
        buf_printf(b, v->truth ? "true" : "false");
    else if (v->type == JSON_STRING)
        json_put_text(b, v->text);
    else if (v->is_whole)
        buf_printf(b, "%llu", (unsigned long long)v->whole);
    else
        json_put_number(b, v->number);
}

static bool is_replaced(const struct rewrite *r, const struct json *v)
{
    const struct json *list = v->parent;
    return list && list->parent == r->t->g.root && list->key &&
           strcmp(list->key, "accessors") == 0 && r->width[v->index];
}

/* Depth is bounded by the parser (JSON_DEPTH_MAX). */
static void put_value(struct rewrite *r, const struct json *v)
{
    if (is_replaced(r, v)) {
        put_new_accessor(r, v->index);
        return;
    }
    if (v->type != JSON_ARRAY && v->type != JSON_OBJECT) {
        put_scalar(r->doc, v);
        return;
    }
    buf_printf(r->doc, v->type == JSON_ARRAY ? "[" : "{");
    for (const struct json *e = v->first; e; e = e->next) {
        buf_printf(r->doc, e == v->first ? "" : ",");
        if (v->type == JSON_OBJECT) {
            json_put_text(r->doc, e->key);
            buf_printf(r->doc, ":");
        }
        put_value(r, e);
    }
    put_additions(r, v);
    buf_printf(r->doc, v->type == JSON_ARRAY ? "]" : "}");
}

/* A GLB file stays one: its head, the text padded with blanks, the binary chunk. */
static void put_document(struct rewrite *r, bool is_glb)
{
    put_value(r, r->t->g.root);
    if (!is_glb)
        return;
    struct buf text = *r->doc;
    buf_init(r->doc);
    while (text.bytes % 4)
        buf_printf(&text, " ");
    size_t bin_bytes = (r->t->bin_bytes + 3) / 4 * 4;
    size_t total = 12 + 8 + text.bytes + (r->t->bin ? 8 + bin_bytes : 0);
    buf_put(r->doc, "glTF", 4);
    buf_put_u32(r->doc, 2);
    buf_put_u32(r->doc, (uint32_t)total);
    buf_put_u32(r->doc, (uint32_t)text.bytes);
    buf_put(r->doc, "JSON", 4);
    buf_put(r->doc, text.data, text.bytes);
    if (r->t->bin) {
        buf_put_u32(r->doc, (uint32_t)bin_bytes);
        buf_put(r->doc, "BIN", 4);
        buf_put(r->doc, r->t->bin, r->t->bin_bytes);
        buf_put(r->doc, "\0\0\0", bin_bytes - r->t->bin_bytes);
    }
    r->doc->failed |= text.failed;
    buf_release(&text);
}

static enum err rewrite_all(struct rewrite *r, bool is_glb)
{
    size_t count = r->t->tables[GLTF_ACCESSORS].count;
    r->width = mem_calloc(count, sizeof *r->width);
    r->offset = mem_calloc(count, sizeof *r->offset);
    r->view = mem_calloc(count, sizeof *r->view);
    if (!r->width || !r->offset || !r->view)
        return ERR_NOMEM;
    mark_all(r);
    for (uint32_t i = 0; i < count; i++)
        if (r->width[i])
            TL_TRY(convert(r, i));
    if (r->view_count > 0)
        put_document(r, is_glb);
    return buf_status(r->doc);
}

enum err gltf_floats(struct import *im, const char *data, size_t bytes, struct buf *doc,
                     struct buf *floats)
{
    struct gltf t;
    TL_TRY(gltf_open(&t, im, data, bytes));
    struct rewrite r = {.t = &t, .doc = doc, .floats = floats};
    enum err e = rewrite_all(&r, bytes >= 4 && memcmp(data, "glTF", 4) == 0);
    mem_free(r.width);
    mem_free(r.offset);
    mem_free(r.view);
    gltf_close(&t);
    return e;
}
