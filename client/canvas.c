#include "client/canvas.h"

#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/png_file.h"

/* Light and dark. The series are told apart by shape as well: colour alone is not for everyone. */
static const char *const colors[INK_COUNT][2] = {
    [INK_PAPER] = {"#ffffff", "#16181d"},       [INK_TEXT] = {"#1c2026", "#e8eaee"},
    [INK_MUTED] = {"#69717d", "#9aa3af"},       [INK_GRID] = {"#dfe3e8", "#343a44"},
    [INK_SERIES] = {"#1f5fbf", "#6ea8ff"},      [INK_SERIES + 1] = {"#c2570c", "#f59a4e"},
    [INK_SERIES + 2] = {"#1d7f45", "#5fc98a"},  [INK_SERIES + 3] = {"#a3278f", "#e583d6"},
    [INK_SERIES + 4] = {"#0f7f8c", "#4fc7d4"},  [INK_SERIES + 5] = {"#b3261e", "#ff8a80"},
    [INK_SERIES + 6] = {"#6b51c9", "#ab98ff"},  [INK_SERIES + 7] = {"#7a6a00", "#d3c04c"},
    [INK_SERIES + 8] = {"#5d4037", "#bf9b8e"},  [INK_SERIES + 9] = {"#3f6212", "#a6cf5c"},
    [INK_SERIES + 10] = {"#475569", "#a3b1c6"}, [INK_SERIES + 11] = {"#be123c", "#ff7d9c"},
};

void canvas_color(enum canvas_ink ink, unsigned char rgb[3])
{
    unsigned r = 0, g = 0, b = 0;
    (void)sscanf(colors[ink][0], "#%2x%2x%2x", &r, &g, &b);
    rgb[0] = (unsigned char)r;
    rgb[1] = (unsigned char)g;
    rgb[2] = (unsigned char)b;
}

void canvas_put_escaped(struct buf *out, const char *text)
{
    for (; *text; text++) {
        switch (*text) {
        case '<':
            buf_printf(out, "&lt;");
            break;
        case '>':
            buf_printf(out, "&gt;");
            break;
        case '&':
            buf_printf(out, "&amp;");
            break;
        case '"':
            buf_printf(out, "&quot;");
            break;
        default:
            /* Control characters are not allowed in XML. */
            buf_put_u8(out, (unsigned char)*text < 0x20 ? '?' : (uint8_t)*text);
        }
    }
}

void canvas_put_colors(struct buf *out)
{
    for (int scheme = 0; scheme < 2; scheme++) {
        buf_printf(out, scheme ? "@media (prefers-color-scheme: dark) { :root {" : ":root {");
        for (int i = 0; i < INK_COUNT; i++)
            buf_printf(out, " --ink%d: %s;", i, colors[i][scheme]);
        buf_printf(out, scheme ? " } }\n" : " }\n");
    }
}

void canvas_init_svg(struct canvas *c, uint32_t width, uint32_t height, struct buf *out)
{
    *c = (struct canvas){.width = width, .height = height, .svg = out};
    buf_printf(out,
               "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %u %u\" "
               "font-family=\"system-ui, sans-serif\">\n<style>\n",
               width, height);
    canvas_put_colors(out);
    buf_printf(out, "</style>\n<rect width=\"%u\" height=\"%u\" style=\"fill: var(--ink0)\"/>\n",
               width, height);
}

enum err canvas_finish_svg(struct canvas *c)
{
    buf_printf(c->svg, "</svg>\n");
    return buf_status(c->svg);
}

static void svg_line(struct canvas *c, const struct canvas_line *l)
{
    buf_printf(c->svg,
               "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" "
               "style=\"stroke: var(--ink%d); stroke-width: %.1f%s\"/>\n",
               l->x0, l->y0, l->x1, l->y1, (int)l->ink, l->width,
               l->dashed ? "; stroke-dasharray: 4 4" : "");
}

