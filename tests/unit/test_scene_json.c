/* Scene files: the committed scenes, every default, old forms, and every refusal with its place. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/scene_json.h"
#include "tests/unit/problem_check.h"

/* A folder with two meshes, made once. */
static char folder[] = P_tmpdir "/tilery-scene-XXXXXX";

static void put_file(const char *name, const char *text)
{
    char *path = file_join(folder, name);
    assert_int_equal(file_write(path, text, strlen(text)), ERR_OK);
    mem_free(path);
}

static const char *const file_names[] = {"tri.obj", "Case.obj",  "empty.obj", "bad.obj",
                                         "bad.exr", "loose.obj", "points.ply"};

static int make_folder(void **state)
{
    (void)state;
    assert_non_null(mkdtemp(folder));
    put_file("tri.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    put_file("Case.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    put_file("empty.obj", "v 0 0 0\n");
    put_file("bad.obj", "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 9\n");
    put_file("bad.exr", "no picture\n");
    put_file("loose.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/7 2 3\nf 1//2 2 3\n");
    put_file("points.ply", "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
                           "property float y\nproperty float z\nend_header\n0 0 0\n");
    return 0;
}

static int remove_folder(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof file_names / sizeof *file_names; i++) {
        char *path = file_join(folder, file_names[i]);
        (void)unlink(path);
        mem_free(path);
    }
    return rmdir(folder);
}

struct loaded {
    struct scene scene;
    struct job_spec spec;
    struct diag_list problems;
    enum err e;
};

static void load(struct loaded *l, const char *text)
{
    diag_init(&l->problems);
    l->e = scene_json_read(text, strlen(text), "s.json", folder, &l->scene, &l->spec, &l->problems);
    assert_int_equal(l->e == ERR_INPUT, l->problems.error_count > 0);
}

static void unload(struct loaded *l)
{
    if (l->e == ERR_OK)
        scene_release(&l->scene);
    diag_release(&l->problems);
}

/* A small good scene into which a test puts its variation. */
#define SCENE(integrator, film, camera, materials, objects, more)                                  \
    "{\"integrator\": {" integrator "}, \"film\": {" film "}, \"camera\": {" camera "},"           \
    " \"textures\": {\"w\": {\"type\": \"constant\", \"color\": [1, 1, 1]}},"                      \
    " \"materials\": {\"m\": {\"texture_name\": \"w\"}" materials "},"                             \
    " \"objects\": [{\"type\": \"sphere\", \"center\": [0, 0, 0], \"light\": {}}" objects "]" more \
    "}"

static void defaults_are_the_formats(void **state)
{
    (void)state;
    struct loaded l;
    load(&l, SCENE("", "", "", "", "", ""));
    assert_int_equal(l.e, ERR_OK);
    const struct scene_camera *c = &l.scene.camera;
    assert_true(c->position[2] == 1 && c->look_at[2] == 0 && c->ref_up[1] == 1 && c->fov == 45);
    assert_int_equal(l.spec.integrator, JOB_INTEGRATOR_PATH);
    assert_int_equal(l.spec.spp, 32);
    assert_int_equal(l.spec.max_depth, 12);
    assert_int_equal(l.spec.width, 600);
    assert_int_equal(l.spec.profile, JOB_PROFILE_MIS);
    assert_true(l.spec.rr_threshold == 0.1 && l.spec.filter_radius == 0.5);
    const struct scene_object *o = &l.scene.objects[0];
    assert_true(o->radius == 1 && o->emits && o->radiance[0] == 1 && o->material == SCENE_NONE);
    assert_int_equal(l.scene.materials[0].type, SCENE_MATERIAL_DIFFUSE);
    unload(&l);
}

static void intersection_test_has_its_own_defaults(void **state)
{
    (void)state;
    struct loaded l;
    load(&l, SCENE("\"type\": \"intersection_test\"", "", "", "", "", ""));
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.spec.integrator, JOB_INTEGRATOR_INTERSECTION_TEST);
    assert_int_equal(l.spec.max_depth, 16);
    assert_int_equal(l.spec.spp, 8);
    assert_int_equal(l.spec.sampler, JOB_SAMPLER_HALTON);
    assert_true(l.scene.seed_light_position[1] == 5 && l.scene.seed_light_flux[2] == 1);
    unload(&l);
}

