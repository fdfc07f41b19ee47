#include "client/preview.h"

#include <string.h>

#include "client/term.h"
#include "common/mem.h"
#include "common/png_file.h"

enum { COLUMNS_MAX = 100, ROWS_MAX = 40, ROWS_FREE = 4, BYTES_PER_CELL = 48 };

#define REFRESH_EVERY_S 1.0

void preview_init(struct preview *p, int fd)
{
    *p = (struct preview){.fd = fd,
                          .last_s = -REFRESH_EVERY_S,
                          .truecolor = term_is_truecolor(),
                          .utf8 = term_is_utf8()};
}

void preview_release(struct preview *p)
{
    mem_free(p->shown);
    p->shown = NULL;
}

void preview_fit(uint32_t width, uint32_t height, uint32_t columns_max, uint32_t rows_max,
                 uint32_t *columns, uint32_t *rows)
{
    uint64_t c = columns_max, r = ((uint64_t)columns_max * height / width + 1) / 2;
    if (r > rows_max) {
        r = rows_max;
        c = 2 * (uint64_t)rows_max * width / height;
    }
    if (c > width)
        c = width;
    if (2 * r > height)
        r = (height + 1) / 2;
    *columns = c ? (uint32_t)c : 1;
    *rows = r ? (uint32_t)r : 1;
}

/* The mean of the pixels under one of `count` equal parts of an axis, at least one pixel. */
static void span_of(uint32_t index, uint32_t count, uint32_t size, uint32_t *begin, uint32_t *end)
{
    *begin = (uint32_t)((uint64_t)index * size / count);
    *end = (uint32_t)(((uint64_t)index + 1) * size / count);
    if (*begin >= size)
        *begin = size - 1;
    if (*end <= *begin)
        *end = *begin + 1;
}

static void mean_of(const unsigned char *rgb, uint32_t width, uint32_t channel_count,
                    const uint32_t x[2], const uint32_t y[2], unsigned char out[3])
{
    uint64_t sum[3] = {0}, count = (uint64_t)(x[1] - x[0]) * (y[1] - y[0]);
    for (uint32_t row = y[0]; row < y[1]; row++)
        for (uint32_t column = x[0]; column < x[1]; column++)
            for (uint32_t c = 0; c < 3; c++)
                sum[c] += rgb[((size_t)row * width + column) * channel_count +
                              (channel_count >= 3 ? c : 0)];
    for (int c = 0; c < 3; c++)
        out[c] = (unsigned char)(sum[c] / count);
}

void preview_scale(const unsigned char *rgb, uint32_t width, uint32_t height,
                   uint32_t channel_count, uint32_t columns, uint32_t rows,
                   struct preview_cell *cells)
{
    for (uint32_t r = 0; r < rows; r++) {
        for (uint32_t c = 0; c < columns; c++) {
            uint32_t x[2], top[2], bottom[2];
            struct preview_cell *cell = &cells[(size_t)r * columns + c];
            span_of(c, columns, width, &x[0], &x[1]);
            span_of(2 * r, 2 * rows, height, &top[0], &top[1]);
            span_of(2 * r + 1, 2 * rows, height, &bottom[0], &bottom[1]);
            mean_of(rgb, width, channel_count, x, top, cell->top);
            mean_of(rgb, width, channel_count, x, bottom, cell->bottom);
        }
    }
}

static void put_color(struct buf *out, const char *ground, const unsigned char rgb[3],
                      bool truecolor)
{
    if (truecolor)
        buf_printf(out, "\x1b[%s8;2;%u;%u;%um", ground, rgb[0], rgb[1], rgb[2]);
    else
        buf_printf(out, "\x1b[%s8;5;%um", ground,
                   16 + 36 * (rgb[0] * 6 / 256) + 6 * (rgb[1] * 6 / 256) + rgb[2] * 6 / 256);
}

static void put_cell(const struct preview *p, const struct preview_cell *cell, struct buf *out)
{
    static const char ramp[] = " .:-=+*#%@";
    if (p->utf8) {
        put_color(out, "3", cell->top, p->truecolor);
        put_color(out, "4", cell->bottom, p->truecolor);
        buf_printf(out, "\xe2\x96\x80");
        return;
    }
    unsigned sum = 0;
    for (int c = 0; c < 3; c++)
        sum += (unsigned)cell->top[c] + cell->bottom[c];
    buf_put_u8(out, (uint8_t)ramp[sum * (sizeof ramp - 1) / (6 * 256)]);
}

