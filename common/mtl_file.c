#include "common/mtl_file.h"

#include <math.h>
#include <string.h>
#include <strings.h>

#include "common/mem.h"
#include "common/number.h"
#include "common/scene.h"

struct parser {
    const char *at, *end; /* the rest of the line */
    uint64_t line;
    const char *file;
    struct mtl_library *library;
    size_t capacity;
    struct mtl_material *material; /* the one being read; NULL before the first */
    struct diag_list *problems;
    bool out_of_memory;
};

static void warn(struct parser *p, const char *id, const char *text, const char *word)
{
    diag_add(p->problems, DIAG_WARNING, (struct diag_place){.file = p->file, .line = p->line}, id,
             NULL, text, word);
}

/* --- Words --------------------------------------------------------------- */

static bool is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\0';
}

static void skip_blank(struct parser *p)
{
    while (p->at < p->end && is_blank(*p->at))
        p->at++;
}

/* The next word of the line; 0 bytes at its end. */
static size_t take_word(struct parser *p, const char **word)
{
    skip_blank(p);
    *word = p->at;
    while (p->at < p->end && !is_blank(*p->at))
        p->at++;
    return (size_t)(p->at - *word);
}

static bool word_is(const char *word, size_t bytes, const char *known)
{
    return bytes == strlen(known) && strncasecmp(word, known, bytes) == 0;
}

/* The end of what a statement says: of the line, or a comment. */
static bool at_values_end(struct parser *p)
{
    skip_blank(p);
    return p->at == p->end || *p->at == '#';
}

/* One finite number; false leaves the place where it was. */
static bool take_number(struct parser *p, double *out)
{
    skip_blank(p);
    double v;
    const char *after = number_parse(p->at, p->end, &v);
    if (!after || (after < p->end && !is_blank(*after)) || !(fabs(v) <= SCENE_NUMBER_MAX))
        return false;
    p->at = after;
    *out = v;
    return true;
}

/* The rest of the line without blanks around it; a comment ends it when `cut` is set. */
static char *take_rest(struct parser *p, bool cut)
{
    skip_blank(p);
    const char *stop = p->end;
    for (const char *c = p->at; cut && c < stop; c++)
        if (*c == '#' && c > p->at && is_blank(c[-1]))
            stop = c;
    while (stop > p->at && is_blank(stop[-1]))
        stop--;
    size_t bytes = (size_t)(stop - p->at);
    char *text = mem_strndup(p->at, bytes < 4096 ? bytes : 4096);
    p->out_of_memory |= !text;
    return text;
}

/* --- Values -------------------------------------------------------------- */

static double clamped(double v, double low, double high)
{
    return v < low ? low : v > high ? high : v;
}

static bool read_scalar(struct parser *p, const char *word, double low, double high, double *out)
{
    double v;
    if (!take_number(p, &v)) {
        warn(p, "bad-number", "%s: expected a finite number", word);
        return false;
    }
    *out = clamped(v, low, high);
    return true;
}

/* Three numbers, or one for all three. Spectral and XYZ forms are left out. */
static bool read_color(struct parser *p, const char *word, double out[3])
{
    double v[3];
    int count = 0;
    while (count < 3 && take_number(p, &v[count]))
        count++;
    if (count < 3 && !(count == 1 && at_values_end(p))) {
        warn(p, "bad-color", "%s: expected three finite numbers, or one", word);
        return false;
    }
    if (count == 1)
        v[1] = v[2] = v[0];
    for (int i = 0; i < 3; i++)
        out[i] = clamped(v[i], 0, 1e9);
    return true;
}

static const struct {
    const char *word;
    enum mtl_map_id id;
} map_words[] = {
    {"map_Kd", MTL_MAP_KD},     {"map_Ke", MTL_MAP_KE},   {"map_Ks", MTL_MAP_KS},
    {"map_d", MTL_MAP_D},       {"norm", MTL_MAP_NORMAL}, {"map_Kn", MTL_MAP_NORMAL},
    {"map_Bump", MTL_MAP_BUMP}, {"bump", MTL_MAP_BUMP},   {"map_Pr", MTL_MAP_PR},
    {"map_Pm", MTL_MAP_PM},
};

/* True if the next word is a number that we cannot use, and takes it, so that it is not part of a
 * file's name: "nan", "-inf", 1e999. */
static bool take_bad_number(struct parser *p)
{
    static const char *const words[] = {"nan", "inf", "infinity"};
    const char *start = p->at, *word;
    double v;
    size_t bytes = take_word(p, &word);
    size_t sign = bytes > 1 && (*word == '-' || *word == '+');
    if (number_parse(word, word + bytes, &v) == word + bytes)
        return true;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (word_is(word + sign, bytes - sign, words[i]))
            return true;
    p->at = start;
    return false;
}

