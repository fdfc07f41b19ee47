#include "client/text_table.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

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

/* Characters, not bytes, of UTF-8. */
static size_t width_of(const char *text)
{
    size_t width = 0;
    for (; *text; text++)
        width += ((unsigned char)*text & 0xc0) != 0x80;
    return width;
}

/* Bytes of the first `width` characters. */
static size_t bytes_of(const char *text, size_t width)
{
    const char *p = text;
    while (*p && width > 0) {
        p++;
        while (((unsigned char)*p & 0xc0) == 0x80)
            p++;
        width--;
    }
    return (size_t)(p - text);
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
    size_t own = width_of(text), pad = own < width ? width - own : 0;
    bool right = t->align[column] == 'r', last = column + 1 == t->column_count;
    const char *code = color && (int)column == t->color_column ? color_of(text) : NULL;
    if (right)
        buf_printf(out, "%*s", (int)pad, "");
    const char *cut = own > width && !last ? ".." : "";
    if (code)
        buf_printf(out, "\x1b[%sm", code);
    buf_printf(out, "%.*s%s", (int)bytes_of(text, own > width ? width - strlen(cut) : own), text,
               cut);
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
    out->failed |= t->failed;
}
