/* OBJ and PLY: forms, polygons, refusals with their line; the models of the data folder. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/buf.h"
#include "common/mem.h"
#include "common/model_file.h"
#include "common/obj_mesh.h"
#include "common/ply_file.h"
#include "common/polygon.h"
#include "tests/unit/problem_check.h"

struct loaded {
    struct scene_mesh mesh;
    struct diag_list problems;
    enum err e;
};

static void load_obj(struct loaded *l, const char *text)
{
    struct obj_model model;
    diag_init(&l->problems);
    l->mesh = (struct scene_mesh){0};
    l->e = obj_read(text, strlen(text), "m.obj", &model, &l->problems);
    if (l->e != ERR_OK)
        return;
    if (model.triangle_count)
        l->e = obj_mesh(&model, OBJ_MATERIAL_ALL, &l->mesh);
    obj_release(&model);
}

static void load_ply(struct loaded *l, const void *data, size_t bytes)
{
    diag_init(&l->problems);
    l->mesh = (struct scene_mesh){0};
    l->e = ply_read_mesh(data, bytes, "m.ply", &l->mesh, &l->problems);
}

static void unload(struct loaded *l)
{
    scene_mesh_release(&l->mesh);
    diag_release(&l->problems);
}

static double mesh_area(const struct scene_mesh *m)
{
    double sum = 0;
    for (size_t t = 0; t < m->triangle_count; t++) {
        const double *a = m->positions + 3 * m->indices[3 * t];
        const double *b = m->positions + 3 * m->indices[3 * t + 1];
        const double *c = m->positions + 3 * m->indices[3 * t + 2];
        double u[3], v[3];
        for (int i = 0; i < 3; i++) {
            u[i] = b[i] - a[i];
            v[i] = c[i] - a[i];
        }
        double x = u[1] * v[2] - u[2] * v[1], y = u[2] * v[0] - u[0] * v[2];
        double z = u[0] * v[1] - u[1] * v[0];
        sum += sqrt(x * x + y * y + z * z) / 2;
    }
    return sum;
}

static void obj_forms_are_read(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l,
             "# c\r\nmtllib a b.mtl\r\no thing\n v 0 0 0 1 0 0\nv 1 0 0\nv +1 .5e0 0.\nv 0 1e0 0\n"
             "vt 0 1\nvt 0.5\nvn 0 0 2\nusemtl red paint\ns 1\nf 1/1/1 2/2/1 \\\n 3//1 4/1\n"
             "l 1 2\np 1\ng a b\nf -4 -3 -2 # end");
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.mesh.triangle_count, 3);
    assert_int_equal(l.mesh.vertex_count, 7); /* 1, 2, 3, 4 as in the quad; 1, 2, 3 bare */
    assert_true(l.mesh.normals[2] == 1);      /* made unit */
    assert_true(l.mesh.uvs[1] == 1);
    unload(&l);
}

/* A file that a text editor marked as UTF-8: its first line is a line like others. Here it was a
 * vertex, which was lost. */
static void obj_may_begin_with_a_mark(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "\xEF\xBB\xBFv 4 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert_int_equal(l.e, ERR_OK);
    assert_true(l.mesh.vertex_count == 3 && l.mesh.positions[0] == 4);
    unload(&l);
}

static void near_color(const float *c, double r, double g, double b)
{
    assert_true(fabs((double)c[0] - r) < 1e-6 && fabs((double)c[1] - g) < 1e-6 &&
                fabs((double)c[2] - b) < 1e-6);
}

/* 0.5 and 188/255 sRGB-encoded, by the standard's formula. */
#define HALF_DECODED 0.21404114
#define B188_DECODED 0.50288646

