/* Does every buffer view lie in its buffer, every accessor in its view? Are the nodes' transforms
 * numbers that floats can be multiplied with? assimp trusts much of it.
 */
#include <math.h>
#include <string.h>
#include <sys/stat.h>

#include "client/import_gltf.h"
#include "common/file_io.h"
#include "common/mem.h"

/* Elements of an accessor without bytes of its own, which costs nothing to write. */
#define EMPTY_COUNT_MAX (1u << 24)

/* How far the length of a node's rotation may be from 1: three decimals, as people write them, are
 * 4e-4 off; what is off by more is no rotation but a mistake, and would scale or shear. */
#define ROTATION_SLACK 0.01

/* How far the last row of a node's matrix may be from 0 0 0 1: the rounding of a product of float
 * matrices. What is off by more would project or scale, which no exporter means. */
#define LAST_ROW_SLACK 1e-6

struct check {
    struct gltf *t;
    uint64_t *buffer_bytes, *view_bytes, *view_stride; /* by index */
    uint64_t *counts;                                  /* of elements, by accessor */
    uint64_t total_bytes;
    bool failed;
};

static void refuse(struct check *c, const struct json *at, const char *text)
{
    json_get_problem(&c->t->g, DIAG_ERROR, at, "bad-accessor", "export the model again", "%s",
                     text);
    c->failed = true;
}

static uint64_t number(struct check *c, const struct json *v, const char *key, uint64_t usual)
{
    if (!json_get_u64(&c->t->g, v, key, 0, UINT32_MAX, &usual))
        c->failed = true;
    return usual;
}

/* --- Buffers ------------------------------------------------------------- */

/* The size of a file that a buffer names; a problem when it is not there. */
static uint64_t file_bytes(struct check *c, const struct json *uri)
{
    struct stat st;
    uint64_t bytes = 0;
    char *path = gltf_uri_path(uri->text);
    char *joined = path ? file_join(c->t->im->folder, path) : NULL;
    if (joined && stat(joined, &st) == 0 && S_ISREG(st.st_mode)) {
        bytes = (uint64_t)st.st_size;
    } else if (joined) {
        json_get_problem(&c->t->g, DIAG_ERROR, uri, "missing-file", NULL, "no file \"%.200s\"",
                         path);
        c->failed = true;
    }
    mem_free(joined);
    mem_free(path);
    return bytes;
}

/* What is really there of a buffer. */
static uint64_t available(struct check *c, const struct json *buffer, size_t index)
{
    const struct json *uri = json_get_member(buffer, "uri");
    if (!uri)
        return index == 0 ? c->t->bin_bytes : 0;
    if (!json_get_is(&c->t->g, uri, JSON_STRING)) {
        c->failed = true;
        return 0;
    }
    if (strncmp(uri->text, "data:", 5) != 0)
        return file_bytes(c, uri);
    const char *comma = strchr(uri->text, ',');
    size_t digits = comma ? strcspn(comma + 1, "=") : 0;
    return digits / 4 * 3 + (digits % 4) * 3 / 4;
}

static void check_buffers(struct check *c)
{
    const struct gltf_table *buffers = &c->t->tables[GLTF_BUFFERS];
    for (size_t i = 0; i < buffers->count; i++) {
        const struct json *v = buffers->items[i];
        uint64_t there = available(c, v, i), claimed = number(c, v, "byteLength", 0);
        c->total_bytes += there;
        c->buffer_bytes[i] = claimed;
        if (!c->failed && claimed > there)
            refuse(c, v, "the buffer is shorter than it says");
    }
}

static void check_views(struct check *c)
{
    const struct gltf_table *views = &c->t->tables[GLTF_BUFFER_VIEWS];
    for (size_t i = 0; i < views->count; i++) {
        const struct json *v = views->items[i];
        uint32_t buffer;
        uint64_t offset = number(c, v, "byteOffset", 0), bytes = number(c, v, "byteLength", 0);
        if (!gltf_reference(c->t, v, "buffer", GLTF_BUFFERS, &buffer))
            refuse(c, v, "the buffer view has no buffer");
        else if (offset + bytes > c->buffer_bytes[buffer])
            refuse(c, v, "the buffer view reaches over the end of its buffer");
        c->view_bytes[i] = bytes;
        c->view_stride[i] = number(c, v, "byteStride", 0);
    }
}

/* --- Accessors ----------------------------------------------------------- */

static uint64_t component_bytes(uint64_t component)
{
    return component == 5120 || component == 5121   ? 1
           : component == 5122 || component == 5123 ? 2
           : component == 5125 || component == 5126 ? 4
                                                    : 0;
}