/* One to `most` numbers of a map's option; how many could be used. */
static int take_option_numbers(struct parser *p, int most, double v[3])
{
    int count = 0;
    while (count < most && take_number(p, &v[count]))
        count++;
    for (int i = count; i < most; i++)
        if (take_bad_number(p) && i == count)
            warn(p, "bad-number", "%s: expected a finite number", "an option of the map");
    return count;
}

/* How many words follow an option of a map. -o -s -t take one to three numbers. */
static void read_map_option(struct parser *p, const char *option, size_t bytes, struct mtl_map *map)
{
    double v[3];
    const char *word;
    if (word_is(option, bytes, "-s") || word_is(option, bytes, "-o") ||
        word_is(option, bytes, "-t")) {
        int count = take_option_numbers(p, 3, v);
        double *to = word_is(option, bytes, "-s")   ? map->scale
                     : word_is(option, bytes, "-o") ? map->offset
                                                    : NULL;
        for (int i = 0; to && i < count && i < 2; i++)
            to[i] = v[i];
    } else if (word_is(option, bytes, "-clamp")) {
        size_t n = take_word(p, &word);
        map->clamp = word_is(word, n, "on");
    } else if (word_is(option, bytes, "-bm")) {
        if (take_option_numbers(p, 1, v) == 1)
            map->bump = v[0];
    } else if (word_is(option, bytes, "-mm")) {
        (void)take_word(p, &word);
        (void)take_word(p, &word);
    } else {
        (void)take_word(p, &word);
    }
}

static void read_map_options(struct parser *p, struct mtl_map *map)
{
    for (;;) {
        skip_blank(p);
        const char *start = p->at, *word;
        size_t bytes = take_word(p, &word);
        bool is_option = bytes > 1 && word[0] == '-' && word[1] >= 'a' && word[1] <= 'z';
        if (!is_option) {
            p->at = start;
            return;
        }
        read_map_option(p, word, bytes, map);
    }
}

/* More behind the name of a file is a part of it, so that no line takes long. */
enum { OPTIONS_BYTES_MAX = 256 };

/* True if a line from `at` on is options of a map, one at least, and nothing else. */
static bool is_options(const char *at, const char *end)
{
    static const struct {
        const char *word;
        int least, most; /* numbers; 0: a word */
    } options[] = {{"-s", 1, 3},      {"-o", 1, 3},      {"-t", 1, 3},      {"-bm", 1, 1},
                   {"-mm", 2, 2},     {"-boost", 1, 1},  {"-texres", 1, 1}, {"-clamp", 0, 0},
                   {"-blendu", 0, 0}, {"-blendv", 0, 0}, {"-cc", 0, 0},     {"-imfchan", 0, 0},
                   {"-type", 0, 0}};
    enum { OPTIONS = sizeof options / sizeof *options };
    struct parser p = {.at = at, .end = end};
    const char *word;
    double v;
    for (size_t bytes = take_word(&p, &word); bytes > 0; bytes = take_word(&p, &word)) {
        size_t i = 0;
        while (i < OPTIONS && !word_is(word, bytes, options[i].word))
            i++;
        if (i == OPTIONS)
            return false;
        int count = 0;
        while (count < options[i].most && take_number(&p, &v))
            count++;
        if (count < options[i].least || (options[i].most == 0 && take_word(&p, &word) == 0))
            return false;
    }
    return true;
}

/* Where options follow the name of the file, though they belong before it; NULL: nowhere. */
static const char *options_behind(const struct parser *p)
{
    bool is_long = p->end - p->at > OPTIONS_BYTES_MAX;
    for (const char *c = is_long ? p->end - OPTIONS_BYTES_MAX : p->at; c < p->end; c++)
        if (*c == '-' && c > p->at && is_blank(c[-1]) && is_options(c, p->end))
            return c;
    return NULL;
}

static void read_map(struct parser *p, enum mtl_map_id id)
{
    struct mtl_map map = {.scale = {1, 1}, .bump = 1};
    read_map_options(p, &map);
    const char *end = p->end, *options = options_behind(p);
    p->end = options ? options : end;
    map.path = take_rest(p, false);
    if (options) {
        p->at = options;
        p->end = end;
        read_map_options(p, &map);
    }
    if (!map.path || !*map.path) {
        if (map.path)
            warn(p, "bad-map", "%s names no file", "the map");
        mem_free(map.path);
        return;
    }
    for (char *c = map.path; *c; c++)
        if (*c == '\\')
            *c = '/';
    mem_free(p->material->maps[id].path);
    p->material->maps[id] = map;
}

static bool read_map_word(struct parser *p, const char *word, size_t bytes)
{
    for (size_t i = 0; i < sizeof map_words / sizeof *map_words; i++)
        if (word_is(word, bytes, map_words[i].word)) {
            read_map(p, map_words[i].id);
            return true;
        }
    return false;
}