static void values_arrive(void **state)
{
    (void)state;
    struct loaded l;
    load(&l,
         SCENE("\"type\": \"photon\", \"n_photons\": 5, \"profile\": \"NextEventEstimation\"",
               "\"resolution\": [512, 256], \"block_side_length\": 32,"
               "\"filter\": {\"type\": \"mitchell\", \"radius\": 2, \"B\": 0.25}",
               "\"position\": [0, 1, 6], \"fov\": 19.5",
               ", \"g\": {\"type\": \"glass\", \"T\": [1, 0, 0]},"
               " \"c\": {\"type\": \"roughconductor\", \"R\": [0.5, 0.5, 0.5], \"alpha_y\": 0.3},"
               " \"old\": {\"type\": \"diffuse\", \"color\": [0.25, 0.5, 0.75]}",
               ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"material_name\": \"old\","
               " \"translate\": [1, 2, 3],"
               " \"transform\": [2,0,0,10, 0,2,0,20, 0,0,2,30, 0,0,0,1]}"
               ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"material_name\": \"c\"}",
               ", \"lights\": {}"));
    assert_int_equal(l.e, ERR_OK);
    assert_non_null(problem_find(&l.problems, "integrator-replaced", "$.integrator.type"));
    assert_non_null(problem_find(&l.problems, "lights-ignored", "$.lights"));
    assert_int_equal(l.spec.profile, JOB_PROFILE_NEE);
    assert_int_equal(l.spec.tile, 32);
    assert_int_equal(l.spec.height, 256);
    assert_int_equal(l.spec.crop.width, 512);
    assert_int_equal(l.spec.filter, JOB_FILTER_MITCHELL);
    assert_true(l.spec.filter_b == 0.25 && l.spec.filter_c == 1 / 3.0);
    assert_true(l.scene.materials[1].T[0] == 1 && l.scene.materials[1].T[1] == 0);
    assert_true(l.scene.materials[2].color[0] == 0.5 && l.scene.materials[2].alpha_y == 0.3);
    assert_int_equal(l.scene.materials[3].texture, SCENE_NONE);
    assert_true(l.scene.materials[3].color[2] == 0.75);
    const double *m = l.scene.objects[1].transform;
    assert_true(m[0] == 2 && m[3] == 11 && m[7] == 22 && m[11] == 33);
    assert_int_equal(l.scene.mesh_count, 1); /* one file, two objects */
    assert_int_equal(l.scene.objects[2].mesh, 0);
    unload(&l);
}

