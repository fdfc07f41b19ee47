#include "common/exr_file.h"

#include <openexr.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "common/file_io.h"
#include "common/image_file.h"
#include "common/image_parts.h"
#include "common/log.h"
#include "common/mem.h"
#include "common/parallel.h"

enum { ZIP_LEVEL = 4, TEXT_BYTES = 200, ALLOCATION_MAX = 1 << 30 };

#define FILE_BYTES_MAX (UINT64_C(4) << 30)
#define SAMPLES_MAX    (UINT64_C(1) << 30) /* of all channels read: 4 GiB */

/* The library's memory: one damaged number must not take the machine's. */
static void *library_alloc(size_t bytes)
{
    return bytes <= ALLOCATION_MAX ? mem_alloc(bytes) : NULL;
}

static exr_context_initializer_t initializer(void *user_data, exr_error_handler_cb_t handler)
{
    exr_context_initializer_t init = EXR_DEFAULT_CONTEXT_INITIALIZER;
    init.error_handler_fn = handler;
    init.alloc_fn = library_alloc;
    init.free_fn = mem_free;
    init.user_data = user_data;
    init.max_image_width = SCENE_IMAGE_SIDE_MAX * 2;
    init.max_image_height = SCENE_IMAGE_SIDE_MAX * 2;
    init.max_tile_width = SCENE_IMAGE_SIDE_MAX;
    init.max_tile_height = SCENE_IMAGE_SIDE_MAX;
    init.zip_level = ZIP_LEVEL;
    init.flags = EXR_CONTEXT_FLAG_SILENT_HEADER_PARSE;
    return init;
}

/* --- Writing ------------------------------------------------------------- */

/* Chunks are deflated side by side and put one after the other, in their order. */
struct writer {
    exr_context_t ctx;
    const struct exr_picture *picture;
    struct buf *out;
    size_t start; /* where the file begins in `out` */
    uint32_t chunk_rows;

    pthread_mutex_t lock;
    pthread_cond_t moved;
    size_t chunk_count;  /* put */
    uint32_t row_count;  /* in them */
    exr_result_t result; /* of a chunk that failed: none is put after it */
};

/* One chunk on its way into the file. */
struct chunk_writer {
    struct writer *w;
    size_t index;
    uint32_t row, row_count;
    exr_result_t (*compress)(exr_encode_pipeline_t *encode); /* the library's */
};

static void log_error_text(exr_const_context_t ctx, exr_result_t code, const char *text)
{
    (void)ctx;
    log_error("exr", "library failed code=%d text=\"%s\"", (int)code, text ? text : "");
}

static int64_t append_at(exr_const_context_t ctx, void *user, const void *data, uint64_t bytes,
                         uint64_t offset, exr_stream_error_func_ptr_t error)
{
    (void)ctx;
    (void)error;
    struct writer *w = user;
    size_t have = w->out->bytes - w->start;
    if (offset + bytes > have && !buf_extend(w->out, (size_t)(offset + bytes) - have))
        return -1;
    memcpy(w->out->data + w->start + offset, data, bytes);
    return (int64_t)bytes;
}

static exr_result_t put_attribute(struct writer *w, const struct exr_attribute *a)
{
    switch (a->type) {
    case EXR_TEXT:
        return exr_attr_set_string(w->ctx, 0, a->name, a->text);
    case EXR_FLOAT:
        return exr_attr_set_float(w->ctx, 0, a->name, (float)a->number);
    case EXR_INT:
        return exr_attr_set_int(w->ctx, 0, a->name, (int32_t)a->number);
    }
    return EXR_ERR_INVALID_ARGUMENT;
}

static exr_attr_box2i_t box(uint32_t x, uint32_t y, uint32_t width, uint32_t height)
{
    exr_attr_box2i_t b;
    b.min.x = (int32_t)x;
    b.min.y = (int32_t)y;
    b.max.x = (int32_t)(x + width) - 1;
    b.max.y = (int32_t)(y + height) - 1;
    return b;
}