static bool read_color_word(struct parser *p, const char *word, size_t bytes)
{
    struct mtl_material *m = p->material;
    if (word_is(word, bytes, "Kd"))
        m->has_kd = read_color(p, "Kd", m->kd) || m->has_kd;
    else if (word_is(word, bytes, "Ke"))
        m->has_ke = read_color(p, "Ke", m->ke) || m->has_ke;
    else if (word_is(word, bytes, "Ks"))
        (void)read_color(p, "Ks", m->ks);
    else if (word_is(word, bytes, "Ka"))
        (void)read_color(p, "Ka", m->ka);
    else if (word_is(word, bytes, "Tf"))
        (void)read_color(p, "Tf", m->tf);
    else
        return false;
    return true;
}

/* "d -halo 0.5" is read without the halo. */
static void read_opacity(struct parser *p)
{
    const char *start = p->at, *word;
    size_t bytes = take_word(p, &word);
    if (!word_is(word, bytes, "-halo"))
        p->at = start;
    if (read_scalar(p, "d", 0, 1, &p->material->opacity))
        p->material->has_d = true;
}

static void read_scalar_word(struct parser *p, const char *word, size_t bytes)
{
    struct mtl_material *m = p->material;
    double v;
    if (word_is(word, bytes, "Ns"))
        (void)read_scalar(p, "Ns", 0, 1e6, &m->ns);
    else if (word_is(word, bytes, "Ni"))
        (void)read_scalar(p, "Ni", 0, 10, &m->ni);
    else if (word_is(word, bytes, "d"))
        read_opacity(p);
    else if (word_is(word, bytes, "Tr") && read_scalar(p, "Tr", 0, 1, &v))
        m->opacity = m->has_d ? m->opacity : 1 - v;
    else if (word_is(word, bytes, "illum") && read_scalar(p, "illum", 0, 10, &v))
        m->illum = (int)v;
    else if (word_is(word, bytes, "Pr"))
        m->has_roughness |= read_scalar(p, "Pr", 0, 1, &m->roughness);
    else if (word_is(word, bytes, "Pm"))
        m->has_metallic |= read_scalar(p, "Pm", 0, 1, &m->metallic);
    else if (word_is(word, bytes, "Ps"))
        (void)read_scalar(p, "Ps", 0, 1, &m->sheen);
    else if (word_is(word, bytes, "Pc"))
        (void)read_scalar(p, "Pc", 0, 1, &m->clearcoat);
    else if (word_is(word, bytes, "Pcr"))
        (void)read_scalar(p, "Pcr", 0, 1, &m->clearcoat_roughness);
}

static void begin_material(struct parser *p)
{
    struct mtl_library *l = p->library;
    char *name = take_rest(p, false);
    if (!name || !mem_grow((void **)&l->materials, l->count, &p->capacity, sizeof *l->materials)) {
        p->out_of_memory = true;
        mem_free(name);
        return;
    }
    p->material = &l->materials[l->count++];
    *p->material = (struct mtl_material){.name = name,
                                         .line = p->line,
                                         .kd = {0.8, 0.8, 0.8},
                                         .tf = {1, 1, 1},
                                         .opacity = 1,
                                         .illum = -1};
}

static void read_line(struct parser *p)
{
    const char *word;
    size_t bytes = take_word(p, &word);
    if (bytes == 0 || *word == '#')
        return;
    if (word_is(word, bytes, "newmtl"))
        begin_material(p);
    else if (!p->material)
        warn(p, "no-newmtl", "a value stands before the first newmtl%s", "");
    else if (!read_color_word(p, word, bytes) && !read_map_word(p, word, bytes))
        read_scalar_word(p, word, bytes);
}

enum err mtl_read(const char *text, size_t bytes, const char *file, struct mtl_library *out,
                  struct diag_list *problems)
{
    struct mtl_library library = {0};
    struct parser p = {.file = file, .library = &library, .problems = problems};
    const char *all_end = text + bytes;
    static const char mark[] = "\xEF\xBB\xBF";
    if (bytes >= 3 && memcmp(text, mark, 3) == 0)
        text += 3;
    for (const char *line = text; line < all_end && !p.out_of_memory;) {
        p.at = p.end = line;
        while (p.end < all_end && *p.end != '\n' && *p.end != '\r')
            p.end++;
        p.line++;
        read_line(&p);
        bool pair = all_end - p.end >= 2 && p.end[0] == '\r' && p.end[1] == '\n';
        line = p.end + (pair ? 2 : 1);
    }
    if (p.out_of_memory) {
        mtl_release(&library);
        return ERR_NOMEM;
    }
    *out = library;
    return ERR_OK;
}

void mtl_release(struct mtl_library *library)
{
    for (size_t i = 0; i < library->count; i++) {
        for (size_t j = 0; j < MTL_MAP_COUNT; j++)
            mem_free(library->materials[i].maps[j].path);
        mem_free(library->materials[i].name);
    }
    mem_free(library->materials);
    *library = (struct mtl_library){0};
}
