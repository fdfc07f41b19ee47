#include "common/ply_file.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/number.h"
#include "common/ply_wedge.h"
#include "common/polygon.h"

enum { PROPERTIES_MAX = 64, ELEMENTS_MAX = 32, WORD_BYTES = 64, LIST_COUNT_MAX = 1 << 20 };

enum form { ASCII, LITTLE, BIG };
enum scalar { INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64, SCALAR_COUNT };

static const size_t scalar_bytes[SCALAR_COUNT] = {1, 1, 2, 2, 4, 4, 4, 8};

/* What a property of a vertex means to us; NONE: skipped. */
enum role { NONE, X, Y, Z, NX, NY, NZ, U, V, RED, GREEN, BLUE, ALPHA, ROLE_COUNT };

struct property {
    bool list;
    enum scalar count_type, type;
    enum role role; /* of a vertex */
    bool indices;   /* of a face: the list of its corners */
    bool strips;    /* "tristrips" */
    bool wedges;    /* of a face: "texcoord", u and v of each corner */
};

struct element {
    char name[WORD_BYTES];
    uint64_t count;
    struct property properties[PROPERTIES_MAX];
    size_t property_count;
};

struct reader {
    const char *at, *end;
    uint64_t line; /* of ascii */
    const char *file;
    struct diag_list *problems;
    enum form form;
    struct element elements[ELEMENTS_MAX];
    size_t element_count;

    struct scene_mesh mesh; /* being made */
    bool has[ROLE_COUNT], has_vertices;
    bool skim_vertices, skim_faces; /* read past them */
    double color_max[4]; /* the integer that is full, of red to alpha; 0: floats, linear */
    uint64_t vertex_count;
    size_t triangle_count, triangle_capacity;
    uint32_t *list; /* of the face being read */
    size_t list_count, list_capacity;
    double *outline;
    uint32_t (*split)[3];
    size_t polygon_capacity;
    size_t degenerate_count;
    bool has_wedges;
    double *wedges; /* of the face being read */
    size_t wedge_count, wedge_capacity;
    float *corner_uvs; /* six per triangle, if has_wedges */
    size_t corner_capacity;
};

static enum err problem(struct reader *r, const char *id, const char *text)
{
    struct diag_place place = {.file = r->file, .line = r->line};
    diag_add(r->problems, DIAG_ERROR, place, id, NULL, "%s", text);
    return ERR_INPUT;
}

/* --- The header ---------------------------------------------------------- */

/* One line of the header as words, the line end taken; false at the end of the file. */
struct words {
    char word[5][WORD_BYTES];
    size_t count;
};

static bool take_line(struct reader *r, struct words *w)
{
    *w = (struct words){0};
    if (r->at == r->end)
        return false;
    r->line++;
    while (r->at < r->end && *r->at != '\n' && *r->at != '\r') {
        const char *start = r->at;
        while (r->at < r->end && (unsigned char)*r->at > ' ')
            r->at++;
        size_t bytes = (size_t)(r->at - start);
        if (bytes && w->count < 5) {
            size_t kept = bytes < WORD_BYTES ? bytes : WORD_BYTES - 1;
            memcpy(w->word[w->count++], start, kept);
        }
        while (r->at < r->end && (*r->at == ' ' || *r->at == '\t'))
            r->at++;
        if (r->at == start) /* another control character */
            r->at++;
    }
    bool pair = r->end - r->at >= 2 && r->at[0] == '\r' && r->at[1] == '\n';
    r->at += pair ? 2 : r->at < r->end;
    return true;
}

static bool parse_scalar(const char *word, enum scalar *out)
{
    static const char *const names[2][SCALAR_COUNT] = {
        {"char", "uchar", "short", "ushort", "int", "uint", "float", "double"},
        {"int8", "uint8", "int16", "uint16", "int32", "uint32", "float32", "float64"}};
    for (unsigned i = 0; i < SCALAR_COUNT; i++) {
        if (strcmp(word, names[0][i]) == 0 || strcmp(word, names[1][i]) == 0) {
            *out = (enum scalar)i;
            return true;
        }
    }
    return false;
}