static uint64_t component_count(const struct json *type)
{
    static const struct {
        const char *name;
        uint64_t count;
    } types[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4},
                 {"MAT2", 4},   {"MAT3", 9}, {"MAT4", 16}};
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (type && type->type == JSON_STRING && strcmp(type->text, types[i].name) == 0)
            return types[i].count;
    return 0;
}

/* `count` elements from `offset` on within a view. */
static void check_span(struct check *c, const struct json *v, uint32_t view, uint64_t offset,
                       uint64_t element, uint64_t count)
{
    uint64_t stride = c->view_stride[view] ? c->view_stride[view] : element;
    if (offset + stride * (count - 1) + element > c->view_bytes[view])
        refuse(c, v, "it reaches over the end of its buffer view");
}

/* The places that a sparse accessor replaces. */
static void check_sparse_places(struct check *c, const struct json *indices, uint32_t view,
                                uint64_t bytes, uint64_t changed, uint64_t count)
{
    const unsigned char *data;
    size_t size;
    uint64_t offset = number(c, indices, "byteOffset", 0);
    if (c->failed || !gltf_view(c->t, view, &data, &size) || offset + changed * bytes > size) {
        refuse(c, indices, "the places of the sparse accessor cannot be read");
        return;
    }
    for (uint64_t i = 0; i < changed; i++) {
        uint64_t place = 0;
        memcpy(&place, data + offset + i * bytes, (size_t)bytes);
        if (place >= count) {
            refuse(c, indices, "a place of the sparse accessor is out of range");
            return;
        }
    }
}

static void check_sparse(struct check *c, const struct json *sparse, uint64_t element,
                         uint64_t count)
{
    const struct json *indices = json_get_member(sparse, "indices");
    const struct json *values = json_get_member(sparse, "values");
    uint64_t changed = number(c, sparse, "count", 0);
    uint64_t bytes = component_bytes(number(c, indices, "componentType", 0));
    uint32_t index_view, value_view;
    if (c->failed || changed < 1 || changed > count || bytes == 0 ||
        !gltf_reference(c->t, indices, "bufferView", GLTF_BUFFER_VIEWS, &index_view) ||
        !gltf_reference(c->t, values, "bufferView", GLTF_BUFFER_VIEWS, &value_view)) {
        refuse(c, sparse, "the sparse accessor has no usable places and values");
        return;
    }
    check_span(c, values, value_view, number(c, values, "byteOffset", 0), element, changed);
    check_sparse_places(c, indices, index_view, bytes, changed, count);
}

static void check_accessor(struct check *c, const struct json *v, uint64_t *count)
{
    uint64_t element = component_bytes(number(c, v, "componentType", 0)) *
                       component_count(json_get_member(v, "type"));
    uint32_t view;
    *count = number(c, v, "count", 0);
    if (element == 0 || *count == 0) {
        refuse(c, v, "the accessor has no known type, or no element");
        return;
    }
    if (gltf_reference(c->t, v, "bufferView", GLTF_BUFFER_VIEWS, &view))
        check_span(c, v, view, number(c, v, "byteOffset", 0), element, *count);
    else if (*count > EMPTY_COUNT_MAX)
        refuse(c, v, "the accessor has no bytes for that many elements");
    const struct json *sparse = json_get_member(v, "sparse");
    if (sparse)
        check_sparse(c, sparse, element, *count);
}

/* --- Meshes and skins ---------------------------------------------------- */

/* Every accessor of an object of attributes has an element for each vertex. */
static void check_attributes(struct check *c, const struct json *list, uint64_t vertex_count)
{
    for (const struct json *a = list ? list->first : NULL; a; a = a->next) {
        uint32_t index;
        if (gltf_entry(c->t, a, GLTF_ACCESSORS, &index) && c->counts[index] < vertex_count)
            refuse(c, a, "the attribute has fewer elements than the mesh has vertices");
    }
}

static void check_primitive(struct check *c, const struct json *p)
{
    const struct json *attributes = json_get_member(p, "attributes");
    const struct json *targets = json_get_member(p, "targets");
    uint32_t index;
    if (!gltf_reference(c->t, attributes, "POSITION", GLTF_ACCESSORS, &index))
        return;
    check_attributes(c, attributes, c->counts[index]);
    for (const struct json *m = targets ? targets->first : NULL; m; m = m->next)
        check_attributes(c, m, c->counts[index]);
}

static void check_meshes(struct check *c)
{
    const struct gltf_table *meshes = &c->t->tables[GLTF_MESHES];
    for (size_t i = 0; i < meshes->count; i++) {
        const struct json *list = json_get_member(meshes->items[i], "primitives");
        for (const struct json *p = list ? list->first : NULL; p; p = p->next)
            check_primitive(c, p);
    }
}