static exr_result_t put_header(struct writer *w)
{
    const struct exr_picture *p = w->picture;
    exr_attr_box2i_t display = box(0, 0, p->width, p->height);
    exr_attr_box2i_t data = box(p->x, p->y, p->data_width, p->data_height);
    exr_attr_v2f_t center;
    center.x = center.y = 0;
    int part;
    exr_result_t r = exr_set_longname_support(w->ctx, 1);
    r = r ? r : exr_add_part(w->ctx, "picture", EXR_STORAGE_SCANLINE, &part);
    r = r ? r
          : exr_initialize_required_attr(w->ctx, part, &display, &data, 1, &center, 1,
                                         EXR_LINEORDER_INCREASING_Y, EXR_COMPRESSION_ZIP);
    for (size_t i = 0; r == EXR_ERR_SUCCESS && i < p->channel_count; i++)
        r = exr_add_channel(w->ctx, part, p->channels[i].name,
                            i < p->half_count ? EXR_PIXEL_HALF : EXR_PIXEL_FLOAT,
                            EXR_PERCEPTUALLY_LOGARITHMIC, 1, 1);
    for (size_t i = 0; r == EXR_ERR_SUCCESS && i < p->attribute_count; i++)
        r = put_attribute(w, &p->attributes[i]);
    return r ? r : exr_write_header(w->ctx);
}

/* The library keeps its channels sorted; each is found again by name. */
static const struct exr_channel *channel_named(const struct exr_picture *p, const char *name)
{
    for (size_t i = 0; i < p->channel_count; i++)
        if (strcmp(p->channels[i].name, name) == 0)
            return &p->channels[i];
    return NULL;
}

static void aim_channels(const struct exr_picture *p, uint32_t row, exr_encode_pipeline_t *encode)
{
    for (int i = 0; i < encode->channel_count; i++) {
        exr_coding_channel_info_t *c = &encode->channels[i];
        const struct exr_channel *from = channel_named(p, c->channel_name);
        TL_ASSERT(from);
        c->user_data_type = EXR_PIXEL_FLOAT;
        c->user_bytes_per_element = sizeof(float);
        c->user_pixel_stride = (int32_t)(from->stride * sizeof(float));
        c->user_line_stride = (int32_t)(from->stride * sizeof(float) * p->data_width);
        c->encode_from_ptr =
            (const uint8_t *)(from->pixels + from->stride * p->data_width * (size_t)row);
    }
}

/* A chunk as large as its pixels is read as not compressed: then it must be the pixels. OpenEXRCore
 * 3.1.5 leaves a deflated chunk of just that size as it is, and noise makes such ones. */
static exr_result_t compress_chunk(exr_encode_pipeline_t *encode)
{
    const struct chunk_writer *c = encode->encoding_user_data;
    exr_result_t r = c->compress(encode);
    if (r == EXR_ERR_SUCCESS && encode->compressed_bytes >= encode->packed_bytes) {
        memcpy(encode->compressed_buffer, encode->packed_buffer, encode->packed_bytes);
        encode->compressed_bytes = encode->packed_bytes;
    }
    return r;
}

/* The library asks when a chunk may be put: once all before it are. */
static exr_result_t wait_for_turn(exr_encode_pipeline_t *encode)
{
    const struct chunk_writer *c = encode->encoding_user_data;
    struct writer *w = c->w;
    (void)pthread_mutex_lock(&w->lock);
    while (w->chunk_count < c->index && w->result == EXR_ERR_SUCCESS)
        (void)pthread_cond_wait(&w->moved, &w->lock);
    exr_result_t r = w->result;
    (void)pthread_mutex_unlock(&w->lock);
    return r;
}

static exr_result_t encode_chunk(struct chunk_writer *c)
{
    const struct writer *w = c->w;
    exr_chunk_info_t info;
    exr_encode_pipeline_t encode = EXR_ENCODE_PIPELINE_INITIALIZER;
    exr_result_t r = exr_write_scanline_chunk_info(w->ctx, 0, (int)(w->picture->y + c->row), &info);
    r = r ? r : exr_encoding_initialize(w->ctx, 0, &info, &encode);
    if (r)
        return r;
    c->row_count = (uint32_t)info.height;
    aim_channels(w->picture, c->row, &encode);
    r = exr_encoding_choose_default_routines(w->ctx, 0, &encode);
    if (r == EXR_ERR_SUCCESS) {
        c->compress = encode.compress_fn;
        encode.compress_fn = compress_chunk;
        encode.yield_until_ready_fn = wait_for_turn;
        encode.encoding_user_data = c;
        r = exr_encoding_run(w->ctx, 0, &encode);
    }
    (void)exr_encoding_destroy(w->ctx, &encode);
    return r;
}

