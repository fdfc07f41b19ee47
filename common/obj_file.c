#include "common/obj_file.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/name_table.h"
#include "common/number.h"
#include "common/polygon.h"
#include "common/scene.h"

/* A corner whose positive index was beyond what was read so far; judged at the end. */
struct forward {
    uint64_t line;
    uint32_t index;
    unsigned kind;
};

enum { POSITION, UV, NORMAL, KINDS };

static const char *const kind_names[KINDS] = {"v", "vt", "vn"};
static const size_t kind_width[KINDS] = {3, 2, 3};

struct parser {
    const char *at, *end; /* the rest of the file */
    uint64_t line;
    const char *file;
    struct diag_list *problems;
    bool out_of_memory;
    bool strict; /* uv and normal indices out of range are errors */

    double *values[KINDS];
    size_t count[KINDS], capacity[KINDS]; /* elements, not doubles */
    float *colors;                        /* of the first positions; white for the others */
    size_t color_count, color_capacity;
    struct obj_triangle *triangles;
    size_t triangle_count, triangle_capacity;
    struct name_table materials, groups, libraries;
    uint32_t material, group;
    bool smooths; /* the faces that follow belong to a smoothing group */
    struct forward *forwards;
    size_t forward_count, forward_capacity;
    struct obj_corner *corners; /* of the face being read */
    size_t corner_count, corner_capacity;
    double *outline; /* its positions */
    size_t outline_capacity;
    uint32_t (*split)[3];
    size_t split_capacity;
    size_t point_count, line_count, unsmoothed_count, degenerate_count, odd_count, dangling_count;
    uint64_t degenerate_line, odd_line, dangling_line;
};

static void problem(struct parser *p, const char *id, const char *hint, const char *text)
{
    diag_add(p->problems, DIAG_ERROR, (struct diag_place){.file = p->file, .line = p->line}, id,
             hint, "%s", text);
}

/* --- Lines and words ----------------------------------------------------- */

static bool at_line_end(const struct parser *p)
{
    return p->at == p->end || *p->at == '\n' || *p->at == '\r' || *p->at == '#';
}

/* Spaces, tabs, and a backslash before a line end. */
static void skip_blank(struct parser *p)
{
    for (; p->at < p->end; p->at++) {
        if (*p->at == ' ' || *p->at == '\t' || *p->at == '\0')
            continue;
        const char *after = p->at + 1;
        if (*p->at == '\\' && after < p->end && *after == '\r')
            after++;
        if (*p->at != '\\' || after >= p->end || *after != '\n')
            return;
        p->at = after;
        p->line++;
    }
}

/* To the start of the next line; "\r\n", "\n" and "\r" end one. */
static void skip_line(struct parser *p)
{
    while (p->at < p->end && *p->at != '\n' && *p->at != '\r')
        p->at++;
    if (p->at == p->end)
        return;
    bool pair = *p->at == '\r' && p->at + 1 < p->end && p->at[1] == '\n';
    p->at += pair ? 2 : 1;
    p->line++;
}

static bool at_word_end(const struct parser *p)
{
    return at_line_end(p) || *p->at == ' ' || *p->at == '\t' || *p->at == '\\' || *p->at == '\0';
}

/* The rest of the line without blanks around it: a name, which may hold spaces. */
static size_t take_name(struct parser *p, const char **name)
{
    skip_blank(p);
    *name = p->at;
    while (p->at < p->end && *p->at != '\n' && *p->at != '\r')
        p->at++;
    const char *stop = p->at;
    while (stop > *name && (stop[-1] == ' ' || stop[-1] == '\t'))
        stop--;
    size_t bytes = (size_t)(stop - *name);
    return bytes < SCENE_NAME_BYTES_MAX ? bytes : SCENE_NAME_BYTES_MAX;
}

/* --- v, vt, vn ----------------------------------------------------------- */