static const struct refusal {
    const char *text, *id, *place;
} refusals[] = {
    {SCENE("\"spp\": 0", "", "", "", "", ""), "out-of-range", "$.integrator.spp"},
    {SCENE("\"spp\": 1e999", "", "", "", "", ""), "out-of-range", "$.integrator.spp"},
    {SCENE("\"rr_threshold\": 1e999", "", "", "", "", ""), "not-finite",
     "$.integrator.rr_threshold"},
    {SCENE("\"type\": \"pth\"", "", "", "", "", ""), "unknown-name", "$.integrator.type"},
    {SCENE("\"sp\": 3", "", "", "", "", ""), "unknown-key", "$.integrator.sp"},
    {SCENE("", "\"resolution\": [65536, 1]", "", "", "", ""), "out-of-range",
     "$.film.resolution[0]"},
    {SCENE("", "\"resolution\": [0, 1]", "", "", "", ""), "out-of-range", "$.film.resolution[0]"},
    {SCENE("", "\"resolution\": [1.5, 1]", "", "", "", ""), "out-of-range", "$.film.resolution[0]"},
    {SCENE("", "\"resolution\": [8]", "", "", "", ""), "wrong-length", "$.film.resolution"},
    {SCENE("", "\"crop\": [0, 0, 601, 2]", "", "", "", ""), "out-of-range", "$.film.crop"},
    {SCENE("", "", "\"fov\": 0", "", "", ""), "out-of-range", "$.camera.fov"},
    {SCENE("", "", "\"fov\": 180", "", "", ""), "out-of-range", "$.camera.fov"},
    {SCENE("", "", "\"position\": [0, 0, 0]", "", "", ""), "camera-degenerate", "$.camera"},
    {SCENE("", "", "\"ref_up\": [0, 0, -3]", "", "", ""), "camera-degenerate", "$.camera"},
    {SCENE("", "", "\"ref_up\": [0, 0, 0]", "", "", ""), "camera-degenerate", "$.camera"},
    {SCENE("", "", "\"position\": [0, \"a\", 1]", "", "", ""), "wrong-type",
     "$.camera.position[1]"},
    {SCENE("", "", "", ", \"b\": {\"texture_name\": \"x\"}", "", ""), "unknown-texture",
     "$.materials.b.texture_name"},
    {SCENE("", "", "", ", \"b\": {}", "", ""), "missing-key", "$.materials.b"},
    {SCENE("", "", "", ", \"b\": {\"type\": \"glass\", \"eta\": 0}", "", ""), "out-of-range",
     "$.materials.b.eta"},
    {SCENE("", "", "", ", \"b\": {\"color\": [1, -1, 1]}", "", ""), "out-of-range",
     "$.materials.b.color[1]"},
    {SCENE("", "", "", ", \"m\": {\"color\": [1, 1, 1]}", "", ""), "duplicate-key",
     "$.materials.m"},
    {SCENE("", "", "", "",
           ", {\"type\": \"sphere\", \"center\": [0,0,0], \"radius\": -1, "
           "\"light\": {}}",
           ""),
     "out-of-range", "$.objects[1].radius"},
    {SCENE("", "", "", "", ", {\"type\": \"sphere\", \"center\": [0,0,0]}", ""), "no-material",
     "$.objects[1]"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"material_name\": \"m\"}", ""), "missing-key",
     "$.objects[1]"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"no.obj\", \"light\": {}}", ""),
     "missing-file", "$.objects[1].path"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"empty.obj\", \"light\": {}}", ""),
     "empty-mesh", "$.objects[1].path"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \".\", \"light\": {}}", ""),
     "unreadable-file", "$.objects[1].path"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"bad.exr\", \"light\": {}}", ""),
     "unknown-format", "$.objects[1].path"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"points.ply\", \"light\": {}}", ""),
     "empty-mesh", "$.objects[1].path"},
    {"{\"integrator\": {}, \"film\": {}, \"camera\": {},"
     " \"textures\": {\"t\": {\"type\": \"image\", \"path\": \"bad.exr\"}}}",
     "unknown-format", "$.textures.t.path"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"loose.obj\", \"light\": {}}", ""),
     "index-out-of-range", "loose.obj"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"bad.obj\", \"light\": {}}", ""),
     "not-finite", "bad.obj"},
    {SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"bad.obj\", \"light\": {}}", ""),
     "index-out-of-range", "bad.obj"},
    {SCENE("", "", "", "",
           ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"light\": {},"
           " \"transform\": [1,2,3,0, 4,5,6,0, 7,8,9,0, 0,0,0,1]}",
           ""),
     "bad-transform", "$.objects[1].transform"},
    {SCENE("", "", "", "",
           ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"light\": {},"
           " \"transform\": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}",
           ""),
     "bad-transform", "$.objects[1].transform"},
    {SCENE("", "", "", "", ", 3", ""), "wrong-type", "$.objects[1]"},
    {SCENE("", "", "", "", "", ", \"lights\": [{\"type\": \"point\"}]"), "missing-key",
     "$.lights[0]"},
    {SCENE("", "", "", "", "",
           ", \"lights\": [{\"type\": \"directional\", \"direction\": [0,0,0]}]"),
     "out-of-range", "$.lights[0].direction"},
    {SCENE("", "", "", "", "", ", \"environment_map\": {}"), "missing-key", "$.environment_map"},
    {SCENE("", "", "", "", "", ", \"enviroment_map\": {}"), "unknown-key", "$.enviroment_map"},
    {SCENE("\"type\": \"intersection_test\", \"point_light_flux\": [0, 0, 0]", "", "", "", "", ""),
     "no-light", "$"},
    {"{\"integrator\": {}, \"film\": {}, \"camera\": {}}", "no-light", "$"},
    {"{\"integrator\": {}, \"film\": {}}", "missing-key", "$"},
    {"{\"camera\": {}, \"renderer\": 3}", "foreign-scene", "$"},
    {"{}", "missing-key", "$"},
    {"{\"integrator\": 3, \"film\": {}, \"camera\": {}}", "wrong-type", "$.integrator"},
    {"[]", "wrong-type", "$"},
    {SCENE("", "", "", "", "", "") " x", "json-syntax", "s.json"},
};

