/* OBJ material libraries: words, defaults, oddities of real exporters, damage. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/mtl_file.h"
#include "tests/unit/problem_check.h"

static struct mtl_library read_text(const char *text, size_t *warnings)
{
    struct mtl_library library;
    struct diag_list problems;
    diag_init(&problems);
    assert_int_equal(mtl_read(text, strlen(text), "a.mtl", &library, &problems), ERR_OK);
    assert_int_equal(problems.error_count, 0);
    *warnings = problems.warning_count;
    diag_release(&problems);
    return library;
}

static void reads_the_classic_words(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l = read_text(
        "# a comment\nnewmtl red paint\n\tKd 0.9 .1 0 # trailing\r\nKs 0.5\nNs 96\nNi 1.45\n"
        "Ke 2 3 4\nd 0.25\nillum 5\nTf 1 0.5 0\nnewmtl second\n",
        &warnings);
    assert_int_equal(l.count, 2);
    const struct mtl_material *m = &l.materials[0];
    assert_string_equal(m->name, "red paint");
    assert_true(m->kd[0] == 0.9 && m->kd[1] == 0.1 && m->kd[2] == 0);
    assert_true(m->ks[0] == 0.5 && m->ks[2] == 0.5);
    assert_true(m->ke[2] == 4 && m->has_ke && m->ns == 96 && m->ni == 1.45);
    assert_true(m->opacity == 0.25 && m->illum == 5 && m->tf[1] == 0.5);
    assert_true(l.materials[1].kd[0] == 0.8 && !l.materials[1].has_kd);
    assert_true(l.materials[1].opacity == 1 && l.materials[1].illum == -1);
    assert_int_equal(warnings, 0);
    mtl_release(&l);
}

/* Exporters write "d 1" and "Tr 1" for the same opaque material. */
static void believes_d_over_tr(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l = read_text("newmtl a\nd 1\nTr 1\nnewmtl b\nTr 0.25\n", &warnings);
    assert_true(l.materials[0].opacity == 1);
    assert_true(l.materials[1].opacity == 0.75);
    mtl_release(&l);
}

static void reads_maps_and_their_options(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l = read_text(
        "newmtl a\nmap_Kd -s 2 3 1 -o 0.5 -clamp on textures\\my wood.png\n"
        "map_Bump -bm 0.3 -imfchan r b.png\nnorm n.png\nmap_Kd\nmap_Pr -mm 0 1 rough.png  \n",
        &warnings);
    const struct mtl_map *kd = &l.materials[0].maps[MTL_MAP_KD];
    assert_string_equal(kd->path, "textures/my wood.png");
    assert_true(kd->scale[0] == 2 && kd->scale[1] == 3 && kd->offset[0] == 0.5 && kd->clamp);
    assert_string_equal(l.materials[0].maps[MTL_MAP_BUMP].path, "b.png");
    assert_true(l.materials[0].maps[MTL_MAP_BUMP].bump == 0.3);
    assert_string_equal(l.materials[0].maps[MTL_MAP_NORMAL].path, "n.png");
    assert_string_equal(l.materials[0].maps[MTL_MAP_PR].path, "rough.png");
    assert_null(l.materials[0].maps[MTL_MAP_KE].path);
    assert_int_equal(warnings, 1); /* the map_Kd without a file */
    mtl_release(&l);
}

/* Some write a map's options behind its file. They were a part of the name, and the picture gone.
 */
static void reads_options_behind_the_file(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l =
        read_text("newmtl a\nmap_Kd my wood.png -s 2 3 1 -clamp on\nmap_Bump -o 1 b.tga -bm 0.3\n"
                  "map_Ke a -s b.png\nmap_Pr c.png -s\nmap_Pm d.png -s 2 e\nnorm n-1.png -2.png\n"
                  "map_d e.png -bm 2 -q 3\n",
                  &warnings);
    const struct mtl_map *maps = l.materials[0].maps;
    assert_string_equal(maps[MTL_MAP_KD].path, "my wood.png");
    assert_true(maps[MTL_MAP_KD].scale[0] == 2 && maps[MTL_MAP_KD].scale[1] == 3);
    assert_true(maps[MTL_MAP_KD].clamp);
    assert_string_equal(maps[MTL_MAP_BUMP].path, "b.tga");
    assert_true(maps[MTL_MAP_BUMP].bump == 0.3 && maps[MTL_MAP_BUMP].offset[0] == 1);
    /* What only looks like options is a part of the name. */
    assert_string_equal(maps[MTL_MAP_KE].path, "a -s b.png");
    assert_string_equal(maps[MTL_MAP_PR].path, "c.png -s");
    assert_string_equal(maps[MTL_MAP_PM].path, "d.png -s 2 e");
    assert_string_equal(maps[MTL_MAP_NORMAL].path, "n-1.png -2.png");
    assert_string_equal(maps[MTL_MAP_D].path, "e.png -bm 2 -q 3");
    assert_int_equal(warnings, 0);
    mtl_release(&l);
}

static void reads_physical_words(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l =
        read_text("newmtl p\nPr 0.2\nPm 1.5\nPs 0.4\nPc .5\nPcr .6\naniso 0.7\n", &warnings);
    const struct mtl_material *m = &l.materials[0];
    assert_true(m->has_roughness && m->roughness == 0.2);
    assert_true(m->has_metallic && m->metallic == 1); /* clamped */
    assert_true(m->sheen == 0.4 && m->clearcoat == 0.5 && m->clearcoat_roughness == 0.6);
    mtl_release(&l);
}