/* One number of the line. Letters glued to it ("3.1+e2") are noted and skipped. */
static bool take_number(struct parser *p, double *out)
{
    skip_blank(p);
    const char *after = at_line_end(p) ? NULL : number_parse(p->at, p->end, out);
    if (!after)
        return false;
    p->at = after;
    if (!at_word_end(p)) {
        p->odd_line = p->odd_count++ ? p->odd_line : p->line;
        while (!at_word_end(p))
            p->at++;
    }
    return true;
}

static void element_problem(struct parser *p, unsigned kind, size_t coordinate)
{
    char text[120], word[24];
    const char *stop = p->at;
    while (stop < p->end && stop - p->at < (long)sizeof word - 1 && (unsigned char)*stop > ' ')
        stop++;
    memcpy(word, p->at, (size_t)(stop - p->at));
    word[stop - p->at] = '\0';
    (void)snprintf(text, sizeof text, "%s %zu: %c is \"%s\", must be a finite number",
                   kind_names[kind], p->count[kind] + 1, "xyz"[coordinate], word);
    problem(p, "not-finite", "re-export the mesh, or correct this line", text);
}

/* White for the positions so far that have no colour. */
static bool pad_colors(struct parser *p, size_t count)
{
    while (p->color_count < count) {
        if (!mem_grow((void **)&p->colors, p->color_count, &p->color_capacity,
                      3 * sizeof *p->colors))
            return false;
        float *to = p->colors + 3 * p->color_count++;
        to[0] = to[1] = to[2] = 1;
    }
    return true;
}

/* The three numbers after a position's, if they are there: a fourth alone is a weight. */
static void parse_color(struct parser *p)
{
    double c[3];
    for (size_t i = 0; i < 3; i++) {
        skip_blank(p);
        const char *after = at_line_end(p) ? NULL : number_parse(p->at, p->end, &c[i]);
        if (!after)
            return;
        p->at = after;
        if (!at_word_end(p))
            return;
    }
    if (!pad_colors(p, p->count[POSITION])) {
        p->out_of_memory = true;
        return;
    }
    for (size_t i = 0; i < 3; i++)
        p->colors[3 * p->color_count - 3 + i] = model_vertex_color(c[i], true);
}

static void parse_element(struct parser *p, unsigned kind)
{
    double limit = kind == POSITION ? SCENE_NUMBER_MAX : (double)FLT_MAX;
    double v[3] = {0, 0, 0};
    size_t width = kind_width[kind], needed = kind == UV ? 1 : width;
    for (size_t i = 0; i < width; i++) {
        skip_blank(p);
        const char *start = p->at;
        bool got = take_number(p, &v[i]);
        if (!got && i >= needed && at_line_end(p))
            break;
        if (!got || !(fabs(v[i]) <= limit)) {
            p->at = start;
            element_problem(p, kind, i);
            v[i] = 0;
            break; /* the element still counts, so that later indices mean the same */
        }
    }
    if (p->count[kind] >= UINT32_MAX - 1 || !mem_grow((void **)&p->values[kind], p->count[kind],
                                                      &p->capacity[kind], width * sizeof(double))) {
        p->out_of_memory = true;
        return;
    }
    memcpy(p->values[kind] + width * p->count[kind]++, v, width * sizeof(double));
    if (kind == POSITION)
        parse_color(p);
}

/* --- f ------------------------------------------------------------------- */

static void index_problem(struct parser *p, unsigned kind, int64_t index)
{
    char text[120];
    (void)snprintf(text, sizeof text, "face refers to %s %lld, expected 1 to %zu or -1 to -%zu",
                   kind_names[kind], (long long)index, p->count[kind], p->count[kind]);
    problem(p, "index-out-of-range", NULL, text);
}

/* A face without its position is an error; without its uv or normal it still has its shape, and
 * is kept when the reader is not strict. */
static void index_missing(struct parser *p, unsigned kind, int64_t index)
{
    if (p->strict || kind == POSITION)
        index_problem(p, kind, index);
    else
        p->dangling_line = p->dangling_count++ ? p->dangling_line : p->line;
}

