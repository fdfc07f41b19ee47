#include "client/import_wire.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/mem.h"
#include "common/package.h"

static const char magic[4] = {'T', 'L', 'Y', 'M'};

void import_message_release(struct import_message *m)
{
    for (size_t i = 0; i < m->count; i++) {
        mem_free(m->pictures[i].texture);
        mem_free(m->pictures[i].path);
    }
    mem_free(m->pictures);
    *m = (struct import_message){0};
}

/* --- Writing ------------------------------------------------------------- */

static void put_optional(struct buf *out, const char *text)
{
    size_t bytes = text ? strlen(text) : 0;
    if (bytes > IMPORT_WIRE_TEXT_BYTES_MAX)
        bytes = IMPORT_WIRE_TEXT_BYTES_MAX;
    buf_put_u32(out, (uint32_t)bytes);
    buf_put(out, text ? text : "", bytes);
}

static void put_said(struct buf *out, const struct diag_list *said)
{
    size_t count = said->count < IMPORT_WIRE_SAID_MAX ? said->count : IMPORT_WIRE_SAID_MAX;
    buf_put_u32(out, (uint32_t)count);
    for (size_t i = 0; i < count; i++) {
        buf_put_u8(out, said->items[i].severity == DIAG_ERROR);
        put_optional(out, said->items[i].text);
        put_optional(out, said->items[i].hint);
    }
}

static void put_pictures(struct buf *out, const struct import_message *m)
{
    buf_put_u32(out, (uint32_t)m->count);
    for (size_t i = 0; i < m->count; i++) {
        const struct import_picture *p = &m->pictures[i];
        put_optional(out, p->texture);
        put_optional(out, p->path);
        buf_put_u8(out, p->use == IMAGE_DATA);
        buf_put_u64(out, p->bytes);
        buf_put(out, p->data, p->bytes);
    }
}

static void put_nodes(struct buf *out, const struct import *im)
{
    buf_put_u32(out, (uint32_t)im->object_node_count);
    for (size_t i = 0; i < im->object_node_count; i++)
        buf_put_u32(out, im->object_nodes[i]);
}

static enum err send_all(int fd, const void *data, size_t bytes)
{
    const char *at = data;
    while (bytes > 0) {
        ssize_t wrote = write(fd, at, bytes);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote <= 0)
            return ERR_IO;
        at += wrote;
        bytes -= (size_t)wrote;
    }
    return ERR_OK;
}

static enum err send_chunk(int fd, const struct package_chunk *c)
{
    struct buf head;
    buf_init(&head);
    buf_put(&head, c->name.bytes, DIGEST_BYTES);
    buf_put_u64(&head, c->bytes);
    enum err e = buf_status(&head);
    if (e == ERR_OK)
        e = send_all(fd, head.data, head.bytes);
    buf_release(&head);
    return e == ERR_OK ? send_all(fd, c->data, c->bytes) : e;
}

static enum err send_package(int fd, struct buf *head, const struct scene *scene)
{
    struct package package;
    TL_TRY(package_write_whole(scene, &package));
    buf_put_u32(head, (uint32_t)package.count);
    enum err e = buf_status(head);
    if (e == ERR_OK)
        e = send_all(fd, head->data, head->bytes);
    for (size_t i = 0; i < package.count && e == ERR_OK; i++)
        e = send_chunk(fd, &package.chunks[i]);
    package_release(&package);
    return e;
}

enum err import_wire_send(int fd, const struct import *im, const struct import_message *m,
                          enum err result)
{
    struct buf head;
    buf_init(&head);
    buf_put(&head, magic, sizeof magic);
    buf_put_u32(&head, IMPORT_WIRE_VERSION);
    buf_put_u32(&head, (uint32_t)result);
    buf_put_u64(&head, im->vertex_count);
    buf_put_u64(&head, im->point_count);
    buf_put_u64(&head, im->line_count);
    buf_put_u8(&head, im->has_camera);
    buf_put_u8(&head, im->has_lamp);
    buf_put_f64(&head, im->aspect);
    put_said(&head, im->problems);
    put_pictures(&head, m);
    put_nodes(&head, im);
    enum err e = buf_status(&head);
    if (e == ERR_OK && result == ERR_OK)
        e = send_package(fd, &head, &im->scene);
    else if (e == ERR_OK)
        e = send_all(fd, head.data, head.bytes);
    buf_release(&head);
    return e;
}

/* --- Reading ------------------------------------------------------------- */

static void get_said(struct buf_reader *in, struct import *im)
{
    uint32_t count = buf_get_u32(in);
    in->failed |= count > IMPORT_WIRE_SAID_MAX;
    for (uint32_t i = 0; !in->failed && i < count; i++) {
        bool is_error = buf_get_u8(in) != 0;
        char *text = buf_get_text(in, IMPORT_WIRE_TEXT_BYTES_MAX);
        char *hint = buf_get_text(in, IMPORT_WIRE_TEXT_BYTES_MAX);
        if (text && hint)
            diag_add(im->problems, is_error ? DIAG_ERROR : DIAG_WARNING,
                     (struct diag_place){.file = im->path}, is_error ? "bad-model" : "left-out",
                     *hint ? hint : NULL, "%s", text);
        mem_free(text);
        mem_free(hint);
    }
}

