/* Textures over footprints: pyramids keep means, fine footprints change no bit, wide ones give the
 * mean without noise, whatever the numbers are. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_build.h"

/* Splitmix64, in [0,1). */
static double random_value(uint64_t *state)
{
    uint64_t z = (*state += UINT64_C(0x9e3779b97f4a7c15));
    z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
    return (double)((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

/* A quad in the plane z = 0 that shows an image; `pixels` are taken. */
static struct scene_texture *add_image_quad(struct scene *s, uint32_t width, uint32_t height,
                                            uint32_t channels, enum scene_image_format format,
                                            void *pixels)
{
    static const double corners[12] = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0};
    static const float uvs[8] = {0, 0, 1, 0, 1, 1, 0, 1};
    struct scene_material *m;
    uint32_t material = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->texture = kit_constant_texture(s, 1);
    struct scene_texture *t = &s->textures[m->texture];
    char *name = t->name;
    scene_image_texture_init(t);
    t->name = name;
    t->image = (uint32_t)s->image_count;
    s->images = mem_realloc_array(s->images, s->image_count + 1, sizeof *s->images);
    s->images[s->image_count++] = (struct scene_image){width, height, channels, format, pixels};
    uint32_t quad = kit_quad(s, corners, material);
    struct scene_mesh *mesh = &s->meshes[s->objects[quad].mesh];
    mesh->uvs = mem_alloc_array(8, sizeof *uvs);
    memcpy(mesh->uvs, uvs, sizeof uvs);
    return t;
}

static struct render_scene *build(const struct scene *s)
{
    struct render_scene *rs;
    struct job_spec spec = kit_spec(8, 1);
    scene_check(s);
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

static float *random_floats(size_t count, uint64_t *random)
{
    float *p = mem_alloc_array(count, sizeof *p);
    assert_non_null(p);
    for (size_t i = 0; i < count; i++)
        p[i] = (float)random_value(random);
    return p;
}

static double level_mean(const struct texture_image *image, uint32_t level, uint32_t channel)
{
    const struct texture_level *l = &image->levels[level];
    double sum = 0, c[4];
    for (uint32_t y = 0; y < l->height; y++)
        for (uint32_t x = 0; x < l->width; x++) {
            texture_texel(image, l, x, y, c);
            sum += c[channel];
        }
    return sum / ((double)l->width * l->height);
}

/* Sides of all kinds: tiles hold what the rows did, each level the mean of the picture. */
static void pyramids_keep_means(void **state)
{
    (void)state;
    static const uint32_t sides[][2] = {{1, 1}, {1, 7}, {5, 3}, {64, 64}, {37, 23}, {101, 2}};
    uint64_t random = 7;
    for (size_t i = 0; i < sizeof sides / sizeof *sides; i++) {
        struct scene s;
        scene_init(&s);
        uint32_t width = sides[i][0], height = sides[i][1];
        float *pixels = random_floats((size_t)width * height * 3, &random);
        add_image_quad(&s, width, height, 3, SCENE_IMAGE_F32, pixels);
        struct render_scene *rs = build(&s);
        const struct texture_image *image = rs->textures[0].image;
        const struct texture_level *finest = &image->levels[0];
        for (uint32_t y = 0; y < height; y++)
            for (uint32_t x = 0; x < width; x++) {
                double c[4];
                texture_texel(image, finest, x, y, c);
                for (uint32_t k = 0; k < 3; k++)
                    assert_true(c[k] == (double)pixels[((size_t)y * width + x) * 3 + k]);
            }
        for (uint32_t l = 1; l < image->level_count; l++) {
            assert_int_equal(image->levels[l].width, width >> l ? width >> l : 1);
            assert_int_equal(image->levels[l].height, height >> l ? height >> l : 1);
            for (uint32_t k = 0; k < 3; k++)
                assert_true(fabs(level_mean(image, l, k) - level_mean(image, 0, k)) < 1e-6);
        }
        assert_int_equal(image->levels[image->level_count - 1].width, 1);
        assert_int_equal(image->levels[image->level_count - 1].height, 1);
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* Black and white squares of one texel, in 8-bit sRGB: half of white is half the light, to half a
 * code, and not code 128. */
static void minified_squares_are_their_mean(void **state)
{
    (void)state;
    enum { SIDE = 256 };
    struct scene s;
    scene_init(&s);
    unsigned char *pixels = mem_alloc_array((size_t)SIDE * SIDE, 3);
    for (size_t i = 0; i < (size_t)SIDE * SIDE; i++)
        memset(pixels + 3 * i, (i % SIDE + i / SIDE) % 2 ? 255 : 0, 3);
    add_image_quad(&s, SIDE, SIDE, 3, SCENE_IMAGE_U8_SRGB, pixels);
    struct render_scene *rs = build(&s);
    const struct texture *t = &rs->textures[0];
    uint64_t random = 3;
    for (int i = 0; i < 20000; i++) {
        double u = random_value(&random) * 4 - 2, v = random_value(&random);
        /* From two texels up, round and long ones at any angle. */
        double size = 2.0 / SIDE * (1 + 100 * random_value(&random));
        double x = random_value(&random) - 0.5, y = random_value(&random) - 0.5;
        double unit = size / sqrt(x * x + y * y), longer = 1 + 9 * random_value(&random);
        struct texture_footprint f = {{x * unit * longer, -y * unit},
                                      {y * unit * longer, x * unit}};
        rgb c = texture_filtered(t, u, v, &f, NULL);
        assert_true(fabs(c.r - 0.5) < 0.004 && c.r == c.g && c.g == c.b);
    }
    render_scene_free(rs);
    scene_release(&s);
}

static void fine_footprints_are_bilinear(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint64_t random = 11;
    struct scene_texture *from =
        add_image_quad(&s, 13, 9, 3, SCENE_IMAGE_F32, random_floats((size_t)13 * 9 * 3, &random));
    from->color[0][1] = 0.25;
    from->uv_matrix[1] = 0.3;
    struct render_scene *rs = build(&s);
    struct texture t = rs->textures[0], bilinear = t;
    bilinear.filter = SCENE_FILTER_BILINEAR;
    for (int i = 0; i < 10000; i++) {
        double u = random_value(&random) * 3 - 1, v = random_value(&random) * 3 - 1;
        struct texture_footprint fine = {{0.03 * random_value(&random), 0.02},
                                         {0.01, -0.03 * random_value(&random)}};
        struct texture_footprint wide = {{3, 0}, {0, 3}};
        rgb a = texture_filtered(&t, u, v, &fine, NULL), b = texture_color(&t, u, v);
        rgb c = texture_filtered(&bilinear, u, v, &wide, NULL);
        assert_memory_equal(&a, &b, sizeof a);
        assert_memory_equal(&c, &b, sizeof a);
        assert_true(texture_filtered(&t, u, v, NULL, NULL).g == b.g);
    }
    /* Nearest: a texel as it is, with the factor. */
    struct texture nearest = t;
    nearest.filter = SCENE_FILTER_NEAREST;
    memcpy(nearest.uv_matrix, (double[6]){1, 0, 0, 0, 1, 0}, sizeof nearest.uv_matrix);
    double texel[4];
    texture_texel(t.image, &t.image->levels[0], 4, 0, texel);
    rgb c = texture_color(&nearest, 4.9 / 13, 8.1 / 9);
    assert_true(c.r == texel[0] && c.g == texel[1] * 0.25);
    render_scene_free(rs);
    scene_release(&s);
}

/* Between levels the value goes over without a jump. */
static void widening_is_continuous(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint64_t random = 5;
    add_image_quad(&s, 64, 64, 1, SCENE_IMAGE_F32, random_floats((size_t)64 * 64, &random));
    struct render_scene *rs = build(&s);
    double before = 0;
    for (int i = 0; i <= 20000; i++) {
        double width = (0.5 + i * 0.005) / 64;
        struct texture_footprint f = {{width, 0}, {0, width}};
        double now = texture_filtered(&rs->textures[0], 0.3, 0.7, &f, NULL).r;
        assert_true(i == 0 || fabs(now - before) < 0.01);
        before = now;
    }
    render_scene_free(rs);
    scene_release(&s);
}

static void any_number_is_fine(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint64_t random = 13;
    add_image_quad(&s, 40, 30, 4, SCENE_IMAGE_F32, random_floats((size_t)40 * 30 * 4, &random));
    struct render_scene *rs = build(&s);
    struct texture image = rs->textures[0];
    struct texture checker = {.type = SCENE_TEXTURE_CHECKERBOARD,
                              .filter = SCENE_FILTER_MIPMAP,
                              .color = {{1, 1, 1}, {0, 0, 0}},
                              .uv_matrix = {1, 0, 0, 0, 1, 0}};
    const double wild[] = {0, 1e-300, 1e-9, 1, 1e9, 1e200, INFINITY, -INFINITY, NAN};
    enum { COUNT = sizeof wild / sizeof *wild };
    for (int i = 0; i < COUNT * COUNT * COUNT * COUNT; i++) {
        struct texture_footprint f = {
            {wild[i % COUNT], wild[i / COUNT % COUNT]},
            {wild[i / COUNT / COUNT % COUNT], -wild[i / COUNT / COUNT / COUNT]}};
        rgb a = texture_filtered(&image, 0.3, 0.4, &f, NULL),
            b = texture_filtered(&checker, 0.3, 0.4, &f, NULL);
        assert_true(a.r >= 0 && a.r <= 1 && a.g >= 0 && a.g <= 1);
        assert_true(b.r >= 0 && b.r <= 1);
    }
    struct texture_footprint endless = {{INFINITY, 0}, {NAN, 1}};
    rgb mean = texture_filtered(&image, 0.1, 0.9, &endless, NULL);
    assert_true(fabs(mean.g - level_mean(image.image, 0, 1)) < 1e-5);
    assert_true(texture_filtered(&checker, 0.1, 0.9, &endless, NULL).r == 0.5);
    render_scene_free(rs);
    scene_release(&s);
}

/* Against the mean of many points of the rectangle. */
static void checkerboards_are_averaged(void **state)
{
    (void)state;
    struct texture t = {.type = SCENE_TEXTURE_CHECKERBOARD,
                        .filter = SCENE_FILTER_MIPMAP,
                        .color = {{1, 0, 0.25}, {0, 1, 0.5}},
                        .uv_matrix = {2, 0, 0.1, 0, 3, 0.2}};
    uint64_t random = 17;
    for (int i = 0; i < 300; i++) {
        double u = random_value(&random) * 8 - 4, v = random_value(&random) * 8 - 4;
        double w = random_value(&random), h = random_value(&random) * 0.3;
        struct texture_footprint f = {{w, 0}, {0, -h}};
        double sum = 0;
        enum { N = 400 };
        for (int k = 0; k < N * N; k++)
            sum += texture_color(&t, u + ((k % N + 0.5) / N - 0.5) * w,
                                 v + ((k / N + 0.5) / N - 0.5) * h)
                       .r;
        rgb c = texture_filtered(&t, u, v, &f, NULL);
        assert_true(fabs(c.r - sum / (N * N)) < 0.01);
        assert_true(fabs(c.r + c.g - 1) < 1e-12);
        struct texture_footprint none = {{1e-12, 0}, {0, 1e-12}};
        assert_true(texture_filtered(&t, u, v, &none, NULL).r == texture_color(&t, u, v).r);
    }
}

/* Clear texels are blue: with opacity their colour does not bleed, without it is one of all. */
static void clear_texels_do_not_bleed(void **state)
{
    (void)state;
    enum { SIDE = 16 };
    for (int used = 0; used < 2; used++) {
        struct scene s;
        scene_init(&s);
        unsigned char *pixels = mem_alloc_array((size_t)SIDE * SIDE, 4);
        for (size_t i = 0; i < (size_t)SIDE * SIDE; i++)
            memcpy(pixels + 4 * i, i % 2 ? "\0\0\xff\0" : "\xff\0\0\xff", 4);
        add_image_quad(&s, SIDE, SIDE, 4, SCENE_IMAGE_U8_LINEAR, pixels);
        s.materials[0].alpha_used = used;
        struct render_scene *rs = build(&s);
        struct texture_footprint all = {{1, 0}, {0, 1}};
        rgb c = texture_filtered(&rs->textures[0], 0.5, 0.5, &all, NULL);
        assert_true(used ? c.r == 1 && c.b == 0 : fabs(c.r - 0.5) < 0.003 && c.b == c.r);
        /* Opacity is that of the point. */
        assert_true(texture_alpha(&rs->textures[0], 0.5 / SIDE, 0.5) == 1);
        assert_true(texture_alpha(&rs->textures[0], 1.5 / SIDE, 0.5) == 0);
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* Levels take a third of what the picture takes; a picture looked up at points has none. */
static void pyramids_take_a_third(void **state)
{
    (void)state;
    size_t bytes[2];
    enum { SIDE = 2000 };
    for (int i = 0; i < 2; i++) {
        struct scene s;
        scene_init(&s);
        unsigned char *pixels = mem_calloc((size_t)SIDE * SIDE, 3);
        add_image_quad(&s, SIDE, SIDE, 3, SCENE_IMAGE_U8_SRGB, pixels)->filter =
            i ? SCENE_FILTER_MIPMAP : SCENE_FILTER_BILINEAR;
        struct render_scene *rs = build(&s);
        bytes[i] = render_scene_bytes(rs);
        assert_true(rs->has_filtered == (i == 1));
        render_scene_free(rs);
        scene_release(&s);
    }
    double picture = 3.0 * SIDE * SIDE, more = (double)(bytes[1] - bytes[0]) / picture;
    printf("  levels of a picture take %.4f of it\n", more);
    assert_true(more > 0.3 && more < 0.34);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pyramids_keep_means),
        cmocka_unit_test(minified_squares_are_their_mean),
        cmocka_unit_test(fine_footprints_are_bilinear),
        cmocka_unit_test(widening_is_continuous),
        cmocka_unit_test(any_number_is_fine),
        cmocka_unit_test(checkerboards_are_averaged),
        cmocka_unit_test(clear_texels_do_not_bleed),
        cmocka_unit_test(pyramids_take_a_third),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