/* From the file's index to ours; OBJ_NONE (and a problem) when it cannot be. */
static uint32_t resolve(struct parser *p, unsigned kind, int64_t index)
{
    size_t count = p->count[kind];
    if (index < 0 && (uint64_t)-index <= count)
        return (uint32_t)(count - (uint64_t)-index);
    if (index <= 0 || index >= (int64_t)UINT32_MAX) {
        index_missing(p, kind, index);
        return OBJ_NONE;
    }
    if ((uint64_t)index > count) {
        if (!mem_grow((void **)&p->forwards, p->forward_count, &p->forward_capacity,
                      sizeof *p->forwards)) {
            p->out_of_memory = true;
            return OBJ_NONE;
        }
        p->forwards[p->forward_count++] =
            (struct forward){.line = p->line, .index = (uint32_t)index, .kind = kind};
    }
    return (uint32_t)index - 1;
}

/* "7", "7/1", "7//3", "7/1/3", and the same with dangling slashes. */
static bool parse_corner(struct parser *p, struct obj_corner *out)
{
    uint32_t got[KINDS] = {OBJ_NONE, OBJ_NONE, OBJ_NONE};
    for (unsigned kind = 0; kind < KINDS; kind++) {
        int64_t index;
        const char *after = number_parse_int(p->at, p->end, &index);
        if (after) {
            p->at = after;
            got[kind] = resolve(p, kind, index);
        } else if (kind == POSITION) {
            return false;
        }
        if (p->at == p->end || *p->at != '/')
            break;
        p->at++;
    }
    *out = (struct obj_corner){.position = got[POSITION], .uv = got[UV], .normal = got[NORMAL]};
    return at_word_end(p);
}

static bool ensure(void **array, size_t *capacity, size_t count, size_t bytes)
{
    if (count <= *capacity)
        return true;
    size_t wanted = count > 2 * *capacity ? count : 2 * *capacity;
    void *grown = mem_realloc_array(*array, wanted, bytes);
    if (!grown)
        return false;
    *array = grown;
    *capacity = wanted;
    return true;
}

/* Positions of the face's corners; those defined later in the file are not known yet and leave
 * the polygon to be cut as a fan. */
static bool take_outline(struct parser *p)
{
    if (!ensure((void **)&p->outline, &p->outline_capacity, 3 * p->corner_count, sizeof(double)))
        return false;
    for (size_t i = 0; i < p->corner_count; i++) {
        uint32_t position = p->corners[i].position;
        static const double unknown[3] = {0, 0, 0};
        const double *from =
            position < p->count[POSITION] ? p->values[POSITION] + 3 * (size_t)position : unknown;
        memcpy(p->outline + 3 * i, from, 3 * sizeof(double));
    }
    return true;
}

static void add_face(struct parser *p)
{
    size_t count = p->corner_count - 2;
    if (!take_outline(p) ||
        !ensure((void **)&p->split, &p->split_capacity, count, sizeof *p->split) ||
        !ensure((void **)&p->triangles, &p->triangle_capacity, p->triangle_count + count,
                sizeof *p->triangles)) {
        p->out_of_memory = true;
        return;
    }
    polygon_split(p->outline, p->corner_count, p->split);
    p->unsmoothed_count += p->smooths && p->corners[0].normal == OBJ_NONE;
    for (size_t t = 0; t < count; t++) {
        struct obj_triangle *triangle = &p->triangles[p->triangle_count++];
        *triangle = (struct obj_triangle){.material = p->material, .group = p->group};
        for (size_t i = 0; i < 3; i++)
            triangle->corners[i] = p->corners[p->split[t][i]];
    }
}

