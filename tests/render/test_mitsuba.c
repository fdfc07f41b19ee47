/* Tilery's pictures against those of Mitsuba 3, an independent renderer, that tests/mitsuba keeps.
 *
 * Each scene of tests/mitsuba/scenes is rendered from 16 seeds of our own. Where the two differ is
 * asked of the means of blocks of 8 x 8 pixels, by Welch's t over the seeds of both sides; the
 * smallest p-value, corrected for the number of blocks (Sidak), must not be under 1e-6, and the
 * picture's mean not off by 4 standard errors. Seeds are fixed: the verdict never changes by
 * itself. On failure ours, theirs and the difference are written as an EXR.
 *
 * A reference EXR has R, G, B: the mean of 16 seeds; variance.R, .G, .B: of the mean of the block
 * that the pixel is in; variance.all: of the mean of the picture. `tests/mitsuba/run references`
 * makes them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/exr_file.h"
#include "common/file_io.h"
#include "common/scene_json.h"
#include "tests/render/render_kit.h"
#include "tests/render/stats.h"

enum { BLOCK = 8, SEEDS = 16, BLOCKS_MAX = 8 * 8 * 3 };

/* Samples a pixel and seed. Under the sanitizers, which are for memory, few. */
#if defined(__SANITIZE_ADDRESS__)
enum { SPP = 4 };
#else
enum { SPP = 16 };
#endif

static const double ALPHA = 1e-6;
static const double MEAN_Z = 4;

/* Mitsuba calculates in single precision: differences below this share of a value say nothing. */
static const double SINGLE = 3e-5;

/* Means of the blocks and of the whole, and the variances of these means. */
struct estimate {
    size_t columns, rows, count;
    double mean[BLOCKS_MAX], variance[BLOCKS_MAX];
    double whole, whole_variance;
};

struct verdict {
    double p, whole_z;
    size_t worst;
};

/* Means over the blocks of planar RGB; the mean of all is returned. */
static double block_means(const double *rgb, size_t width, size_t height, double *out)
{
    size_t columns = width / BLOCK, rows = height / BLOCK, count = columns * rows * 3;
    double whole = 0;
    memset(out, 0, count * sizeof *out);
    for (size_t i = 0; i < width * height * 3; i++) {
        size_t x = i % width, y = i / width % height, k = i / (width * height);
        out[(k * rows + y / BLOCK) * columns + x / BLOCK] += rgb[i] / (BLOCK * BLOCK);
        whole += rgb[i] / (double)(width * height * 3);
    }
    return whole;
}

/* Our seeds; the mean picture goes to `picture`, planar RGB. */
static struct estimate render_ours(const struct scene *scene, struct job_spec spec, double *picture)
{
    struct estimate e = {.columns = spec.width / BLOCK, .rows = spec.height / BLOCK};
    size_t values = (size_t)spec.width * spec.height * 3;
    e.count = e.columns * e.rows * 3;
    assert_true(e.count <= BLOCKS_MAX);
    memset(picture, 0, values * sizeof *picture);
    spec.spp = SPP;
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        double means[BLOCKS_MAX];
        spec.seed = 1000 + seed;
        struct kit_picture p = kit_render(scene, &spec, 0);
        assert_int_equal(p.counters.nonfinite, 0);
        double whole = block_means(p.mean, spec.width, spec.height, means);
        for (size_t b = 0; b < e.count; b++) {
            e.mean[b] += means[b] / SEEDS;
            e.variance[b] += means[b] * means[b] / SEEDS;
        }
        e.whole += whole / SEEDS;
        e.whole_variance += whole * whole / SEEDS;
        for (size_t i = 0; i < values; i++)
            picture[i] += p.mean[i] / SEEDS;
        kit_picture_free(&p);
    }
    for (size_t b = 0; b < e.count; b++)
        e.variance[b] = fmax(0, e.variance[b] - e.mean[b] * e.mean[b]) / (SEEDS - 1);
    e.whole_variance = fmax(0, e.whole_variance - e.whole * e.whole) / (SEEDS - 1);
    return e;
}