static enum role role_of(const char *name)
{
    static const struct {
        const char *name;
        enum role role;
    } roles[] = {{"x", X},
                 {"y", Y},
                 {"z", Z},
                 {"nx", NX},
                 {"ny", NY},
                 {"nz", NZ},
                 {"u", U},
                 {"v", V},
                 {"s", U},
                 {"t", V},
                 {"texture_u", U},
                 {"texture_v", V},
                 {"red", RED},
                 {"green", GREEN},
                 {"blue", BLUE},
                 {"alpha", ALPHA},
                 {"diffuse_red", RED},
                 {"diffuse_green", GREEN},
                 {"diffuse_blue", BLUE}};
    for (size_t i = 0; i < sizeof roles / sizeof *roles; i++)
        if (strcmp(name, roles[i].name) == 0)
            return roles[i].role;
    return NONE;
}

/* Integers are what a screen shows: sRGB-encoded, up to their type's most, 255 if that is no colour
 * depth. */
static double color_max_of(enum scalar type)
{
    return type >= FLOAT32 ? 0 : type == UINT16 ? 65535 : 255;
}

static enum err parse_property(struct reader *r, const struct words *w)
{
    struct element *e = r->element_count ? &r->elements[r->element_count - 1] : NULL;
    if (!e || e->property_count == PROPERTIES_MAX)
        return problem(r, "ply-header", "a property outside an element, or over 64 of them");
    struct property p = {.list = w->count == 5 && strcmp(w->word[1], "list") == 0};
    const char *name = p.list ? w->word[4] : w->word[2];
    bool good = p.list ? parse_scalar(w->word[2], &p.count_type) && p.count_type < FLOAT32 &&
                             parse_scalar(w->word[3], &p.type)
                       : w->count == 3 && parse_scalar(w->word[1], &p.type);
    if (!good)
        return problem(r, "ply-header",
                       "expected \"property TYPE NAME\" or \"property list TYPE TYPE NAME\"");
    if (!p.list && strcmp(e->name, "vertex") == 0)
        p.role = role_of(name);
    p.indices = p.list && strcmp(e->name, "face") == 0 &&
                (strcmp(name, "vertex_indices") == 0 || strcmp(name, "vertex_index") == 0);
    p.strips = p.list && strcmp(e->name, "tristrips") == 0 &&
               (strcmp(name, "vertex_indices") == 0 || strcmp(name, "vertex_index") == 0);
    p.wedges = p.list && strcmp(e->name, "face") == 0 && strcmp(name, "texcoord") == 0;
    r->has_wedges |= p.wedges;
    e->properties[e->property_count++] = p;
    if (p.role != NONE)
        r->has[p.role] = true;
    if (p.role >= RED)
        r->color_max[p.role - RED] = color_max_of(p.type);
    return ERR_OK;
}

static enum err parse_element(struct reader *r, const struct words *w)
{
    int64_t count;
    const char *digits = w->word[2], *stop = digits + strlen(digits);
    if (w->count != 3 || number_parse_int(digits, stop, &count) != stop || count < 0)
        return problem(r, "ply-header", "expected \"element NAME COUNT\"");
    if (r->element_count == ELEMENTS_MAX)
        return problem(r, "ply-header", "over 32 elements");
    if (strcmp(w->word[1], "vertex") == 0) {
        if (r->has_vertices || count >= (int64_t)UINT32_MAX)
            return problem(r, "ply-header", "a second vertex element, or too many vertices");
        r->vertex_count = (uint64_t)count;
        r->has_vertices = true;
    }
    struct element *e = &r->elements[r->element_count++];
    *e = (struct element){.count = (uint64_t)count};
    memcpy(e->name, w->word[1], WORD_BYTES);
    return ERR_OK;
}