static void parse_face(struct parser *p)
{
    p->corner_count = 0;
    for (skip_blank(p); !at_line_end(p); skip_blank(p)) {
        if (!mem_grow((void **)&p->corners, p->corner_count, &p->corner_capacity,
                      sizeof *p->corners)) {
            p->out_of_memory = true;
            return;
        }
        if (!parse_corner(p, &p->corners[p->corner_count])) {
            problem(p, "obj-syntax", NULL,
                    "a face corner is not of the form 1, 1/2, 1//3 or 1/2/3");
            return;
        }
        p->corner_count++;
    }
    if (p->corner_count >= 3)
        add_face(p);
    else
        p->degenerate_line = p->degenerate_count++ ? p->degenerate_line : p->line;
}

/* --- The file ------------------------------------------------------------ */

static void parse_name(struct parser *p, struct name_table *table, uint32_t *current)
{
    const char *name;
    size_t bytes = take_name(p, &name);
    if (bytes == 0)
        *current = OBJ_NONE;
    else if (name_table_add(table, name, bytes, current) != ERR_OK)
        p->out_of_memory = true;
}

static bool is_word(const char *word, size_t bytes, const char *what)
{
    return strlen(what) == bytes && memcmp(word, what, bytes) == 0;
}

/* The number of a smoothing group; 0 and "off" are none. */
static void parse_smoothing(struct parser *p)
{
    const char *name;
    size_t bytes = take_name(p, &name);
    p->smooths = bytes > 0 && !is_word(name, bytes, "0") && !is_word(name, bytes, "off");
}

static void parse_line(struct parser *p)
{
    uint32_t unused;
    skip_blank(p);
    const char *word = p->at;
    while (!at_word_end(p))
        p->at++;
    size_t bytes = (size_t)(p->at - word);
    if (is_word(word, bytes, "v"))
        parse_element(p, POSITION);
    else if (is_word(word, bytes, "vt"))
        parse_element(p, UV);
    else if (is_word(word, bytes, "vn"))
        parse_element(p, NORMAL);
    else if (is_word(word, bytes, "f") || is_word(word, bytes, "fo"))
        parse_face(p);
    else if (is_word(word, bytes, "usemtl"))
        parse_name(p, &p->materials, &p->material);
    else if (is_word(word, bytes, "o") || is_word(word, bytes, "g"))
        parse_name(p, &p->groups, &p->group);
    else if (is_word(word, bytes, "mtllib"))
        parse_name(p, &p->libraries, &unused);
    else if (is_word(word, bytes, "s"))
        parse_smoothing(p);
    else if (is_word(word, bytes, "p"))
        p->point_count++;
    else if (is_word(word, bytes, "l"))
        p->line_count++;
    skip_line(p);
}

static void judge_forwards(struct parser *p)
{
    for (size_t i = 0; i < p->forward_count; i++) {
        const struct forward *f = &p->forwards[i];
        p->line = f->line;
        if (f->index > p->count[f->kind])
            index_missing(p, f->kind, f->index);
    }
}

/* Corners whose uv or normal the file turned out not to have lose it. */
static void drop_dangling(struct parser *p)
{
    for (size_t i = 0; p->dangling_count && i < p->triangle_count; i++) {
        for (size_t j = 0; j < 3; j++) {
            struct obj_corner *c = &p->triangles[i].corners[j];
            c->uv = c->uv < p->count[UV] ? c->uv : OBJ_NONE;
            c->normal = c->normal < p->count[NORMAL] ? c->normal : OBJ_NONE;
        }
    }
}

static void warn(struct parser *p, const char *id, size_t count, uint64_t line, const char *what)
{
    if (count)
        diag_add(p->problems, DIAG_WARNING, (struct diag_place){.file = p->file, .line = line}, id,
                 NULL, "%zu %s; this is the first", count, what);
}

static void warn_counts(struct parser *p)
{
    warn(p, "degenerate-face", p->degenerate_count, p->degenerate_line,
         "faces with fewer than three corners are left out");
    warn(p, "odd-number", p->odd_count, p->odd_line,
         "numbers are followed by other characters, which are ignored");
    warn(p, "index-out-of-range", p->dangling_count, p->dangling_line,
         "uv or normal indices are out of range and are ignored");
}

