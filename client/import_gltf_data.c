/* Buffers, views, accessors and URIs of glTF. */
#include <math.h>
#include <string.h>

#include "client/import_gltf.h"
#include "common/file_io.h"
#include "common/mem.h"

#define BUFFER_BYTES_MAX (UINT64_C(2) << 30)
#define ELEMENTS_MAX     (1u << 22)

/* --- URIs ---------------------------------------------------------------- */

static int base64_value(char c)
{
    if (c >= 'A' && c <= 'Z')
        return c - 'A';
    if (c >= 'a' && c <= 'z')
        return c - 'a' + 26;
    if (c >= '0' && c <= '9')
        return c - '0' + 52;
    if (c == '+' || c == '-')
        return 62;
    return c == '/' || c == '_' ? 63 : -1;
}

/* False at a character that is none of base64's. */
static bool decode_base64(const char *text, unsigned char *out, size_t *bytes)
{
    uint32_t bits = 0;
    int held = 0;
    size_t count = 0;
    for (; *text && *text != '='; text++) {
        int v = base64_value(*text);
        if (v < 0)
            return false;
        bits = (bits << 6 | (uint32_t)v) & 0xFFFFFF;
        held += 6;
        if (held >= 8) {
            held -= 8;
            out[count++] = (unsigned char)(bits >> held & 0xFF);
        }
    }
    *bytes = count;
    return true;
}

enum err gltf_data_uri(const char *uri, unsigned char **out, size_t *bytes)
{
    static const char mark[] = ";base64,";
    const char *body = strncmp(uri, "data:", 5) == 0 ? strstr(uri, mark) : NULL;
    *out = NULL;
    *bytes = 0;
    if (!body)
        return ERR_OK;
    body += sizeof mark - 1;
    unsigned char *data = mem_alloc(strlen(body) / 4 * 3 + 3);
    if (!data)
        return ERR_NOMEM;
    if (decode_base64(body, data, bytes))
        *out = data;
    else
        mem_free(data);
    return ERR_OK;
}

