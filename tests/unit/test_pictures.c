/* EXR and PNG out and in, Radiance in; cut and damaged files; the pictures of the data folder. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dmath.h"
#include "common/exr_file.h"
#include "common/file_io.h"
#include "common/image_file.h"
#include "common/mem.h"
#include "common/png_file.h"

enum { WIDTH = 37, HEIGHT = 53, PIXELS = WIDTH * HEIGHT };

static void fill(float *v, size_t count, uint32_t seed)
{
    for (size_t i = 0; i < count; i++) {
        seed = seed * 1664525u + 1013904223u;
        v[i] = (float)(seed >> 8) / 16777216.0f * (i % 7 == 0 ? 1e6f : 1.0f);
    }
}

/* Every float of every channel comes back, planar and interleaved, with the crop's windows. */
static void exr_round_trips_exactly(void **state)
{
    (void)state;
    static float rgb[PIXELS * 3], depth[PIXELS];
    fill(rgb, PIXELS * 3, 1);
    fill(depth, PIXELS, 2);
    const struct exr_channel channels[] = {{"R", rgb, 3},
                                           {"G", rgb + 1, 3},
                                           {"B", rgb + 2, 3},
                                           {"depth.with.a.name.longer.than.31.bytes.Z", depth, 1}};
    const struct exr_attribute attributes[] = {{"tilery:job", EXR_TEXT, "j1", 0},
                                               {"tilery:relmse", EXR_FLOAT, NULL, 0.25},
                                               {"tilery:spp", EXR_INT, NULL, 64}};
    struct exr_picture picture = {.width = 100,
                                  .height = 90,
                                  .x = 11,
                                  .y = 20,
                                  .data_width = WIDTH,
                                  .data_height = HEIGHT,
                                  .channels = channels,
                                  .channel_count = 4,
                                  .attributes = attributes,
                                  .attribute_count = 3};
    struct buf out;
    struct exr_image back;
    struct diag_list problems;
    buf_init(&out);
    diag_init(&problems);
    buf_put(&out, "before", 6);
    assert_int_equal(exr_write(&picture, &out), ERR_OK);
    assert_int_equal(exr_read(out.data + 6, out.bytes - 6, "p.exr", NULL, 0, &back, &problems),
                     ERR_OK);
    assert_int_equal(back.width, 100);
    assert_int_equal(back.x, 11);
    assert_int_equal(back.data_height, HEIGHT);
    assert_int_equal(back.channel_count, 4);
    const float *g = exr_image_plane(&back, "G"), *z = exr_image_plane(&back, channels[3].name);
    assert_true(g && z);
    for (size_t i = 0; i < PIXELS; i++)
        assert_true(g[i] == rgb[3 * i + 1] && z[i] == depth[i]);
    exr_image_release(&back);
    const char *wanted[] = {"B", "nope"};
    assert_int_equal(exr_read(out.data + 6, out.bytes - 6, "p.exr", wanted, 1, &back, &problems),
                     ERR_OK);
    assert_int_equal(back.channel_count, 1);
    exr_image_release(&back);
    assert_int_equal(exr_read(out.data + 6, out.bytes - 6, "p.exr", wanted, 2, &back, &problems),
                     ERR_INPUT);
    diag_release(&problems);
    buf_release(&out);
}

static void refuse_cuts(const struct buf *file, size_t step)
{
    for (size_t cut = 0; cut < file->bytes; cut += step) {
        struct scene_image image;
        struct diag_list problems;
        diag_init(&problems);
        assert_int_equal(image_read(file->data, cut, "p", IMAGE_COLOR, &image, &problems),
                         ERR_INPUT);
        assert_int_equal(problems.error_count, 1);
        diag_release(&problems);
    }
}

static void survive_flips(struct buf *file, size_t step)
{
    for (size_t bit = 0; bit < 8 * file->bytes; bit += step) {
        struct scene_image image;
        struct diag_list problems;
        diag_init(&problems);
        file->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        enum err e = image_read(file->data, file->bytes, "p", IMAGE_COLOR, &image, &problems);
        assert_true(e == ERR_OK || e == ERR_INPUT);
        if (e == ERR_OK)
            mem_free(image.pixels);
        file->data[bit / 8] ^= (unsigned char)(1 << bit % 8);
        diag_release(&problems);
    }
}

/* A 2-spp picture of a Cornell box came back with NaNs and floats of any size in 16 of its rows:
 * deflated, they had been just as large as before, and a chunk of that size is read as not
 * compressed. Noise that begins with a growing run of equal floats comes by that size. */