static void parser_release(struct parser *p)
{
    mem_free(p->colors);
    for (unsigned kind = 0; kind < KINDS; kind++)
        mem_free(p->values[kind]);
    mem_free(p->triangles);
    mem_free(p->forwards);
    mem_free(p->corners);
    mem_free(p->outline);
    mem_free(p->split);
    name_table_release(&p->materials);
    name_table_release(&p->groups);
    name_table_release(&p->libraries);
}

static void take_names(struct name_table *from, char ***names, size_t *count)
{
    *names = from->names;
    *count = from->count;
    from->names = NULL;
    from->count = from->capacity = 0;
}

static void give_model(struct parser *p, struct obj_model *out)
{
    *out = (struct obj_model){
        .positions = p->values[POSITION],
        .position_count = p->count[POSITION],
        .colors = p->colors,
        .uvs = p->values[UV],
        .uv_count = p->count[UV],
        .normals = p->values[NORMAL],
        .normal_count = p->count[NORMAL],
        .triangles = p->triangles,
        .triangle_count = p->triangle_count,
        .point_count = p->point_count,
        .line_count = p->line_count,
        .unsmoothed_count = p->unsmoothed_count,
    };
    take_names(&p->materials, &out->material_names, &out->material_count);
    take_names(&p->groups, &out->group_names, &out->group_count);
    take_names(&p->libraries, &out->libraries, &out->library_count);
    p->values[POSITION] = p->values[UV] = p->values[NORMAL] = NULL;
    p->colors = NULL;
    p->triangles = NULL;
}

static enum err read_model(const char *text, size_t bytes, const char *file, bool strict,
                           struct obj_model *out, struct diag_list *problems)
{
    struct parser p = {.at = text,
                       .end = text + bytes,
                       .line = 1,
                       .file = file,
                       .problems = problems,
                       .strict = strict,
                       .material = OBJ_NONE,
                       .group = OBJ_NONE};
    static const char mark[] = "\xEF\xBB\xBF";
    if (bytes >= 3 && memcmp(text, mark, 3) == 0)
        p.at += 3;
    size_t errors_before = problems->error_count;
    while (p.at < p.end && !p.out_of_memory && p.triangle_count <= SCENE_TRIANGLES_MAX)
        parse_line(&p);
    enum err e = p.out_of_memory                          ? ERR_NOMEM
                 : p.triangle_count > SCENE_TRIANGLES_MAX ? ERR_LIMIT
                                                          : ERR_OK;
    if (e == ERR_OK) {
        judge_forwards(&p);
        drop_dangling(&p);
        warn_counts(&p);
        e = problems->error_count == errors_before ? ERR_OK : ERR_INPUT;
    }
    if (e == ERR_OK && p.colors && !pad_colors(&p, p.count[POSITION]))
        e = ERR_NOMEM;
    if (e == ERR_OK)
        give_model(&p, out);
    parser_release(&p);
    return e;
}

enum err obj_read(const char *text, size_t bytes, const char *file, struct obj_model *out,
                  struct diag_list *problems)
{
    return read_model(text, bytes, file, false, out, problems);
}

enum err obj_read_strict(const char *text, size_t bytes, const char *file, struct obj_model *out,
                         struct diag_list *problems)
{
    return read_model(text, bytes, file, true, out, problems);
}

static void names_release(char **names, size_t count)
{
    for (size_t i = 0; i < count; i++)
        mem_free(names[i]);
    mem_free(names);
}

void obj_release(struct obj_model *m)
{
    mem_free(m->positions);
    mem_free(m->colors);
    mem_free(m->uvs);
    mem_free(m->normals);
    mem_free(m->triangles);
    names_release(m->material_names, m->material_count);
    names_release(m->group_names, m->group_count);
    names_release(m->libraries, m->library_count);
    *m = (struct obj_model){0};
}
