/* Pictures in pieces: a package of them, read as a worker reads it, gives a unit the bits of the
 * whole picture with the pieces alone that its paths meet; a worker that has all pieces has every
 * texel of every level. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/package_late.h"
#include "common/texel.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_late.h"

enum { SIDE = 32, SPP = 8 };

/* Noise, of which large areas differ. */
static uint32_t add_image(struct scene *s, uint32_t width, uint32_t height, uint32_t channels,
                          enum scene_image_format format)
{
    size_t texels = (size_t)width * height;
    bool f32 = format == SCENE_IMAGE_F32;
    void *pixels = mem_alloc_array(texels, channels * (f32 ? sizeof(float) : 1));
    uint32_t x = 7 + (uint32_t)s->image_count;
    assert_non_null(pixels);
    for (size_t i = 0; i < texels * channels; i++) {
        x = x * 1664525u + 1013904223u;
        uint32_t v = 64 + (x >> 25) + (uint32_t)(i / channels / width / 100 % 4) * 16;
        if (f32)
            ((float *)pixels)[i] = (float)v / 200;
        else
            ((unsigned char *)pixels)[i] = (unsigned char)v;
    }
    s->images = mem_realloc_array(s->images, s->image_count + 1, sizeof *s->images);
    s->images[s->image_count] = (struct scene_image){width, height, channels, format, pixels};
    return (uint32_t)s->image_count++;
}

/* A quad with texture coordinates; its material is a principled one. */
static struct scene_material *add_quad(struct scene *s, const double corners[12])
{
    static const float uvs[8] = {0, 0, 1, 0, 1, 1, 0, 1};
    struct scene_material *m;
    uint32_t material = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    uint32_t quad = kit_quad(s, corners, material);
    struct scene_mesh *mesh = &s->meshes[s->objects[quad].mesh];
    mesh->uvs = mem_alloc_array(8, sizeof *uvs);
    memcpy(mesh->uvs, uvs, sizeof uvs);
    return &s->materials[material];
}

/* A floor whose far end is seen from aslant, a wall in the distance, a bumpy one at the side, and
 * one behind the camera. */
static void make_scene(struct scene *s)
{
    static const double floor[12] = {-20, 0, 2, 20, 0, 2, 20, 0, -40, -20, 0, -40};
    static const double wall[12] = {-20, 0, -41, 20, 0, -41, 20, 20, -41, -20, 20, -41};
    static const double side[12] = {-4, 0, 1, -4, 0, -5, -4, 4, -5, -4, 4, 1};
    static const double behind[12] = {20, 0, 9, -20, 0, 9, -20, 20, 9, 20, 20, 9};
    scene_init(s);
    uint32_t image = add_image(s, 1536, 1024, 3, SCENE_IMAGE_U8_SRGB);
    add_quad(s, floor)->texture = kit_image_texture(s, image, SCENE_FILTER_MIPMAP);
    image = add_image(s, 1032, 520, 1, SCENE_IMAGE_U8_LINEAR);
    add_quad(s, wall)->texture = kit_image_texture(s, image, SCENE_FILTER_MIPMAP);
    image = add_image(s, 1024, 512, 3, SCENE_IMAGE_F32);
    struct scene_material *m = add_quad(s, side);
    m->bump_texture = kit_image_texture(s, image, SCENE_FILTER_BILINEAR);
    m->bump_scale = 0.01;
    m->roughness = 0.4;
    image = add_image(s, 1024, 1024, 3, SCENE_IMAGE_U8_SRGB);
    add_quad(s, behind)->texture = kit_image_texture(s, image, SCENE_FILTER_NEAREST);
    kit_emit(s, kit_sphere(s, 0, 15, -5, 1, kit_diffuse(s, 0, 0, 0)), 200, 200, 200);
    const double camera[3] = {0, 1.6, 0}, at[3] = {-1, 1.2, -4};
    memcpy(s->camera.position, camera, sizeof camera);
    memcpy(s->camera.look_at, at, sizeof at);
    scene_check(s);
}

/* A package, and the scene that a worker builds of it without what comes late. */
struct rig {
    struct package package;
    struct package_index index;
    struct render_scene *rs;
};