/* One row; cells equal to `old` (may be NULL) are skipped over. */
static void put_row(const struct preview *p, const struct preview_cell *cells,
                    const struct preview_cell *old, uint32_t columns, struct buf *out)
{
    bool skipped = false;
    for (uint32_t c = 0; c < columns; c++) {
        if (old && memcmp(&cells[c], &old[c], sizeof *cells) == 0) {
            skipped = true;
            continue;
        }
        if (skipped)
            buf_printf(out, "\x1b[%uG", c + 1);
        skipped = false;
        put_cell(p, &cells[c], out);
    }
    if (p->utf8)
        buf_printf(out, "\x1b[0m");
}

/* Over the picture that stands there, `above` lines up. */
static void put_changes(const struct preview *p, const struct preview_cell *cells, uint32_t above,
                        struct buf *out)
{
    buf_printf(out, "\x1b[%uA", above);
    for (uint32_t r = 0; r < p->rows; r++) {
        size_t at = (size_t)r * p->columns;
        buf_printf(out, "\r");
        put_row(p, cells + at, p->shown + at, p->columns, out);
        buf_printf(out, "\x1b[1B");
    }
    if (above > p->rows)
        buf_printf(out, "\x1b[%uB", above - p->rows);
    buf_printf(out, "\r");
}

static void put_whole(const struct preview *p, const struct preview_cell *cells, struct buf *out)
{
    for (uint32_t r = 0; r < p->rows; r++) {
        put_row(p, cells + (size_t)r * p->columns, NULL, p->columns, out);
        buf_printf(out, "\n");
    }
}

static void draw(struct preview *p, const struct scene_image *image, struct progress *progress)
{
    uint32_t columns, rows, window = (uint32_t)term_columns(p->fd) - 1;
    uint32_t window_rows = (uint32_t)term_rows(p->fd);
    preview_fit(image->width, image->height, window < COLUMNS_MAX ? window : COLUMNS_MAX,
                window_rows > ROWS_MAX + ROWS_FREE ? ROWS_MAX
                : window_rows > ROWS_FREE          ? window_rows - ROWS_FREE
                                                   : 1,
                &columns, &rows);
    struct preview_cell *cells = mem_calloc((size_t)columns * rows, sizeof *cells);
    if (!cells)
        return;
    preview_scale(image->pixels, image->width, image->height, image->channel_count, columns, rows,
                  cells);
    struct buf out;
    buf_init(&out);
    progress_hide(progress);
    uint64_t above = p->rows + (progress->line_count - p->line_count);
    if (p->shown && p->columns == columns && p->rows == rows && above < window_rows) {
        put_changes(p, cells, (uint32_t)above, &out);
    } else {
        p->columns = columns;
        p->rows = rows;
        p->line_count = progress->line_count;
        put_whole(p, cells, &out);
    }
    if (buf_status(&out) == ERR_OK)
        term_write(p->fd, (const char *)out.data, out.bytes);
    buf_release(&out);
    mem_free(p->shown);
    p->shown = cells;
}

void preview_refresh(struct preview *p, struct farm *farm, const char *job,
                     struct progress *progress, double now_s)
{
    char path[FARM_PATH_BYTES];
    struct scene_image image;
    struct diag_list problems;
    if (now_s - p->last_s < REFRESH_EVERY_S)
        return;
    p->last_s = now_s;
    (void)snprintf(path, sizeof path, "/api/v1/jobs/%s/picture.png?partial=1", job);
    if (farm_try(farm, "GET", path, NULL) != ERR_OK || farm->reply.status != 200)
        return;
    diag_init(&problems);
    if (png_read(farm->reply.body.data, farm->reply.body.bytes, "picture", IMAGE_COLOR, &image,
                 &problems) == ERR_OK) {
        if (image.format != SCENE_IMAGE_F32 && image.width > 0 && image.height > 0)
            draw(p, &image, progress);
        mem_free(image.pixels);
    }
    diag_release(&problems);
}