/* How textures are looked up, and heights: what is given and what stands where nothing is. */
static void filters_and_bumps_arrive(void **state)
{
    (void)state;
    static const char text[] =
        "{\"integrator\": {}, \"film\": {}, \"camera\": {}, \"textures\": {"
        "\"a\": {\"type\": \"checkerboard\"},"
        "\"b\": {\"type\": \"checkerboard\", \"filter\": \"mipmap\"}},"
        "\"materials\": {\"m\": {\"texture_name\": \"a\"},"
        "\"n\": {\"type\": \"glass\", \"bump_texture\": \"b\", \"bump_scale\": -0.25}},"
        "\"objects\": [{\"type\": \"sphere\", \"center\": [0, 0, 0], \"light\": {}}]}";
    struct loaded l;
    load(&l, text);
    assert_int_equal(l.e, ERR_OK);
    assert_int_equal(l.scene.textures[0].filter, SCENE_FILTER_NEAREST);
    assert_int_equal(l.scene.textures[1].filter, SCENE_FILTER_MIPMAP);
    assert_int_equal(l.scene.materials[0].bump_texture, SCENE_NONE);
    assert_true(l.scene.materials[0].bump_scale == 1);
    assert_int_equal(l.scene.materials[1].bump_texture, 1);
    assert_true(l.scene.materials[1].bump_scale == -0.25);
    unload(&l);
}

static void bad_scenes_are_refused_with_their_place(void **state)
{
    (void)state;
    for (size_t i = 0; i < sizeof refusals / sizeof *refusals; i++) {
        struct loaded l;
        load(&l, refusals[i].text);
        if (l.e != ERR_INPUT || !problem_find(&l.problems, refusals[i].id, refusals[i].place)) {
            diag_print(&l.problems, stderr);
            fail_msg("not refused as %s at %s: %s", refusals[i].id, refusals[i].place,
                     refusals[i].text);
        }
        unload(&l);
    }
}

static void all_problems_come_in_one_run(void **state)
{
    (void)state;
    struct loaded l;
    load(&l, SCENE("\"spp\": -1", "", "\"fov\": 200", ", \"b\": {\"type\": \"galss\"}",
                   ", {\"type\": \"sphere\", \"center\": [0,0,0], \"material_name\": \"mm\"}"
                   ", {\"type\": \"mesh\", \"path\": \"case.obj\", \"light\": {}}",
                   ""));
    assert_int_equal(l.e, ERR_INPUT);
    assert_int_equal(l.problems.error_count, 5);
    const struct diag *d =
        problem_find(&l.problems, "unknown-material", "$.objects[1].material_name");
    assert_non_null(d);
    assert_string_equal(d->text, "no material \"mm\"");
    assert_string_equal(d->hint, "did you mean \"m\"? known: m, b");
    d = problem_find(&l.problems, "missing-file", "$.objects[2].path");
    assert_non_null(d);
    assert_string_equal(d->hint, "looked beside s.json; \"Case.obj\" exists");
    unload(&l);
}

