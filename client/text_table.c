#include "client/text_table.h"

#include <locale.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <wchar.h>

#include "common/mem.h"
#include "common/utf8.h"

enum { CELL_BYTES = 256, NAME_WIDTH_MIN = 12 };

void text_table_init(struct text_table *t, const char *const *headings, const char *align)
{
    *t = (struct text_table){
        .headings = headings, .align = align, .color_column = -1, .name_column = -1};
    t->column_count = strlen(align);
    TL_ASSERT(t->column_count > 0 && t->column_count <= TEXT_TABLE_COLUMNS_MAX);
}

void text_table_release(struct text_table *t)
{
    for (size_t i = 0; i < t->cell_count; i++)
        mem_free(t->cells[i]);
    mem_free(t->cells);
    *t = (struct text_table){0};
}

void text_table_add(struct text_table *t, const char *text)
{
    char *copy = mem_strndup(text && text[0] ? text : "-", CELL_BYTES);
    if (!copy || !mem_grow((void **)&t->cells, t->cell_count, &t->capacity, sizeof *t->cells)) {
        mem_free(copy);
        t->failed = true;
        return;
    }
    utf8_mask(copy);
    t->cells[t->cell_count++] = copy;
}

void text_table_addf(struct text_table *t, const char *format, ...)
{
    char text[CELL_BYTES];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    text_table_add(t, text);
}

/* The C library knows how wide characters are, in a locale whose wide characters are code points.
 * This thread's locale is that one between the two calls; where there is none, each byte that
 * begins a character is a column. */
struct widths_locale {
    locale_t own, before;
};

static struct widths_locale widths_begin(void)
{
    struct widths_locale w = {.own = newlocale(LC_CTYPE_MASK, "C.UTF-8", (locale_t)0)};
    if (w.own)
        w.before = uselocale(w.own);
    return w;
}

static void widths_end(const struct widths_locale *w)
{
    if (!w->own)
        return;
    (void)uselocale(w->before);
    freelocale(w->own);
}

/* The bytes of the first characters that take at most `columns_max` columns of a terminal, and how
 * many these take: two for a character of China, Japan or Korea, none for a combining mark. */
static size_t fit(const char *text, size_t columns_max, size_t *columns)
{
    const char *p = text, *end = text + strlen(text);
    for (*columns = 0; p < end;) {
        wchar_t c = 0;
        int bytes = mbtowc(&c, p, (size_t)(end - p));
        int wide = bytes > 0 ? wcwidth(c) : ((unsigned char)*p & 0xc0) != 0x80;
        size_t more = wide >= 0 ? (size_t)wide : 1;
        if (more > columns_max - *columns)
            break;
        *columns += more;
        p += bytes > 0 ? bytes : 1;
    }
    return (size_t)(p - text);
}

static size_t width_of(const char *text)
{
    size_t columns;
    (void)fit(text, SIZE_MAX, &columns);
    return columns;
}

/* 16-colour codes of the states that want attention; words carry the meaning without them. */
static const char *color_of(const char *word)
{
    static const struct {
        const char *word, *code;
    } colors[] = {{"done", "32"},      {"rendering", "36"}, {"busy", "36"},
                  {"failed", "31"},    {"cancelled", "33"}, {"lost", "31"},
                  {"set aside", "31"}, {"paused", "33"},    {"draining", "33"}};
    for (size_t i = 0; i < sizeof colors / sizeof *colors; i++)
        if (strcmp(word, colors[i].word) == 0)
            return colors[i].code;
    return NULL;
}

static void put_cell(const struct text_table *t, size_t column, const char *text, size_t width,
                     bool color, struct buf *out)
{
    bool right = t->align[column] == 'r', last = column + 1 == t->column_count;
    const char *code = color && (int)column == t->color_column ? color_of(text) : NULL;
    const char *cut = width_of(text) > width && !last ? ".." : "";
    size_t own, bytes = fit(text, width - strlen(cut), &own);
    size_t pad = width - own - strlen(cut);
    if (right)
        buf_printf(out, "%*s", (int)pad, "");
    if (code)
        buf_printf(out, "\x1b[%sm", code);
    buf_printf(out, "%.*s%s", (int)bytes, text, cut);
    if (code)
        buf_printf(out, "\x1b[0m");
    if (!right && !last)
        buf_printf(out, "%*s", (int)pad, "");
    buf_printf(out, last ? "\n" : "  ");
}

/* Takes from a name what the line is too long by; how much that is. */
static size_t shrink(size_t *width, size_t line, size_t columns)
{
    size_t room = *width > NAME_WIDTH_MIN ? *width - NAME_WIDTH_MIN : 0;
    size_t excess = line > columns ? line - columns : 0;
    size_t taken = excess < room ? excess : room;
    *width -= taken;
    return taken;
}

void text_table_print(const struct text_table *t, int columns, bool color, struct buf *out)
{
    struct widths_locale locale = widths_begin();
    size_t widths[TEXT_TABLE_COLUMNS_MAX] = {0}, total = 0;
    for (size_t c = 0; c < t->column_count; c++) {
        widths[c] = width_of(t->headings[c]);
        for (size_t i = c; i < t->cell_count; i += t->column_count)
            if (width_of(t->cells[i]) > widths[c])
                widths[c] = width_of(t->cells[i]);
        total += widths[c] + 2;
    }
    size_t last = t->column_count - 1;
    if (columns > 0 && t->name_column >= 0)
        total -= shrink(&widths[t->name_column], total - 2, (size_t)columns);
    size_t before = total - widths[last] - 2;
    if (columns > 0 && total - 2 > (size_t)columns)
        widths[last] = before + 4 < (size_t)columns ? (size_t)columns - before : 4;
    for (size_t c = 0; c < t->column_count; c++)
        put_cell(t, c, t->headings[c], widths[c], false, out);
    for (size_t i = 0; i + t->column_count <= t->cell_count; i += t->column_count)
        for (size_t c = 0; c < t->column_count; c++)
            put_cell(t, c, t->cells[i + c], widths[c], color, out);
    widths_end(&locale);
    out->failed |= t->failed;
}
