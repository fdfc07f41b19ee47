/* Packages: round trip, sharing, what is left out, hostile bytes; chunks through zstd. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <string.h>

#include "common/mem.h"
#include "common/package.h"
#include "tests/unit/made_scene.h"

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    const struct package *p = ctx;
    assert_true(digest_equal(&entry->name, &p->chunks[1 + i].name));
    *data = p->chunks[1 + i].data;
    *bytes = p->chunks[1 + i].bytes;
    return ERR_OK;
}

/* What is sent again after an edit: the chunks whose names were not there before. */
static size_t new_chunks(const struct package *before, const struct package *after)
{
    size_t count = 0;
    for (size_t i = 0; i < after->count; i++) {
        bool known = false;
        for (size_t k = 0; k < before->count; k++)
            known |= digest_equal(&after->chunks[i].name, &before->chunks[k].name);
        count += !known;
    }
    return count;
}

static void edits_send_what_changed(void **state)
{
    (void)state;
    struct scene s;
    struct package before, after;
    made_scene(&s);
    assert_int_equal(package_write(&s, 0, &before), ERR_OK);
    s.materials[2].color[0] = 0.25;
    assert_int_equal(package_write(&s, 0, &after), ERR_OK);
    assert_int_equal(new_chunks(&before, &after), 1); /* the root */
    assert_true(after.chunks[0].bytes < 4096);
    package_release(&after);
    s.meshes[1].positions[3] = 9;
    assert_int_equal(package_write(&s, 0, &after), ERR_OK);
    assert_int_equal(new_chunks(&before, &after), 2); /* and the mesh */
    package_release(&after);
    package_release(&before);
    scene_release(&s);
}