static void svg_mark(struct canvas *c, const struct canvas_mark *m)
{
    double r = m->radius, x = m->x, y = m->y;
    char style[120];
    (void)snprintf(style, sizeof style, "style=\"fill: var(--ink%d); stroke: var(--ink%d)\"",
                   (int)m->ink, m->ringed ? INK_TEXT : INK_PAPER);
    if (m->tooltip) {
        buf_printf(c->svg, "<g><title>");
        canvas_put_escaped(c->svg, m->tooltip);
        buf_printf(c->svg, "</title>");
    }
    switch (m->shape) {
    case SHAPE_SQUARE:
        buf_printf(c->svg, "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"%.1f\" %s/>",
                   x - 0.85 * r, y - 0.85 * r, 1.7 * r, 1.7 * r, style);
        break;
    case SHAPE_DIAMOND:
        buf_printf(c->svg, "<path d=\"M%.1f %.1fL%.1f %.1fL%.1f %.1fL%.1f %.1fZ\" %s/>", x,
                   y - 1.2 * r, x + 1.2 * r, y, x, y + 1.2 * r, x - 1.2 * r, y, style);
        break;
    case SHAPE_TRIANGLE:
        buf_printf(c->svg, "<path d=\"M%.1f %.1fL%.1f %.1fL%.1f %.1fZ\" %s/>", x, y - 1.2 * r,
                   x + 1.1 * r, y + 0.8 * r, x - 1.1 * r, y + 0.8 * r, style);
        break;
    default:
        buf_printf(c->svg, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"%.1f\" %s/>", x, y, r, style);
    }
    buf_printf(c->svg, m->tooltip ? "</g>\n" : "\n");
}

static void svg_words(struct canvas *c, const struct canvas_words *w)
{
    static const char *const anchors[] = {"start", "middle", "end"};
    char turn[80] = "";
    if (w->upwards)
        (void)snprintf(turn, sizeof turn, " transform=\"rotate(-90 %.1f %.1f)\"", w->x, w->y);
    buf_printf(c->svg,
               "<text x=\"%.1f\" y=\"%.1f\"%s style=\"fill: var(--ink%d); font-size: %.0fpx; "
               "text-anchor: %s\">",
               w->x, w->y, turn, (int)w->ink, w->size, anchors[w->align]);
    canvas_put_escaped(c->svg, w->text);
    buf_printf(c->svg, "</text>\n");
}

enum err canvas_init_raster(struct canvas *c, uint32_t width, uint32_t height)
{
    *c = (struct canvas){.width = width, .height = height};
    size_t values = 3 * (size_t)width * height;
    c->rgb = mem_alloc_array(values, sizeof *c->rgb);
    if (!c->rgb)
        return ERR_NOMEM;
    for (size_t i = 0; i < values; i++)
        c->rgb[i] = 255;
    return ERR_OK;
}

enum err canvas_finish_png(struct canvas *c, struct buf *out)
{
    size_t values = 3 * (size_t)c->width * c->height;
    unsigned char *bytes = mem_alloc(values);
    enum err e = bytes ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; bytes && i < values; i++)
        bytes[i] = (unsigned char)(c->rgb[i] + 0.5f);
    if (e == ERR_OK)
        e = png_write_bytes(bytes, c->width, c->height, 3, out);
    mem_free(bytes);
    mem_free(c->rgb);
    *c = (struct canvas){0};
    return e;
}

void canvas_line(struct canvas *c, const struct canvas_line *line)
{
    if (c->svg)
        svg_line(c, line);
    else
        raster_line(c, line);
}

void canvas_mark(struct canvas *c, const struct canvas_mark *mark)
{
    if (c->svg)
        svg_mark(c, mark);
    else
        raster_mark(c, mark);
}

void canvas_words(struct canvas *c, const struct canvas_words *words)
{
    if (c->svg)
        svg_words(c, words);
    else
        raster_words(c, words);
}
