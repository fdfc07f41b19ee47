#include "client/study_plot.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "client/human.h"
#include "client/study_write.h"

enum { LEFT = 92, RIGHT = 250, TOP = 56, BOTTOM = 64 };
enum { POINT_SIZE = 6, SMALL_TEXT = 13, TEXT = 15, TITLE_TEXT = 18 };

/* Decades of the axes, rounded outwards to a third of one. */
struct frame {
    double x_low, x_high, y_low, y_high; /* log10 */
};

enum canvas_ink study_ink(enum study_knob knob)
{
    return (enum canvas_ink)(INK_SERIES + (int)knob % CANVAS_SERIES);
}

enum canvas_shape study_shape(enum study_knob knob)
{
    /* The inks that are used again come with another shape. */
    return (enum canvas_shape)(((int)knob + (int)knob / CANVAS_SERIES) % SHAPE_COUNT);
}

static bool drawn(const struct study_point *p)
{
    return study_point_measured(p) && p->cost.value > 0 && p->error.value > 0;
}

static double x_of(const struct frame *f, double cost)
{
    double t = (log10(cost) - f->x_low) / (f->x_high - f->x_low);
    return LEFT + t * (STUDY_PLOT_WIDTH - LEFT - RIGHT);
}

static double y_of(const struct frame *f, double error)
{
    double t = (log10(error) - f->y_low) / (f->y_high - f->y_low);
    return STUDY_PLOT_HEIGHT - BOTTOM - t * (STUDY_PLOT_HEIGHT - TOP - BOTTOM);
}

static void widen(double *low, double *high, double value)
{
    if (!(value > 0) || !isfinite(value))
        return;
    *low = fmin(*low, log10(value));
    *high = fmax(*high, log10(value));
}

static struct frame frame_of(const struct study *s)
{
    struct frame f = {HUGE_VAL, -HUGE_VAL, HUGE_VAL, -HUGE_VAL};
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (!drawn(p))
            continue;
        widen(&f.x_low, &f.x_high, p->cost.value);
        widen(&f.y_low, &f.y_high, p->error.value);
    }
    if (!isfinite(f.x_low))
        f = (struct frame){0, 0, 0, 0};
    f.x_low = floor(3 * f.x_low - 0.4) / 3;
    f.x_high = ceil(3 * f.x_high + 0.4) / 3;
    f.y_low = floor(3 * f.y_low - 0.4) / 3;
    f.y_high = ceil(3 * f.y_high + 0.4) / 3;
    return f;
}

static void words(struct canvas *c, double x, double y, double size, enum canvas_align align,
                  enum canvas_ink ink, const char *text)
{
    struct canvas_words w = {
        .x = x, .y = y, .size = size, .align = align, .ink = ink, .text = text};
    canvas_words(c, &w);
}

static void line(struct canvas *c, double x0, double y0, double x1, double y1, double width,
                 enum canvas_ink ink, bool dashed)
{
    struct canvas_line l = {x0, y0, x1, y1, width, ink, dashed};
    canvas_line(c, &l);
}

/* --- Axes ------------------------------------------------------------------- */

static void draw_grid(struct canvas *c, const struct frame *f, bool upright)
{
    static const double steps[] = {1, 2, 5};
    double low = upright ? f->x_low : f->y_low, high = upright ? f->x_high : f->y_high;
    bool many = high - low > 3.4;
    for (double decade = floor(low); decade <= high; decade++) {
        for (size_t k = 0; k < 3; k++) {
            double v = steps[k] * pow(10, decade);
            char text[24];
            if (log10(v) < low - 1e-9 || log10(v) > high + 1e-9)
                continue;
            (void)snprintf(text, sizeof text, "%g", v);
            double x = x_of(f, v), y = y_of(f, v);
            if (upright)
                line(c, x, TOP, x, STUDY_PLOT_HEIGHT - BOTTOM, 1, INK_GRID, false);
            else
                line(c, LEFT, y, STUDY_PLOT_WIDTH - RIGHT, y, 1, INK_GRID, false);
            if (many && k > 0)
                continue;
            if (upright)
                words(c, x, STUDY_PLOT_HEIGHT - BOTTOM + 20, SMALL_TEXT, ALIGN_CENTER, INK_MUTED,
                      text);
            else
                words(c, LEFT - 8, y + 5, SMALL_TEXT, ALIGN_RIGHT, INK_MUTED, text);
        }
    }
}