/* A carriage return alone was taken for a blank, and the file for one material of a long name. */
static void lines_may_end_as_on_old_machines(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l =
        read_text("newmtl a\rKd 1 0 0\rnewmtl b\r\nKd 0 1 0\n\rbad 1\r", &warnings);
    assert_int_equal(l.count, 2);
    assert_string_equal(l.materials[0].name, "a");
    assert_true(l.materials[0].kd[0] == 1 && l.materials[1].kd[1] == 1 && warnings == 0);
    mtl_release(&l);
}

static void warns_of_nonsense_and_keeps_values(void **state)
{
    (void)state;
    size_t warnings;
    struct mtl_library l = read_text("Kd 1 1 1\nnewmtl a\nKd red\nKs 1 2\nNs nan\nNi 1e999\nd\n"
                                     "Kd 0.1 0.2 0.3\nKd spectral x.rfl 1\nwhatever 1 2 3\n",
                                     &warnings);
    assert_int_equal(warnings, 7);
    assert_true(l.materials[0].kd[1] == 0.2 && l.materials[0].opacity == 1);
    mtl_release(&l);
}

/* A number that is none is said with its line, and keeps nothing: "Kd 0.5 nan 0.5" was a grey, and
 * of "-bm inf a.png" the file was called "inf a.png". */
static void says_numbers_that_are_none(void **state)
{
    (void)state;
    static const struct {
        const char *line, *id;
    } cases[] = {
        {"Kd 0.5 nan 0.5", "bad-color"},
        {"Kd 0.5 0.5 inf", "bad-color"},
        {"Kd -inf 0.5 0.5", "bad-color"},
        {"Ke 1 1e999 1", "bad-color"},
        {"Ks 0.5 x", "bad-color"},
        {"Ns inf", "bad-number"},
        {"Ni NaN", "bad-number"},
        {"d -Infinity", "bad-number"},
        {"Pr 1e200", "bad-number"},
        {"map_Kd -s nan 1 1 a.png", "bad-number"},
        {"map_Kd -o 1 inf a.png", "bad-number"},
        {"map_Kd -bm -nan a.png", "bad-number"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char text[120];
        struct mtl_library l;
        struct diag_list problems;
        int n = snprintf(text, sizeof text, "newmtl a\nPr 0.25\n%s\n", cases[i].line);
        diag_init(&problems);
        assert_int_equal(mtl_read(text, (size_t)n, "a.mtl", &l, &problems), ERR_OK);
        const struct diag *d = problem_find(&problems, cases[i].id, "a.mtl");
        if (!d || d->line != 3 || problems.warning_count != 1)
            fail_msg("%s: %zu warnings", cases[i].line, problems.warning_count);
        const struct mtl_material *m = &l.materials[0];
        const struct mtl_map *map = &m->maps[MTL_MAP_KD];
        assert_true(!m->has_kd && m->kd[0] == 0.8 && m->opacity == 1 && m->roughness == 0.25);
        assert_true(m->has_roughness && isfinite(map->scale[0]) && isfinite(map->bump));
        assert_true(strncmp(cases[i].line, "map", 3) != 0 || strcmp(map->path, "a.png") == 0);
        mtl_release(&l);
        diag_release(&problems);
    }
}

/* Every cut of a library gives a library, and nothing is read past the end. */
static void takes_any_cut(void **state)
{
    (void)state;
    static const char text[] = "newmtl a\nKd 1 .5 0.25\nmap_Kd -s 1 2 -o 3 a b.png\nd -halo 0.5\n";
    for (size_t bytes = 0; bytes < sizeof text; bytes++) {
        struct mtl_library l;
        struct diag_list problems;
        char *cut = mem_alloc(bytes + (bytes == 0));
        assert_non_null(cut);
        memcpy(cut, text, bytes);
        diag_init(&problems);
        assert_int_equal(mtl_read(cut, bytes, NULL, &l, &problems), ERR_OK);
        mtl_release(&l);
        diag_release(&problems);
        mem_free(cut);
    }
}

static void survives_lack_of_memory(void **state)
{
    (void)state;
    static const char text[] = "newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Ke b.png\n";
    enum err e = ERR_NOMEM;
    for (uint64_t n = 0; e == ERR_NOMEM; n++) {
        struct mtl_library l;
        struct diag_list problems;
        diag_init(&problems);
        mem_fail_after(n);
        e = mtl_read(text, sizeof text - 1, "a.mtl", &l, &problems);
        mem_fail_after(UINT64_MAX);
        if (e == ERR_OK)
            mtl_release(&l);
        diag_release(&problems);
        assert_true(n < 100);
    }
    assert_int_equal(e, ERR_OK);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(reads_the_classic_words),
        cmocka_unit_test(believes_d_over_tr),
        cmocka_unit_test(reads_maps_and_their_options),
        cmocka_unit_test(reads_options_behind_the_file),
        cmocka_unit_test(reads_physical_words),
        cmocka_unit_test(lines_may_end_as_on_old_machines),
        cmocka_unit_test(warns_of_nonsense_and_keeps_values),
        cmocka_unit_test(says_numbers_that_are_none),
        cmocka_unit_test(takes_any_cut),
        cmocka_unit_test(survives_lack_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