static void a_scene_comes_back_trimmed(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p, again;
    made_scene(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(p.count, 1 + 2 + 1); /* root, two distinct meshes, one used image */
    assert_int_equal(package_read(p.chunks[0].data, p.chunks[0].bytes, fetch, &p, &back), ERR_OK);
    assert_int_equal(back.mesh_count, 2);
    assert_int_equal(back.texture_count, 2);
    assert_int_equal(back.material_count, 1);
    assert_int_equal(back.object_count, 4);
    assert_int_equal(back.objects[0].mesh, back.objects[2].mesh);
    assert_string_equal(back.materials[back.objects[1].material].name, "m2");
    assert_string_equal(back.textures[back.materials[0].texture].name, "t1");
    assert_int_equal(((unsigned char *)back.images[0].pixels)[0], 10);
    assert_true(back.meshes[1].positions[3] == 1.1); /* not a float: kept in double */
    assert_true(back.lights[0].intensity[2] == 3);
    /* The same scene gives the same names, wherever it was read from. */
    assert_int_equal(package_write(&back, 0, &again), ERR_OK);
    assert_true(digest_equal(&p.chunks[0].name, &again.chunks[0].name));
    package_release(&again);
    package_release(&p);
    scene_release(&back);
    scene_release(&s);
}

/* Chunks that were decoded before are taken as they are; the others are fetched. */
static void parts_need_no_fetch(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p, again;
    struct package_index index;
    struct package_part parts[3] = {{0}};
    made_scene(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    const struct package_chunk *root = &p.chunks[0];
    assert_int_equal(package_root_read(root->data, root->bytes, &index), ERR_OK);
    assert_int_equal(index.count, 3);
    for (size_t left_out = 0; left_out < 3; left_out++) {
        for (size_t i = 0; i < 3; i++)
            if (i != left_out)
                assert_int_equal(package_part_get(index.entries[i].kind, p.chunks[i + 1].data,
                                                  p.chunks[i + 1].bytes, &parts[i]),
                                 ERR_OK);
        struct package one = p; /* without the contents of the two that are there */
        struct package_chunk chunks[4];
        memcpy(chunks, p.chunks, sizeof chunks);
        for (size_t i = 0; i < 3; i++)
            if (i != left_out)
                chunks[i + 1].bytes = 0;
        one.chunks = chunks;
        assert_int_equal(
            package_read_parts(root->data, root->bytes, parts, NULL, fetch, &one, &back), ERR_OK);
        for (size_t i = 0; i < 3; i++)
            assert_false(parts[i].there);
        assert_int_equal(package_write(&back, 0, &again), ERR_OK);
        assert_true(digest_equal(&root->name, &again.chunks[0].name));
        package_release(&again);
        scene_release(&back);
    }
    assert_int_not_equal(
        package_part_get(PACKAGE_MESH, p.chunks[1].data, p.chunks[1].bytes - 1, &parts[0]), ERR_OK);
    assert_false(parts[0].there);
    package_index_release(&index);
    package_release(&p);
    scene_release(&s);
}

static void the_index_lists_what_is_needed(void **state)
{
    (void)state;
    struct scene s;
    struct package p;
    struct package_index index;
    made_scene(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(package_root_read(p.chunks[0].data, p.chunks[0].bytes, &index), ERR_OK);
    assert_int_equal(index.count, p.count - 1);
    for (size_t i = 0; i < index.count; i++) {
        assert_true(digest_equal(&index.entries[i].name, &p.chunks[1 + i].name));
        assert_int_equal(index.entries[i].bytes, p.chunks[1 + i].bytes);
        assert_int_equal(index.entries[i].kind, p.chunks[1 + i].kind);
    }
    package_index_release(&index);
    package_release(&p);
    scene_release(&s);
}

/* Cut anywhere, or with any bit of root or chunk turned, a package is refused or a valid scene. */
static void hostile_bytes_never_pass_unseen(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p;
    struct package_index index;
    made_scene(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    struct package_chunk *root = &p.chunks[0];
    for (size_t cut = 0; cut < root->bytes; cut++)
        assert_int_equal(package_root_read(root->data, cut, &index), ERR_CORRUPT);
    for (size_t bit = 0; bit < 8 * root->bytes; bit += 3) {
        root->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        if (package_root_read(root->data, root->bytes, &index) == ERR_OK)
            package_index_release(&index);
        root->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
    }
    struct package_chunk *mesh = &p.chunks[1];
    for (size_t bit = 0; bit < 8 * mesh->bytes; bit++) {
        mesh->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        if (package_read(root->data, root->bytes, fetch, &p, &back) == ERR_OK) {
            scene_check(&back);
            scene_release(&back);
        }
        mesh->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
    }
    package_release(&p);
    scene_release(&s);
}

static void memory_runs_out_cleanly(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p;
    made_scene(&s);
    enum err e = ERR_NOMEM;
    for (uint64_t n = 0; e != ERR_OK; n++) {
        mem_fail_after(n);
        e = package_write(&s, 0, &p);
        mem_fail_after(UINT64_MAX);
        assert_true(e == ERR_OK || e == ERR_NOMEM);
    }
    e = ERR_NOMEM;
    for (uint64_t n = 0; e != ERR_OK; n++) {
        mem_fail_after(n);
        e = package_read(p.chunks[0].data, p.chunks[0].bytes, fetch, &p, &back);
        mem_fail_after(UINT64_MAX);
        /* A master without memory once told people that their package was damaged. */
        assert_true(e == ERR_OK || e == ERR_NOMEM);
    }
    scene_release(&back);
    package_release(&p);
    scene_release(&s);
}

static void chunks_survive_zstd_and_nothing_else_does(void **state)
{
    (void)state;
    enum { BYTES = 700000 };
    unsigned char *data = mem_alloc(BYTES);
    struct buf frame, out;
    assert_non_null(data);
    for (size_t i = 0; i < BYTES; i++)
        data[i] = (unsigned char)(i * i >> 9);
    digest name = digest_of(data, BYTES), wrong = digest_of(data, BYTES - 1);
    buf_init(&frame);
    buf_init(&out);
    assert_int_equal(chunk_compress(data, BYTES, &frame), ERR_OK);
    assert_true(frame.bytes < BYTES);
    buf_put(&out, "kept", 4);
    assert_int_equal(chunk_decompress(frame.data, frame.bytes, &name, BYTES, &out), ERR_OK);
    assert_int_equal(out.bytes, 4 + BYTES);
    assert_memory_equal(out.data + 4, data, BYTES);
    out.bytes = 4;
    assert_int_equal(chunk_decompress(frame.data, frame.bytes, &wrong, BYTES, &out), ERR_CORRUPT);
    assert_int_equal(chunk_decompress(frame.data, frame.bytes, &name, BYTES - 1, &out), ERR_LIMIT);
    assert_int_equal(chunk_decompress(frame.data, frame.bytes, &name, BYTES + 1, &out),
                     ERR_CORRUPT);
    assert_int_equal(chunk_decompress(frame.data, frame.bytes - 1, &name, BYTES, &out),
                     ERR_CORRUPT);
    assert_int_equal(chunk_decompress(frame.data, 0, &name, BYTES, &out), ERR_CORRUPT);
    buf_put_u8(&frame, 0);
    assert_int_equal(chunk_decompress(frame.data, frame.bytes, &name, BYTES, &out), ERR_CORRUPT);
    frame.data[frame.bytes / 2] ^= 1;
    assert_int_equal(chunk_decompress(frame.data, frame.bytes - 1, &name, BYTES, &out),
                     ERR_CORRUPT);
    assert_int_equal(out.bytes, 4);
    assert_memory_equal(out.data, "kept", 4);
    buf_release(&frame);
    buf_release(&out);
    mem_free(data);
}

/* With and without the plain bytes, the same judgement. */
static enum err judge(const void *frame, size_t frame_bytes, const digest *name, uint64_t bytes_max)
{
    struct buf out;
    uint64_t bytes = 0;
    buf_init(&out);
    enum err e = chunk_decompress_any(frame, frame_bytes, name, bytes_max, &out);
    assert_int_equal(chunk_check(frame, frame_bytes, name, bytes_max, &bytes), e);
    assert_int_equal(bytes, e == ERR_OK ? out.bytes : 0);
    buf_release(&out);
    return e;
}

static void frames_are_judged_without_their_bytes(void **state)
{
    (void)state;
    enum { BYTES = 700000, RUN = 100 };
    unsigned char *data = mem_alloc(BYTES);
    struct buf frame;
    assert_non_null(data);
    for (size_t i = 0; i < BYTES; i++)
        data[i] = (unsigned char)(i * i >> 9);
    digest name = digest_of(data, BYTES), wrong = digest_of(data, BYTES - 1);
    buf_init(&frame);
    assert_int_equal(chunk_compress(data, BYTES, &frame), ERR_OK);
    assert_int_equal(judge(frame.data, frame.bytes, &name, BYTES), ERR_OK);
    assert_int_equal(judge(frame.data, frame.bytes, &name, BYTES - 1), ERR_LIMIT);
    assert_int_equal(judge(frame.data, frame.bytes, &wrong, BYTES), ERR_CORRUPT);
    for (size_t cut = 0; cut < frame.bytes; cut += 1 + frame.bytes / 50)
        assert_int_equal(judge(frame.data, cut, &name, BYTES), ERR_CORRUPT);
    for (size_t at = 0; at < frame.bytes; at += 1 + frame.bytes / 50) {
        frame.data[at] ^= 0x10;
        assert_int_not_equal(judge(frame.data, frame.bytes, &name, BYTES), ERR_OK);
        frame.data[at] ^= 0x10;
    }
    buf_put_u8(&frame, 0);
    assert_int_equal(judge(frame.data, frame.bytes, &name, BYTES), ERR_CORRUPT);

    /* A run of one byte, in a frame that asks for a window of 8 MiB, then for one of 128. */
    unsigned char run[] = {0x28, 0xb5, 0x2f, 0xfd, 0x80, 13 << 3, RUN, 0, 0, 0, 0x23, 0x03, 0, 'x'};
    memset(data, 'x', RUN);
    name = digest_of(data, RUN);
    assert_int_equal(judge(run, sizeof run, &name, BYTES), ERR_OK);
    run[5] = 17 << 3;
    assert_int_equal(judge(run, sizeof run, &name, BYTES), ERR_CORRUPT);
    buf_release(&frame);
    mem_free(data);
}

static void singular_transforms_are_known_at_any_scale(void **state)
{
    (void)state;
    double m[16] = {1, 2, 3, 0, 4, 5, 6, 0, 7, 8, 9, 0, 0, 0, 0, 1};
    assert_false(scene_transform_valid(m));
    m[10] = 10;
    for (int k = -120; k <= 120; k += 40) {
        double scaled[16];
        memcpy(scaled, m, sizeof m);
        for (int i = 0; i < 12; i++)
            scaled[i] = __builtin_ldexp(m[i], k);
        assert_true(scene_transform_valid(scaled));
    }
    m[15] = 2;
    assert_false(scene_transform_valid(m));
}

/* --- Pictures in pieces --------------------------------------------------- */

enum { BIG = 1024, SMALL = BIG >> PYRAMID_PIECE_LEVELS };

/* A scene of one picture of four pieces, no two of them alike. */
static unsigned char *big_picture(struct scene *s)
{
    made_scene(s);
    struct scene_image *image = &s->images[0];
    mem_free(image->pixels);
    *image = (struct scene_image){BIG, BIG, 1, SCENE_IMAGE_U8_LINEAR, mem_calloc(BIG, BIG)};
    unsigned char *pixels = image->pixels;
    assert_non_null(pixels);
    for (size_t i = 0; i < (size_t)BIG * BIG; i++)
        pixels[i] = (unsigned char)(i % BIG / 8 + i / BIG / 4);
    return pixels;
}

static size_t count_kind(const struct package *p, enum package_kind kind)
{
    size_t count = 0;
    for (size_t i = 0; i < p->count; i++)
        count += p->chunks[i].kind == kind;
    return count;
}

static void a_large_picture_comes_back_from_pieces(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p;
    unsigned char *pixels = big_picture(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(count_kind(&p, PACKAGE_BASE), 1);
    assert_int_equal(count_kind(&p, PACKAGE_PIECE), 4);
    assert_int_equal(package_read(p.chunks[0].data, p.chunks[0].bytes, fetch, &p, &back), ERR_OK);
    assert_memory_equal(back.images[0].pixels, pixels, (size_t)BIG * BIG);
    scene_release(&back);
    package_release(&p);

    /* Equal pieces are one chunk, and come back wherever they belong. */
    memset(pixels, 9, (size_t)BIG * BIG);
    pixels[BIG * BIG - 1] = 7;
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(count_kind(&p, PACKAGE_PIECE), 2);
    assert_int_equal(package_read(p.chunks[0].data, p.chunks[0].bytes, fetch, &p, &back), ERR_OK);
    assert_memory_equal(back.images[0].pixels, pixels, (size_t)BIG * BIG);
    scene_release(&back);
    package_release(&p);

    /* A byte less than 1 MiB, sides that do not divide, a use that building reads. */
    s.images[0].height = BIG - 8;
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(count_kind(&p, PACKAGE_BASE), 0);
    package_release(&p);
    s.images[0].height = BIG;
    s.envmap.texture = 1;
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    assert_int_equal(count_kind(&p, PACKAGE_BASE), 0);
    package_release(&p);
    scene_release(&s);
}

/* Two texels of a piece exchanged, which no level of the base can tell. */
static void a_retouched_picture_sends_a_piece_and_a_base(void **state)
{
    (void)state;
    struct scene s;
    struct package before, after;
    unsigned char *pixels = big_picture(&s);
    pixels[0] = 200;
    assert_int_equal(package_write(&s, 0, &before), ERR_OK);
    pixels[0] = pixels[1];
    pixels[1] = 200;
    assert_int_equal(package_write(&s, 0, &after), ERR_OK);
    assert_int_equal(new_chunks(&before, &after), 3); /* with the root */
    package_release(&after);
    package_release(&before);
    scene_release(&s);
}

/* The numbers of the pieces stand where a root first differs from one with other numbers. */
static void bad_pieces_are_refused(void **state)
{
    (void)state;
    struct scene s, back;
    struct package p;
    struct package_index index;
    (void)big_picture(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    struct package_chunk *root = &p.chunks[0];
    static const unsigned char sizes[] = {0, 4, 0, 0, 0, 4, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0};
    unsigned char *at = memmem(root->data, root->bytes, sizes, sizeof sizes);
    assert_non_null(at);
    static const struct {
        size_t at;
        unsigned char value;
    } bad[] = {{0, 1}, {1, 0},  {4, 4},  {6, 1},    {8, 0}, {8, 2},
               {8, 5}, {12, 3}, {16, 4}, {28, 255}, {31, 1}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        unsigned char good = at[bad[i].at];
        at[bad[i].at] = bad[i].value;
        assert_int_equal(package_root_read(root->data, root->bytes, &index), ERR_CORRUPT);
        at[bad[i].at] = good;
    }
    /* More pieces, and fewer, than there are numbers. */
    static const unsigned char heights[] = {2, 8};
    for (int i = 0; i < 2; i++) {
        at[5] = heights[i];
        assert_int_not_equal(package_root_read(root->data, root->bytes, &index), ERR_OK);
    }
    at[5] = 4;
    for (size_t i = 1; i < p.count; i++) {
        if (p.chunks[i].kind != PACKAGE_PIECE)
            continue;
        p.chunks[i].data[12] ^= 1; /* height */
        assert_int_equal(package_read(root->data, root->bytes, fetch, &p, &back), ERR_CORRUPT);
        p.chunks[i].data[12] ^= 1;
    }
    package_release(&p);
    scene_release(&s);
}

/* Levels of a base: each cut and each damaged field. */
static void bad_bases_are_refused(void **state)
{
    (void)state;
    struct scene s;
    struct package p;
    struct package_base base;
    (void)big_picture(&s);
    assert_int_equal(package_write(&s, 0, &p), ERR_OK);
    for (size_t i = 1; i < p.count; i++) {
        struct package_chunk *c = &p.chunks[i];
        if (c->kind != PACKAGE_BASE) {
            assert_int_equal(package_base_get(c->data, c->bytes, &base), ERR_CORRUPT);
            continue;
        }
        assert_int_equal(package_base_get(c->data, c->bytes, &base), ERR_OK);
        assert_int_equal(base.level_count, 8);
        assert_int_equal(base.levels[0].width, SMALL);
        assert_int_equal(base.levels[7].height, 1);
        package_base_release(&base);
        for (size_t cut = 0; cut < c->bytes; cut += cut < 100 ? 1 : 1000)
            assert_int_equal(package_base_get(c->data, cut, &base), ERR_CORRUPT);
        for (size_t field = 40; field < 60; field += 4) {
            c->data[field] ^= 0x81;
            assert_int_equal(package_base_get(c->data, c->bytes, &base), ERR_CORRUPT);
            c->data[field] ^= 0x81;
        }
    }
    package_release(&p);
    scene_release(&s);
}

static void no_memory_no_pieces(void **state)
{
    (void)state;
    struct scene s;
    struct package p;
    uint64_t failed = 0;
    (void)big_picture(&s);
    s.images[0].width = s.images[0].height = 16;
    for (uint64_t i = 0; i < 100000; i++) {
        mem_fail_after(i);
        enum err e = package_write_pieces(&s, 0, 1, &p);
        mem_fail_after(UINT64_MAX);
        if (e == ERR_OK)
            break;
        assert_int_equal(e, ERR_NOMEM);
        failed++;
    }
    assert_true(failed > 20);
    package_release(&p);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_large_picture_comes_back_from_pieces),
        cmocka_unit_test(a_retouched_picture_sends_a_piece_and_a_base),
        cmocka_unit_test(bad_pieces_are_refused),
        cmocka_unit_test(bad_bases_are_refused),
        cmocka_unit_test(no_memory_no_pieces),
        cmocka_unit_test(a_scene_comes_back_trimmed),
        cmocka_unit_test(edits_send_what_changed),
        cmocka_unit_test(parts_need_no_fetch),
        cmocka_unit_test(the_index_lists_what_is_needed),
        cmocka_unit_test(hostile_bytes_never_pass_unseen),
        cmocka_unit_test(memory_runs_out_cleanly),
        cmocka_unit_test(chunks_survive_zstd_and_nothing_else_does),
        cmocka_unit_test(frames_are_judged_without_their_bytes),
        cmocka_unit_test(singular_transforms_are_known_at_any_scale),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