/* The kept reference. */
static struct estimate read_theirs(const char *name, struct exr_image *image, double *picture)
{
    static const char *const wanted[] = {"R",          "G",          "B",           "variance.R",
                                         "variance.G", "variance.B", "variance.all"};
    char path[200];
    struct diag_list problems;
    diag_init(&problems);
    snprintf(path, sizeof path, "tests/mitsuba/references/%s.exr", name);
    enum err read = exr_read_file(path, wanted, 7, image, &problems);
    diag_print(&problems, stderr);
    diag_release(&problems);
    assert_int_equal(read, ERR_OK);
    size_t w = image->width, h = image->height, plane = w * h;
    struct estimate e = {.columns = w / BLOCK, .rows = h / BLOCK};
    e.count = e.columns * e.rows * 3;
    assert_true(e.count <= BLOCKS_MAX);
    for (size_t k = 0; k < 3; k++)
        for (size_t i = 0; i < plane; i++)
            picture[k * plane + i] = (double)exr_image_plane(image, wanted[k])[i];
    e.whole = block_means(picture, w, h, e.mean);
    for (size_t b = 0; b < e.count; b++) {
        size_t x = b % e.columns * BLOCK, y = b / e.columns % e.rows * BLOCK;
        const float *variance = exr_image_plane(image, wanted[3 + b / (e.columns * e.rows)]);
        e.variance[b] = (double)variance[y * w + x];
    }
    e.whole_variance = (double)exr_image_plane(image, "variance.all")[0];
    return e;
}

static struct verdict judge(const struct estimate *ours, const struct estimate *theirs)
{
    struct verdict v = {.p = 1};
    assert_int_equal(ours->count, theirs->count);
    assert_int_equal(ours->columns, theirs->columns);
    for (size_t b = 0; b < ours->count; b++) {
        double a = ours->variance[b], c = theirs->variance[b];
        double floor_sigma = SINGLE * fmax(fabs(ours->mean[b]), fabs(theirs->mean[b]));
        double floor2 = floor_sigma * floor_sigma + 1e-30, sum = a + c + floor2;
        double degrees = (SEEDS - 1) * sum * sum / (a * a + c * c + floor2 * floor2 / 2 + 1e-300);
        double p = stats_t_two_sided((ours->mean[b] - theirs->mean[b]) / sqrt(sum), degrees);
        if (p < v.p) {
            v.p = p;
            v.worst = b;
        }
    }
    v.p = -expm1((double)ours->count * log1p(-fmin(v.p, 1 - 1e-16)));
    double floor_sigma = SINGLE * theirs->whole;
    v.whole_z = (ours->whole - theirs->whole) / sqrt(ours->whole_variance + theirs->whole_variance +
                                                     floor_sigma * floor_sigma + 1e-30);
    return v;
}

static bool agrees(const struct verdict *v)
{
    return v->p >= ALPHA && fabs(v->whole_z) < MEAN_Z;
}

/* Writes ours, theirs and ours - theirs beside each other. */
static void write_difference(const char *name, const double *ours, const double *theirs, size_t w,
                             size_t h)
{
    static const char *const channels[9] = {
        "R", "G", "B", "theirs.R", "theirs.G", "theirs.B", "minus.R", "minus.G", "minus.B"};
    static float planes[9][BLOCKS_MAX / 3 * BLOCK * BLOCK];
    struct exr_channel list[9];
    struct exr_picture picture = {.width = (uint32_t)w,
                                  .height = (uint32_t)h,
                                  .data_width = (uint32_t)w,
                                  .data_height = (uint32_t)h,
                                  .channels = list,
                                  .channel_count = 9};
    struct buf file;
    char path[300];
    buf_init(&file);
    for (size_t k = 0; k < 3; k++) {
        for (size_t i = 0; i < w * h; i++) {
            double a = ours[k * w * h + i], b = theirs[k * w * h + i];
            planes[k][i] = (float)a;
            planes[3 + k][i] = (float)b;
            planes[6 + k][i] = (float)(a - b);
        }
    }
    for (size_t k = 0; k < 9; k++)
        list[k] = (struct exr_channel){channels[k], planes[k], 1};
    const char *folder = getenv("TMPDIR");
    snprintf(path, sizeof path, "%s/tilery_%s_difference.exr", folder ? folder : "/tmp", name);
    FILE *out = exr_write(&picture, &file) == ERR_OK ? fopen(path, "wb") : NULL;
    if (out && fwrite(file.data, 1, file.bytes, out) == file.bytes)
        print_message("the difference is in %s\n", path);
    if (out)
        fclose(out);
    buf_release(&file);
}