static void obj_colors_are_decoded(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "v 0 0 0\nv 1 0 0 0.5 1 0\nv 0 1 0 7 -1 0.5 1\nv 1 1 0 1\nf 1 2 3\nf 2 4 3");
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.problems.warning_count, 0);
    near_color(l.mesh.colors, 1, 1, 1); /* none of its own */
    near_color(l.mesh.colors + 3, HALF_DECODED, 1, 0);
    near_color(l.mesh.colors + 6, 1, 0, HALF_DECODED);
    near_color(l.mesh.colors + 9, 1, 1, 1); /* a weight is no colour */
    unload(&l);
    load_obj(&l, "v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3");
    assert_null(l.mesh.colors);
    unload(&l);
}

/* Opacity is never encoded; without colours there is none. */
static void ply_alphas_are_read(void **state)
{
    (void)state;
    static const struct {
        const char *type, *colors, *rows;
        double second; /* under 0: none */
    } cases[] = {
        {"uchar", "red green blue", "0 0 0 0 0 0 0\n1 0 0 9 9 9 51\n0 1 0 9 9 9 255\n", 0.2},
        {"float", "red green blue", "0 0 0 0 0 0 0\n1 0 0 1 1 1 .75\n0 1 0 1 1 1 7\n", 0.75},
        {"uchar", "a b c", "0 0 0 0 0 0 0\n1 0 0 9 9 9 51\n0 1 0 9 9 9 255\n", -1},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct loaded l;
        char text[500], names[3][8];
        const char *t = cases[i].type;
        assert_int_equal(sscanf(cases[i].colors, "%7s %7s %7s", names[0], names[1], names[2]), 3);
        int n =
            snprintf(text, sizeof text,
                     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                     "property float z\nproperty %s %s\nproperty %s %s\nproperty %s %s\n"
                     "property %s alpha\nelement face 1\nproperty list uchar int vertex_indices\n"
                     "end_header\n%s3 0 1 2\n",
                     t, names[0], t, names[1], t, names[2], t, cases[i].rows);
        load_ply(&l, text, (size_t)n);
        assert_int_equal(l.e, ERR_OK);
        assert_true((l.mesh.alphas != NULL) == (cases[i].second >= 0));
        if (l.mesh.alphas) {
            assert_true(l.mesh.alphas[0] == 0 && l.mesh.alphas[2] == 1);
            assert_true(fabs((double)l.mesh.alphas[1] - cases[i].second) < 1e-7);
        }
        unload(&l);
    }
}

static void ply_colors_are_told_by_type(void **state)
{
    (void)state;
    static const struct {
        const char *type, *rows;
        double second[3];
    } cases[] = {
        {"uchar", "0 0 0 0 0 0\n1 0 0 188 255 0\n0 1 0 9 9 9\n", {B188_DECODED, 1, 0}},
        {"ushort", "0 0 0 0 0 0\n1 0 0 48316 65535 0\n0 1 0 9 9 9\n", {B188_DECODED, 1, 0}},
        {"float", "0 0 0 0 0 0\n1 0 0 0.25 1.5 -1\n0 1 0 0 0 0\n", {0.25, 1, 0}},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct loaded l;
        char text[500];
        const char *t = cases[i].type;
        int n =
            snprintf(text, sizeof text,
                     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
                     "property float z\nproperty %s red\nproperty %s green\nproperty %s blue\n"
                     "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
                     "%s3 0 1 2\n",
                     t, t, t, cases[i].rows);
        load_ply(&l, text, (size_t)n);
        assert_int_equal(l.e, ERR_OK);
        near_color(l.mesh.colors + 3, cases[i].second[0], cases[i].second[1], cases[i].second[2]);
        unload(&l);
    }
}

/* The names that older programs give them. */
static void ply_diffuse_colors_are_colors(void **state)
{
    (void)state;
    static const char text[] =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar diffuse_red\nproperty uchar diffuse_green\n"
        "property uchar diffuse_blue\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0 0 0 0\n1 0 0 188 255 0\n0 1 0 9 9 9\n3 0 1 2\n";
    struct loaded l;
    load_ply(&l, text, sizeof text - 1);
    assert_int_equal(l.e, ERR_OK);
    assert_non_null(l.mesh.colors);
    near_color(l.mesh.colors + 3, B188_DECODED, 1, 0);
    unload(&l);
}