static void chunk_turn(void *arg, size_t i)
{
    struct writer *w = arg;
    struct chunk_writer c = {.w = w, .index = i, .row = (uint32_t)i * w->chunk_rows};
    exr_result_t r = encode_chunk(&c);
    (void)pthread_mutex_lock(&w->lock);
    if (r == EXR_ERR_SUCCESS) {
        w->chunk_count++;
        w->row_count += c.row_count;
    } else if (w->result == EXR_ERR_SUCCESS) {
        w->result = r;
    }
    (void)pthread_cond_broadcast(&w->moved);
    (void)pthread_mutex_unlock(&w->lock);
}

static exr_result_t put_rows(struct writer *w)
{
    int32_t step = 0;
    exr_result_t r = exr_get_scanlines_per_chunk(w->ctx, 0, &step);
    if (r)
        return r;
    w->chunk_rows = (uint32_t)step;
    (void)pthread_mutex_init(&w->lock, NULL);
    (void)pthread_cond_init(&w->moved, NULL);
    parallel_for((w->picture->data_height + w->chunk_rows - 1) / w->chunk_rows, chunk_turn, w);
    (void)pthread_cond_destroy(&w->moved);
    (void)pthread_mutex_destroy(&w->lock);
    return w->result;
}

static void check_picture(const struct exr_picture *p)
{
    TL_ASSERT(p->width >= 1 && p->height >= 1 && p->data_width >= 1 && p->data_height >= 1);
    TL_ASSERT(p->x + p->data_width <= p->width && p->y + p->data_height <= p->height);
    TL_ASSERT(p->channel_count >= 1 && p->channel_count <= EXR_CHANNELS_MAX);
}

enum err exr_write(const struct exr_picture *picture, struct buf *out)
{
    check_picture(picture);
    struct writer w = {.picture = picture, .out = out, .start = out->bytes};
    exr_context_initializer_t init = initializer(&w, log_error_text);
    init.write_fn = append_at;
    exr_result_t r = exr_start_write(&w.ctx, "picture.exr", EXR_WRITE_FILE_DIRECTLY, &init);
    if (r == EXR_ERR_SUCCESS) {
        r = put_header(&w);
        r = r ? r : put_rows(&w);
        exr_result_t finish = exr_finish(&w.ctx);
        r = r ? r : finish;
    }
    /* exr_finish reports success when rows are missing: they are counted. */
    if (r == EXR_ERR_SUCCESS && w.row_count == picture->data_height && buf_status(out) == ERR_OK)
        return ERR_OK;
    out->bytes = w.start;
    return r == EXR_ERR_OUT_OF_MEMORY || out->failed ? ERR_NOMEM : ERR_IO;
}

/* --- Reading ------------------------------------------------------------- */

struct reader {
    exr_context_t ctx;
    const unsigned char *data;
    size_t bytes;
    const char *file;
    struct diag_list *problems;
    int part;
    exr_attr_box2i_t window;
    struct exr_image image;
    exr_decode_pipeline_t decode;
    bool decode_open;
    char text[TEXT_BYTES]; /* of the library's first error */
};

static void keep_error_text(exr_const_context_t ctx, exr_result_t code, const char *text)
{
    (void)code;
    void *user = NULL;
    if (!ctx || exr_get_user_data(ctx, &user) != EXR_ERR_SUCCESS || !user)
        return;
    struct reader *r = user;
    if (!r->text[0] && text)
        (void)snprintf(r->text, sizeof r->text, "%s", text);
}

static int64_t take_at(exr_const_context_t ctx, void *user, void *to, uint64_t bytes,
                       uint64_t offset, exr_stream_error_func_ptr_t error)
{
    (void)ctx;
    (void)error;
    struct reader *r = user;
    if (offset > r->bytes)
        return -1;
    size_t there = r->bytes - (size_t)offset;
    size_t taken = bytes < there ? (size_t)bytes : there;
    memcpy(to, r->data + offset, taken);
    return (int64_t)taken;
}