static void exr_chunk_of_its_own_size(void **state)
{
    (void)state;
    enum { SIDE = 16, VALUES = SIDE * SIDE, RUNS = 64, SEEDS = 20 };
    float noise[VALUES];
    const struct exr_channel channel = {"Y", noise, 1};
    const struct exr_picture picture = {.width = SIDE,
                                        .height = SIDE,
                                        .data_width = SIDE,
                                        .data_height = SIDE,
                                        .channels = &channel,
                                        .channel_count = 1};
    for (uint32_t k = 0; k < RUNS * SEEDS; k++) {
        uint32_t state32 = k / RUNS + 1;
        for (uint32_t i = 0; i < VALUES; i++) {
            state32 = state32 * 1664525u + 1013904223u;
            uint32_t bits = (state32 >> 8) ^ state32 << 7;
            if (i < k % RUNS)
                bits = 0x3f800000u;
            memcpy(&noise[i], &bits, sizeof bits);
        }
        struct buf out;
        struct exr_image back;
        struct diag_list problems;
        buf_init(&out);
        diag_init(&problems);
        assert_int_equal(exr_write(&picture, &out), ERR_OK);
        assert_int_equal(exr_read(out.data, out.bytes, "p.exr", NULL, 0, &back, &problems), ERR_OK);
        assert_memory_equal(exr_image_plane(&back, "Y"), noise, sizeof noise);
        exr_image_release(&back);
        diag_release(&problems);
        buf_release(&out);
    }
}

/* Chunks are deflated side by side: they stand in the file in their order all the same. */
static void exr_bytes_are_the_same_each_time(void **state)
{
    (void)state;
    enum { ROWS = 1000, RUNS = 10, VALUES = WIDTH * ROWS };
    static float grey[VALUES];
    const struct exr_channel channel = {"Y", grey, 1};
    const struct exr_picture picture = {.width = WIDTH,
                                        .height = ROWS,
                                        .data_width = WIDTH,
                                        .data_height = ROWS,
                                        .channels = &channel,
                                        .channel_count = 1};
    struct buf first, again;
    fill(grey, VALUES, 5);
    buf_init(&first);
    assert_int_equal(exr_write(&picture, &first), ERR_OK);
    for (int run = 0; run < RUNS; run++) {
        buf_init(&again);
        assert_int_equal(exr_write(&picture, &again), ERR_OK);
        assert_int_equal(again.bytes, first.bytes);
        assert_memory_equal(again.data, first.data, first.bytes);
        buf_release(&again);
    }
    struct exr_image back;
    struct diag_list problems;
    diag_init(&problems);
    assert_int_equal(exr_read(first.data, first.bytes, "p.exr", NULL, 0, &back, &problems), ERR_OK);
    assert_memory_equal(exr_image_plane(&back, "Y"), grey, sizeof grey);
    exr_image_release(&back);
    diag_release(&problems);
    buf_release(&first);
}

static void damaged_exr_is_refused(void **state)
{
    (void)state;
    static float grey[PIXELS];
    const struct exr_channel channel = {"Y", grey, 1};
    struct exr_picture picture = {.width = WIDTH,
                                  .height = HEIGHT,
                                  .data_width = WIDTH,
                                  .data_height = HEIGHT,
                                  .channels = &channel,
                                  .channel_count = 1};
    struct buf out;
    fill(grey, PIXELS, 3);
    buf_init(&out);
    assert_int_equal(exr_write(&picture, &out), ERR_OK);
    refuse_cuts(&out, 7);
    survive_flips(&out, 11);
    buf_release(&out);
}