static void check_skins(struct check *c)
{
    const struct json *skins = json_get_member(c->t->g.root, "skins");
    for (const struct json *s = skins ? skins->first : NULL; s; s = s->next) {
        const struct json *joints = json_get_member(s, "joints");
        uint32_t index;
        if (joints && gltf_reference(c->t, s, "inverseBindMatrices", GLTF_ACCESSORS, &index) &&
            c->counts[index] < joints->count)
            refuse(c, s, "the skin has fewer matrices than joints");
    }
}

/* --- Nodes --------------------------------------------------------------- */

/* Matrices come column by column. What rounding has left in the last row is taken for 0 0 0 1. */
static void check_affine(struct check *c, const struct json *node, const double m[16])
{
    if (fabs(m[3]) <= LAST_ROW_SLACK && fabs(m[7]) <= LAST_ROW_SLACK &&
        fabs(m[11]) <= LAST_ROW_SLACK && fabs(m[15] - 1) <= LAST_ROW_SLACK)
        return;
    json_get_problem(&c->t->g, DIAG_ERROR, json_get_member(node, "matrix"), "bad-transform", NULL,
                     "a last row of %.6g %.6g %.6g %.6g, expected 0 0 0 1", m[3], m[7], m[11],
                     m[15]);
    c->failed = true;
}

/* Entries that are there lie within `limit`; they go to `out`. */
static bool check_entries(struct check *c, const struct json *node, const char *key, size_t count,
                          double limit, double *out)
{
    const struct json *v = json_get_member(node, key);
    if (!v)
        return true;
    bool good = json_value_numbers(&c->t->g, v, count, -limit, limit, out);
    c->failed |= !good;
    return good;
}

bool gltf_is_rotation(const double turn[4], double *length)
{
    *length = sqrt(turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3]);
    return fabs(*length - 1) <= ROTATION_SLACK;
}

static void check_node(struct check *c, const struct json *node)
{
    double entries[16], turn[4] = {0, 0, 0, 1}, length;
    if (json_get_member(node, "matrix") &&
        check_entries(c, node, "matrix", 16, GLTF_TRANSFORM_MAX, entries))
        check_affine(c, node, entries);
    (void)check_entries(c, node, "translation", 3, GLTF_TRANSFORM_MAX, entries);
    (void)check_entries(c, node, "scale", 3, GLTF_TRANSFORM_MAX, entries);
    if (!check_entries(c, node, "rotation", 4, GLTF_TRANSFORM_MAX, turn))
        return;
    if (gltf_is_rotation(turn, &length))
        return;
    json_get_problem(&c->t->g, DIAG_ERROR, json_get_member(node, "rotation"), "bad-transform",
                     "divide it by its length", "a quaternion of length %.6g, expected 1", length);
    c->failed = true;
}

static enum err run(struct check *c)
{
    const struct gltf_table *tables = c->t->tables;
    c->buffer_bytes = mem_calloc(tables[GLTF_BUFFERS].count, sizeof *c->buffer_bytes);
    c->view_bytes = mem_calloc(tables[GLTF_BUFFER_VIEWS].count, sizeof *c->view_bytes);
    c->view_stride = mem_calloc(tables[GLTF_BUFFER_VIEWS].count, sizeof *c->view_stride);
    c->counts = mem_calloc(tables[GLTF_ACCESSORS].count, sizeof *c->counts);
    if (!c->buffer_bytes || !c->view_bytes || !c->view_stride || !c->counts)
        return ERR_NOMEM;
    check_buffers(c);
    if (!c->failed)
        check_views(c);
    for (size_t i = 0; !c->failed && i < tables[GLTF_ACCESSORS].count; i++)
        check_accessor(c, tables[GLTF_ACCESSORS].items[i], &c->counts[i]);
    if (!c->failed)
        check_meshes(c);
    if (!c->failed)
        check_skins(c);
    for (size_t i = 0; i < tables[GLTF_NODES].count; i++)
        check_node(c, tables[GLTF_NODES].items[i]);
    return c->failed ? ERR_INPUT : ERR_OK;
}

enum err gltf_check(struct gltf *t, uint64_t *buffer_bytes)
{
    struct check c = {.t = t};
    enum err e = run(&c);
    *buffer_bytes += c.total_bytes;
    mem_free(c.buffer_bytes);
    mem_free(c.view_bytes);
    mem_free(c.view_stride);
    mem_free(c.counts);
    return e;
}