static void obj_keeps_double_coordinates(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "v 1000000.123456789 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3");
    assert_int_equal(l.e, ERR_OK);
    assert_true(l.mesh.positions[0] == 1000000.123456789);
    unload(&l);
}

static void obj_problems_have_their_line(void **state)
{
    (void)state;
    static const struct {
        const char *text, *id;
        uint64_t line;
    } cases[] = {
        {"v 0 0 0\nv 0 nan 0\n", "not-finite", 2},
        {"v 0 0 0\nv 0 1e999 0\n", "not-finite", 2},
        {"v 0 0\n", "not-finite", 1},
        {"v a b c\n", "not-finite", 1},
        {"v 0 0 0\nv 0 1 0\nv 1 0 0\n\nf 1 2 4\n", "index-out-of-range", 5},
        {"v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 0\n", "index-out-of-range", 4},
        {"v 0 0 0\nv 0 1 0\nv 1 0 0\nf 1 2 -4\n", "index-out-of-range", 4},
        {"v 0 0 0\nf 1 2 99999999999\n", "index-out-of-range", 2},
        {"v 0 0 0\nf 1 b 1\n", "obj-syntax", 2},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct loaded l;
        load_obj(&l, cases[i].text);
        const struct diag *d = problem_find(&l.problems, cases[i].id, "m.obj");
        if (l.e != ERR_INPUT || !d || d->line != cases[i].line)
            fail_msg("not refused as %s: %s", cases[i].id, cases[i].text);
        unload(&l);
    }
}

static void obj_survives_small_faults_with_a_warning(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "v 0 0 0\nv 1 0 0x\nv 0 1 0\nf 1 2\nf 1/7/7 2 3\n");
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.mesh.triangle_count, 1);
    assert_null(l.mesh.uvs);
    assert_int_equal(l.problems.warning_count, 3);
    unload(&l);
}

static void obj_vertices_may_come_later(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "f 1 2 3 4\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n");
    assert_int_equal(l.e, ERR_OK);
    assert_true(mesh_area(&l.mesh) == 1);
    unload(&l);
}