static int64_t query_size(exr_const_context_t ctx, void *user)
{
    (void)ctx;
    return (int64_t)((struct reader *)user)->bytes;
}

static enum err damaged(struct reader *r, exr_result_t code)
{
    if (code == EXR_ERR_OUT_OF_MEMORY)
        return image_problem(r->problems, r->file, "image-size",
                             "EXR: a part of it would need over 1 GiB of memory");
    return image_problem(r->problems, r->file, "image-damaged", "EXR: %s",
                         r->text[0] ? r->text : exr_get_default_error_message(code));
}

/* The first part that is neither deep nor compressed in a way the library does not decode. */
static enum err choose_part(struct reader *r)
{
    static const char *const names[] = {"none",  "RLE", "ZIPS", "ZIP",  "PIZ",
                                        "PXR24", "B44", "B44A", "DWAA", "DWAB"};
    int count = 0;
    exr_compression_t compression = EXR_COMPRESSION_NONE;
    bool deep = false;
    (void)exr_get_count(r->ctx, &count);
    for (r->part = 0; r->part < count; r->part++) {
        exr_storage_t storage;
        if (exr_get_storage(r->ctx, r->part, &storage) != EXR_ERR_SUCCESS ||
            exr_get_compression(r->ctx, r->part, &compression) != EXR_ERR_SUCCESS)
            continue;
        deep = storage == EXR_STORAGE_DEEP_SCANLINE || storage == EXR_STORAGE_DEEP_TILED;
        if (!deep && compression <= EXR_COMPRESSION_PXR24)
            return ERR_OK;
    }
    if (deep || count == 0)
        return image_problem(r->problems, r->file, "unsupported", "EXR: %s",
                             deep ? "deep data is not supported" : "no part in it");
    return image_problem(r->problems, r->file, "unsupported",
                         "EXR: %s compression is not supported, expected none, RLE, ZIPS, ZIP, "
                         "PIZ or PXR24",
                         (unsigned)compression < 10 ? names[compression] : "unknown");
}

static enum err read_windows(struct reader *r)
{
    exr_attr_box2i_t display;
    exr_result_t code = exr_get_data_window(r->ctx, r->part, &r->window);
    code = code ? code : exr_get_display_window(r->ctx, r->part, &display);
    if (code)
        return damaged(r, code);
    int64_t width = (int64_t)r->window.max.x - r->window.min.x + 1;
    int64_t height = (int64_t)r->window.max.y - r->window.min.y + 1;
    int64_t full_width = (int64_t)display.max.x - display.min.x + 1;
    int64_t full_height = (int64_t)display.max.y - display.min.y + 1;
    int64_t x = (int64_t)r->window.min.x - display.min.x;
    int64_t y = (int64_t)r->window.min.y - display.min.y;
    if (width < 1 || width > 65536 || height < 1 || height > 65536 || full_width < 1 ||
        full_width > INT32_MAX || full_height < 1 || full_height > INT32_MAX ||
        (uint64_t)width * (uint64_t)height > IMAGE_PIXELS_MAX || x != (int32_t)x || y != (int32_t)y)
        return image_problem(r->problems, r->file, "image-size",
                             "EXR: windows of %lld x %lld and %lld x %lld pixels are out of range",
                             (long long)width, (long long)height, (long long)full_width,
                             (long long)full_height);
    r->image.width = (uint32_t)full_width;
    r->image.height = (uint32_t)full_height;
    r->image.x = (int32_t)x;
    r->image.y = (int32_t)y;
    r->image.data_width = (uint32_t)width;
    r->image.data_height = (uint32_t)height;
    return ERR_OK;
}

static bool is_wanted(const char *name, const char *const *wanted, size_t wanted_count)
{
    for (size_t i = 0; i < wanted_count; i++)
        if (strcmp(name, wanted[i]) == 0)
            return true;
    return wanted_count == 0;
}

