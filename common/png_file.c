#include "common/png_file.h"

#include <png.h>
#include <stdio.h>
#include <string.h>

#include "common/dmath.h"
#include "common/image_parts.h"
#include "common/mem.h"

/* Deflate expands at most 1032 times: a file that claims more pixels is damaged. */
enum { LEVEL = 3, DEFLATE_RATIO_MAX = 1032, CHUNK_BYTES_MAX = 8 << 20, TEXT_BYTES = 120 };

/* --- Writing ------------------------------------------------------------- */

struct writer {
    png_structp png;
    png_infop info;
    struct buf *out;
};

static void fail_write(png_structp png, png_const_charp text)
{
    (void)text;
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text;
}

static void append(png_structp png, png_bytep data, size_t bytes)
{
    buf_put(png_get_io_ptr(png), data, bytes);
}

static void flush_nothing(png_structp png)
{
    (void)png;
}

/* False when the library gave up, for want of memory. */
static bool write_rows(struct writer *w, const unsigned char *samples, uint32_t width,
                       uint32_t height, uint32_t channel_count)
{
    if (setjmp(png_jmpbuf(w->png)))
        return false;
    png_set_write_fn(w->png, w->out, append, flush_nothing);
    png_set_compression_level(w->png, LEVEL);
    png_set_IHDR(w->png, w->info, width, height, 8,
                 channel_count == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB_gAMA_and_cHRM(w->png, w->info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(w->png, w->info);
    size_t row_bytes = (size_t)width * channel_count;
    for (uint32_t y = 0; y < height; y++)
        png_write_row(w->png, samples + row_bytes * y);
    png_write_end(w->png, NULL);
    return true;
}

enum err png_write_bytes(const unsigned char *samples, uint32_t width, uint32_t height,
                         uint32_t channel_count, struct buf *out)
{
    TL_ASSERT(channel_count == 1 || channel_count == 3);
    size_t before = out->bytes;
    struct writer w = {.out = out};
    w.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, fail_write, ignore_warning);
    w.info = w.png ? png_create_info_struct(w.png) : NULL;
    bool good = w.info && write_rows(&w, samples, width, height, channel_count);
    png_destroy_write_struct(&w.png, &w.info);
    if (good && buf_status(out) == ERR_OK)
        return ERR_OK;
    out->bytes = before;
    return ERR_NOMEM;
}

/* The least linear value that is shown as each of 1..255: one comparison chain instead of a pow for
 * each sample. */
static void encode_limits(double limits[256])
{
    limits[0] = 0;
    for (int i = 1; i < 256; i++)
        limits[i] = dmath_srgb_decode((i - 0.5) / 255);
}

static unsigned char encode(const double limits[256], double linear)
{
    if (!(linear > 0)) /* NaN too */
        return 0;
    int low = 0, high = 255; /* limits[low] <= linear */
    while (low < high) {
        int middle = (low + high + 1) / 2;
        if (limits[middle] <= linear)
            low = middle;
        else
            high = middle - 1;
    }
    return (unsigned char)low;
}

enum err png_write_rgb(const float *rgb, uint32_t width, uint32_t height, double exposure,
                       struct buf *out)
{
    double limits[256];
    size_t count = (size_t)width * height * 3;
    unsigned char *samples = mem_alloc(count);
    if (!samples)
        return ERR_NOMEM;
    encode_limits(limits);
    for (size_t i = 0; i < count; i++)
        samples[i] = encode(limits, (double)rgb[i] * exposure);
    enum err e = png_write_bytes(samples, width, height, 3, out);
    mem_free(samples);
    return e;
}

/* --- Reading ------------------------------------------------------------- */

struct reader {
    png_structp png;
    png_infop info;
    const unsigned char *at, *end;
    const char *file;
    enum image_use use;
    struct diag_list *problems;
    struct scene_image image;
    unsigned char *wide; /* 16-bit samples as they come, big-endian */
    png_bytepp rows;
    char text[TEXT_BYTES]; /* of the library's error */
};

static void fail_read(png_structp png, png_const_charp text)
{
    struct reader *r = png_get_error_ptr(png);
    (void)snprintf(r->text, sizeof r->text, "%s", text);
    png_longjmp(png, 1);
}

static void take(png_structp png, png_bytep data, size_t bytes)
{
    struct reader *r = png_get_io_ptr(png);
    if ((size_t)(r->end - r->at) < bytes)
        png_error(png, "the file is cut short");
    memcpy(data, r->at, bytes);
    r->at += bytes;
}

/* Everything becomes grey, RGB or RGBA of 8 or 16 bits. */
static void set_transforms(struct reader *r)
{
    bool transparent = png_get_valid(r->png, r->info, PNG_INFO_tRNS) != 0;
    int type = png_get_color_type(r->png, r->info);
    png_set_expand(r->png);
    if (transparent || type == PNG_COLOR_TYPE_GRAY_ALPHA)
        png_set_gray_to_rgb(r->png);
    (void)png_set_interlace_handling(r->png);
    png_read_update_info(r->png, r->info);
}

static enum err prepare(struct reader *r)
{
    uint32_t width = png_get_image_width(r->png, r->info);
    uint32_t height = png_get_image_height(r->png, r->info);
    uint64_t row_bits =
        (uint64_t)width * png_get_bit_depth(r->png, r->info) * png_get_channels(r->png, r->info);
    if (row_bits / 8 * height / DEFLATE_RATIO_MAX > (uint64_t)(r->end - r->at) + 64)
        return image_problem(r->problems, r->file, "image-damaged",
                             "PNG: %u x %u pixels cannot be in so short a file", width, height);
    set_transforms(r);
    bool deep = png_get_bit_depth(r->png, r->info) == 16;
    enum scene_image_format format = deep                    ? SCENE_IMAGE_F32
                                     : r->use == IMAGE_COLOR ? SCENE_IMAGE_U8_SRGB
                                                             : SCENE_IMAGE_U8_LINEAR;
    uint32_t channels = png_get_channels(r->png, r->info);
    TL_TRY(image_alloc(width, height, channels, format, r->file, &r->image, r->problems));
    size_t row_bytes = png_get_rowbytes(r->png, r->info);
    r->rows = mem_alloc_array(height, sizeof *r->rows);
    r->wide = deep ? mem_calloc(height, row_bytes) : NULL;
    if (!r->rows || (deep && !r->wide))
        return ERR_NOMEM;
    unsigned char *base = deep ? r->wide : r->image.pixels;
    for (uint32_t y = 0; y < height; y++)
        r->rows[y] = base + row_bytes * y;
    return ERR_OK;
}

/* The library leaves by longjmp: what it touches lives in *r. */
static enum err read_pixels(struct reader *r)
{
    if (setjmp(png_jmpbuf(r->png)))
        return image_problem(r->problems, r->file, "image-damaged", "PNG: %s", r->text);
    png_set_read_fn(r->png, r, take);
    png_set_user_limits(r->png, SCENE_IMAGE_SIDE_MAX, SCENE_IMAGE_SIDE_MAX);
    png_set_chunk_malloc_max(r->png, CHUNK_BYTES_MAX);
    png_read_info(r->png, r->info);
    enum err e = prepare(r);
    if (e != ERR_OK)
        return e;
    png_read_image(r->png, r->rows);
    png_read_end(r->png, NULL);
    return ERR_OK;
}

/* 16-bit samples become linear floats, alpha as it is. */
static void widen(struct reader *r)
{
    size_t count = (size_t)r->image.width * r->image.height * r->image.channel_count;
    float *to = r->image.pixels;
    for (size_t i = 0; i < count; i++) {
        double v = (r->wide[2 * i] << 8 | r->wide[2 * i + 1]) / 65535.0;
        bool alpha = r->image.channel_count == 4 && i % 4 == 3;
        to[i] = (float)(r->use == IMAGE_COLOR && !alpha ? dmath_srgb_decode(v) : v);
    }
}

enum err png_read(const void *data, size_t bytes, const char *file, enum image_use use,
                  struct scene_image *out, struct diag_list *problems)
{
    struct reader r = {.at = data,
                       .end = (const unsigned char *)data + bytes,
                       .file = file,
                       .use = use,
                       .problems = problems};
    r.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &r, fail_read, ignore_warning);
    r.info = r.png ? png_create_info_struct(r.png) : NULL;
    enum err e = r.info ? read_pixels(&r) : ERR_NOMEM;
    png_destroy_read_struct(&r.png, &r.info, NULL);
    if (e == ERR_OK && r.wide)
        widen(&r);
    mem_free(r.wide);
    mem_free(r.rows);
    if (e == ERR_OK)
        *out = r.image;
    else
        mem_free(r.image.pixels);
    return e;
}