struct rendering {
    struct scene scene;
    struct job_spec spec;
};

static void read_scene(const char *name, struct rendering *r)
{
    char path[200];
    struct diag_list problems;
    diag_init(&problems);
    snprintf(path, sizeof path, "tests/mitsuba/scenes/%s.json", name);
    enum err read = scene_json_read_file(path, &r->scene, &r->spec, &problems);
    diag_print(&problems, stderr);
    diag_release(&problems);
    assert_int_equal(read, ERR_OK);
}

static struct verdict compare(const char *name, struct rendering *r, bool expected)
{
    static double ours[BLOCKS_MAX * BLOCK * BLOCK], theirs[BLOCKS_MAX * BLOCK * BLOCK];
    struct exr_image image;
    struct estimate b = read_theirs(name, &image, theirs);
    assert_int_equal(image.width, r->spec.width);
    struct estimate a = render_ours(&r->scene, r->spec, ours);
    struct verdict v = judge(&a, &b);
    print_message("%-16s mean %.5f against %.5f (z %+.2f), worst of %zu blocks: number %zu, "
                  "p %.3g\n",
                  name, a.whole, b.whole, v.whole_z, a.count, v.worst, v.p);
    if (agrees(&v) != expected)
        write_difference(name, ours, theirs, image.width, image.height);
    exr_image_release(&image);
    return v;
}

static void same_picture(void **state)
{
    struct rendering r;
    read_scene(*state, &r);
    struct verdict v = compare(*state, &r, true);
    scene_release(&r.scene);
    assert_true(agrees(&v));
}

/* A test that everything passes shows nothing: glass of a somewhat other index must be seen. */
static void wrong_index_is_seen(void **state)
{
    (void)state;
    struct rendering r;
    read_scene("nested_glass", &r);
    for (size_t i = 0; i < r.scene.material_count; i++)
        r.scene.materials[i].eta *= 1.06;
    struct verdict v = compare("nested_glass", &r, false);
    scene_release(&r.scene);
    assert_false(agrees(&v));
}

/* And so must a lamp that is 3 % too bright, by the picture's mean alone. */
static void wrong_lamp_is_seen(void **state)
{
    (void)state;
    struct rendering r;
    read_scene("punctual", &r);
    for (size_t i = 0; i < r.scene.light_count; i++)
        for (size_t k = 0; k < 3; k++)
            r.scene.lights[i].intensity[k] *= 1.03;
    struct verdict v = compare("punctual", &r, false);
    scene_release(&r.scene);
    assert_true(fabs(v.whole_z) > MEAN_Z);
}

static void student(void **state)
{
    (void)state;
    assert_true(fabs(stats_t_two_sided(1, 1) - 0.5) < 1e-12);
    assert_true(fabs(stats_t_two_sided(2.042272, 30) - 0.05) < 1e-6);
    assert_true(fabs(stats_t_two_sided(-6, 30) / 1.40e-6 - 1) < 0.02);
}

#define SCENE(name)                                                                                \
    {                                                                                              \
#name, same_picture, NULL, NULL, (void *)(uintptr_t) #name                                 \
    }

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(student),
        SCENE(cornell_area),
        SCENE(cornell_point),
        SCENE(cornell_direct),
        SCENE(seed_light),
        SCENE(glass_block),
        SCENE(glass_sphere),
        SCENE(nested_glass),
        SCENE(rough_glass),
        SCENE(glass_sheets),
        SCENE(veach_plates),
        SCENE(metal_spheres),
        SCENE(textured_mesh),
        SCENE(sky_alone),
        SCENE(spheres_uv),
        SCENE(leaves),
        SCENE(glow),
        SCENE(punctual),
        SCENE(sides),
        SCENE(thin_lens),
        SCENE(filter_tent),
        SCENE(filter_mitchell),
        cmocka_unit_test(wrong_index_is_seen),
        cmocka_unit_test(wrong_lamp_is_seen),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