static const struct package_chunk *chunk_of(const struct package *p, const digest *name)
{
    for (size_t i = 0; i < p->count; i++)
        if (digest_equal(&p->chunks[i].name, name))
            return &p->chunks[i];
    return NULL;
}

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    const struct package_chunk *chunk = chunk_of(ctx, &entry->name);
    (void)i;
    assert_non_null(chunk);
    *data = chunk->data;
    *bytes = chunk->bytes;
    return ERR_OK;
}

static void rig_init(struct rig *r, const struct scene *s, const struct job_spec *spec)
{
    struct scene tables, scene;
    bool *late;
    struct late_chunk *chunks;
    assert_int_equal(package_write_pieces(s, spec->aov, 1, &r->package), ERR_OK);
    const struct package_chunk *root = &r->package.chunks[0];
    assert_int_equal(package_tables_read(root->data, root->bytes, &tables, &r->index), ERR_OK);
    late = mem_calloc(r->index.count, sizeof *late);
    chunks = mem_calloc(tables.image_count, sizeof *chunks);
    assert_true(late && chunks);
    assert_int_equal(package_late_choose(&tables, &r->index, late), s->image_count);
    for (size_t i = 0; i < tables.image_count; i++) {
        const struct package_index_entry *e = &r->index.entries[tables.mesh_count + i];
        assert_int_equal(e->kind, PACKAGE_BASE);
        chunks[i] = (struct late_chunk){.late = true,
                                        .name = e->name,
                                        .bytes = e->bytes,
                                        .pieces = r->index.pieces[i],
                                        .entries = r->index.entries};
    }
    assert_int_equal(
        package_read_parts(root->data, root->bytes, NULL, late, fetch, &r->package, &scene),
        ERR_OK);
    struct scene_building how = {.late = chunks};
    assert_int_equal(scene_build_as(&scene, spec, &how, &r->rs), ERR_OK);
    scene_release(&scene);
    scene_release(&tables);
    mem_free(chunks);
    mem_free(late);
}

static void rig_release(struct rig *r)
{
    render_scene_free(r->rs);
    package_index_release(&r->index);
    package_release(&r->package);
}

static void bring(struct rig *r, uint32_t number)
{
    struct picture_need need;
    struct picture *picture;
    size_t before = render_scene_late_count(r->rs);
    assert_true(render_scene_need(r->rs, number, &need));
    const struct package_chunk *chunk = chunk_of(&r->package, &need.name);
    assert_int_equal(picture_read(&need, chunk->data, chunk->bytes, &picture), ERR_OK);
    render_scene_put(r->rs, number, picture);
    assert_false(render_scene_need(r->rs, number, &need));
    assert_int_equal(render_scene_late_count(r->rs), before - 1);
}

static void pieces_that_are_met_make_the_same_bits(void **state)
{
    (void)state;
    struct scene s;
    struct rig r;
    struct grid grid;
    struct render_scratch *scratch;
    struct render_scene *eager;
    struct render_counters counters, same;
    struct job_spec spec = kit_spec(SIDE, SPP);
    make_scene(&s);
    rig_init(&r, &s, &spec);
    assert_int_equal(scene_build(&s, &spec, NULL, &eager), ERR_OK);
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    assert_int_equal(render_scratch_new(&scratch), ERR_OK);
    struct unit unit = {.cell_count = grid.cell_count};
    size_t values = grid.plane_count * (size_t)grid_pixels(&grid, 0, grid.cell_count);
    float *whole = mem_alloc_array(values, sizeof *whole),
          *out = mem_alloc_array(values, sizeof *out);
    assert_true(whole && out);
    assert_int_equal(render_unit(eager, &grid, unit, scratch, NULL, whole, &same), ERR_OK);

    uint32_t runs = 0;
    size_t all = render_scene_late_count(r.rs);
    enum err e;
    while ((e = render_unit(r.rs, &grid, unit, scratch, NULL, out, &counters)) == ERR_NOT_FOUND) {
        const uint32_t *lacks;
        uint32_t copy[RENDER_LACKS_MAX];
        size_t count = render_lacks(scratch, &lacks);
        memcpy(copy, lacks, count * sizeof *copy);
        for (size_t i = 0; i < count; i++)
            bring(&r, copy[i]);
        assert_true(++runs <= 4);
    }
    assert_int_equal(e, ERR_OK);
    assert_memory_equal(out, whole, values * sizeof *out);
    assert_memory_equal(&counters, &same, sizeof same);
    /* Of the picture behind the camera, which only light from the lamp could show, and of what the
     * distance blurs, there is much that nothing asked for. */
    size_t left = render_scene_late_count(r.rs);
    printf("%zu of %zu pieces and bases were not met, in %u runs\n", left, all, runs);
    assert_true(left >= 4);
    mem_free(whole);
    mem_free(out);
    render_scratch_free(scratch);
    grid_release(&grid);
    render_scene_free(eager);
    rig_release(&r);
    scene_release(&s);
}

