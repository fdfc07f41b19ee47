/* client/import_image.c: the pictures that a model names, each read once for each use.
 *
 * Keeps which source became which image; the scene owns the pixels. A picture that cannot be read
 * is a warning, and the model comes without it. One thread.
 */
#include <string.h>

#include "client/import_model.h"
#include "common/file_io.h"
#include "common/mem.h"

#define IMAGE_BYTES_MAX (UINT64_C(1) << 30)

/* Sources are numbered as their names, which begin with the use. */
static char *name_of(const char *key, enum image_use use)
{
    return mem_sprintf("%d%s", (int)use, key);
}

/* NULL in *out: not asked for yet. */
static enum err find(const struct import *im, const char *key, enum image_use use,
                     const struct import_source **out)
{
    char *name = name_of(key, use);
    if (!name)
        return ERR_NOMEM;
    uint32_t index = name_table_find(&im->source_names, name, strlen(name));
    mem_free(name);
    *out = index == UINT32_MAX ? NULL : &im->sources[index];
    return ERR_OK;
}

static enum err remember(struct import *im, const char *key, const char *path, enum image_use use,
                         uint32_t image)
{
    uint32_t index;
    if (!mem_grow((void **)&im->sources, im->source_count, &im->source_capacity,
                  sizeof *im->sources))
        return ERR_NOMEM;
    char *name = name_of(key, use), *copy = path ? mem_strdup(path) : NULL;
    enum err e = name && (copy || !path)
                     ? name_table_add(&im->source_names, name, strlen(name), &index)
                     : ERR_NOMEM;
    mem_free(name);
    if (e != ERR_OK) {
        mem_free(copy);
        return e;
    }
    TL_ASSERT(index == im->source_count);
    im->sources[im->source_count++] =
        (struct import_source){.path = copy, .use = use, .image = image};
    return ERR_OK;
}

/* An image that cannot be read is no reason to refuse the model: its errors become warnings. */
static void soften(struct import *im, const struct diag_list *found)
{
    for (size_t i = 0; i < found->count; i++) {
        const struct diag *d = &found->items[i];
        diag_add(im->problems, DIAG_WARNING,
                 (struct diag_place){.file = d->file, .line = d->line, .path = d->path}, d->id,
                 "the model is shown without this picture", "%s", d->text);
    }
}

static enum err decode(struct import *im, const void *data, size_t bytes, const char *shown,
                       enum image_use use, uint32_t *out)
{
    struct diag_list found;
    struct scene_image image;
    diag_init(&found);
    enum err e = image_read(data, bytes, shown, use, &image, &found);
    soften(im, &found);
    diag_release(&found);
    *out = SCENE_NONE;
    if (e == ERR_NOMEM)
        return e;
    return e == ERR_OK ? import_add_image(im, &image, out) : ERR_OK;
}

enum err import_image_file(struct import *im, const char *path, enum image_use use, uint32_t *out)
{
    const struct import_source *known;
    TL_TRY(find(im, path, use, &known));
    if (known) {
        *out = known->image;
        return ERR_OK;
    }
    char *joined = file_join(im->folder, path);
    char *data = NULL;
    size_t bytes;
    uint32_t image = SCENE_NONE;
    enum err e = joined ? file_read(joined, IMAGE_BYTES_MAX, &data, &bytes) : ERR_NOMEM;
    if (e == ERR_OK) {
        im->source_bytes += bytes;
        e = decode(im, data, bytes, joined, use, &image);
    } else if (e != ERR_NOMEM) {
        import_warn(im, "missing-image", "the model is shown without this picture",
                    "picture \"%s\": %s", path, e == ERR_NOT_FOUND ? "no such file" : err_text(e));
        e = ERR_OK;
    }
    if (e == ERR_OK)
        e = remember(im, path, image == SCENE_NONE ? NULL : joined, use, image);
    mem_free(data);
    mem_free(joined);
    if (e == ERR_OK)
        *out = image;
    return e;
}

static enum err keep(struct import_source *s, const void *data, size_t bytes)
{
    s->data = mem_alloc(bytes);
    if (!s->data)
        return ERR_NOMEM;
    memcpy(s->data, data, bytes);
    s->bytes = bytes;
    return ERR_OK;
}

enum err import_image_bytes(struct import *im, const char *key, const void *data, size_t bytes,
                            enum image_use use, uint32_t *out)
{
    const struct import_source *known;
    TL_TRY(find(im, key, use, &known));
    uint32_t image = SCENE_NONE;
    if (!known) {
        char *shown = mem_sprintf("%s%s", im->path, key);
        enum err e = shown ? decode(im, data, bytes, shown, use, &image) : ERR_NOMEM;
        mem_free(shown);
        if (e != ERR_OK)
            return e;
        TL_TRY(remember(im, key, NULL, use, image));
        if (im->keep_bytes && image != SCENE_NONE)
            TL_TRY(keep(&im->sources[im->source_count - 1], data, bytes));
    }
    *out = known ? known->image : image;
    return ERR_OK;
}

bool import_is_normal_map(const struct scene_image *image)
{
    if (image->channel_count < 3)
        return false;
    const unsigned char *bytes = image->pixels;
    const float *floats = image->pixels;
    size_t count = (size_t)image->width * image->height, blue = 0;
    for (size_t i = 0; i < count; i++) {
        float c[3];
        for (size_t k = 0; k < 3; k++) {
            size_t at = i * image->channel_count + k;
            c[k] = image->format == SCENE_IMAGE_F32 ? floats[at] : bytes[at] / 255.0f;
        }
        blue += c[2] > 0.505f && c[2] >= c[0] && c[2] >= c[1] && (c[2] > c[0] || c[2] > c[1]);
    }
    return blue > count / 2;
}
