/* A scene to a package: what is used, renumbered, as a root chunk and a chunk for each mesh and
 * image, or several for a large image. Owns the trimmed copy and the chunks until they are given
 * away; no state, any thread. */
#include <string.h>

#include "common/mem.h"
#include "common/package_codec.h"
#include "common/package_late.h"
#include "common/package_split.h"
#include "common/package_trim.h"
#include "common/parallel.h"

const char *const package_left_what[PACKAGE_LEFT_COUNT] = {
#define PACKAGE_LEFT_WHAT(id, what, why) what,
    PACKAGE_LEFT(PACKAGE_LEFT_WHAT)
#undef PACKAGE_LEFT_WHAT
};
const char *const package_left_why[PACKAGE_LEFT_COUNT] = {
#define PACKAGE_LEFT_WHY(id, what, why) why,
    PACKAGE_LEFT(PACKAGE_LEFT_WHY)
#undef PACKAGE_LEFT_WHY
};

/* An image in pieces, as the root tells of it. */
struct pieced {
    struct scene_image picture; /* without pixels */
    uint32_t *numbers;          /* owned; of its pieces; NULL: the image is one chunk */
    size_t count;
};

/* A shallow copy of the scene that keeps only what the plan does, renumbered. Names, pixels and
 * vertices still belong to the original. */
struct trimmed {
    struct scene scene;
    struct scene_plan plan; /* its meshes and channels follow the scene's order */
    uint32_t *texture_map, *material_map, *mesh_map, *image_map; /* old index -> new */
    uint64_t split_bytes_min; /* of pictures in pieces; UINT64_MAX: none */
    bool *may_be_late;        /* of its images */
    struct pieced *pieced;    /* of the images that have a chunk */
    size_t pieced_count;
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
    scene_plan_release(&t->plan);
    mem_free(t->texture_map);
    mem_free(t->material_map);
    mem_free(t->mesh_map);
    mem_free(t->image_map);
    mem_free(t->may_be_late);
    for (size_t i = 0; i < t->pieced_count; i++)
        mem_free(t->pieced[i].numbers);
    mem_free(t->pieced);
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

static void leave(struct package_left *left, enum package_left_kind kind, uint64_t bytes)
{
    left[kind].count++;
    left[kind].bytes += bytes;
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
        renumber(&m->bump_texture, t->texture_map);
        renumber(&m->transmission_texture, t->texture_map);
    }
    for (size_t i = 0; i < s->texture_count; i++)
        renumber(&s->textures[i].image, t->image_map);
    renumber(&s->envmap.texture, t->texture_map);
}

/* Marks what the plan keeps, and counts the rest. */
static void mark_kept(struct trimmed *t, struct package_left *left)
{
    const struct scene *s = &t->scene;
    for (size_t i = 0; i < s->mesh_count; i++) {
        if (t->plan.meshes[i].uses > 0)
            t->mesh_map[i] = 0;
        else
            leave(left, PACKAGE_LEFT_MESHES, package_mesh_bytes(&s->meshes[i]));
    }
    for (size_t i = 0; i < s->image_count; i++) {
        if (t->plan.channels[i])
            t->image_map[i] = 0;
        else
            leave(left, PACKAGE_LEFT_IMAGES, package_image_bytes(&s->images[i]));
    }
    for (size_t i = 0; i < s->texture_count; i++) {
        if (t->plan.textures[i])
            t->texture_map[i] = 0;
        else
            leave(left, PACKAGE_LEFT_TEXTURES, CODEC_TEXTURE_BYTES + strlen(s->textures[i].name));
    }
    for (size_t i = 0; i < s->material_count; i++) {
        if (t->plan.materials[i])
            t->material_map[i] = 0;
        else
            leave(left, PACKAGE_LEFT_MATERIALS,
                  CODEC_MATERIAL_BYTES + strlen(s->materials[i].name));
    }
}