/* cost * error = 10^k, cut to the frame: in logarithms a line of slope -1. */
static void draw_diagonals(struct canvas *c, const struct frame *f)
{
    for (double k = ceil(f->x_low + f->y_low); k <= f->x_high + f->y_high; k++) {
        double from = fmax(f->x_low, k - f->y_high), to = fmin(f->x_high, k - f->y_low);
        if (from >= to)
            continue;
        line(c, x_of(f, pow(10, from)), y_of(f, pow(10, k - from)), x_of(f, pow(10, to)),
             y_of(f, pow(10, k - to)), 1, INK_MUTED, true);
    }
}

static void draw_axes(struct canvas *c, const struct frame *f, const struct study *s)
{
    char title[160];
    struct canvas_words up = {.x = 24,
                              .y = (TOP + STUDY_PLOT_HEIGHT - BOTTOM) / 2.0,
                              .size = TEXT,
                              .align = ALIGN_CENTER,
                              .ink = INK_TEXT,
                              .upwards = true,
                              .text = "relMSE"};
    draw_grid(c, f, true);
    draw_grid(c, f, false);
    draw_diagonals(c, f);
    canvas_words(c, &up);
    words(c, (LEFT + STUDY_PLOT_WIDTH - RIGHT) / 2.0, STUDY_PLOT_HEIGHT - 18, TEXT, ALIGN_CENTER,
          INK_TEXT, "core-seconds of a picture");
    (void)snprintf(title, sizeof title, "%.80s, %ux%u: speed against accuracy", s->scene, s->width,
                   s->height);
    words(c, LEFT, 32, TITLE_TEXT, ALIGN_LEFT, INK_TEXT, title);
}

/* --- Points ----------------------------------------------------------------- */

/* The next point of the front to the right, or -1. */
static int next_on_front(const struct study *s, double cost)
{
    int next = -1;
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->front && drawn(p) && p->cost.value > cost &&
            (next < 0 || p->cost.value < s->points[next].cost.value))
            next = (int)i;
    }
    return next;
}

static void draw_front(struct canvas *c, const struct frame *f, const struct study *s)
{
    int at = next_on_front(s, 0);
    while (at >= 0) {
        const struct study_point *p = &s->points[at];
        double x = x_of(f, p->cost.value), y = y_of(f, p->error.value);
        int next = next_on_front(s, p->cost.value);
        double x1 = next >= 0 ? x_of(f, s->points[next].cost.value) : STUDY_PLOT_WIDTH - RIGHT;
        line(c, x, y, x1, y, 2, INK_TEXT, false);
        if (next >= 0)
            line(c, x1, y, x1, y_of(f, s->points[next].error.value), 2, INK_TEXT, false);
        at = next;
    }
}

/* The points of a knob whose values are in order, joined. */
static void draw_curve(struct canvas *c, const struct frame *f, const struct study *s,
                       enum study_knob knob)
{
    const struct study_point *last = NULL;
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->knob != knob || !drawn(p))
            continue;
        if (last)
            line(c, x_of(f, last->cost.value), y_of(f, last->error.value), x_of(f, p->cost.value),
                 y_of(f, p->error.value), 1.5, study_ink(knob), false);
        last = p;
    }
}