/* The triangles of a concave outline cover it once: their areas sum to its area. */
static void concave_polygons_are_cut_along_their_shape(void **state)
{
    (void)state;
    struct loaded l;
    load_obj(&l, "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nf 1 2 3 4 5\n");
    assert_int_equal(l.mesh.triangle_count, 3);
    assert_true(fabs(mesh_area(&l.mesh) - 10) < 1e-12);
    unload(&l);
    load_obj(&l, "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 2 1 0\nv 0 4 0\nf 5 4 3 2 1\n");
    assert_true(fabs(mesh_area(&l.mesh) - 10) < 1e-12);
    unload(&l);
    /* A comb in the plane x = z, every tooth a notch. */
    double points[3 * 202];
    size_t n = 0;
    for (int i = 0; i <= 100; i++, n += 3) {
        points[n] = points[n + 2] = i;
        points[n + 1] = i % 2 ? 9 : 1;
    }
    points[n] = points[n + 2] = 100;
    points[n + 1] = 0;
    points[n + 3] = points[n + 4] = points[n + 5] = 0;
    size_t corners = n / 3 + 2;
    uint32_t triangles[200][3];
    assert_true(corners - 2 <= 200);
    polygon_split(points, corners, triangles);
    double area = 0;
    for (size_t t = 0; t < corners - 2; t++) {
        const double *a = points + 3 * triangles[t][0], *b = points + 3 * triangles[t][1];
        const double *c = points + 3 * triangles[t][2];
        area += fabs((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2;
    }
    assert_true(fabs(area - 500) < 1e-9);
}

static void hostile_polygons_end(void **state)
{
    (void)state;
    enum { CORNERS = 1000 };
    static double points[3 * CORNERS];
    static uint32_t triangles[CORNERS][3];
    memset(points, 0, sizeof points);
    polygon_split(points, CORNERS, triangles);
    for (size_t i = 0; i < CORNERS; i++) { /* a self-crossing star */
        points[3 * i] = (double)(i * 7919 % CORNERS);
        points[3 * i + 1] = (double)(i * i * 31 % CORNERS);
    }
    polygon_split(points, CORNERS, triangles);
    for (size_t t = 0; t < CORNERS - 2; t++)
        for (int j = 0; j < 3; j++)
            assert_true(triangles[t][j] < CORNERS);
}

/* Three positions with many coordinates each, then all of them again: as many vertices as there are
 * kinds of corners, in the order of their first use. */
static void obj_corners_become_few_vertices(void **state)
{
    (void)state;
    enum { TRIANGLES = 3000 };
    struct buf b;
    struct loaded l;
    buf_init(&b);
    buf_printf(&b, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\n");
    for (int i = 0; i < TRIANGLES; i++)
        buf_printf(&b, "vt %d.5 0.25\n", i);
    for (int i = 0; i < 2 * TRIANGLES; i++) {
        int uv = i % TRIANGLES + 1;
        buf_printf(&b, "f 1/%d 2/%d 3/%d\n", uv, uv, uv);
    }
    buf_put_u8(&b, 0);
    load_obj(&l, (const char *)b.data);
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.mesh.triangle_count, 2 * TRIANGLES);
    assert_int_equal(l.mesh.vertex_count, 3 * TRIANGLES);
    for (uint32_t i = 0; i < 6 * TRIANGLES; i++)
        assert_int_equal(l.mesh.indices[i], i % (3 * TRIANGLES));
    for (uint32_t v = 0; v < 3 * TRIANGLES; v++)
        assert_true((double)l.mesh.uvs[2 * (size_t)v] == v / 3 + 0.5);
    unload(&l);
    buf_release(&b);
}

static const char ply_header[] = "element vertex 4\nproperty double x\nproperty double y\n"
                                 "property double z\nelement face 1\n"
                                 "property list uchar int vertex_indices\nend_header\n";

static void put_scalar(struct buf *b, const void *v, size_t bytes, bool big)
{
    const unsigned char *p = v;
    for (size_t i = 0; i < bytes; i++)
        buf_put_u8(b, p[big ? bytes - 1 - i : i]);
}

static void ply_gives_the_same_in_every_form(void **state)
{
    (void)state;
    static const double square[12] = {0, 0, 0, 1.25, 0, 0, 1.25, 2, 0, 0, 2, 0.1};
    for (int form = 0; form < 3; form++) {
        static const char *const names[] = {"ascii", "binary_little_endian", "binary_big_endian"};
        struct buf b;
        struct loaded l;
        buf_init(&b);
        buf_printf(&b, "ply\nformat %s 1.0\ncomment x\n%s", names[form], ply_header);
        for (int i = 0; i < 12; i++)
            if (form == 0)
                buf_printf(&b, "%.17g%s", square[i], i % 3 == 2 ? " 7 7\n" : " ");
            else
                put_scalar(&b, &square[i], 8, form == 2);
        if (form == 0)
            buf_printf(&b, "4 0 1 2 3\n");
        else
            buf_put_u8(&b, 4);
        for (int32_t i = 0; form != 0 && i < 4; i++)
            put_scalar(&b, &i, 4, form == 2);
        load_ply(&l, b.data, b.bytes);
        assert_int_equal(l.e, ERR_OK);
        assert_int_equal(l.mesh.triangle_count, 2);
        assert_memory_equal(l.mesh.positions, square, sizeof square);
        unload(&l);
        for (size_t cut = 0; cut + 1 < b.bytes; cut++) { /* any shorter file is refused */
            load_ply(&l, b.data, cut);
            assert_true(l.e == ERR_INPUT || form == 0);
            unload(&l);
        }
        buf_release(&b);
    }
}

/* Runs of triangles, which are taken together, among faces that are something else. */
static void ply_triangles_and_others_take_turns(void **state)
{
    (void)state;
    static const unsigned char corners[] = {3, 3, 4, 3, 2, 3, 3, 5};
    static const double points[18] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 2, 2, 1, 3, 2, 1};
    enum { FACES = sizeof corners, TRIANGLES = 5 + 2 + 3 };
    for (int broken = -1; broken < FACES; broken++) {
        struct buf b;
        struct loaded l;
        buf_init(&b);
        buf_printf(&b,
                   "ply\nformat binary_little_endian 1.0\nelement vertex 6\nproperty double x\n"
                   "property double y\nproperty double z\nelement face %d\n"
                   "property list uchar int vertex_indices\nend_header\n",
                   FACES);
        buf_put(&b, points, sizeof points);
        for (int i = 0; i < FACES; i++) {
            buf_put_u8(&b, corners[i]);
            for (uint32_t k = 0; k < corners[i]; k++)
                buf_put_u32(&b, i == broken && k == 1 ? 6 : (k + (uint32_t)i % 2) % 6);
        }
        load_ply(&l, b.data, b.bytes);
        if (broken < 0) {
            assert_int_equal(l.e, ERR_OK);
            assert_int_equal(l.mesh.triangle_count, TRIANGLES);
            static const uint32_t first[] = {0, 1, 2, 1, 2, 3};
            assert_memory_equal(l.mesh.indices, first, sizeof first);
        } else {
            assert_int_equal(l.e, ERR_INPUT);
            assert_true(problem_find(&l.problems, "index-out-of-range", "m.ply"));
        }
        unload(&l);
        for (size_t cut = b.bytes - 60; broken < 0 && cut < b.bytes; cut++) {
            load_ply(&l, b.data, cut);
            assert_int_equal(l.e, ERR_INPUT);
            unload(&l);
        }
        buf_release(&b);
    }
}

/* Coordinates of corners: a vertex is split where they differ, shared where they agree, dropped
 * where no face has it. A polygon's go with its triangles; a face with too few gets zeros. */
static void ply_corners_have_coordinates(void **state)
{
    (void)state;
    static const char text[] =
        "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement face 3\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
        "0 0 0\n1 0 0\n1 1 0\n0 1 0\n9 9 9\n0 0 1\n"
        "4 0 1 2 3 8 .1 .2 .3 .4 .5 .6 .7 .8\n"
        "3 0 1 5 6 .1 .2 .9 .9 .5 .5\n"
        "3 0 2 5 2 1 1\n";
    struct loaded l;
    load_ply(&l, text, sizeof text - 1);
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.mesh.triangle_count, 4);
    /* 0 and 1 come twice, 2 twice (zeros), 5 twice, 0 once more with zeros, 3 once; 4 is gone. */
    assert_int_equal(l.mesh.vertex_count, 3 + 3 + 2 + 1);
    assert_non_null(l.mesh.uvs);
    static const float expected[4][3][2] = {
        {{.1f, .2f}, {.3f, .4f}, {.5f, .6f}},
        {{.1f, .2f}, {.5f, .6f}, {.7f, .8f}},
        {{.1f, .2f}, {.9f, .9f}, {.5f, .5f}},
        {{0, 0}, {0, 0}, {0, 0}},
    };
    for (size_t t = 0; t < 4; t++)
        for (size_t k = 0; k < 3; k++) {
            uint32_t v = l.mesh.indices[3 * t + k];
            assert_true(v < l.mesh.vertex_count);
            assert_memory_equal(l.mesh.uvs + 2 * v, expected[t][k], sizeof expected[t][k]);
        }
    /* Positions went with their vertices: the last face is 0, 2, 5. */
    const double *p = l.mesh.positions + 3 * (size_t)l.mesh.indices[10];
    assert_true(p[0] == 1 && p[1] == 1 && p[2] == 0);
    unload(&l);
}