static enum err add_plane(struct reader *r, const exr_attr_chlist_entry_t *channel)
{
    struct exr_image *image = &r->image;
    if (channel->x_sampling != 1 || channel->y_sampling != 1)
        return image_problem(r->problems, r->file, "unsupported",
                             "EXR: channel %.60s is subsampled, which is not supported",
                             channel->name.str);
    uint64_t samples = (uint64_t)image->data_width * image->data_height;
    if ((image->channel_count + 1) * samples > SAMPLES_MAX)
        return image_problem(r->problems, r->file, "image-size",
                             "EXR: over 2^30 samples in its channels");
    if (image->channel_count == EXR_CHANNELS_MAX || strlen(channel->name.str) > EXR_NAME_BYTES_MAX)
        return image_problem(r->problems, r->file, "exr-channels",
                             "EXR: over %d channels, or a name over %d bytes",
                             (int)EXR_CHANNELS_MAX, (int)EXR_NAME_BYTES_MAX);
    float *plane = mem_calloc((size_t)image->data_width * image->data_height, sizeof *plane);
    if (!plane)
        return ERR_NOMEM;
    memcpy(image->names[image->channel_count], channel->name.str, strlen(channel->name.str) + 1);
    image->planes[image->channel_count++] = plane;
    return ERR_OK;
}

static enum err alloc_planes(struct reader *r, const char *const *wanted, size_t wanted_count)
{
    struct exr_image *image = &r->image;
    const exr_attr_chlist_t *list;
    exr_result_t code = exr_get_channels(r->ctx, r->part, &list);
    if (code)
        return damaged(r, code);
    image->names = mem_calloc(EXR_CHANNELS_MAX, sizeof *image->names);
    image->planes = mem_calloc(EXR_CHANNELS_MAX, sizeof *image->planes);
    if (!image->names || !image->planes)
        return ERR_NOMEM;
    for (int i = 0; i < list->num_channels; i++)
        if (is_wanted(list->entries[i].name.str, wanted, wanted_count))
            TL_TRY(add_plane(r, &list->entries[i]));
    for (size_t i = 0; i < wanted_count; i++)
        if (!exr_image_plane(image, wanted[i]))
            return image_problem(r->problems, r->file, "exr-channels", "EXR: no channel \"%.60s\"",
                                 wanted[i]);
    return image->channel_count
               ? ERR_OK
               : image_problem(r->problems, r->file, "exr-channels", "EXR: no channel in it");
}

/* Points the channels of a chunk whose corner is (x, y) of the data window at their planes. */
static void aim_planes(struct reader *r, uint32_t x, uint32_t y)
{
    const struct exr_image *image = &r->image;
    for (int i = 0; i < r->decode.channel_count; i++) {
        exr_coding_channel_info_t *c = &r->decode.channels[i];
        float *plane = (float *)(uintptr_t)exr_image_plane(image, c->channel_name);
        c->decode_to_ptr = plane ? (uint8_t *)(plane + (size_t)image->data_width * y + x) : NULL;
        c->user_data_type = EXR_PIXEL_FLOAT;
        c->user_bytes_per_element = sizeof(float);
        c->user_pixel_stride = sizeof(float);
        c->user_line_stride = (int32_t)(image->data_width * sizeof(float));
    }
}

static exr_result_t read_chunk(struct reader *r, const exr_chunk_info_t *chunk, uint32_t x,
                               uint32_t y)
{
    const struct exr_image *image = &r->image;
    bool inside = x <= image->data_width && y <= image->data_height && chunk->width >= 1 &&
                  chunk->height >= 1 && (uint32_t)chunk->width <= image->data_width - x &&
                  (uint32_t)chunk->height <= image->data_height - y;
    if (!inside)
        return EXR_ERR_BAD_CHUNK_LEADER;
    bool first = !r->decode_open;
    exr_result_t code = first ? exr_decoding_initialize(r->ctx, r->part, chunk, &r->decode)
                              : exr_decoding_update(r->ctx, r->part, chunk, &r->decode);
    r->decode_open = r->decode_open || code == EXR_ERR_SUCCESS;
    if (code)
        return code;
    aim_planes(r, x, y);
    if (first)
        code = exr_decoding_choose_default_routines(r->ctx, r->part, &r->decode);
    return code ? code : exr_decoding_run(r->ctx, r->part, &r->decode);
}