static void png_encodes_srgb_rounded_to_nearest(void **state)
{
    (void)state;
    enum { SIDE = 64 };
    static float rgb[SIDE * SIDE * 3];
    struct buf out;
    struct scene_image back;
    struct diag_list problems;
    for (size_t i = 0; i < SIDE * SIDE * 3; i++)
        rgb[i] = (float)i / (float)(SIDE * SIDE * 3 - 1) * 1.2f - 0.1f;
    rgb[5] = nanf("");
    rgb[6] = INFINITY;
    buf_init(&out);
    diag_init(&problems);
    assert_int_equal(png_write_rgb(rgb, SIDE, SIDE, 1, &out), ERR_OK);
    assert_int_equal(image_read(out.data, out.bytes, "p.png", IMAGE_COLOR, &back, &problems),
                     ERR_OK);
    assert_int_equal(back.channel_count, 3);
    assert_int_equal(back.format, SCENE_IMAGE_U8_SRGB);
    const unsigned char *samples = back.pixels;
    assert_int_equal(samples[5], 0);
    assert_int_equal(samples[6], 255);
    for (size_t i = 7; i < SIDE * SIDE * 3; i++) {
        double linear = fmin(fmax((double)rgb[i], 0), 1);
        double code = linear <= 0.0031308 ? 12.92 * linear : 1.055 * pow(linear, 1 / 2.4) - 0.055;
        assert_true(fabs(samples[i] - code * 255) <= 0.5 + 1e-6);
    }
    mem_free(back.pixels);
    refuse_cuts(&out, 31);
    survive_flips(&out, 97);
    diag_release(&problems);
    buf_release(&out);
}

static void radiance_forms_are_read(void **state)
{
    (void)state;
    static const char header[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1\n\n";
    struct buf flat, rle;
    struct scene_image a, b;
    struct diag_list problems;
    diag_init(&problems);
    buf_init(&flat);
    buf_init(&rle);
    buf_printf(&flat, "%s-Y 1 +X 9\n", header);
    buf_printf(&rle, "%s-Y 1 +X 9\n", header);
    buf_put(&flat, "\x80\x40\x20\x81", 4);
    buf_put(&flat, "\x01\x01\x01\x08", 4); /* the old run: eight more of the same */
    buf_put(&rle, "\x02\x02\x00\x09", 4);
    buf_put(&rle, "\x89\x80\x89\x40\x05\x20\x20\x20\x20\x20\x84\x20\x89\x81", 14);
    assert_int_equal(image_read(flat.data, flat.bytes, "a.hdr", IMAGE_COLOR, &a, &problems),
                     ERR_OK);
    assert_int_equal(image_read(rle.data, rle.bytes, "b.hdr", IMAGE_COLOR, &b, &problems), ERR_OK);
    for (size_t i = 0; i < 27; i++) {
        static const float expected[3] = {1.0f, 0.5f, 0.25f};
        assert_true(((float *)a.pixels)[i] == expected[i % 3]);
        assert_true(((float *)b.pixels)[i] == expected[i % 3]);
    }
    mem_free(a.pixels);
    mem_free(b.pixels);
    refuse_cuts(&flat, 1);
    refuse_cuts(&rle, 1);
    survive_flips(&rle, 1);
    diag_release(&problems);
    buf_release(&flat);
    buf_release(&rle);
}

/* Sizes are judged before memory is taken. */
static void claims_of_size_are_refused(void **state)
{
    (void)state;
    static const char *const sizes[] = {"-Y 99999999 +X 2\n", "-Y 2 +X 99999999\n",
                                        "-Y 32768 +X 32768\n", "-Y 0 +X 1\n", "-Y -5 +X 1\n"};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        struct buf b;
        struct scene_image image;
        struct diag_list problems;
        diag_init(&problems);
        buf_init(&b);
        buf_printf(&b, "#?RGBE\n\n%s", sizes[i]);
        assert_int_equal(image_read(b.data, b.bytes, "a.hdr", IMAGE_COLOR, &image, &problems),
                         ERR_INPUT);
        buf_release(&b);
        diag_release(&problems);
    }
}

/* Files that another library wrote: every compression, layout and type that we read; the others are
 * refused by name. */
static void foreign_exr_forms_are_read(void **state)
{
    (void)state;
    static const char *const names[] = {"none_half",  "rle_float",       "zips_half_tiled",
                                        "zip_uint",   "zip_float_tiled", "piz_half",
                                        "pxr24_half", "piz_float_tiled", "two_parts"};
    static const char *const refused[][2] = {{"refused_b44", "B44"}, {"refused_dwaa", "DWAA"}};
    struct exr_image image;
    struct diag_list problems;
    diag_init(&problems);
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        char *path = mem_sprintf("tests/unit/exr/%s.exr", names[i]);
        assert_int_equal(exr_read_file(path, NULL, 0, &image, &problems), ERR_OK);
        assert_true(image.data_width == 21 && image.data_height == 19 && image.channel_count == 1);
        float unit = strcmp(names[i], "zip_uint") == 0 ? 1.0f : 0.25f;
        for (size_t k = 0; k < (size_t)21 * 19; k++)
            assert_true(image.planes[0][k] == (float)k * unit);
        exr_image_release(&image);
        mem_free(path);
    }
    for (size_t i = 0; i < 2; i++) {
        char *path = mem_sprintf("tests/unit/exr/%s.exr", refused[i][0]);
        assert_int_equal(exr_read_file(path, NULL, 0, &image, &problems), ERR_INPUT);
        assert_non_null(strstr(problems.items[i].text, refused[i][1]));
        mem_free(path);
    }
    diag_release(&problems);
}