static void ply_problems_are_named(void **state)
{
    (void)state;
    static const struct {
        const char *text, *id;
    } cases[] = {
        {"", "ply-header"},
        {"plx\n", "ply-header"},
        {"ply\nend_header\n", "ply-header"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n",
         "ply-header"},
        {"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "ply-header"},
        {"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
         "property float z\nend_header\n0 0 0\n",
         "ply-data"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 0\n3 0 0 1\n",
         "index-out-of-range"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
         "0 0 1e999\n3 0 0 0\n",
         "not-finite"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         "property float z\nend_header\n0 0 0\n",
         "empty-mesh"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct loaded l;
        load_ply(&l, cases[i].text, strlen(cases[i].text));
        if (l.e != ERR_INPUT || !problem_find(&l.problems, cases[i].id, "m.ply"))
            fail_msg("not refused as %s: %s", cases[i].id, cases[i].text);
        unload(&l);
    }
}

/* Elements are counted from 1 in every message; an index is told as the file has it. */
static void ply_problems_count_from_one(void **state)
{
    (void)state;
    static const char head[] =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float u\nproperty float v\nelement face 2\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n";
    static const struct {
        const char *rest, *id, *said;
    } cases[] = {
        {"0 0 0 0 0\n0 1e200 0 0 0\n1 1 0 0 0\n3 0 1 2 0\n3 0 1 2 0\n", "not-finite",
         "vertex 2 of 3: y is 1e+200, must be a finite number"},
        {"0 0 0 0 0\n0 1 0 0 1e39\n1 1 0 0 0\n3 0 1 2 0\n3 0 1 2 0\n", "not-finite",
         "vertex 2 of 3: v is 1e+39, must be a finite number"},
        {"0 0 0 0 0\n0 nan 0 0 0\n1 1 0 0 0\n3 0 1 2 0\n3 0 1 2 0\n", "ply-data",
         "vertex 2 of 3: expected a number"},
        {"0 0 0 0 0\n0 1 0 0 0\n1 1 0 0 0\n3 0 1 2 0\n3 0 1 3 0\n", "index-out-of-range",
         "face 2 of 2: index 3, expected 0 to 2"},
        {"0 0 0 0 0\n0 1 0 0 0\n1 1 0 0 0\n3 0 1 2 0\n-3 0 1 2 0\n", "ply-data",
         "face 2 of 2: a list of an impossible length"},
        {"0 0 0 0 0\n0 1 0 0 0\n1 1 0 0 0\n3 0 1 2 0\n3 0 1 2 6 0 0 0 1e999 0 0\n", "not-finite",
         "face 2 of 2: v of a corner is inf, must be a finite number"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct loaded l;
        char text[600];
        int n = snprintf(text, sizeof text, "%s%s", head, cases[i].rest);
        load_ply(&l, text, (size_t)n);
        const struct diag *d = problem_find(&l.problems, cases[i].id, "m.ply");
        assert_true(l.e == ERR_INPUT && d);
        assert_string_equal(d->text, cases[i].said);
        unload(&l);
    }
}

static void ply_faces_may_come_first(void **state)
{
    (void)state;
    struct loaded l;
    const char *text = "ply\nformat ascii 1.0\nelement face 1\n"
                       "property list uchar uint vertex_index\nelement vertex 4\nproperty int x\n"
                       "property int y\nproperty int z\nend_header\n4 0 1 2 3\n"
                       "0 0 0\n2 0 0\n2 3 0\n0 3 0\n";
    load_ply(&l, text, strlen(text));
    assert_int_equal(l.e, ERR_OK);
    assert_true(mesh_area(&l.mesh) == 6);
    unload(&l);
}

static void memory_runs_out_cleanly(void **state)
{
    (void)state;
    static const char obj[] =
        "mtllib a\nusemtl b\ng c\nf 1/1/1 2 3 4 5\nv 0 0 0\nv 1 0 0\nv 1 1 0\n"
        "v 0 1 0\nv 0 0.5 0\nvt 0 0\nvn 0 0 1\nf -1 -2\n";
    static const char ply[] = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n"
                              "property float y\nproperty float z\nproperty float nx\n"
                              "property float ny\nproperty float nz\nelement face 1\n"
                              "property list uchar int vertex_indices\nend_header\n0 0 0 0 0 1\n"
                              "1 0 0 0 0 1\n1 1 0 0 0 1\n0 1 0 0 0 1\n4 0 1 2 3\n";
    for (int form = 0; form < 2; form++) {
        struct loaded l = {.e = ERR_NOMEM};
        for (uint64_t n = 0; l.e != ERR_OK; n++) {
            mem_fail_after(n);
            if (form == 0)
                load_obj(&l, obj);
            else
                load_ply(&l, ply, sizeof ply - 1);
            mem_fail_after(UINT64_MAX);
            assert_true(l.e == ERR_OK || l.e == ERR_NOMEM);
            unload(&l);
        }
    }
}

static void outside_models_load(void **state)
{
    (void)state;
    static const struct {
        const char *path;
        uint32_t triangles;
    } models[] = {
        {"obj/spot/spot_triangulated.obj", 5856},
        {"obj/spot/spot_quadrangulated.obj", 5856},
        {"cornell/mcguire/CornellBox-Original.obj", 36},
        {"ply/happly/platonic_shelf_ascii.ply", 80},
        {"ply/happly/platonic_shelf_big_endian.ply", 80},
        {"ply/trimesh/fuze_ascii.ply", 1000},
        {"ply/tinyply/icosahedron.ply", 20},
        {"ply/draco/Box.ply", 12},
    };
    const char *data = getenv("TILERY_TEST_DATA");
    if (!data)
        skip();
    for (size_t i = 0; i < sizeof models / sizeof *models; i++) {
        struct loaded l = {0};
        char *path = mem_sprintf("%s/%s", data, models[i].path);
        diag_init(&l.problems);
        assert_int_equal(model_read_mesh(path, path, &l.mesh, &l.problems), ERR_OK);
        assert_int_equal(l.mesh.triangle_count, models[i].triangles);
        mem_free(path);
        unload(&l);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(obj_forms_are_read),
        cmocka_unit_test(obj_may_begin_with_a_mark),
        cmocka_unit_test(obj_colors_are_decoded),
        cmocka_unit_test(ply_colors_are_told_by_type),
        cmocka_unit_test(ply_alphas_are_read),
        cmocka_unit_test(ply_diffuse_colors_are_colors),
        cmocka_unit_test(obj_keeps_double_coordinates),
        cmocka_unit_test(obj_problems_have_their_line),
        cmocka_unit_test(obj_survives_small_faults_with_a_warning),
        cmocka_unit_test(obj_vertices_may_come_later),
        cmocka_unit_test(concave_polygons_are_cut_along_their_shape),
        cmocka_unit_test(hostile_polygons_end),
        cmocka_unit_test(obj_corners_become_few_vertices),
        cmocka_unit_test(ply_gives_the_same_in_every_form),
        cmocka_unit_test(ply_triangles_and_others_take_turns),
        cmocka_unit_test(ply_corners_have_coordinates),
        cmocka_unit_test(ply_problems_are_named),
        cmocka_unit_test(ply_problems_count_from_one),
        cmocka_unit_test(ply_faces_may_come_first),
        cmocka_unit_test(memory_runs_out_cleanly),
        cmocka_unit_test(outside_models_load),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
