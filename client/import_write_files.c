/* The meshes and pictures of an imported scene, as files beside it. */
#include <errno.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "client/import_write.h"
#include "common/exr_file.h"
#include "common/file_io.h"
#include "common/mem.h"

/* --- Names --------------------------------------------------------------- */

/* Letters, digits and '-' of a name, for a file's. */
static void plain_name(const char *name, char out[40])
{
    size_t n = 0;
    for (; *name && n < 39; name++) {
        bool plain = (*name >= 'a' && *name <= 'z') || (*name >= 'A' && *name <= 'Z') ||
                     (*name >= '0' && *name <= '9');
        if (plain || (n > 0 && out[n - 1] != '-'))
            out[n++] = plain ? *name : '-';
    }
    while (n > 0 && out[n - 1] == '-')
        n--;
    out[n] = '\0';
}

static enum err make_folder(struct import_writer *w, const char *kind)
{
    char *name = mem_sprintf("%s_%s", w->stem, kind);
    char *path = name ? file_join(w->folder, name) : NULL;
    enum err e = path ? ERR_OK : ERR_NOMEM;
    if (path && mkdir(path, 0777) != 0 && errno != EEXIST) {
        e = errno == ENOENT ? ERR_NOT_FOUND : err_from_errno(errno);
        w->failed = path;
        path = NULL;
    }
    mem_free(path);
    mem_free(name);
    return e;
}

/* Writes `path`, which is relative to the scene file's folder. */
static enum err write_beside(struct import_writer *w, const char *path, const void *data,
                             size_t bytes)
{
    char *joined = file_join(w->folder, path);
    if (!joined)
        return ERR_NOMEM;
    enum err e = file_write(joined, data, bytes);
    if (e == ERR_OK || e == ERR_NOMEM)
        mem_free(joined);
    else
        w->failed = joined;
    return e;
}

/* --- Meshes -------------------------------------------------------------- */

static void put_header(const struct scene_mesh *m, struct buf *out)
{
    buf_printf(out,
               "ply\nformat binary_little_endian 1.0\nelement vertex %u\n"
               "property double x\nproperty double y\nproperty double z\n",
               m->vertex_count);
    if (m->normals)
        buf_printf(out, "property float nx\nproperty float ny\nproperty float nz\n");
    if (m->uvs)
        buf_printf(out, "property float u\nproperty float v\n");
    if (m->colors)
        buf_printf(out, "property float red\nproperty float green\nproperty float blue\n");
    if (m->alphas)
        buf_printf(out, "property float alpha\n");
    buf_printf(out, "element face %u\nproperty list uchar uint vertex_indices\nend_header\n",
               m->triangle_count);
}

static void put_mesh(const struct scene_mesh *m, struct buf *out)
{
    put_header(m, out);
    for (size_t i = 0; i < m->vertex_count; i++) {
        for (size_t c = 0; c < 3; c++)
            buf_put_f64(out, m->positions[3 * i + c]);
        for (size_t c = 0; m->normals && c < 3; c++)
            buf_put_f32(out, m->normals[3 * i + c]);
        for (size_t c = 0; m->uvs && c < 2; c++)
            buf_put_f32(out, m->uvs[2 * i + c]);
        for (size_t c = 0; m->colors && c < 3; c++)
            buf_put_f32(out, m->colors[3 * i + c]);
        if (m->alphas)
            buf_put_f32(out, m->alphas[i]);
    }
    for (size_t t = 0; t < m->triangle_count; t++) {
        buf_put_u8(out, 3);
        for (size_t c = 0; c < 3; c++)
            buf_put_u32(out, m->indices[3 * t + c]);
    }
}

static enum err write_mesh(struct import_writer *w, size_t i)
{
    const struct scene_mesh *m = &w->im->scene.meshes[i];
    struct buf out;
    char name[40];
    plain_name(m->name, name);
    w->mesh_paths[i] = mem_sprintf("%s_meshes/%zu%s%s.ply", w->stem, i, *name ? "-" : "", name);
    if (!w->mesh_paths[i])
        return ERR_NOMEM;
    buf_init(&out);
    put_mesh(m, &out);
    enum err e = buf_status(&out);
    if (e == ERR_OK)
        e = write_beside(w, w->mesh_paths[i], out.data, out.bytes);
    buf_release(&out);
    return e;
}

/* --- Pictures ------------------------------------------------------------ */

const struct import_source *import_source_of(const struct import *im, uint32_t image)
{
    for (size_t i = 0; i < im->source_count; i++)
        if (im->sources[i].image == image)
            return &im->sources[i];
    return NULL;
}

