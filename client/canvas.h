/* client/canvas.h: a drawing of lines, marks and words, made twice: as SVG text and as pixels.
 *
 * Coordinates are pixels from the upper left corner. Colours are roles, so that the SVG can change
 * with the reader's light or dark scheme; pixels are of the light one. The raster's letters are
 * strokes of a small font of our own (canvas_font.c): no font file is needed. One thread.
 */
#ifndef CLIENT_CANVAS_H
#define CLIENT_CANVAS_H

#include "common/buf.h"

enum { CANVAS_SERIES = 12 };
enum canvas_ink {
    INK_PAPER,
    INK_TEXT,
    INK_MUTED,
    INK_GRID,
    INK_SERIES, /* and CANVAS_SERIES - 1 more */
    INK_COUNT = INK_SERIES + CANVAS_SERIES
};
enum canvas_align { ALIGN_LEFT, ALIGN_CENTER, ALIGN_RIGHT };
enum canvas_shape { SHAPE_CIRCLE, SHAPE_SQUARE, SHAPE_DIAMOND, SHAPE_TRIANGLE, SHAPE_COUNT };

struct canvas_line {
    double x0, y0, x1, y1, width;
    enum canvas_ink ink;
    bool dashed;
};
struct canvas_mark {
    double x, y, radius;
    enum canvas_shape shape;
    enum canvas_ink ink;
    bool ringed;         /* with a ring of the text's colour around it */
    const char *tooltip; /* may be NULL; the SVG shows it */
};
struct canvas_words {
    double x, y, size; /* left, middle or right end of the baseline; height of the letters */
    enum canvas_align align;
    enum canvas_ink ink;
    bool upwards; /* turned by a quarter */
    const char *text;
};

struct canvas {
    uint32_t width, height;
    struct buf *svg; /* NULL: pixels */
    float *rgb;      /* owned; values of the display, 0..255 */
};

/* Starts an SVG; everything is appended to `out`. */
void canvas_init_svg(struct canvas *c, uint32_t width, uint32_t height, struct buf *out);
/* Ends its text. ERR_NOMEM. */
TL_NODISCARD enum err canvas_finish_svg(struct canvas *c);

TL_NODISCARD enum err canvas_init_raster(struct canvas *c, uint32_t width, uint32_t height);
/* Appends the PNG and releases. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err canvas_finish_png(struct canvas *c, struct buf *out);

void canvas_line(struct canvas *c, const struct canvas_line *line);
void canvas_mark(struct canvas *c, const struct canvas_mark *mark);
void canvas_words(struct canvas *c, const struct canvas_words *words);

/* The colours as custom properties (--ink0 ...) of a style sheet, for pages around an SVG. */
void canvas_put_colors(struct buf *out);

/* Text for HTML and XML. */
void canvas_put_escaped(struct buf *out, const char *text);

/* --- canvas_raster.c, canvas_font.c: for canvas.c --------------------------- */

void raster_line(struct canvas *c, const struct canvas_line *line);
void raster_mark(struct canvas *c, const struct canvas_mark *mark);
void raster_words(struct canvas *c, const struct canvas_words *words);

/* Strokes of a letter, as pairs of digits x (0..4) and y (0..8, the baseline at 2, capitals up to
 * 8); strokes are parted by blanks. Unknown letters are a box. */
const char *font_strokes(char letter);
enum { FONT_ADVANCE = 6, FONT_BASELINE = 2, FONT_CAPITAL = 6 };

/* 8-bit sRGB of a role in the light scheme. */
void canvas_color(enum canvas_ink ink, unsigned char rgb[3]);

#endif
