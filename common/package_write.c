/* A scene to a package: what is used, renumbered, as a root chunk and a chunk for each mesh and
 * image. Owns the trimmed copy and the chunks until they are given away; no state, any thread. */
#include <string.h>

#include "common/mem.h"
#include "common/package_codec.h"

/* A shallow copy of the scene that keeps only what is used, renumbered. Names, pixels and
 * vertices still belong to the original. */
struct trimmed {
    struct scene scene;
    uint32_t *texture_map, *material_map, *mesh_map, *image_map; /* old index -> new */
};

void package_release(struct package *p)
{
    for (size_t i = 0; i < p->count; i++)
        mem_free(p->chunks[i].data);
    mem_free(p->chunks);
    *p = (struct package){0};
}

/* --- What is used -------------------------------------------------------- */

static void trimmed_release(struct trimmed *t)
{
    mem_free(t->texture_map);
    mem_free(t->material_map);
    mem_free(t->mesh_map);
    mem_free(t->image_map);
    mem_free(t->scene.images);
    mem_free(t->scene.textures);
    mem_free(t->scene.materials);
    mem_free(t->scene.meshes);
    mem_free(t->scene.objects);
    mem_free(t->scene.lights);
}

static uint32_t *new_map(size_t count)
{
    uint32_t *map = mem_alloc_array(count, sizeof *map);
    for (size_t i = 0; map && i < count; i++)
        map[i] = SCENE_NONE;
    return map;
}

static void *copy_of(const void *items, size_t count, size_t item_bytes)
{
    void *copy = mem_alloc_array(count, item_bytes);
    if (copy && count)
        memcpy(copy, items, count * item_bytes);
    return copy;
}

static bool trimmed_alloc(struct trimmed *t, const struct scene *s)
{
    struct scene *to = &t->scene;
    *to = *s;
    t->texture_map = new_map(s->texture_count);
    t->material_map = new_map(s->material_count);
    t->mesh_map = new_map(s->mesh_count);
    t->image_map = new_map(s->image_count);
    to->images = copy_of(s->images, s->image_count, sizeof *s->images);
    to->textures = copy_of(s->textures, s->texture_count, sizeof *s->textures);
    to->materials = copy_of(s->materials, s->material_count, sizeof *s->materials);
    to->meshes = copy_of(s->meshes, s->mesh_count, sizeof *s->meshes);
    to->objects = copy_of(s->objects, s->object_count, sizeof *s->objects);
    to->lights = copy_of(s->lights, s->light_count, sizeof *s->lights);
    return t->texture_map && t->material_map && t->mesh_map && t->image_map && to->images &&
           to->textures && to->materials && to->meshes && to->objects && to->lights;
}

static void mark(uint32_t *map, uint32_t index)
{
    if (index != SCENE_NONE)
        map[index] = 0;
}

static void renumber(uint32_t *index, const uint32_t *map)
{
    if (*index != SCENE_NONE)
        *index = map[*index];
}

/* Moves the marked items to the front and writes their new numbers into the map. */
static size_t compact(void *items, size_t count, size_t item_bytes, uint32_t *map)
{
    unsigned char *bytes = items;
    size_t kept = 0;
    for (size_t i = 0; i < count; i++) {
        if (map[i] == SCENE_NONE)
            continue;
        memmove(bytes + kept * item_bytes, bytes + i * item_bytes, item_bytes);
        map[i] = (uint32_t)kept++;
    }
    return kept;
}

static void mark_material(struct trimmed *t, const struct scene_material *m)
{
    mark(t->texture_map, m->texture);
    mark(t->texture_map, m->metallic_roughness_texture);
    mark(t->texture_map, m->emission_texture);
    mark(t->texture_map, m->normal_texture);
    mark(t->texture_map, m->transmission_texture);
}

static void renumber_all(struct trimmed *t)
{
    struct scene *s = &t->scene;
    for (size_t i = 0; i < s->object_count; i++) {
        renumber(&s->objects[i].material, t->material_map);
        renumber(&s->objects[i].mesh, t->mesh_map);
    }
    for (size_t i = 0; i < s->material_count; i++) {
        struct scene_material *m = &s->materials[i];
        renumber(&m->texture, t->texture_map);
        renumber(&m->metallic_roughness_texture, t->texture_map);
        renumber(&m->emission_texture, t->texture_map);
        renumber(&m->normal_texture, t->texture_map);
        renumber(&m->transmission_texture, t->texture_map);
    }
    for (size_t i = 0; i < s->texture_count; i++)
        renumber(&s->textures[i].image, t->image_map);
    renumber(&s->envmap.texture, t->texture_map);
}

static void trim(struct trimmed *t)
{
    struct scene *s = &t->scene;
    for (size_t i = 0; i < s->object_count; i++) {
        mark(t->material_map, s->objects[i].material);
        mark(t->mesh_map, s->objects[i].mesh);
    }
    for (size_t i = 0; i < s->material_count; i++)
        if (t->material_map[i] != SCENE_NONE)
            mark_material(t, &s->materials[i]);
    mark(t->texture_map, s->envmap.texture);
    for (size_t i = 0; i < s->texture_count; i++)
        if (t->texture_map[i] != SCENE_NONE)
            mark(t->image_map, s->textures[i].image);

    s->material_count =
        compact(s->materials, s->material_count, sizeof *s->materials, t->material_map);
    s->mesh_count = compact(s->meshes, s->mesh_count, sizeof *s->meshes, t->mesh_map);
    s->texture_count = compact(s->textures, s->texture_count, sizeof *s->textures, t->texture_map);
    s->image_count = compact(s->images, s->image_count, sizeof *s->images, t->image_map);
    renumber_all(t);
}