/* `path` seen from the folder `from`, both absolute and without links. */
static char *path_from(const char *from, const char *path)
{
    size_t common = 0, i = 0;
    for (; from[i] && from[i] == path[i]; i++)
        if (from[i] == '/')
            common = i + 1;
    if (!from[i] && path[i] == '/')
        common = i + 1;
    struct buf out;
    buf_init(&out);
    if (common <= strlen(from) && from[common])
        buf_printf(&out, "../");
    for (const char *c = from + (common <= strlen(from) ? common : strlen(from)); *c; c++)
        if (*c == '/')
            buf_printf(&out, "../");
    buf_printf(&out, "%s", path + common);
    buf_put_u8(&out, 0);
    char *text = buf_status(&out) == ERR_OK ? mem_strdup((const char *)out.data) : NULL;
    buf_release(&out);
    return text;
}

/* A picture that is a file stays where it is. */
static char *refer_to(const struct import_writer *w, const char *path)
{
    char from[PATH_MAX], to[PATH_MAX];
    if (!realpath(w->folder, from) || !realpath(path, to))
        return mem_strdup(path);
    return path_from(from, to);
}

static const char *extension_of(const unsigned char *data, size_t bytes)
{
    if (bytes >= 4 && memcmp(data, "\x89PNG", 4) == 0)
        return "png";
    if (bytes >= 2 && memcmp(data, "\xFF\xD8", 2) == 0)
        return "jpg";
    return bytes >= 4 && memcmp(data, "\x76\x2F\x31\x01", 4) == 0 ? "exr" : "hdr";
}

/* A picture of ours, linear floats. */
static enum err write_float_image(struct import_writer *w, size_t i)
{
    static const char *const names[3] = {"R", "G", "B"};
    const struct scene_image *image = &w->im->scene.images[i];
    struct exr_channel channels[3];
    struct buf out;
    TL_ASSERT(image->format == SCENE_IMAGE_F32 && image->channel_count == 3);
    for (size_t c = 0; c < 3; c++)
        channels[c] = (struct exr_channel){names[c], (const float *)image->pixels + c, 3};
    struct exr_picture picture = {.width = image->width,
                                  .height = image->height,
                                  .data_width = image->width,
                                  .data_height = image->height,
                                  .channels = channels,
                                  .channel_count = 3};
    w->image_paths[i] = mem_sprintf("%s_images/%zu.exr", w->stem, i);
    if (!w->image_paths[i])
        return ERR_NOMEM;
    buf_init(&out);
    enum err e = exr_write(&picture, &out);
    if (e == ERR_OK)
        e = write_beside(w, w->image_paths[i], out.data, out.bytes);
    buf_release(&out);
    return e;
}

static enum err write_image(struct import_writer *w, size_t i)
{
    const struct import_source *s = import_source_of(w->im, (uint32_t)i);
    if (!s)
        return write_float_image(w, i);
    if (s->path) {
        w->image_paths[i] = refer_to(w, s->path);
        return w->image_paths[i] ? ERR_OK : ERR_NOMEM;
    }
    TL_ASSERT(s->data);
    w->image_paths[i] =
        mem_sprintf("%s_images/%zu.%s", w->stem, i, extension_of(s->data, s->bytes));
    if (!w->image_paths[i])
        return ERR_NOMEM;
    return write_beside(w, w->image_paths[i], s->data, s->bytes);
}

static bool has_own_images(const struct import *im)
{
    for (size_t i = 0; i < im->scene.image_count; i++) {
        const struct import_source *s = import_source_of(im, (uint32_t)i);
        if (!s || !s->path)
            return true;
    }
    return false;
}

enum err import_write_files(struct import_writer *w)
{
    const struct scene *s = &w->im->scene;
    w->mesh_paths = mem_calloc(s->mesh_count, sizeof *w->mesh_paths);
    w->image_paths = mem_calloc(s->image_count, sizeof *w->image_paths);
    if (!w->mesh_paths || !w->image_paths)
        return ERR_NOMEM;
    TL_TRY(make_folder(w, "meshes"));
    if (has_own_images(w->im))
        TL_TRY(make_folder(w, "images"));
    for (size_t i = 0; i < s->mesh_count; i++)
        TL_TRY(write_mesh(w, i));
    for (size_t i = 0; i < s->image_count; i++)
        TL_TRY(write_image(w, i));
    return ERR_OK;
}