/* Writes and reads once with the n-th allocation failing; ERR_OK when nothing failed. */
static enum err try_all(uint64_t n, const struct exr_picture *picture, const float *rgb)
{
    struct buf exr, png;
    struct scene_image image;
    struct diag_list problems;
    diag_init(&problems);
    buf_init(&exr);
    buf_init(&png);
    mem_fail_after(n);
    enum err e = exr_write(picture, &exr);
    if (e == ERR_OK)
        e = png_write_rgb(rgb, 8, 4, 1, &png);
    for (int i = 0; e == ERR_OK && i < 2; i++) {
        const struct buf *file = i ? &png : &exr;
        e = image_read(file->data, file->bytes, "p", IMAGE_COLOR, &image, &problems);
        if (e == ERR_OK)
            mem_free(image.pixels);
    }
    mem_fail_after(UINT64_MAX);
    buf_release(&exr);
    buf_release(&png);
    diag_release(&problems);
    return e;
}

/* The library reports some of its own failures as damage; none may crash or leak. */
static void memory_runs_out_cleanly(void **state)
{
    (void)state;
    static float rgb[8 * 4 * 3];
    const struct exr_channel channels[] = {{"R", rgb, 3}, {"G", rgb + 1, 3}, {"B", rgb + 2, 3}};
    struct exr_picture picture = {.width = 8,
                                  .height = 4,
                                  .data_width = 8,
                                  .data_height = 4,
                                  .channels = channels,
                                  .channel_count = 3};
    fill(rgb, 8 * 4 * 3, 5);
    uint64_t n = 0;
    while (try_all(n, &picture, rgb) != ERR_OK)
        n++;
    assert_true(n > 10 && n < 10000);
}

/* Reads every file of a folder; gives how many there are and how many load. */
static size_t read_folder(const char *name, size_t *good)
{
    const char *data = getenv("TILERY_TEST_DATA");
    char *folder = data ? mem_sprintf("%s/%s", data, name) : NULL;
    DIR *dir = folder ? opendir(folder) : NULL;
    size_t count = 0;
    *good = 0;
    for (struct dirent *entry = dir ? readdir(dir) : NULL; entry; entry = readdir(dir)) {
        struct scene_image image;
        struct diag_list problems;
        if (entry->d_name[0] == '.' || strstr(entry->d_name, "LICENSE"))
            continue;
        char *path = file_join(folder, entry->d_name);
        diag_init(&problems);
        enum err e = image_read_file(path, IMAGE_COLOR, &image, &problems);
        assert_true(e == ERR_OK || (e == ERR_INPUT && problems.error_count > 0));
        if (e == ERR_OK)
            mem_free(image.pixels);
        *good += e == ERR_OK;
        count++;
        diag_release(&problems);
        mem_free(path);
    }
    if (dir)
        (void)closedir(dir);
    mem_free(folder);
    return count;
}

static void outside_pictures_load_or_are_refused(void **state)
{
    (void)state;
    size_t good, count = read_folder("image/png", &good);
    if (count == 0)
        skip();
    assert_int_equal(good, count);
    count = read_folder("image/exr/TestImages", &good);
    assert_true(count > 0 && good == count);
    count = read_folder("image/hdr", &good);
    assert_true(count > 0 && good == count);
    count = read_folder("bad/png", &good);
    assert_true(count > 0 && good == 0);
    count = read_folder("bad/exr/openexr", &good);
    assert_true(count > 20 && good < count / 4);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(exr_round_trips_exactly),
        cmocka_unit_test(exr_chunk_of_its_own_size),
        cmocka_unit_test(exr_bytes_are_the_same_each_time),
        cmocka_unit_test(damaged_exr_is_refused),
        cmocka_unit_test(foreign_exr_forms_are_read),
        cmocka_unit_test(png_encodes_srgb_rounded_to_nearest),
        cmocka_unit_test(radiance_forms_are_read),
        cmocka_unit_test(claims_of_size_are_refused),
        cmocka_unit_test(memory_runs_out_cleanly),
        cmocka_unit_test(outside_pictures_load_or_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