static int hex_value(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    if (c >= 'a' && c <= 'f')
        return c - 'a' + 10;
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

char *gltf_uri_path(const char *uri)
{
    char *path = mem_strdup(uri), *to = path;
    for (const char *c = uri; path && *c; c++) {
        int high = *c == '%' ? hex_value(c[1]) : -1;
        int low = high >= 0 ? hex_value(c[2]) : -1;
        bool is_escape = low >= 0 && (high | low) != 0;
        *to++ = is_escape ? (char)(high * 16 + low) : *c;
        c += is_escape ? 2 : 0;
    }
    if (path)
        *to = '\0';
    return path;
}

/* --- Buffers ------------------------------------------------------------- */

static void read_buffer(struct gltf *t, uint32_t index, struct gltf_buffer *b)
{
    const struct json *v = t->tables[GLTF_BUFFERS].items[index];
    const struct json *uri = json_get_member(v, "uri");
    if (!uri || uri->type != JSON_STRING) {
        b->data = index == 0 ? t->bin : NULL;
        b->bytes = t->bin_bytes;
        return;
    }
    unsigned char *inside;
    char *data = NULL;
    if (gltf_data_uri(uri->text, &inside, &b->bytes) == ERR_OK && inside) {
        b->owned = inside;
    } else {
        char *path = gltf_uri_path(uri->text);
        char *joined = path ? file_join(t->im->folder, path) : NULL;
        if (joined && file_read(joined, BUFFER_BYTES_MAX, &data, &b->bytes) == ERR_OK) {
            b->owned = data;
            t->im->source_bytes += b->bytes;
        }
        mem_free(joined);
        mem_free(path);
    }
    b->data = b->owned;
}

static struct gltf_buffer *buffer_at(struct gltf *t, uint32_t index)
{
    if (!t->buffers)
        t->buffers = mem_calloc(t->tables[GLTF_BUFFERS].count, sizeof *t->buffers);
    if (!t->buffers)
        return NULL;
    struct gltf_buffer *b = &t->buffers[index];
    if (!b->tried) {
        b->tried = true;
        read_buffer(t, index, b);
    }
    return b;
}

bool gltf_view(struct gltf *t, uint32_t view, const unsigned char **data, size_t *bytes)
{
    const struct gltf_table *views = &t->tables[GLTF_BUFFER_VIEWS];
    if (view >= views->count)
        return false;
    const struct json *v = views->items[view];
    uint64_t offset = 0, length = 0;
    uint32_t buffer;
    if (!gltf_reference(t, v, "buffer", GLTF_BUFFERS, &buffer) ||
        !json_get_u64(&t->g, v, "byteOffset", 0, UINT32_MAX, &offset) ||
        !json_get_u64(&t->g, v, "byteLength", 1, UINT32_MAX, &length))
        return false;
    const struct gltf_buffer *b = buffer_at(t, buffer);
    if (!b || !b->data || offset > b->bytes || length > b->bytes - offset)
        return false;
    *data = b->data + offset;
    *bytes = (size_t)length;
    return true;
}

/* --- Accessors ----------------------------------------------------------- */

struct layout {
    uint32_t component, bytes; /* glTF's component type, and its size */
    bool normalized;
    uint64_t offset, stride, count;
};

static uint32_t component_bytes(uint32_t component)
{
    switch (component) {
    case 5120:
    case 5121:
        return 1;
    case 5122:
    case 5123:
        return 2;
    case 5125:
    case 5126:
        return 4;
    default:
        return 0;
    }
}

static double component_value(const unsigned char *at, const struct layout *l)
{
    uint16_t u16;
    uint32_t u32;
    float f;
    double scale = l->normalized ? 1 : 0;
    switch (l->component) {
    case 5120:
        return scale > 0 ? fmax((int8_t)*at / 127.0, -1) : (int8_t)*at;
    case 5121:
        return scale > 0 ? *at / 255.0 : *at;
    case 5122:
        memcpy(&u16, at, sizeof u16);
        return scale > 0 ? fmax((int16_t)u16 / 32767.0, -1) : (int16_t)u16;
    case 5123:
        memcpy(&u16, at, sizeof u16);
        return scale > 0 ? u16 / 65535.0 : u16;
    case 5125:
        memcpy(&u32, at, sizeof u32);
        return u32;
    default:
        memcpy(&f, at, sizeof f);
        return (double)f;
    }
}

static bool read_layout(struct gltf *t, const struct json *a, uint32_t width, struct layout *l)
{
    static const char *const types[] = {"", "SCALAR", "VEC2", "VEC3", "VEC4"};
    const struct json *type = json_get_member(a, "type");
    *l = (struct layout){0};
    if (!type || type->type != JSON_STRING || strcmp(type->text, types[width]) != 0 ||
        json_get_member(a, "sparse") ||
        !json_get_u32(&t->g, a, "componentType", 0, UINT32_MAX, &l->component) ||
        !json_get_bool(&t->g, a, "normalized", &l->normalized) ||
        !json_get_u64(&t->g, a, "byteOffset", 0, UINT32_MAX, &l->offset) ||
        !json_get_u64(&t->g, a, "count", 1, ELEMENTS_MAX, &l->count))
        return false;
    l->bytes = component_bytes(l->component);
    l->stride = (uint64_t)l->bytes * width;
    return l->bytes > 0 && l->count > 0;
}

enum err gltf_accessor(struct gltf *t, uint32_t accessor, uint32_t width, double **out,
                       size_t *count)
{
    const struct gltf_table *accessors = &t->tables[GLTF_ACCESSORS];
    struct layout l;
    uint32_t view;
    const unsigned char *data;
    size_t bytes;
    *out = NULL;
    if (accessor >= accessors->count || !read_layout(t, accessors->items[accessor], width, &l))
        return ERR_OK;
    const struct json *v =
        gltf_reference(t, accessors->items[accessor], "bufferView", GLTF_BUFFER_VIEWS, &view);
    uint64_t element = l.stride;
    if (!v || !json_get_u64(&t->g, v, "byteStride", element, 252, &l.stride) ||
        !gltf_view(t, view, &data, &bytes))
        return ERR_OK;
    if (l.offset > bytes || element > bytes - l.offset ||
        (bytes - l.offset - element) / l.stride < l.count - 1)
        return ERR_OK;
    double *values = mem_alloc_array((size_t)l.count * width, sizeof *values);
    if (!values)
        return ERR_NOMEM;
    for (size_t i = 0; i < l.count; i++)
        for (uint32_t c = 0; c < width; c++)
            values[i * width + c] =
                component_value(data + l.offset + i * l.stride + (size_t)c * l.bytes, &l);
    *out = values;
    *count = (size_t)l.count;
    return ERR_OK;
}
