/* Random scenes: a package read back and packed again has the same names, every chunk survives
 * zstd, and a chunk that is swapped for another is noticed.
 *
 * The seed is printed; prop_package SEED repeats it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/mem.h"
#include "common/package.h"

enum { ROUNDS = 300, COUNT_MAX = 12 };

static uint64_t state;

static uint32_t draw(uint32_t below)
{
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return below ? (uint32_t)((state >> 33) % below) : 0;
}

static double draw_number(void)
{
    double v = draw(1u << 30) / (double)(1u << 30);
    return draw(2) ? (double)(float)v : v * 1e6;
}

static uint32_t draw_index(size_t count)
{
    return count == 0 || draw(4) == 0 ? SCENE_NONE : draw((uint32_t)count);
}

static void *new_items(size_t count, size_t bytes)
{
    void *items = mem_calloc(count, bytes);
    TL_ASSERT(items);
    return items;
}

static void make_mesh(struct scene_mesh *m)
{
    *m = (struct scene_mesh){.vertex_count = 3 + draw(20), .triangle_count = 1 + draw(30)};
    m->name = mem_sprintf("mesh %u", draw(5));
    m->positions = new_items(m->vertex_count, 3 * sizeof(double));
    m->indices = new_items(m->triangle_count, 3 * sizeof(uint32_t));
    m->normals = draw(2) ? new_items(m->vertex_count, 3 * sizeof(float)) : NULL;
    m->uvs = draw(2) ? new_items(m->vertex_count, 2 * sizeof(float)) : NULL;
    m->colors = draw(2) ? new_items(m->vertex_count, 3 * sizeof(float)) : NULL;
    for (size_t i = 0; m->colors && i < (size_t)m->vertex_count * 3; i++)
        m->colors[i] = (float)draw(256) / 255;
    m->alphas = draw(2) ? new_items(m->vertex_count, sizeof(float)) : NULL;
    for (size_t i = 0; m->alphas && i < m->vertex_count; i++)
        m->alphas[i] = (float)draw(256) / 255;
    bool plain = draw(3) == 0; /* equal meshes must share a chunk */
    for (size_t i = 0; i < (size_t)m->vertex_count * 3; i++)
        m->positions[i] = plain ? 1 : draw_number();
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++)
        m->indices[i] = plain ? 0 : draw(m->vertex_count);
}

/* Small, or such that a picture can be in pieces, now and then in two a row. */
static uint32_t draw_side(void)
{
    return draw(2) ? 1 + draw(9) : 8 * (1 + draw(draw(8) ? 3 : 70));
}

static void make_image(struct scene_image *image)
{
    static const uint32_t channels[] = {1, 3, 4};
    *image = (struct scene_image){.width = draw_side(), .height = draw_side()};
    image->channel_count = channels[draw(3)];
    image->format = (enum scene_image_format)draw(3);
    size_t samples = (size_t)image->width * image->height * image->channel_count;
    image->pixels = new_items(samples, image->format == SCENE_IMAGE_F32 ? sizeof(float) : 1);
    if (image->format == SCENE_IMAGE_F32)
        ((float *)image->pixels)[draw((uint32_t)samples)] = (float)draw_number();
}

static void make_texture(const struct scene *s, struct scene_texture *t, size_t i)
{
    scene_texture_init(t);
    t->name = mem_sprintf("t%zu", i);
    t->type = (enum scene_texture_type)draw(s->image_count ? 3 : 2);
    if (t->type == SCENE_TEXTURE_IMAGE)
        t->image = draw((uint32_t)s->image_count);
    t->color[1][2] = draw_number();
    t->wrap[1] = (enum scene_wrap)draw(3);
    t->filter = (enum scene_texture_filter)draw(3);
}

static void make_material(const struct scene *s, struct scene_material *m, size_t i)
{
    scene_material_init(m);
    m->name = mem_sprintf("m%zu", i);
    m->type = (enum scene_material_type)draw(SCENE_MATERIAL_BLACK + 1);
    m->texture = draw_index(s->texture_count);
    m->normal_texture = draw_index(s->texture_count);
    m->bump_texture = draw_index(s->texture_count);
    m->bump_scale = draw_number();
    m->emission_texture = draw_index(s->texture_count);
    m->twosided = draw(2);
    m->vertex_colors = draw(2);
    m->emission_vertex_colors = draw(2);
    m->emission_twosided = draw(2);
    m->backface_culling = draw(2);
    m->k[1] = draw_number();
}

static void make_object(const struct scene *s, struct scene_object *o)
{
    scene_object_init(o);
    o->type = s->mesh_count && draw(2) ? SCENE_OBJECT_MESH : SCENE_OBJECT_SPHERE;
    if (o->type == SCENE_OBJECT_MESH)
        o->mesh = draw((uint32_t)s->mesh_count);
    o->material = draw_index(s->material_count);
    o->emits = draw(2);
    o->transform[3] = draw_number();
    o->center[1] = draw_number();
}

