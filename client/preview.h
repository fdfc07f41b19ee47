/* client/preview.h: a small picture of a job in the terminal, refined as it renders.
 *
 * Half blocks, two pixels a cell, in 24-bit or 256 colours; grey letters where the locale is
 * not UTF-8. Only changed cells are sent. No alternate screen, so the last picture stays. It
 * stands above the progress line and knows by the count of lines how far. One thread.
 */
#ifndef CLIENT_PREVIEW_H
#define CLIENT_PREVIEW_H

#include "client/farm_api.h"
#include "client/progress.h"

struct preview_cell {
    unsigned char top[3], bottom[3];
};

struct preview {
    int fd;
    uint32_t columns, rows;     /* of what stands on the terminal */
    struct preview_cell *shown; /* owned; NULL before the first */
    uint64_t line_count;        /* of the progress when it was drawn */
    double last_s;
    bool truecolor, utf8;
};

void preview_init(struct preview *p, int fd);
void preview_release(struct preview *p);

/* Fetches and draws if a second has passed since the last; failures leave it as it is. */
void preview_refresh(struct preview *p, struct farm *farm, const char *job,
                     struct progress *progress, double now_s);

/* Cells of a picture of 8-bit RGB, scaled by averaging; pure. `cells` has columns * rows. */
void preview_scale(const unsigned char *rgb, uint32_t width, uint32_t height,
                   uint32_t channel_count, uint32_t columns, uint32_t rows,
                   struct preview_cell *cells);

/* The largest columns x rows (half-block cells) of that shape within the window; pure. */
void preview_fit(uint32_t width, uint32_t height, uint32_t columns_max, uint32_t rows_max,
                 uint32_t *columns, uint32_t *rows);

#endif
