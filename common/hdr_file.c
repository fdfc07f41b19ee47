/* Radiance pictures (.hdr, .pic): flat, old and new run-length coding, 32-bit_rle_rgbe. */
#include <math.h>
#include <string.h>

#include "common/image_parts.h"
#include "common/mem.h"
#include "common/number.h"

enum { NEW_RLE_WIDTH_MIN = 8, NEW_RLE_WIDTH_MAX = 0x7fff, RUN = 128 };

struct reader {
    const unsigned char *at, *end;
    const char *file;
    struct diag_list *problems;
};

static size_t left(const struct reader *r)
{
    return (size_t)(r->end - r->at);
}

static enum err cut_short(struct reader *r)
{
    return image_problem(r->problems, r->file, "image-damaged", "the file is cut short or damaged");
}

/* One header line without its end; false at the end of the file. */
static bool take_line(struct reader *r, const char **line, size_t *bytes)
{
    const unsigned char *stop = memchr(r->at, '\n', left(r));
    if (!stop)
        return false;
    *line = (const char *)r->at;
    *bytes = (size_t)(stop - r->at);
    r->at = stop + 1;
    return true;
}

static bool line_is(const char *line, size_t bytes, const char *what)
{
    return bytes >= strlen(what) && memcmp(line, what, strlen(what)) == 0;
}

/* "-Y 512 +X 1024": rows from the top, columns from the left. */
static enum err parse_size(struct reader *r, uint64_t *width, uint64_t *height)
{
    const char *line;
    size_t bytes;
    int64_t w, h;
    if (!take_line(r, &line, &bytes))
        return cut_short(r);
    const char *end = line + bytes;
    bool good = line_is(line, bytes, "-Y ");
    const char *at = good ? number_parse_int(line + 3, end, &h) : NULL;
    good = at && (size_t)(end - at) > 4 && memcmp(at, " +X ", 4) == 0 &&
           number_parse_int(at + 4, end, &w) && w > 0 && h > 0;
    if (!good)
        return image_problem(r->problems, r->file, "hdr-header",
                             "expected a size of the form \"-Y HEIGHT +X WIDTH\"");
    *width = (uint64_t)w;
    *height = (uint64_t)h;
    return ERR_OK;
}

static enum err parse_header(struct reader *r, uint64_t *width, uint64_t *height)
{
    const char *line;
    size_t bytes;
    do {
        if (!take_line(r, &line, &bytes))
            return cut_short(r);
        if (line_is(line, bytes, "FORMAT=") && !line_is(line, bytes, "FORMAT=32-bit_rle_rgbe"))
            return image_problem(r->problems, r->file, "hdr-header",
                                 "%.*s is not supported, expected FORMAT=32-bit_rle_rgbe",
                                 bytes < 60 ? (int)bytes : 60, line);
    } while (bytes > 0 && !(bytes == 1 && line[0] == '\r'));
    return parse_size(r, width, height);
}

/* Four runs, one for each component. */
static bool take_new_rle(struct reader *r, unsigned char *rgbe, uint32_t width)
{
    r->at += 4;
    for (uint32_t c = 0; c < 4; c++) {
        for (uint32_t x = 0; x < width;) {
            if (left(r) < 2)
                return false;
            uint32_t count = *r->at++;
            bool run = count > RUN;
            count = run ? count - RUN : count;
            if (count == 0 || count > width - x || (!run && left(r) < count))
                return false;
            for (uint32_t i = 0; i < count; i++)
                rgbe[4 * (x + i) + c] = run ? r->at[0] : r->at[i];
            r->at += run ? 1 : count;
            x += count;
        }
    }
    return true;
}

/* Pixels one by one; (1, 1, 1, n) repeats the last one, more such in a row shift n by 8. */
static bool take_flat(struct reader *r, unsigned char *rgbe, uint32_t width)
{
    unsigned shift = 0;
    for (uint32_t x = 0; x < width; r->at += 4) {
        if (left(r) < 4)
            return false;
        if (r->at[0] != 1 || r->at[1] != 1 || r->at[2] != 1) {
            memcpy(rgbe + 4 * (size_t)x++, r->at, 4);
            shift = 0;
            continue;
        }
        uint64_t count = (uint64_t)r->at[3] << shift;
        if (x == 0 || shift > 16 || count > width - x)
            return false;
        for (; count > 0; count--, x++)
            memcpy(rgbe + 4 * (size_t)x, rgbe + 4 * ((size_t)x - 1), 4);
        shift += 8;
    }
    return true;
}

static void decode(const unsigned char *rgbe, uint32_t width, float *rgb)
{
    for (uint32_t x = 0; x < width; x++, rgbe += 4)
        for (int c = 0; c < 3; c++)
            *rgb++ = rgbe[3] ? ldexpf((float)rgbe[c], rgbe[3] - (128 + 8)) : 0;
}

static enum err read_rows(struct reader *r, struct scene_image *image)
{
    uint32_t width = image->width;
    unsigned char *rgbe = mem_alloc_array(width, 4);
    if (!rgbe)
        return ERR_NOMEM;
    bool good = true;
    for (uint32_t y = 0; good && y < image->height; y++) {
        bool new_rle = width >= NEW_RLE_WIDTH_MIN && width <= NEW_RLE_WIDTH_MAX && left(r) >= 4 &&
                       r->at[0] == 2 && r->at[1] == 2 &&
                       (uint32_t)(r->at[2] << 8 | r->at[3]) == width;
        good = new_rle ? take_new_rle(r, rgbe, width) : take_flat(r, rgbe, width);
        if (good)
            decode(rgbe, width, (float *)image->pixels + (size_t)3 * width * y);
    }
    mem_free(rgbe);
    return good ? ERR_OK : cut_short(r);
}

enum err hdr_read(const void *data, size_t bytes, const char *file, struct scene_image *out,
                  struct diag_list *problems)
{
    struct reader r = {
        .at = data, .end = (const unsigned char *)data + bytes, .file = file, .problems = problems};
    struct scene_image image;
    uint64_t width = 0, height = 0;
    TL_TRY(parse_header(&r, &width, &height));
    /* Every row takes one pixel at least: few bytes must not claim much memory. */
    if (left(&r) / 4 < height)
        return cut_short(&r);
    TL_TRY(image_alloc(width, height, 3, SCENE_IMAGE_F32, file, &image, problems));
    enum err e = read_rows(&r, &image);
    if (e == ERR_OK)
        *out = image;
    else
        mem_free(image.pixels);
    return e;
}