/* Objects keep their numbers; those that nothing meets keep nothing else. */
static void trim_objects(struct trimmed *t, struct package_left *left)
{
    for (size_t i = 0; i < t->scene.object_count; i++) {
        if (t->plan.objects[i])
            continue;
        scene_object_init(&t->scene.objects[i]);
        t->scene.objects[i].type = SCENE_OBJECT_NOTHING;
        leave(left, PACKAGE_LEFT_OBJECTS, 0);
    }
}

static void trim(struct trimmed *t, struct package_left *left)
{
    struct scene *s = &t->scene;
    struct scene_plan *p = &t->plan;
    trim_objects(t, left);
    for (size_t i = 0; i < s->material_count; i++)
        if (s->materials[i].number == SCENE_NONE)
            s->materials[i].number = (uint32_t)i;
    for (size_t i = 0; !p->whole && i < s->material_count; i++)
        s->materials[i] = scene_plan_material(&s->materials[i], p->emissions[i]);
    mark_kept(t, left);
    (void)compact(p->meshes, s->mesh_count, sizeof *p->meshes, t->mesh_map);
    (void)compact(p->channels, s->image_count, sizeof *p->channels, t->image_map);
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

static void chunk_take(struct package_chunk *chunk, struct buf *b, const digest *name,
                       enum package_kind kind)
{
    *chunk =
        (struct package_chunk){.name = *name, .data = b->data, .bytes = b->bytes, .kind = kind};
    buf_init(b);
}

/* Takes the buf's memory as a chunk after the others, or frees it if an equal one is there; gives
 * its place and whether it is new. */
static bool chunk_set_add(struct chunk_set *set, struct buf *b, const digest *name,
                          enum package_kind kind, uint32_t *place)
{
    size_t slot;
    memcpy(&slot, name->bytes, sizeof slot);
    for (slot &= set->mask; set->slots[slot]; slot = (slot + 1) & set->mask) {
        *place = set->slots[slot] - 1;
        if (digest_equal(&set->chunks[*place].name, name)) {
            buf_release(b);
            return false;
        }
    }
    *place = (uint32_t)set->count++;
    set->slots[slot] = *place + 1;
    chunk_take(&set->chunks[*place], b, name, kind);
    return true;
}

/* A chunk that is there already has cost nothing but its name. */
static void leave_copy(struct package *p, uint64_t bytes)
{
    leave(p->left, PACKAGE_LEFT_COPIES, bytes + CODEC_ENTRY_BYTES);
}

/* One chunk being made, with what it leaves out. */
struct packed {
    struct buf bytes;
    digest name;
    struct split split;   /* pieces of the image; none: it is whole */
    uint64_t whole_bytes; /* of the image as one chunk */
    struct package_left left[PACKAGE_LEFT_COUNT];
    enum err error;
};

/* The trimmed mesh as a chunk. */
static enum err put_mesh(const struct trimmed *t, size_t i, struct packed *out)
{
    struct trimmed_mesh m = {.mesh = t->scene.meshes[i]};
    if (!t->plan.whole)
        TL_TRY(package_trim_mesh(&t->scene.meshes[i], &t->plan.meshes[i], out->left, &m));
    bool f32 = !t->plan.whole && package_mesh_fits_f32(&m.mesh);
    if (f32) {
        out->left[PACKAGE_LEFT_DIGITS].count += m.mesh.vertex_count * UINT64_C(3);
        out->left[PACKAGE_LEFT_DIGITS].bytes += m.mesh.vertex_count * UINT64_C(3) * sizeof(float);
    }
    enum err e = package_mesh_put(&m.mesh, f32, &out->bytes);
    package_trim_mesh_release(&m);
    return e;
}

/* One chunk, or a base and pieces. */
static enum err put_pixels(const struct scene_image *image, unsigned stored,
                           uint64_t split_bytes_min, struct packed *out)
{
    out->whole_bytes = package_image_chunk_bytes(image, stored);
    if (!package_is_split(image, stored, split_bytes_min))
        return package_image_put(image, stored, &out->bytes);
    TL_TRY(package_split(image, stored, &out->split));
    out->bytes = out->split.base;
    buf_init(&out->split.base);
    return ERR_OK;
}

static enum err put_image(const struct trimmed *t, size_t i, struct packed *out)
{
    struct scene_image image = t->scene.images[i];
    unsigned stored = (1u << image.channel_count) - 1;
    bool own = false;
    if (!t->plan.whole)
        TL_TRY(package_trim_image(&t->scene.images[i], t->plan.channels[i], out->left, &image,
                                  &stored, &own));
    enum err e =
        put_pixels(&image, stored, t->may_be_late[i] ? t->split_bytes_min : UINT64_MAX, out);
    if (own)
        mem_free(image.pixels);
    return e;
}

/* Chunks of one kind, made side by side, some at a time: an equal one is found by its name only
 * once it is made. */
enum { PACKED_MAX = 32 };

struct packing {
    const struct trimmed *from;
    enum package_kind kind;
    size_t first; /* of the scene's meshes or images */
    struct packed chunks[PACKED_MAX];
};

static void pack_one(void *arg, size_t i)
{
    struct packing *w = arg;
    struct packed *out = &w->chunks[i];
    out->error = w->kind == PACKAGE_MESH ? put_mesh(w->from, w->first + i, out)
                                         : put_image(w->from, w->first + i, out);
    if (out->error == ERR_OK && out->split.count > 0)
        out->name = out->split.name;
    else if (out->error == ERR_OK)
        out->name = digest_of(out->bytes.data, out->bytes.bytes);
}

static void add_left(struct package_left *sum, const struct package_left *left)
{
    for (int k = 0; k < PACKAGE_LEFT_COUNT; k++) {
        sum[k].count += left[k].count;
        sum[k].bytes += left[k].bytes;
    }
}

/* Threads are begun for more than they cost. */
#define SIDE_BY_SIDE_BYTES_MIN (UINT64_C(1) << 20)

static void pack_some(struct packing *w, size_t count)
{
    const struct scene *s = &w->from->scene;
    uint64_t bytes = 0;
    for (size_t i = w->first; i < w->first + count; i++)
        bytes += w->kind == PACKAGE_MESH ? package_mesh_bytes(&s->meshes[i])
                                         : package_image_bytes(&s->images[i]);
    if (bytes >= SIDE_BY_SIDE_BYTES_MIN)
        parallel_for(count, pack_one, w);
    for (size_t i = 0; bytes < SIDE_BY_SIDE_BYTES_MIN && i < count; i++)
        pack_one(w, i);
}

/* The chunks of one kind that are made, and of images the pieces beside them. */
struct shelf {
    struct chunk_set set, pieces;
};

static enum err take_pieces(struct trimmed *t, struct packed *c, uint64_t base_bytes,
                            struct shelf *to, struct package *p)
{
    struct pieced *out = &t->pieced[t->pieced_count++];
    *out = (struct pieced){.count = c->split.count, .picture = c->split.picture};
    if (c->split.count == 0)
        return ERR_OK;
    uint64_t bytes = base_bytes + CODEC_PIECED_BYTES + c->split.count * sizeof *out->numbers;
    out->numbers = mem_alloc_array(c->split.count, sizeof *out->numbers);
    if (!out->numbers)
        return ERR_NOMEM;
    for (size_t i = 0; i < c->split.count; i++) {
        struct split_piece *piece = &c->split.pieces[i];
        uint64_t piece_bytes = piece->bytes.bytes + CODEC_ENTRY_BYTES;
        bool is_new = chunk_set_add(&to->pieces, &piece->bytes, &piece->name, PACKAGE_PIECE,
                                    &out->numbers[i]);
        bytes += is_new ? piece_bytes : 0;
    }
    p->pieces_extra += (int64_t)bytes - (int64_t)c->whole_bytes;
    return ERR_OK;
}

/* In the scene's order, whoever was made first. */
static enum err take_packed(struct trimmed *t, struct packing *w, size_t count, struct shelf *to,
                            struct package *p)
{
    struct scene *s = &t->scene;
    for (size_t k = 0; k < count; k++) {
        struct packed *c = &w->chunks[k];
        size_t i = w->first + k;
        TL_TRY(c->error);
        add_left(p->left, c->left);
        bool mesh = w->kind == PACKAGE_MESH;
        uint64_t chunk_bytes = c->bytes.bytes;
        uint64_t bytes = mesh ? chunk_bytes : c->whole_bytes + CODEC_PIECES_BYTES;
        enum package_kind kind = c->split.count > 0 ? PACKAGE_BASE : w->kind;
        uint32_t *place = mesh ? &t->mesh_map[i] : &t->image_map[i];
        bool is_new = chunk_set_add(&to->set, &c->bytes, &c->name, kind, place);
        if (mesh && is_new)
            s->meshes[to->set.count - 1] = s->meshes[i];
        else if (is_new)
            TL_TRY(take_pieces(t, c, chunk_bytes, to, p));
        else
            leave_copy(p, bytes + (mesh ? CODEC_NAME_BYTES + strlen(s->meshes[i].name) : 0));
    }
    return ERR_OK;
}

/* Behind the others of the package. */
static enum err add_pieces(struct chunk_set *pieces, struct package *p)
{
    if (pieces->count == 0)
        return ERR_OK;
    struct package_chunk *all =
        mem_realloc_array(p->chunks, p->count + pieces->count, sizeof *p->chunks);
    if (!all)
        return ERR_NOMEM;
    memcpy(all + p->count, pieces->chunks, pieces->count * sizeof *all);
    p->chunks = all;
    p->count += pieces->count;
    pieces->count = 0;
    return ERR_OK;
}

/* So many pieces at most. */
static size_t pieces_max(const struct trimmed *t)
{
    size_t count = 0;
    for (size_t i = 0; t->split_bytes_min < UINT64_MAX && i < t->scene.image_count; i++)
        count += t->may_be_late[i] ? (size_t)pyramid_pieces_across(&t->scene.images[i]) *
                                         pyramid_pieces_down(&t->scene.images[i])
                                   : 0;
    return count;
}

static bool shelf_init(struct shelf *to, const struct trimmed *t, enum package_kind kind,
                       size_t count, struct package *p)
{
    size_t pieces = kind == PACKAGE_IMAGE ? pieces_max(t) : 0;
    struct package_chunk *room = mem_calloc(pieces, sizeof *room);
    bool set = chunk_set_init(&to->set, p->chunks + p->count, count);
    return chunk_set_init(&to->pieces, room, pieces) && set && room;
}

static void shelf_release(struct shelf *to)
{
    for (size_t i = 0; i < to->pieces.count; i++)
        mem_free(to->pieces.chunks[i].data);
    mem_free(to->pieces.chunks);
    mem_free(to->pieces.slots);
    mem_free(to->set.slots);
}

/* Chunks with the same bytes become one: who refers to them then shares its index. */
static enum err pack_all(struct trimmed *t, enum package_kind kind, size_t count, struct package *p)
{
    struct shelf to;
    struct packing *w = mem_calloc(1, sizeof *w);
    bool made = shelf_init(&to, t, kind, count, p);
    enum err e = w && made ? ERR_OK : ERR_NOMEM;
    for (size_t first = 0; e == ERR_OK && first < count; first += PACKED_MAX) {
        size_t some = count - first < PACKED_MAX ? count - first : PACKED_MAX;
        *w = (struct packing){.from = t, .kind = kind, .first = first};
        pack_some(w, some);
        e = take_packed(t, w, some, &to, p);
        for (size_t k = 0; k < some; k++) {
            buf_release(&w->chunks[k].bytes);
            package_split_release(&w->chunks[k].split);
        }
    }
    if (kind == PACKAGE_MESH)
        t->scene.mesh_count = to.set.count;
    else
        t->scene.image_count = to.set.count;
    p->count += to.set.count;
    if (e == ERR_OK)
        e = add_pieces(&to.pieces, p);
    shelf_release(&to);
    mem_free(w);
    return e;
}

static enum err put_meshes(struct trimmed *t, struct package *p)
{
    struct scene *s = &t->scene;
    TL_TRY(pack_all(t, PACKAGE_MESH, s->mesh_count, p));
    for (size_t i = 0; i < s->object_count; i++)
        renumber(&s->objects[i].mesh, t->mesh_map);
    return ERR_OK;
}

static enum err put_images(struct trimmed *t, struct package *p)
{
    struct scene *s = &t->scene;
    t->may_be_late = mem_calloc(s->image_count, sizeof *t->may_be_late);
    t->pieced = mem_calloc(s->image_count, sizeof *t->pieced);
    if (!t->may_be_late || !t->pieced)
        return ERR_NOMEM;
    package_late_may(s, t->may_be_late);
    TL_TRY(pack_all(t, PACKAGE_IMAGE, s->image_count, p));
    for (size_t i = 0; i < s->texture_count; i++)
        renumber(&s->textures[i].image, t->image_map);
    return ERR_OK;
}

static void put_pieced(struct codec *c, struct pieced *image)
{
    bool pieces = image->count > 0;
    codec_bool(c, &pieces);
    if (!pieces)
        return;
    codec_u32(c, &image->picture.width);
    codec_u32(c, &image->picture.height);
    codec_u32(c, &image->picture.channel_count);
    codec_enum(c, &image->picture.format, SCENE_IMAGE_U8_LINEAR);
    for (size_t i = 0; i < image->count; i++)
        codec_u32(c, &image->numbers[i]);
}

static enum err put_root(struct trimmed *t, struct package *p)
{
    t->scene.uvs_left_out |= p->left[PACKAGE_LEFT_UVS].count > 0;
    struct buf b;
    buf_init(&b);
    struct codec c = {.out = &b};
    struct scene *s = &t->scene;
    codec_magic(&c, "TLYR");
    buf_put_u32(&b, (uint32_t)s->mesh_count);
    buf_put_u32(&b, (uint32_t)s->image_count);
    buf_put_u32(&b, (uint32_t)(p->count - 1 - s->mesh_count - s->image_count));
    for (size_t i = 1; i < p->count; i++) {
        buf_put(&b, p->chunks[i].name.bytes, DIGEST_BYTES);
        buf_put_u64(&b, p->chunks[i].bytes);
    }
    for (size_t i = 0; i < s->mesh_count; i++)
        codec_name(&c, &s->meshes[i].name);
    for (size_t i = 0; i < s->image_count; i++)
        put_pieced(&c, &t->pieced[i]);
    codec_scene(&c, s);
    enum err e = codec_end(&c);
    if (e == ERR_OK) {
        digest name = digest_of(b.data, b.bytes);
        chunk_take(&p->chunks[0], &b, &name, PACKAGE_ROOT);
    }
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

/* Takes the plan. */
static enum err write_planned(const struct scene *scene, const struct scene_plan *plan,
                              uint64_t split_bytes_min, struct package *out)
{
    struct trimmed t = {.plan = *plan, .split_bytes_min = split_bytes_min};
    struct package p = {0};
    enum err e = ERR_NOMEM;
    if (trimmed_alloc(&t, scene)) {
        trim(&t, p.left);
        e = put_all(&t, &p);
    }
    trimmed_release(&t);
    if (e == ERR_OK)
        *out = p;
    else
        package_release(&p);
    return e;
}

enum err package_write_pieces(const struct scene *scene, uint32_t aov, uint64_t split_bytes_min,
                              struct package *out)
{
    struct scene_plan plan;
    TL_TRY(scene_plan_make(scene, aov, &plan));
    return write_planned(scene, &plan, split_bytes_min, out);
}

enum err package_write(const struct scene *scene, uint32_t aov, struct package *out)
{
    return package_write_pieces(scene, aov, PACKAGE_SPLIT_BYTES_MIN, out);
}

enum err package_write_whole(const struct scene *scene, struct package *out)
{
    struct scene_plan plan;
    TL_TRY(scene_plan_keep_all(scene, &plan));
    return write_planned(scene, &plan, UINT64_MAX, out);
}