static exr_result_t read_scanlines(struct reader *r)
{
    int32_t step = 0;
    exr_chunk_info_t chunk;
    exr_result_t code = exr_get_scanlines_per_chunk(r->ctx, r->part, &step);
    if (code == EXR_ERR_SUCCESS && step < 1)
        return EXR_ERR_INVALID_ATTR;
    for (uint32_t y = 0; code == EXR_ERR_SUCCESS && y < r->image.data_height; y += (uint32_t)step) {
        code = exr_read_scanline_chunk_info(r->ctx, r->part, r->window.min.y + (int32_t)y, &chunk);
        code = code ? code : read_chunk(r, &chunk, 0, y);
    }
    return code;
}

/* Level 0 of a tiled part. */
static exr_result_t read_tiles(struct reader *r)
{
    int32_t width = 0, height = 0;
    exr_chunk_info_t chunk;
    exr_result_t code = exr_get_tile_sizes(r->ctx, r->part, 0, 0, &width, &height);
    if (code == EXR_ERR_SUCCESS && (width < 1 || height < 1))
        return EXR_ERR_INVALID_ATTR;
    for (uint32_t y = 0; code == EXR_ERR_SUCCESS && y < r->image.data_height;
         y += (uint32_t)height) {
        for (uint32_t x = 0; code == EXR_ERR_SUCCESS && x < r->image.data_width;
             x += (uint32_t)width) {
            code = exr_read_tile_chunk_info(r->ctx, r->part, (int)(x / (uint32_t)width),
                                            (int)(y / (uint32_t)height), 0, 0, &chunk);
            code = code ? code : read_chunk(r, &chunk, x, y);
        }
    }
    return code;
}

static enum err read_part(struct reader *r, const char *const *wanted, size_t wanted_count)
{
    exr_storage_t storage;
    TL_TRY(choose_part(r));
    TL_TRY(read_windows(r));
    TL_TRY(alloc_planes(r, wanted, wanted_count));
    exr_result_t code = exr_get_storage(r->ctx, r->part, &storage);
    if (code == EXR_ERR_SUCCESS)
        code = storage == EXR_STORAGE_TILED ? read_tiles(r) : read_scanlines(r);
    if (r->decode_open)
        (void)exr_decoding_destroy(r->ctx, &r->decode);
    return code ? damaged(r, code) : ERR_OK;
}

enum err exr_read(const void *data, size_t bytes, const char *file, const char *const *wanted,
                  size_t wanted_count, struct exr_image *out, struct diag_list *problems)
{
    struct reader r = {.data = data, .bytes = bytes, .file = file, .problems = problems};
    exr_context_initializer_t init = initializer(&r, keep_error_text);
    init.read_fn = take_at;
    init.size_fn = query_size;
    exr_result_t code = exr_start_read(&r.ctx, file ? file : "picture.exr", &init);
    if (code)
        return damaged(&r, code);
    enum err e = read_part(&r, wanted, wanted_count);
    (void)exr_finish(&r.ctx);
    if (e == ERR_OK)
        *out = r.image;
    else
        exr_image_release(&r.image);
    return e;
}

enum err exr_read_file(const char *path, const char *const *wanted, size_t wanted_count,
                       struct exr_image *out, struct diag_list *problems)
{
    char *data;
    size_t bytes;
    enum err e = file_read(path, FILE_BYTES_MAX, &data, &bytes);
    if (e == ERR_NOMEM)
        return e;
    if (e == ERR_NOT_FOUND)
        return image_problem(problems, path, "missing-file", "no such file");
    if (e != ERR_OK)
        return image_problem(problems, path, "unreadable-file", "cannot be read: %s",
                             file_read_why(path, e));
    e = exr_read(data, bytes, path, wanted, wanted_count, out, problems);
    mem_free(data);
    return e;
}

void exr_image_release(struct exr_image *image)
{
    for (size_t i = 0; i < image->channel_count; i++)
        mem_free(image->planes[i]);
    mem_free(image->planes);
    mem_free(image->names);
    *image = (struct exr_image){0};
}

const float *exr_image_plane(const struct exr_image *image, const char *name)
{
    for (size_t i = 0; i < image->channel_count; i++)
        if (strcmp(image->names[i], name) == 0)
            return image->planes[i];
    return NULL;
}