static void make_scene(struct scene *s)
{
    scene_init(s);
    size_t meshes = draw(COUNT_MAX), images = draw(COUNT_MAX), textures = draw(COUNT_MAX);
    size_t materials = draw(COUNT_MAX), objects = draw(COUNT_MAX);
    s->meshes = new_items(meshes, sizeof *s->meshes);
    s->images = new_items(images, sizeof *s->images);
    s->textures = new_items(textures, sizeof *s->textures);
    s->materials = new_items(materials, sizeof *s->materials);
    s->objects = new_items(objects, sizeof *s->objects);
    for (; s->mesh_count < meshes; s->mesh_count++)
        make_mesh(&s->meshes[s->mesh_count]);
    for (; s->image_count < images; s->image_count++)
        make_image(&s->images[s->image_count]);
    for (; s->texture_count < textures; s->texture_count++)
        make_texture(s, &s->textures[s->texture_count], s->texture_count);
    for (; s->material_count < materials; s->material_count++)
        make_material(s, &s->materials[s->material_count], s->material_count);
    for (; s->object_count < objects; s->object_count++)
        make_object(s, &s->objects[s->object_count]);
    s->envmap.texture = draw_index(s->texture_count);
    scene_check(s);
}

/* Gives the chunks of a package, after a trip through zstd. */
struct supply {
    const struct package *package;
    struct buf plain;
    size_t swapped; /* this one gives the bytes of the one after it; SIZE_MAX: none */
};

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    struct supply *s = ctx;
    struct buf frame;
    const struct package_chunk *chunk = &s->package->chunks[1 + i + (i == s->swapped)];
    TL_ASSERT(i == s->swapped || digest_equal(&entry->name, &chunk->name));
    buf_init(&frame);
    buf_clear(&s->plain);
    TL_TRY(chunk_compress(chunk->data, chunk->bytes, &frame));
    TL_TRY(chunk_decompress(frame.data, frame.bytes, &chunk->name, chunk->bytes, &s->plain));
    buf_release(&frame);
    *data = s->plain.data;
    *bytes = s->plain.bytes;
    return ERR_OK;
}

static void check_swap(const struct package *p, struct supply *supply)
{
    struct scene s;
    if (p->count < 3)
        return;
    supply->swapped = draw((uint32_t)p->count - 2);
    enum err e = package_read(p->chunks[0].data, p->chunks[0].bytes, fetch, supply, &s);
    if (e == ERR_OK) { /* of one kind and size: only the name tells, which the fetcher checks */
        TL_ASSERT(scene_valid(&s));
        scene_release(&s);
    }
    supply->swapped = SIZE_MAX;
}

static void run_round(void)
{
    struct scene s, back;
    struct package p, again;
    make_scene(&s);
    uint64_t split_bytes_min = draw(2) ? 0 : UINT64_MAX;
    TL_ASSERT(package_write_pieces(&s, 0, split_bytes_min, &p) == ERR_OK);
    struct supply supply = {.package = &p, .swapped = SIZE_MAX};
    TL_ASSERT(package_read(p.chunks[0].data, p.chunks[0].bytes, fetch, &supply, &back) == ERR_OK);
    TL_ASSERT(back.object_count == s.object_count && back.mesh_count <= s.mesh_count);
    for (size_t i = 0; i < s.object_count; i++) {
        const struct scene_object *a = &s.objects[i], *b = &back.objects[i];
        TL_ASSERT((a->material == SCENE_NONE) == (b->material == SCENE_NONE));
        TL_ASSERT(a->material == SCENE_NONE ||
                  strcmp(s.materials[a->material].name, back.materials[b->material].name) == 0);
        TL_ASSERT(a->type == SCENE_OBJECT_SPHERE ||
                  s.meshes[a->mesh].triangle_count == back.meshes[b->mesh].triangle_count);
    }
    TL_ASSERT(package_write_pieces(&back, 0, split_bytes_min, &again) == ERR_OK &&
              again.count == p.count);
    for (size_t i = 0; i < p.count; i++)
        TL_ASSERT(digest_equal(&p.chunks[i].name, &again.chunks[i].name));
    check_swap(&p, &supply);
    buf_release(&supply.plain);
    package_release(&p);
    package_release(&again);
    scene_release(&back);
    scene_release(&s);
}

int main(int argc, char **argv)
{
    uint64_t seed = argc > 1 ? strtoull(argv[1], NULL, 10) : (uint64_t)time(NULL);
    printf("seed %llu\n", (unsigned long long)seed);
    (void)fflush(stdout);
    state = seed;
    for (int i = 0; i < ROUNDS; i++)
        run_round();
    printf("%d scenes packed and read back\n", (int)ROUNDS);
    return 0;
}
