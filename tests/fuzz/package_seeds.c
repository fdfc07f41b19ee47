/* package_seeds FOLDER [--write]: the seeds of fuzz_package and fuzz_chunk, of today's packages.
 *
 * Without --write: each must be in FOLDER as it would be written now, so that a new version of the
 * package does not leave the fuzzers at its version number. Exit 1: one is missing or stale. */
#include <stdio.h>
#include <string.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/package.h"
#include "tests/unit/made_scene.h"

static struct {
    const char *folder;
    bool write;
    int stale;
} seeds;

static void put(const char *target, const char *name, const struct buf *seed)
{
    char *path = mem_sprintf("%s/%s/%s", seeds.folder, target, name), *found = NULL;
    size_t bytes = 0;
    TL_ASSERT(path && seed->bytes > 0 && buf_status(seed) == ERR_OK);
    bool there = file_read(path, SIZE_MAX / 2, &found, &bytes) == ERR_OK && bytes == seed->bytes &&
                 memcmp(found, seed->data, bytes) == 0;
    mem_free(found);
    if (!there && seeds.write) {
        TL_ASSERT(file_write(path, seed->data, seed->bytes) == ERR_OK);
    } else if (!there) {
        (void)fprintf(stderr, "%s: missing or stale; run package_seeds %s --write\n", path,
                      seeds.folder);
        seeds.stale++;
    }
    mem_free(path);
}

static const struct package_chunk *chunk_of(const struct package *p, const digest *name)
{
    for (size_t i = 0; i < p->count; i++)
        if (digest_equal(&p->chunks[i].name, name))
            return &p->chunks[i];
    TL_ASSERT(false);
    return NULL;
}

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    const struct package_chunk *chunk = chunk_of(ctx, &entry->name);
    (void)i;
    *data = chunk->data;
    *bytes = chunk->bytes;
    return ERR_OK;
}

/* fuzz_package: the length of the root, the root, and the chunks in the order of its list. */
static void put_package(const struct package *p, const char *name)
{
    const struct package_chunk *root = &p->chunks[0];
    struct package_index index;
    struct scene back;
    struct buf seed;
    TL_ASSERT(package_read(root->data, root->bytes, fetch, (void *)p, &back) == ERR_OK);
    scene_release(&back);
    TL_ASSERT(package_root_read(root->data, root->bytes, &index) == ERR_OK);
    buf_init(&seed);
    buf_put_u32(&seed, (uint32_t)root->bytes);
    buf_put(&seed, root->data, root->bytes);
    for (size_t i = 0; i < index.count; i++) {
        const struct package_chunk *chunk = chunk_of(p, &index.entries[i].name);
        buf_put(&seed, chunk->data, chunk->bytes);
    }
    put("fuzz_package", name, &seed);
    package_index_release(&index);
    buf_release(&seed);
}

/* fuzz_chunk: 1 and a chunk, or 0 and its frame. */
static void put_chunk(const struct package_chunk *chunk, const char *name, bool frame)
{
    struct buf seed;
    buf_init(&seed);
    buf_put_u8(&seed, !frame);
    if (frame)
        TL_ASSERT(chunk_compress(chunk->data, chunk->bytes, &seed) == ERR_OK);
    else
        buf_put(&seed, chunk->data, chunk->bytes);
    put("fuzz_chunk", name, &seed);
    buf_release(&seed);
}

/* Everything that a mesh and a picture can have. */
static void enrich(struct scene *s)
{
    struct scene_mesh *m = &s->meshes[1];
    m->uvs = mem_calloc(6, sizeof *m->uvs);
    m->colors = mem_calloc(9, sizeof *m->colors);
    m->alphas = mem_calloc(3, sizeof *m->alphas);
    TL_ASSERT(m->uvs && m->colors && m->alphas);
    m->uvs[2] = m->uvs[5] = m->colors[4] = m->alphas[1] = 1;
    struct scene_image *image = &s->images[1];
    image->format = SCENE_IMAGE_F32;
    mem_free(image->pixels);
    float *pixels = mem_calloc(6, sizeof *pixels);
    TL_ASSERT(pixels);
    pixels[0] = 2;
    pixels[4] = 0.5f;
    image->pixels = pixels;
    s->materials[2].type = SCENE_MATERIAL_PRINCIPLED;
    s->materials[2].vertex_colors = s->materials[2].alpha_used = true;
    s->materials[2].emission_texture = 2;
    s->materials[2].bump_texture = 0;
    s->objects[2].material = 1;
    s->camera.type = SCENE_CAMERA_PANORAMA;
    s->uvs_left_out = false;
    scene_check(s);
}

static void put_both(const struct package_chunk *chunk, size_t number)
{
    static const char *const kinds[] = {"root", "mesh", "image", "base", "piece"};
    char name[32];
    (void)snprintf(name, sizeof name, "%s_%zu", kinds[chunk->kind], number);
    put_chunk(chunk, name, false);
    (void)snprintf(name, sizeof name, "%s_%zu.zst", kinds[chunk->kind], number);
    put_chunk(chunk, name, true);
}

/* A picture of two pieces, which may come late. */
static void cut(struct scene *s)
{
    struct scene_image *image = &s->images[0];
    mem_free(image->pixels);
    *image = (struct scene_image){520, 8, 1, SCENE_IMAGE_U8_LINEAR, mem_calloc(520, 8)};
    TL_ASSERT(image->pixels);
    for (size_t i = 0; i < (size_t)520 * 8; i++)
        ((unsigned char *)image->pixels)[i] = (unsigned char)(i % 64);
    for (size_t i = 0; i < s->material_count; i++) {
        s->materials[i].emission_texture = SCENE_NONE;
        s->materials[i].alpha_used = false;
    }
    s->envmap.texture = SCENE_NONE;
    scene_check(s);
}

int main(int argc, char **argv)
{
    if (argc < 2 || argc > 3 || (argc == 3 && strcmp(argv[2], "--write") != 0)) {
        (void)fprintf(stderr, "usage: package_seeds FOLDER [--write]\n");
        return 2;
    }
    seeds.folder = argv[1];
    seeds.write = argc == 3;
    struct scene s;
    struct package trimmed, whole;
    made_scene(&s);
    TL_ASSERT(package_write(&s, 0, &trimmed) == ERR_OK);
    enrich(&s);
    TL_ASSERT(package_write_whole(&s, &whole) == ERR_OK);
    put_package(&trimmed, "trimmed");
    put_package(&whole, "whole");
    for (size_t i = 0; i < whole.count; i++)
        put_both(&whole.chunks[i], i);
    struct package pieces;
    cut(&s);
    TL_ASSERT(package_write_pieces(&s, 0, 1, &pieces) == ERR_OK && pieces.pieces_extra > 0);
    put_package(&pieces, "pieces");
    for (size_t i = 0; i < pieces.count; i++)
        if (pieces.chunks[i].kind != PACKAGE_MESH)
            put_both(&pieces.chunks[i], whole.count + i);
    package_release(&pieces);
    package_release(&whole);
    package_release(&trimmed);
    scene_release(&s);
    return seeds.stale > 0;
}
