/* Which pictures are late: many and large ones, and none that building a scene reads. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <string.h>

#include "common/mem.h"
#include "common/package_late.h"

enum { MESHES = 3, IMAGES = 20, BIG = 2 << 20 };

/* Tables of a scene in which picture i is shown by texture i, and that by material i. */
struct rig {
    struct scene tables;
    struct package_index index;
    struct scene_texture textures[IMAGES + 1];
    struct scene_material materials[IMAGES];
    struct package_index_entry entries[MESHES + IMAGES];
    bool late[MESHES + IMAGES];
};

static void rig_init(struct rig *r, uint64_t bytes)
{
    memset(r, 0, sizeof *r);
    scene_init(&r->tables);
    r->tables.mesh_count = MESHES;
    r->tables.image_count = r->tables.material_count = IMAGES;
    r->tables.texture_count = IMAGES + 1;
    r->tables.textures = r->textures;
    r->tables.materials = r->materials;
    r->index = (struct package_index){.entries = r->entries, .count = MESHES + IMAGES};
    for (uint32_t i = 0; i < IMAGES; i++) {
        scene_image_texture_init(&r->textures[i]);
        r->textures[i].image = i;
        scene_material_init(&r->materials[i]);
        r->materials[i].texture = i;
    }
    scene_texture_init(&r->textures[IMAGES]); /* of one colour */
    for (uint32_t i = 0; i < MESHES + IMAGES; i++)
        r->entries[i] = (struct package_index_entry){
            .bytes = bytes, .kind = i < MESHES ? PACKAGE_MESH : PACKAGE_IMAGE};
}

static size_t choose(struct rig *r)
{
    memset(r->late, 1, sizeof r->late);
    size_t count = package_late_choose(&r->tables, &r->index, r->late), marked = 0;
    for (size_t i = 0; i < MESHES + IMAGES; i++)
        marked += r->late[i];
    assert_int_equal(count, marked);
    for (size_t i = 0; i < MESHES; i++)
        assert_false(r->late[i]);
    return count;
}

static void large_pictures_are_late(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, BIG);
    assert_int_equal(choose(&r), IMAGES);
    r.entries[MESHES + 4].bytes = PACKAGE_LATE_BYTES_MIN - 1;
    assert_int_equal(choose(&r), IMAGES - 1);
    assert_false(r.late[MESHES + 4]);
    r.entries[MESHES + 4].bytes = PACKAGE_LATE_BYTES_MIN;
    assert_int_equal(choose(&r), IMAGES);
}

static void few_or_small_ones_are_not(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, BIG);
    /* One less than eight. */
    for (size_t i = PACKAGE_LATE_COUNT_MIN - 1; i < IMAGES; i++)
        r.entries[MESHES + i].bytes = 100;
    r.entries[MESHES].bytes = UINT64_C(1) << 33;
    assert_int_equal(choose(&r), 0);
    r.entries[MESHES + IMAGES - 1].bytes = PACKAGE_LATE_BYTES_MIN;
    assert_int_equal(choose(&r), PACKAGE_LATE_COUNT_MIN);
    /* One byte less than 16 MiB in all. */
    rig_init(&r, PACKAGE_LATE_SUM_MIN / IMAGES);
    assert_true(PACKAGE_LATE_SUM_MIN / IMAGES * IMAGES < PACKAGE_LATE_SUM_MIN);
    assert_int_equal(choose(&r), 0);
    r.entries[MESHES].bytes += PACKAGE_LATE_SUM_MIN % IMAGES - 1;
    assert_int_equal(choose(&r), 0);
    r.entries[MESHES].bytes += 1;
    assert_int_equal(choose(&r), IMAGES);
}

static void what_building_reads_is_not(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, BIG);
    r.tables.envmap.texture = 2;
    r.materials[3].emission_texture = 5;
    r.materials[7].alpha_used = true;
    r.materials[8].alpha_used = true;
    r.materials[8].texture = IMAGES;
    r.materials[8].normal_texture = 9;
    r.materials[10].texture = SCENE_NONE;
    assert_int_equal(choose(&r), IMAGES - 3);
    assert_false(r.late[MESHES + 2] || r.late[MESHES + 5] || r.late[MESHES + 7]);
    /* By whatever else a picture is shown. */
    r.textures[12].image = 2;
    r.textures[13].image = 5;
    assert_int_equal(choose(&r), IMAGES - 3);
    /* And those that are left must be enough. */
    rig_init(&r, BIG);
    for (uint32_t i = 0; i < IMAGES - PACKAGE_LATE_COUNT_MIN + 1; i++)
        r.materials[i].alpha_used = true;
    assert_int_equal(choose(&r), 0);
}

/* One in pieces is late however small and alone, and its pieces with it, unless another picture
 * that is not late has them, too. */
static void those_in_pieces_are_late(void **state)
{
    (void)state;
    struct rig r;
    enum { PIECES = 3, FIRST = MESHES + IMAGES };
    struct package_pieces pieces[IMAGES] = {{0}};
    struct package_index_entry entries[FIRST + PIECES] = {{.bytes = 1}};
    bool late[FIRST + PIECES];
    static const uint32_t one[] = {FIRST, FIRST + 1}, other[] = {FIRST + 2, FIRST + 1};
    rig_init(&r, 100);
    memcpy(entries, r.entries, sizeof r.entries);
    pieces[4] = (struct package_pieces){2, 1, one};
    r.index = (struct package_index){.entries = entries, .count = FIRST + PIECES, .pieces = pieces};
    assert_int_equal(package_late_choose(&r.tables, &r.index, late), 1);
    assert_true(late[MESHES + 4] && late[FIRST] && late[FIRST + 1]);
    assert_false(late[MESHES + 3]);
    pieces[5] = (struct package_pieces){2, 1, other};
    r.materials[5].emission_texture = 5;
    assert_int_equal(package_late_choose(&r.tables, &r.index, late), 1);
    assert_true(late[MESHES + 4] && late[FIRST]);
    assert_false(late[MESHES + 5] || late[FIRST + 1] || late[FIRST + 2]);
}

static void no_pictures_no_matter(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, BIG);
    r.tables.image_count = r.tables.texture_count = r.tables.material_count = 0;
    r.index.count = MESHES;
    memset(r.late, 1, sizeof r.late);
    assert_int_equal(package_late_choose(&r.tables, &r.index, r.late), 0);
    assert_false(r.late[0] || r.late[MESHES - 1]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(large_pictures_are_late),    cmocka_unit_test(few_or_small_ones_are_not),
        cmocka_unit_test(what_building_reads_is_not), cmocka_unit_test(those_in_pieces_are_late),
        cmocka_unit_test(no_pictures_no_matter),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