/* --- Chunks -------------------------------------------------------------- */

/* The chunks of one kind by name: open addressing, at most half full. */
struct chunk_set {
    struct package_chunk *chunks; /* borrowed */
    size_t count, mask;
    uint32_t *slots; /* place + 1; 0: free */
};

static bool chunk_set_init(struct chunk_set *set, struct package_chunk *chunks, size_t count_max)
{
    size_t slots = 16;
    while (slots < 2 * count_max)
        slots *= 2;
    *set = (struct chunk_set){.chunks = chunks, .mask = slots - 1};
    set->slots = mem_calloc(slots, sizeof *set->slots);
    return set->slots != NULL;
}

static void chunk_take(struct package_chunk *chunk, struct buf *b, enum package_kind kind)
{
    *chunk = (struct package_chunk){
        .name = digest_of(b->data, b->bytes), .data = b->data, .bytes = b->bytes, .kind = kind};
    buf_init(b);
}

/* Takes the buf's memory as a chunk after the others, or frees it if an equal one is there; gives
 * its place and whether it is new. */
static bool chunk_set_add(struct chunk_set *set, struct buf *b, enum package_kind kind,
                          uint32_t *place)
{
    struct package_chunk *chunk = &set->chunks[set->count];
    chunk_take(chunk, b, kind);
    size_t slot;
    memcpy(&slot, chunk->name.bytes, sizeof slot);
    for (slot &= set->mask; set->slots[slot]; slot = (slot + 1) & set->mask) {
        *place = set->slots[slot] - 1;
        if (digest_equal(&set->chunks[*place].name, &chunk->name)) {
            mem_free(chunk->data);
            *chunk = (struct package_chunk){0};
            return false;
        }
    }
    *place = (uint32_t)set->count++;
    set->slots[slot] = *place + 1;
    return true;
}

/* Meshes with the same bytes become one: objects then share its index. */
static enum err put_meshes(struct trimmed *t, struct package *p)
{
    struct scene *s = &t->scene;
    struct chunk_set set;
    enum err e = chunk_set_init(&set, p->chunks + p->count, s->mesh_count) ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; e == ERR_OK && i < s->mesh_count; i++) {
        struct buf b;
        buf_init(&b);
        e = package_mesh_put(&s->meshes[i], &b);
        if (e == ERR_OK && chunk_set_add(&set, &b, PACKAGE_MESH, &t->mesh_map[i]))
            s->meshes[set.count - 1] = s->meshes[i];
        buf_release(&b);
    }
    for (size_t i = 0; e == ERR_OK && i < s->object_count; i++)
        renumber(&s->objects[i].mesh, t->mesh_map);
    s->mesh_count = set.count;
    p->count += set.count;
    mem_free(set.slots);
    return e;
}

static enum err put_images(struct trimmed *t, struct package *p)
{
    struct scene *s = &t->scene;
    struct chunk_set set;
    enum err e = chunk_set_init(&set, p->chunks + p->count, s->image_count) ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; e == ERR_OK && i < s->image_count; i++) {
        struct buf b;
        buf_init(&b);
        e = package_image_put(&s->images[i], &b);
        if (e == ERR_OK)
            (void)chunk_set_add(&set, &b, PACKAGE_IMAGE, &t->image_map[i]);
        buf_release(&b);
    }
    for (size_t i = 0; e == ERR_OK && i < s->texture_count; i++)
        renumber(&s->textures[i].image, t->image_map);
    s->image_count = set.count;
    p->count += set.count;
    mem_free(set.slots);
    return e;
}

static enum err put_root(struct trimmed *t, struct package *p)
{
    struct buf b;
    buf_init(&b);
    struct codec c = {.out = &b};
    struct scene *s = &t->scene;
    codec_magic(&c, "TLYR");
    buf_put_u32(&b, (uint32_t)s->mesh_count);
    buf_put_u32(&b, (uint32_t)s->image_count);
    for (size_t i = 1; i < p->count; i++) {
        buf_put(&b, p->chunks[i].name.bytes, DIGEST_BYTES);
        buf_put_u64(&b, p->chunks[i].bytes);
    }
    for (size_t i = 0; i < s->mesh_count; i++)
        codec_name(&c, &s->meshes[i].name);
    codec_scene(&c, s);
    enum err e = codec_end(&c);
    if (e == ERR_OK)
        chunk_take(&p->chunks[0], &b, PACKAGE_ROOT);
    buf_release(&b);
    return e;
}

static enum err put_all(struct trimmed *t, struct package *p)
{
    size_t room = 1 + t->scene.mesh_count + t->scene.image_count;
    p->chunks = mem_calloc(room, sizeof *p->chunks);
    if (!p->chunks)
        return ERR_NOMEM;
    p->count = 1;
    TL_TRY(put_meshes(t, p));
    TL_TRY(put_images(t, p));
    return put_root(t, p);
}

enum err package_write(const struct scene *scene, struct package *out)
{
    struct trimmed t = {0};
    struct package p = {0};
    enum err e = ERR_NOMEM;
    if (trimmed_alloc(&t, scene)) {
        trim(&t);
        e = put_all(&t, &p);
    }
    trimmed_release(&t);
    if (e == ERR_OK)
        *out = p;
    else
        package_release(&p);
    return e;
}