static void draw_bars(struct canvas *c, const struct frame *f, const struct study_point *p)
{
    enum canvas_ink ink = study_ink(p->knob);
    double x = x_of(f, p->cost.value), y = y_of(f, p->error.value);
    if (p->error.low > 0 && isfinite(p->error.high))
        line(c, x, fmin(y_of(f, p->error.low), STUDY_PLOT_HEIGHT - BOTTOM), x,
             fmax(y_of(f, p->error.high), TOP), 1.5, ink, false);
    if (p->cost.low > 0 && isfinite(p->cost.high))
        line(c, fmax(x_of(f, p->cost.low), LEFT), y,
             fmin(x_of(f, p->cost.high), STUDY_PLOT_WIDTH - RIGHT), y, 1.5, ink, false);
}

static void draw_point(struct canvas *c, const struct frame *f, const struct study_point *p)
{
    char tip[200], error[HUMAN_BYTES], low[HUMAN_BYTES], high[HUMAN_BYTES];
    human_error(p->error.value, error);
    human_error(p->error.low, low);
    human_error(p->error.high, high);
    (void)snprintf(tip, sizeof tip, "%s %s: %.3g core-seconds, relMSE %s (95 %%: %s to %s)",
                   study_knob_words[p->knob], p->label, p->cost.value, error, low, high);
    struct canvas_mark mark = {.x = x_of(f, p->cost.value),
                               .y = y_of(f, p->error.value),
                               .radius = p->own ? POINT_SIZE + 2 : POINT_SIZE,
                               .shape = study_shape(p->knob),
                               .ink = study_ink(p->knob),
                               .ringed = p->front,
                               .tooltip = tip};
    draw_bars(c, f, p);
    canvas_mark(c, &mark);
    if (p->knob == KNOB_SPP)
        words(c, mark.x - 9, mark.y + 16, SMALL_TEXT, ALIGN_RIGHT, study_ink(p->knob), p->label);
    else if (p->knob == KNOB_PRESET || (p->knob == KNOB_DEPTH && study_biased(p)))
        words(c, mark.x + 10, mark.y - 8, SMALL_TEXT, ALIGN_LEFT, study_ink(p->knob), p->label);
}

static void draw_legend(struct canvas *c, const struct study *s)
{
    double x = STUDY_PLOT_WIDTH - RIGHT + 24, y = TOP + 8;
    for (int knob = 0; knob < KNOB_COUNT; knob++) {
        bool any = false;
        for (uint32_t i = 0; i < s->point_count; i++)
            any |= (int)s->points[i].knob == knob && drawn(&s->points[i]);
        if (!any)
            continue;
        struct canvas_mark mark = {.x = x,
                                   .y = y,
                                   .radius = POINT_SIZE,
                                   .shape = study_shape((enum study_knob)knob),
                                   .ink = study_ink((enum study_knob)knob)};
        canvas_mark(c, &mark);
        words(c, x + 16, y + 5, SMALL_TEXT, ALIGN_LEFT, INK_TEXT, study_knob_words[knob]);
        y += 24;
    }
    y += 12;
    line(c, x - 8, y, x + 10, y, 2, INK_TEXT, false);
    words(c, x + 18, y + 5, SMALL_TEXT, ALIGN_LEFT, INK_TEXT, "best for its cost");
    y += 24;
    line(c, x - 8, y, x + 10, y, 1, INK_MUTED, true);
    words(c, x + 18, y + 5, SMALL_TEXT, ALIGN_LEFT, INK_TEXT, "equal efficiency");
    y += 24;
    line(c, x, y - 8, x, y + 8, 1.5, INK_TEXT, false);
    words(c, x + 18, y + 5, SMALL_TEXT, ALIGN_LEFT, INK_TEXT, "95 % interval");
}

void study_plot(const struct study *s, struct canvas *c)
{
    struct frame f = frame_of(s);
    draw_axes(c, &f, s);
    draw_curve(c, &f, s, KNOB_SPP);
    draw_curve(c, &f, s, KNOB_DEPTH);
    draw_front(c, &f, s);
    for (uint32_t i = 0; i < s->point_count; i++)
        if (drawn(&s->points[i]))
            draw_point(c, &f, &s->points[i]);
    draw_legend(c, s);
}