static void get_picture(struct buf_reader *in, struct import_picture *p)
{
    p->texture = buf_get_text(in, IMPORT_WIRE_TEXT_BYTES_MAX);
    p->path = buf_get_text(in, IMPORT_WIRE_TEXT_BYTES_MAX);
    p->use = buf_get_u8(in) ? IMAGE_DATA : IMAGE_COLOR;
    uint64_t bytes = buf_get_u64(in);
    in->failed |= bytes > buf_left(in);
    p->bytes = (size_t)bytes;
    p->data = in->failed ? NULL : buf_get(in, p->bytes);
    if (p->path && !*p->path) {
        mem_free(p->path);
        p->path = NULL;
    }
}

static enum err get_pictures(struct buf_reader *in, struct import_message *m)
{
    uint32_t count = buf_get_u32(in);
    TL_TRY(buf_reader_status(in));
    if (count > IMPORT_WIRE_PICTURES_MAX)
        return ERR_CORRUPT;
    for (uint32_t i = 0; i < count && !in->failed; i++) {
        if (!mem_grow((void **)&m->pictures, m->count, &m->capacity, sizeof *m->pictures))
            return ERR_NOMEM;
        m->pictures[m->count] = (struct import_picture){0};
        get_picture(in, &m->pictures[m->count++]);
    }
    return buf_reader_status(in);
}

static enum err get_nodes(struct buf_reader *in, struct import *im)
{
    uint32_t count = buf_get_u32(in);
    if (in->failed || count > buf_left(in) / sizeof *im->object_nodes)
        return ERR_CORRUPT;
    im->object_nodes = mem_alloc_array(count ? count : 1, sizeof *im->object_nodes);
    if (!im->object_nodes)
        return ERR_NOMEM;
    for (; im->object_node_count < count; im->object_node_count++)
        im->object_nodes[im->object_node_count] = buf_get_u32(in);
    return buf_reader_status(in);
}

/* The chunks that arrived, sorted by name; the root, which comes first, apart. */
struct shelf {
    struct chunk {
        digest name;
        const unsigned char *data;
        size_t bytes;
    } * chunks;
    size_t count;
};

static int compare_chunks(const void *a, const void *b)
{
    const struct chunk *x = a, *y = b;
    return memcmp(x->name.bytes, y->name.bytes, DIGEST_BYTES);
}

static enum err get_shelf(struct buf_reader *in, struct shelf *s)
{
    uint32_t count = buf_get_u32(in);
    if (in->failed || count < 1 || count > buf_left(in) / (DIGEST_BYTES + 8))
        return ERR_CORRUPT;
    s->chunks = mem_calloc(count, sizeof *s->chunks);
    if (!s->chunks)
        return ERR_NOMEM;
    for (; s->count < count && !in->failed; s->count++) {
        struct chunk *c = &s->chunks[s->count];
        const unsigned char *name = buf_get(in, DIGEST_BYTES);
        uint64_t bytes = buf_get_u64(in);
        if (!name || bytes > buf_left(in))
            return ERR_CORRUPT;
        memcpy(c->name.bytes, name, DIGEST_BYTES);
        c->bytes = (size_t)bytes;
        c->data = buf_get(in, c->bytes);
    }
    if (in->failed || buf_left(in) > 0)
        return ERR_CORRUPT;
    qsort(s->chunks + 1, s->count - 1, sizeof *s->chunks, compare_chunks);
    return ERR_OK;
}

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    const struct shelf *s = ctx;
    struct chunk wanted = {.name = entry->name};
    (void)i;
    const struct chunk *found =
        bsearch(&wanted, s->chunks + 1, s->count - 1, sizeof *s->chunks, compare_chunks);
    if (!found)
        return ERR_CORRUPT;
    *data = found->data;
    *bytes = found->bytes;
    return ERR_OK;
}

static enum err get_scene(struct buf_reader *in, struct scene *out)
{
    struct shelf s = {0};
    enum err e = get_shelf(in, &s);
    if (e == ERR_OK)
        e = package_read(s.chunks[0].data, s.chunks[0].bytes, fetch, &s, out);
    mem_free(s.chunks);
    return e;
}

/* The capacities of tables that came as they are. */
static void note_capacities(struct import *im)
{
    const struct scene *s = &im->scene;
    im->image_capacity = s->image_count;
    im->texture_capacity = s->texture_count;
    im->material_capacity = s->material_count;
    im->mesh_capacity = s->mesh_count;
    im->object_capacity = s->object_count;
    im->light_capacity = s->light_count;
}

enum err import_wire_get(const void *data, size_t bytes, struct import *im,
                         struct import_message *m)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    const unsigned char *start = buf_get(&in, sizeof magic);
    if (!start || memcmp(start, magic, sizeof magic) != 0 ||
        buf_get_u32(&in) != IMPORT_WIRE_VERSION)
        return ERR_CORRUPT;
    uint32_t result = buf_get_u32(&in);
    im->vertex_count += buf_get_u64(&in);
    im->point_count += buf_get_u64(&in);
    im->line_count += buf_get_u64(&in);
    im->has_camera = buf_get_u8(&in) != 0;
    im->has_lamp = buf_get_u8(&in) != 0;
    im->aspect = buf_get_f64(&in);
    get_said(&in, im);
    TL_TRY(get_pictures(&in, m));
    TL_TRY(get_nodes(&in, im));
    if (result != ERR_OK)
        return result == ERR_NOMEM ? ERR_LIMIT : result < ERR_COUNT ? ERR_INPUT : ERR_CORRUPT;
    struct scene scene;
    TL_TRY(get_scene(&in, &scene));
    scene_release(&im->scene);
    im->scene = scene;
    note_capacities(im);
    return im->object_node_count == scene.object_count ? ERR_OK : ERR_CORRUPT;
}