/* The user learns which file it is and what uses it. */
static void problems_of_files_name_their_user(void **state)
{
    (void)state;
    struct loaded l;
    load(&l, SCENE("", "", "", "",
                   ", {\"type\": \"mesh\", \"path\": \"empty.obj\", \"light\": {}}"
                   ", {\"type\": \"mesh\", \"path\": \"bad.obj\", \"light\": {}}"
                   ", {\"type\": \"mesh\", \"path\": \"loose.obj\", \"light\": {}}",
                   ""));
    assert_int_equal(l.e, ERR_INPUT);
    const struct diag *d = problem_find(&l.problems, "empty-mesh", "$.objects[1].path");
    assert_non_null(d);
    assert_string_equal(d->file, "s.json");
    assert_non_null(strstr(d->text, "/empty.obj: no face in it: "));
    d = problem_find(&l.problems, "not-finite", "bad.obj");
    assert_non_null(d);
    assert_true(d->line > 0);
    assert_non_null(strstr(d->hint, "read for s.json: $.objects[2].path"));
    size_t loose = 0;
    for (size_t i = 0; i < l.problems.count; i++) {
        d = &l.problems.items[i];
        bool here = d->file && strstr(d->file, "loose.obj") && d->severity == DIAG_ERROR;
        loose += here && (d->line == 4 || d->line == 5);
    }
    assert_int_equal(loose, 2);
    unload(&l);
}

static void winding_follows_the_normals(void **state)
{
    (void)state;
    struct loaded l;
    put_file("tri.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 -1\nf 1//1 2//1 3//1\n");
    load(&l,
         SCENE("", "", "", "", ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"light\": {}}", ""));
    assert_int_equal(l.e, ERR_OK);
    const struct scene_mesh *m = &l.scene.meshes[0];
    assert_true(m->positions[3 * m->indices[1] + 1] == 1 && m->positions[3 * m->indices[2]] == 1);
    unload(&l);
    put_file("tri.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
}

static void memory_runs_out_cleanly(void **state)
{
    (void)state;
    const char *text =
        SCENE("", "", "", ", \"b\": {\"type\": \"mirror\"}",
              ", {\"type\": \"mesh\", \"path\": \"tri.obj\", \"material_name\": \"b\"}",
              ", \"lights\": [{\"type\": \"point\", \"position\": [0, 1, 0]}]");
    enum err e = ERR_NOMEM;
    for (uint64_t n = 0; e != ERR_OK; n++) {
        struct loaded l;
        diag_init(&l.problems);
        mem_fail_after(n);
        e = scene_json_read(text, strlen(text), "s.json", folder, &l.scene, &l.spec, &l.problems);
        mem_fail_after(UINT64_MAX);
        assert_true(e == ERR_OK || e == ERR_NOMEM);
        l.e = e;
        unload(&l);
    }
}

static void committed_scenes_load(void **state)
{
    (void)state;
    static const char *const names[] = {"cbox",       "cbox_no_light", "cbox_no_light_refract",
                                        "glass_cbox", "sphere",        "two_spheres",
                                        "veach"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        struct loaded l;
        char *path = mem_sprintf("scenes/%s.json", names[i]);
        diag_init(&l.problems);
        l.e = scene_json_read_file(path, &l.scene, &l.spec, &l.problems);
        if (l.e != ERR_OK)
            diag_print(&l.problems, stderr);
        assert_int_equal(l.e, ERR_OK);
        mem_free(path);
        unload(&l);
    }
}

static void a_missing_file_is_a_problem(void **state)
{
    (void)state;
    struct loaded l;
    diag_init(&l.problems);
    assert_int_equal(scene_json_read_file("scenes/CBOX.json", &l.scene, &l.spec, &l.problems),
                     ERR_INPUT);
    assert_string_equal(l.problems.items[0].hint, "did you mean scenes/cbox.json?");
    diag_release(&l.problems);
    diag_init(&l.problems);
    assert_int_equal(scene_json_read_file("scenes", &l.scene, &l.spec, &l.problems), ERR_INPUT);
    diag_release(&l.problems);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(defaults_are_the_formats),
        cmocka_unit_test(intersection_test_has_its_own_defaults),
        cmocka_unit_test(values_arrive),
        cmocka_unit_test(filters_and_bumps_arrive),
        cmocka_unit_test(bad_scenes_are_refused_with_their_place),
        cmocka_unit_test(all_problems_come_in_one_run),
        cmocka_unit_test(problems_of_files_name_their_user),
        cmocka_unit_test(winding_follows_the_normals),
        cmocka_unit_test(memory_runs_out_cleanly),
        cmocka_unit_test(committed_scenes_load),
        cmocka_unit_test(a_missing_file_is_a_problem),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
