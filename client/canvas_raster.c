/* client/canvas_raster.c: the canvas as pixels: coverage from the distance to what is drawn. */
#include <math.h>
#include <string.h>

#include "client/canvas.h"

#define DASH 4.0

/* Colours of the display are mixed as they are: thin lines look as a browser draws them. */
static void blend(struct canvas *c, int64_t x, int64_t y, double coverage,
                  const unsigned char ink[3])
{
    if (x < 0 || y < 0 || x >= (int64_t)c->width || y >= (int64_t)c->height || coverage <= 0)
        return;
    float share = (float)(coverage > 1 ? 1 : coverage);
    float *pixel = c->rgb + 3 * ((size_t)y * c->width + (size_t)x);
    for (int k = 0; k < 3; k++)
        pixel[k] += share * ((float)ink[k] - pixel[k]);
}

/* Distance of a point to a segment; *along is how far along it, in pixels, the nearest one lies. */
static double segment_distance(const struct canvas_line *l, double x, double y, double *along)
{
    double dx = l->x1 - l->x0, dy = l->y1 - l->y0, square = dx * dx + dy * dy;
    double t = square > 0 ? ((x - l->x0) * dx + (y - l->y0) * dy) / square : 0;
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    *along = t * sqrt(square);
    return hypot(x - l->x0 - t * dx, y - l->y0 - t * dy);
}

void raster_line(struct canvas *c, const struct canvas_line *l)
{
    unsigned char ink[3];
    double reach = l->width / 2 + 1;
    canvas_color(l->ink, ink);
    int64_t top = (int64_t)floor(fmin(l->y0, l->y1) - reach);
    int64_t bottom = (int64_t)ceil(fmax(l->y0, l->y1) + reach);
    int64_t left = (int64_t)floor(fmin(l->x0, l->x1) - reach);
    int64_t right = (int64_t)ceil(fmax(l->x0, l->x1) + reach);
    for (int64_t y = top; y <= bottom; y++) {
        for (int64_t x = left; x <= right; x++) {
            double along;
            double d = segment_distance(l, (double)x + 0.5, (double)y + 0.5, &along);
            bool gap = l->dashed && fmod(along, 2 * DASH) >= DASH;
            if (!gap)
                blend(c, x, y, l->width / 2 + 0.5 - d, ink);
        }
    }
}

/* How deep a point lies inside a shape; negative outside. */
static double depth_in(const struct canvas_mark *m, double radius, double x, double y)
{
    double dx = fabs(x - m->x), dy = y - m->y;
    switch (m->shape) {
    case SHAPE_SQUARE:
        return 0.85 * radius - fmax(dx, fabs(dy));
    case SHAPE_DIAMOND:
        return (1.2 * radius - dx - fabs(dy)) * sqrt(0.5);
    case SHAPE_TRIANGLE:
        /* The slanted side goes from (0, -1.2 r) to (1.1 r, 0.8 r). */
        return fmin(0.8 * radius - dy, (1.1 * (dy + 1.2 * radius) - 2 * dx) / hypot(1.1, 2));
    default:
        return radius - hypot(dx, dy);
    }
}

void raster_mark(struct canvas *c, const struct canvas_mark *m)
{
    unsigned char ink[3], edge[3];
    double reach = 1.5 * m->radius + 2;
    canvas_color(m->ink, ink);
    canvas_color(m->ringed ? INK_TEXT : INK_PAPER, edge);
    for (int64_t y = (int64_t)floor(m->y - reach); y <= (int64_t)ceil(m->y + reach); y++) {
        for (int64_t x = (int64_t)floor(m->x - reach); x <= (int64_t)ceil(m->x + reach); x++) {
            double px = (double)x + 0.5, py = (double)y + 0.5;
            blend(c, x, y, depth_in(m, m->radius + 0.5, px, py) + 0.5, edge);
            blend(c, x, y, depth_in(m, m->radius - 0.5, px, py) + 0.5, ink);
        }
    }
}

/* One letter with its left end of the baseline at (x, y). */
static void draw_letter(struct canvas *c, const struct canvas_words *w, double x, double y,
                        double unit)
{
    bool pen_down = false;
    double from[2] = {0};
    for (const char *p = font_strokes(*w->text); *p; p++) {
        if (*p == ' ') {
            pen_down = false;
            continue;
        }
        double right = unit * (p[0] - '0'), up = unit * (p[1] - '0' - FONT_BASELINE);
        double to[2] = {x + (w->upwards ? -up : right), y - (w->upwards ? right : up)};
        struct canvas_line stroke = {.x0 = pen_down ? from[0] : to[0],
                                     .y0 = pen_down ? from[1] : to[1],
                                     .x1 = to[0],
                                     .y1 = to[1],
                                     .width = fmax(1.1, 0.11 * w->size),
                                     .ink = w->ink};
        raster_line(c, &stroke);
        memcpy(from, to, sizeof from);
        pen_down = true;
        p++;
    }
}

void raster_words(struct canvas *c, const struct canvas_words *words)
{
    struct canvas_words w = *words;
    double unit = 0.72 * w.size / FONT_CAPITAL;
    double length = unit * (FONT_ADVANCE * (double)strlen(w.text) - 2);
    double shift = w.align == ALIGN_LEFT ? 0 : w.align == ALIGN_CENTER ? length / 2 : length;
    double x = w.x - (w.upwards ? 0 : shift), y = w.y + (w.upwards ? shift : 0);
    for (; *w.text; w.text++) {
        draw_letter(c, &w, x, y, unit);
        x += w.upwards ? 0 : unit * FONT_ADVANCE;
        y -= w.upwards ? unit * FONT_ADVANCE : 0;
    }
}