static enum err parse_format(struct reader *r, const struct words *w)
{
    static const char *const forms[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    for (unsigned i = 0; w->count >= 2 && i < 3; i++) {
        if (strcmp(w->word[1], forms[i]) == 0) {
            r->form = (enum form)i;
            return ERR_OK;
        }
    }
    return problem(r, "ply-header",
                   "expected \"format ascii\", binary_little_endian or binary_big_endian");
}

static enum err parse_header(struct reader *r)
{
    struct words w;
    bool has_format = false;
    if (!take_line(r, &w) || strcmp(w.word[0], "ply") != 0)
        return problem(r, "ply-header", "not a PLY file: the first line is not \"ply\"");
    while (take_line(r, &w)) {
        enum err e = ERR_OK;
        if (strcmp(w.word[0], "end_header") == 0)
            return has_format ? ERR_OK : problem(r, "ply-header", "no format line");
        if (strcmp(w.word[0], "format") == 0) {
            e = parse_format(r, &w);
            has_format = true;
        } else if (strcmp(w.word[0], "element") == 0) {
            e = parse_element(r, &w);
        } else if (strcmp(w.word[0], "property") == 0) {
            e = parse_property(r, &w);
        } else if (w.count && strcmp(w.word[0], "comment") != 0 &&
                   strcmp(w.word[0], "obj_info") != 0) {
            e = problem(r, "ply-header", "unknown keyword");
        }
        TL_TRY(e);
    }
    return problem(r, "ply-header", "the header has no end_header");
}

/* --- Values -------------------------------------------------------------- */

static bool take_ascii(struct reader *r, double *out)
{
    while (r->at < r->end && (unsigned char)*r->at <= ' ') {
        r->line += *r->at == '\n';
        r->at++;
    }
    const char *after = number_parse(r->at, r->end, out);
    if (!after || (after < r->end && (unsigned char)*after > ' '))
        return false;
    r->at = after;
    return true;
}

static double from_bits(enum scalar type, uint64_t bits)
{
    float f;
    double d;
    switch (type) {
    case INT8:
        return (int8_t)bits;
    case INT16:
        return (int16_t)bits;
    case INT32:
        return (int32_t)bits;
    case FLOAT32: {
        uint32_t low = (uint32_t)bits;
        memcpy(&f, &low, sizeof f);
        return (double)f;
    }
    case FLOAT64:
        memcpy(&d, &bits, sizeof d);
        return d;
    default:
        return (double)bits;
    }
}

/* 1, 2, 4 or 8 bytes, the first the lowest; each a single load. */
static uint64_t take_bits(const char *at, size_t bytes)
{
    uint64_t bits = 0;
    switch (bytes) {
    case 1:
        return (unsigned char)*at;
    case 2:
        memcpy(&bits, at, 2);
        return bits;
    case 4:
        memcpy(&bits, at, 4);
        return bits;
    default:
        memcpy(&bits, at, 8);
        return bits;
    }
}

static bool take_value(struct reader *r, enum scalar type, double *out)
{
    if (r->form == ASCII)
        return take_ascii(r, out);
    size_t bytes = scalar_bytes[type];
    if ((size_t)(r->end - r->at) < bytes)
        return false;
    uint64_t bits = take_bits(r->at, bytes);
    if (r->form == BIG)
        bits = __builtin_bswap64(bits) >> (64 - 8 * bytes);
    r->at += bytes;
    *out = from_bits(type, bits);
    return true;
}

/* An ascii element is a line: what its header does not name is ignored. */
static void skip_rest_of_line(struct reader *r)
{
    while (r->form == ASCII && r->at < r->end && *r->at != '\n' && *r->at != '\r')
        r->at++;
}

/* Of an element by its number as people count, from 1; indices are told as the file has them. */
static enum err element_problem(struct reader *r, const char *id, const struct element *e,
                                uint64_t index, const char *what)
{
    char text[240];
    (void)snprintf(text, sizeof text, "%s %llu of %llu: %s", e->name, (unsigned long long)index + 1,
                   (unsigned long long)e->count, what);
    return problem(r, id, text);
}

static enum err cut_short(struct reader *r, const struct element *e, uint64_t index)
{
    return element_problem(r, "ply-data", e, index,
                           r->at == r->end ? "the file ends here" : "expected a number");
}

static void not_finite(struct reader *r, const struct element *e, uint64_t index, const char *name,
                       double value)
{
    char text[120];
    (void)snprintf(text, sizeof text, "%s is %.9g, must be a finite number", name, value);
    (void)element_problem(r, "not-finite", e, index, text);
}

/* --- Vertices ------------------------------------------------------------ */

static bool vertex_alloc(struct reader *r)
{
    size_t count = (size_t)r->vertex_count;
    struct scene_mesh *m = &r->mesh;
    m->vertex_count = (uint32_t)count;
    m->positions = mem_calloc(count, 3 * sizeof *m->positions);
    if (r->has[NX] && r->has[NY] && r->has[NZ])
        m->normals = mem_calloc(count, 3 * sizeof *m->normals);
    if (r->has[U] && r->has[V])
        m->uvs = mem_calloc(count, 2 * sizeof *m->uvs);
    bool colored = r->has[RED] && r->has[GREEN] && r->has[BLUE];
    if (colored)
        m->colors = mem_calloc(count, 3 * sizeof *m->colors);
    if (colored && r->has[ALPHA])
        m->alphas = mem_calloc(count, sizeof *m->alphas);
    return m->positions && (m->colors || !colored) && (m->alphas || !(colored && r->has[ALPHA])) &&
           (m->normals || !(r->has[NX] && r->has[NY] && r->has[NZ])) &&
           (m->uvs || !(r->has[U] && r->has[V]));
}

static void put_unit(const double n[3], float out[3])
{
    double largest = fmax(fabs(n[0]), fmax(fabs(n[1]), fabs(n[2])));
    if (!(largest > 0) || !isfinite(n[0]) || !isfinite(n[1]) || !isfinite(n[2]))
        return; /* no normal there; fmax passes a lone NaN over */
    double x = n[0] / largest, y = n[1] / largest, z = n[2] / largest;
    double length = sqrt(x * x + y * y + z * z);
    out[0] = (float)(x / length);
    out[1] = (float)(y / length);
    out[2] = (float)(z / length);
}

static void put_vertex(struct reader *r, const struct element *e, size_t i,
                       const double v[ROLE_COUNT])
{
    static const char *const names[ROLE_COUNT] = {
        [X] = "x", [Y] = "y", [Z] = "z", [U] = "u", [V] = "v"};
    struct scene_mesh *m = &r->mesh;
    enum role bad = NONE; /* the first coordinate that is no number */
    for (size_t j = 0; j < 3; j++) {
        m->positions[3 * i + j] = v[X + j];
        if (bad == NONE && !(fabs(v[X + j]) <= SCENE_NUMBER_MAX))
            bad = (enum role)(X + j);
    }
    for (size_t j = 0; m->uvs && j < 2; j++) {
        bool finite = fabs(v[U + j]) <= (double)FLT_MAX;
        m->uvs[2 * i + j] = finite ? (float)v[U + j] : 0;
        if (bad == NONE && !finite)
            bad = (enum role)(U + j);
    }
    for (size_t j = 0; m->colors && j < 3; j++) {
        double max = r->color_max[j];
        m->colors[3 * i + j] = model_vertex_color(max > 0 ? v[RED + j] / max : v[RED + j], max > 0);
    }
    if (m->alphas) {
        double max = r->color_max[3];
        m->alphas[i] = model_vertex_color(max > 0 ? v[ALPHA] / max : v[ALPHA], false);
    }
    if (m->normals)
        put_unit(v + NX, m->normals + 3 * i);
    if (bad != NONE)
        not_finite(r, e, i, names[bad], v[bad]);
}

static enum err read_vertices(struct reader *r, const struct element *e)
{
    if (!r->has[X] || !r->has[Y] || !r->has[Z])
        return problem(r, "ply-header", "vertices without x, y and z");
    /* Each vertex takes at least a byte a property: what the file cannot hold is not allocated. */
    if (e->count > (uint64_t)(r->end - r->at) / e->property_count)
        return problem(r, "ply-data", "the file is too short for its vertices");
    if (!r->skim_vertices && !vertex_alloc(r))
        return ERR_NOMEM;
    for (uint64_t i = 0; i < e->count; i++) {
        double v[ROLE_COUNT] = {0}, value = 0;
        for (size_t j = 0; j < e->property_count; j++) {
            const struct property *p = &e->properties[j];
            double count = 1;
            if (p->list && !take_value(r, p->count_type, &count))
                return cut_short(r, e, i);
            for (double k = 0; k < count; k++)
                if (!take_value(r, p->type, &value))
                    return cut_short(r, e, i);
            v[p->role] = value;
        }
        skip_rest_of_line(r);
        if (!r->skim_vertices)
            put_vertex(r, e, (size_t)i, v);
    }
    return ERR_OK;
}

/* --- Faces --------------------------------------------------------------- */

static bool polygon_room(struct reader *r)
{
    if (r->list_count <= r->polygon_capacity)
        return true;
    double *outline = mem_realloc_array(r->outline, r->list_count, 3 * sizeof *outline);
    r->outline = outline ? outline : r->outline;
    uint32_t(*split)[3] = mem_realloc_array(r->split, r->list_count, sizeof *split);
    r->split = split ? split : r->split;
    if (!outline || !split)
        return false;
    r->polygon_capacity = r->list_count;
    return true;
}

static enum err add_triangle(struct reader *r, uint32_t a, uint32_t b, uint32_t c)
{
    if (r->triangle_count >= SCENE_TRIANGLES_MAX)
        return ERR_LIMIT;
    if (!mem_grow((void **)&r->mesh.indices, r->triangle_count, &r->triangle_capacity,
                  3 * sizeof *r->mesh.indices))
        return ERR_NOMEM;
    uint32_t *to = r->mesh.indices + 3 * r->triangle_count++;
    to[0] = a;
    to[1] = b;
    to[2] = c;
    return ERR_OK;
}

static enum err add_polygon(struct reader *r)
{
    if (r->list_count < 3) {
        r->degenerate_count++;
        return ERR_OK;
    }
    if (r->list_count == 3 && !r->has_wedges) /* nothing to split */
        return add_triangle(r, r->list[0], r->list[1], r->list[2]);
    if (!polygon_room(r))
        return ERR_NOMEM;
    for (size_t i = 0; i < r->list_count; i++)
        memcpy(r->outline + 3 * i, r->mesh.positions + 3 * (size_t)r->list[i], 3 * sizeof(double));
    polygon_split(r->outline, r->list_count, r->split);
    for (size_t t = 0; t + 2 < r->list_count; t++)
        TL_TRY(add_triangle(r, r->list[r->split[t][0]], r->list[r->split[t][1]],
                            r->list[r->split[t][2]]));
    return ERR_OK;
}

/* A strip turns around at every triangle; UINT32_MAX (-1 in the file) starts anew. */
static enum err add_strip(struct reader *r)
{
    size_t start = 0;
    for (size_t i = 0; i < r->list_count; i++) {
        if (r->list[i] == UINT32_MAX) {
            start = i + 1;
        } else if (i >= start + 2) {
            bool odd = (i - start) % 2 == 1;
            uint32_t a = r->list[i - 2], b = r->list[i - 1], c = r->list[i];
            if (a != b && b != c && a != c)
                TL_TRY(add_triangle(r, odd ? b : a, odd ? a : b, c));
        }
    }
    return ERR_OK;
}

/* The corners of a face or strip; an index out of range is a problem that names it. */
static enum err read_corners(struct reader *r, const struct element *e, uint64_t index,
                             const struct property *p, double count)
{
    r->list_count = 0;
    for (double k = 0; k < count; k++) {
        double value;
        if (!take_value(r, p->type, &value))
            return cut_short(r, e, index);
        bool restart = p->strips && value == -1;
        if (!restart &&
            !(value >= 0 && value < (double)r->mesh.vertex_count && value == floor(value))) {
            char text[120];
            (void)snprintf(text, sizeof text, "index %.10g, expected 0 to %lld", value,
                           (long long)r->mesh.vertex_count - 1);
            return element_problem(r, "index-out-of-range", e, index, text);
        }
        if (!mem_grow((void **)&r->list, r->list_count, &r->list_capacity, sizeof *r->list))
            return ERR_NOMEM;
        r->list[r->list_count++] = restart ? UINT32_MAX : (uint32_t)value;
    }
    return p->strips ? add_strip(r) : add_polygon(r);
}

/* The numbers of a face's corner coordinates; how many fit its corners is seen later. */
static enum err read_wedges(struct reader *r, const struct element *e, uint64_t index,
                            const struct property *p, double count)
{
    for (uint64_t k = 0; (double)k < count; k++) {
        double value;
        if (!take_value(r, p->type, &value))
            return cut_short(r, e, index);
        if (!mem_grow((void **)&r->wedges, r->wedge_count, &r->wedge_capacity, sizeof *r->wedges))
            return ERR_NOMEM;
        bool finite = fabs(value) <= (double)FLT_MAX;
        if (!finite)
            not_finite(r, e, index, k % 2 ? "v of a corner" : "u of a corner", value);
        r->wedges[r->wedge_count++] = finite ? value : 0;
    }
    return ERR_OK;
}

/* Gives the triangles from `begin` on, those of one face, the coordinates of their corners; 0 where
 * the face has none or another number of them. */
static enum err put_wedges(struct reader *r, size_t begin)
{
    /* One polygon's triangles, and a pair for each of its corners: not so if it has two lists of
     * them. */
    bool known =
        r->wedge_count == 2 * r->list_count && r->triangle_count - begin + 2 == r->list_count;
    for (size_t t = begin; r->has_wedges && t < r->triangle_count; t++) {
        if (!mem_grow((void **)&r->corner_uvs, t, &r->corner_capacity, 6 * sizeof *r->corner_uvs))
            return ERR_NOMEM;
        for (size_t k = 0; k < 6; k++) {
            size_t from = known ? 2 * (size_t)r->split[t - begin][k / 2] + k % 2 : 0;
            r->corner_uvs[6 * t + k] = known ? (float)r->wedges[from] : 0;
        }
    }
    return ERR_OK;
}

static enum err read_list(struct reader *r, const struct element *e, uint64_t index,
                          const struct property *p)
{
    double count, value;
    if (!take_value(r, p->count_type, &count))
        return cut_short(r, e, index);
    if (!(count >= 0 && count <= (double)LIST_COUNT_MAX * 1024) || count != floor(count))
        return element_problem(r, "ply-data", e, index, "a list of an impossible length");
    if ((p->indices || p->strips) && !r->skim_faces)
        return read_corners(r, e, index, p, count);
    if (p->wedges && !r->skim_faces)
        return read_wedges(r, e, index, p, count);
    for (double k = 0; k < count; k++)
        if (!take_value(r, p->type, &value))
            return cut_short(r, e, index);
    return ERR_OK;
}

/* True for the element that large files consist of: little-endian faces of nothing but a list of
 * corners, counted in a byte, numbered in four. */
static bool is_plain_faces(const struct reader *r, const struct element *e)
{
    const struct property *p = &e->properties[0];
    return r->form == LITTLE && !r->skim_faces && !r->has_wedges && e->property_count == 1 &&
           p->indices && (p->count_type == INT8 || p->count_type == UINT8) &&
           (p->type == INT32 || p->type == UINT32);
}

/* Takes the triangles from face *index on, up to the first face that is something else or has a
 * corner that is not there: read_list says what about it. */
static enum err take_triangles(struct reader *r, const struct element *e, uint64_t *index)
{
    enum { FACE_BYTES = 1 + 3 * sizeof(uint32_t) };
    for (; *index < e->count && r->end - r->at >= FACE_BYTES && *r->at == 3; ++*index) {
        uint32_t v[3];
        memcpy(v, r->at + 1, sizeof v);
        if (v[0] >= r->mesh.vertex_count || v[1] >= r->mesh.vertex_count ||
            v[2] >= r->mesh.vertex_count)
            return ERR_OK;
        TL_TRY(add_triangle(r, v[0], v[1], v[2]));
        r->at += FACE_BYTES;
    }
    return ERR_OK;
}

static enum err read_other(struct reader *r, const struct element *e)
{
    double value;
    bool plain = is_plain_faces(r, e);
    for (uint64_t i = 0; e->property_count && i < e->count; i++) {
        if (plain)
            TL_TRY(take_triangles(r, e, &i));
        if (i == e->count)
            break;
        size_t begin = r->triangle_count;
        r->list_count = r->wedge_count = 0;
        for (size_t j = 0; j < e->property_count; j++) {
            const struct property *p = &e->properties[j];
            if (p->list)
                TL_TRY(read_list(r, e, i, p));
            else if (!take_value(r, p->type, &value))
                return cut_short(r, e, i);
        }
        TL_TRY(put_wedges(r, begin));
        skip_rest_of_line(r);
    }
    return ERR_OK;
}

/* --- The file ------------------------------------------------------------ */

static enum err read_elements(struct reader *r)
{
    for (size_t i = 0; i < r->element_count; i++) {
        const struct element *e = &r->elements[i];
        TL_TRY(strcmp(e->name, "vertex") == 0 ? read_vertices(r, e) : read_other(r, e));
    }
    return ERR_OK;
}

/* Where faces stand before the vertices they refer to, the data is read twice. */
static enum err read_body(struct reader *r)
{
    size_t first = 0;
    while (first < r->element_count && strcmp(r->elements[first].name, "vertex") != 0)
        first++;
    r->line = r->form == ASCII ? r->line : 0;
    if (first == 0 || first == r->element_count)
        return read_elements(r);
    const char *start = r->at;
    uint64_t start_line = r->line;
    r->skim_faces = true;
    TL_TRY(read_elements(r));
    r->at = start;
    r->line = start_line;
    r->skim_faces = false;
    r->skim_vertices = true;
    return read_elements(r);
}

static enum err judge(struct reader *r)
{
    if (r->degenerate_count)
        diag_add(r->problems, DIAG_WARNING, (struct diag_place){.file = r->file}, "degenerate-face",
                 NULL, "%zu faces with fewer than three corners are left out", r->degenerate_count);
    if (r->triangle_count)
        return ERR_OK;
    char text[120];
    (void)snprintf(text, sizeof text, "no face in it: %llu vertices",
                   (unsigned long long)r->vertex_count);
    return problem(r, "empty-mesh", text);
}

enum err ply_read_mesh(const char *data, size_t bytes, const char *file, struct scene_mesh *out,
                       struct diag_list *problems)
{
    struct reader *r = mem_calloc(1, sizeof *r);
    if (!r)
        return ERR_NOMEM;
    r->at = data;
    r->end = data + bytes;
    r->file = file;
    r->problems = problems;
    size_t errors_before = problems->error_count;
    enum err e = parse_header(r);
    if (e == ERR_OK)
        e = read_body(r);
    if (e == ERR_OK && problems->error_count != errors_before)
        e = ERR_INPUT;
    r->line = 0;
    if (e == ERR_OK)
        e = judge(r);
    r->mesh.triangle_count = (uint32_t)r->triangle_count;
    if (e == ERR_OK && r->has_wedges)
        e = ply_split_corners(&r->mesh, r->corner_uvs);
    if (e == ERR_OK)
        *out = r->mesh;
    else
        scene_mesh_release(&r->mesh);
    mem_free(r->list);
    mem_free(r->outline);
    mem_free(r->split);
    mem_free(r->wedges);
    mem_free(r->corner_uvs);
    mem_free(r);
    return e;
}