/* All levels, of what is in pieces and of what is not. */
static void compare_image(const struct texture_image *a, const struct texture_image *b)
{
    assert_int_equal(a->level_count, b->level_count);
    assert_int_equal(a->piece_levels, a->level_count > 1 ? PYRAMID_PIECE_LEVELS : 1);
    assert_int_equal(b->piece_levels, 0);
    for (uint32_t l = 0; l < a->level_count; l++) {
        const struct texture_level *at = &a->levels[l], *there = &b->levels[l];
        unsigned shift = PYRAMID_PIECE_SHIFT - l;
        assert_true(at->width == there->width && at->height == there->height);
        for (uint32_t y = 0; y < at->height; y++) {
            for (uint32_t x = 0; x < at->width; x++) {
                double c[4] = {0}, d[4] = {0};
                texture_texel(b, there, x, y, d);
                if (l < a->piece_levels) {
                    const void *texels = a->pieces[(y >> shift) * a->pieces_across + (x >> shift)];
                    texel_get(a->format, a->channel_count, texels, texture_piece_place(l, x, y), c);
                } else {
                    texture_texel(a, at, x, y, c);
                }
                if (memcmp(c, d, sizeof c) != 0)
                    fail_msg("level %u: another texel at %u, %u", l, x, y);
            }
        }
    }
}

static void all_pieces_make_every_texel(void **state)
{
    (void)state;
    struct scene s;
    struct rig r;
    struct render_scene *eager;
    struct job_spec spec = kit_spec(SIDE, SPP);
    make_scene(&s);
    rig_init(&r, &s, &spec);
    assert_int_equal(scene_build(&s, &spec, NULL, &eager), ERR_OK);
    struct picture_need need;
    for (uint32_t i = 0; i < render_scene_late_end(r.rs); i++)
        if (render_scene_need(r.rs, i, &need))
            bring(&r, i);
    assert_int_equal(render_scene_late_count(r.rs), 0);
    for (size_t i = 0; i < s.image_count; i++)
        compare_image(&r.rs->images[i], &eager->images[i]);
    render_scene_free(eager);
    rig_release(&r);
    scene_release(&s);
}

/* Another chunk than the one that is needed, and one that is cut short. */
static void other_chunks_are_refused(void **state)
{
    (void)state;
    struct scene s;
    struct rig r;
    struct picture_need base, piece, narrow;
    struct picture *picture = NULL;
    struct job_spec spec = kit_spec(SIDE, SPP);
    make_scene(&s);
    rig_init(&r, &s, &spec);
    uint32_t first = r.rs->images[1].first_number; /* 1032 x 520: three pieces across, two down */
    assert_true(render_scene_need(r.rs, 1, &base));
    assert_true(render_scene_need(r.rs, first, &piece));
    assert_true(render_scene_need(r.rs, first + 2, &narrow));
    assert_true(narrow.is.width == 8 && narrow.is.height == 512);
    const struct picture_need *needs[] = {&base, &piece, &narrow};
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            const struct package_chunk *chunk = chunk_of(&r.package, &needs[k]->name);
            struct picture_need as = *needs[i];
            as.bytes = chunk->bytes;
            enum err e = picture_read(&as, chunk->data, chunk->bytes, &picture);
            assert_int_equal(e, i == k ? ERR_OK : ERR_CORRUPT);
            if (i == k)
                picture_free(picture);
            as.bytes--;
            assert_int_equal(picture_read(&as, chunk->data, chunk->bytes - 1, &picture),
                             ERR_CORRUPT);
        }
    }
    assert_false(render_scene_need(r.rs, (uint32_t)render_scene_late_end(r.rs), &base));
    rig_release(&r);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pieces_that_are_met_make_the_same_bits),
        cmocka_unit_test(all_pieces_make_every_texel),
        cmocka_unit_test(other_chunks_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
