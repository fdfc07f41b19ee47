/* The importer's parts: wire, URIs, glTF data, framing, and whole models in memory of a folder. */
#include <stdarg.h>
#include <stddef.h>
#include <setjmp.h>
#include <cmocka.h>

#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "client/import.h"
#include "client/import_gltf.h"
#include "client/import_wire.h"
#include "common/file_io.h"
#include "common/mem.h"

/* --- A scene of one triangle ---------------------------------------------- */

static void add_triangle(struct import *im, double size, double z)
{
    struct scene_mesh mesh = {.vertex_count = 3, .triangle_count = 1};
    struct scene_object object;
    const double p[9] = {0, 0, z, size, 0, z, 0, size, z};
    scene_object_init(&object);
    mesh.positions = mem_alloc_array(9, sizeof *mesh.positions);
    mesh.indices = mem_alloc_array(3, sizeof *mesh.indices);
    memcpy(mesh.positions, p, sizeof p);
    for (uint32_t i = 0; i < 3; i++)
        mesh.indices[i] = i;
    assert_int_equal(import_add_mesh(im, &mesh, &object.mesh), ERR_OK);
    assert_int_equal(import_add_object(im, &object), ERR_OK);
}

static void make(struct import *im, struct diag_list *problems)
{
    diag_init(problems);
    assert_int_equal(import_init(im, "model.glb", problems), ERR_OK);
}

static void finish(struct import *im, struct diag_list *problems)
{
    import_release(im);
    diag_release(problems);
}

/* --- The wire ------------------------------------------------------------ */

static struct buf message_of(const struct import *im, const struct import_message *m)
{
    struct buf out;
    int ends[2];
    buf_init(&out);
    assert_int_equal(pipe(ends), 0);
    assert_int_equal(import_wire_send(ends[1], im, m, ERR_OK), ERR_OK);
    (void)close(ends[1]);
    for (;;) {
        unsigned char *at = buf_extend(&out, 4096);
        ssize_t got = read(ends[0], at, 4096);
        assert_true(got >= 0);
        out.bytes -= 4096 - (size_t)got;
        if (got == 0)
            break;
    }
    (void)close(ends[0]);
    return out;
}

static struct buf sample_message(void)
{
    static char texture[] = "picture0", path[] = "a.png";
    struct import_picture pictures[2] = {
        {.texture = texture, .path = path},
        {.texture = texture, .data = (const unsigned char *)"bytes", .bytes = 5}};
    struct import_message m = {.pictures = pictures, .count = 2};
    struct import im;
    struct diag_list problems;
    make(&im, &problems);
    add_triangle(&im, 1, 0);
    im.object_nodes = mem_alloc_array(1, sizeof *im.object_nodes);
    im.object_nodes[im.object_node_count++] = 5;
    im.line_count = 7;
    im.aspect = 1.5;
    import_warn(&im, "left-out", "a hint", "something is left out");
    struct buf out = message_of(&im, &m);
    finish(&im, &problems);
    return out;
}

static void wire_carries_a_scene(void **state)
{
    (void)state;
    struct buf sent = sample_message();
    struct import im;
    struct import_message m = {0};
    struct diag_list problems;
    make(&im, &problems);
    assert_int_equal(import_wire_get(sent.data, sent.bytes, &im, &m), ERR_OK);
    assert_int_equal(im.scene.object_count, 1);
    assert_int_equal(im.scene.meshes[0].triangle_count, 1);
    assert_true(im.line_count == 7 && im.aspect == 1.5);
    assert_int_equal(im.object_node_count, 1);
    assert_int_equal(im.object_nodes[0], 5);
    assert_int_equal(problems.warning_count, 1);
    assert_string_equal(problems.items[0].hint, "a hint");
    assert_int_equal(m.count, 2);
    assert_string_equal(m.pictures[0].path, "a.png");
    assert_null(m.pictures[1].path);
    assert_memory_equal(m.pictures[1].data, "bytes", 5);
    import_message_release(&m);
    finish(&im, &problems);
    buf_release(&sent);
}

static void get_any(const unsigned char *data, size_t bytes, bool may_be_good)
{
    struct import im;
    struct import_message m = {0};
    struct diag_list problems;
    make(&im, &problems);
    enum err e = import_wire_get(data, bytes, &im, &m);
    assert_true(e != ERR_OK || (may_be_good && scene_valid(&im.scene)));
    import_message_release(&m);
    finish(&im, &problems);
}

/* Whatever a child that was taken over sends, it is refused or a valid scene. */
static void wire_takes_hostile_bytes(void **state)
{
    (void)state;
    struct buf sent = sample_message();
    for (size_t bytes = 0; bytes < sent.bytes; bytes++)
        get_any(sent.data, bytes, false);
    for (size_t i = 0; i < sent.bytes; i++)
        for (int bit = 0; bit < 8; bit += 3) {
            sent.data[i] ^= (unsigned char)(1 << bit);
            get_any(sent.data, sent.bytes, true);
            sent.data[i] ^= (unsigned char)(1 << bit);
        }
    buf_release(&sent);
}

/* --- glTF's data --------------------------------------------------------- */

static void uris_are_decoded(void **state)
{
    (void)state;
    unsigned char *data;
    size_t bytes;
    assert_int_equal(gltf_data_uri("data:;base64,aGVsbG8=", &data, &bytes), ERR_OK);
    assert_int_equal(bytes, 5);
    assert_memory_equal(data, "hello", 5);
    mem_free(data);
    assert_int_equal(gltf_data_uri("data:;base64,a*", &data, &bytes), ERR_OK);
    assert_null(data);
    assert_int_equal(gltf_data_uri("data:text/plain,x", &data, &bytes), ERR_OK);
    assert_null(data);
    char *path = gltf_uri_path("a%20b%2Fc%zz%0");
    assert_string_equal(path, "a b/c%zz%0");
    mem_free(path);
}

static const char accessor_json[] =
    "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":8,"
    "\"uri\":\"data:;base64,AID/f///AAA=\"}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":8}],"
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"normalized\":true,\"count\":2,"
    "\"type\":\"VEC2\"},{\"bufferView\":0,\"componentType\":5123,\"count\":5,\"type\":\"SCALAR\"},"
    "{\"bufferView\":9,\"componentType\":5123,\"count\":1,\"type\":\"SCALAR\"}]}";

static void accessors_are_normalised_and_bounded(void **state)
{
    (void)state;
    struct import im;
    struct diag_list problems;
    struct gltf t;
    double *v;
    size_t count;
    make(&im, &problems);
    assert_int_equal(gltf_open(&t, &im, accessor_json, sizeof accessor_json - 1), ERR_OK);
    assert_int_equal(gltf_accessor(&t, 0, 2, &v, &count), ERR_OK);
    assert_non_null(v);
    assert_int_equal(count, 2);
    assert_true(v[0] == -1 && v[1] == 1 && v[2] == -1.0 / 32767 && v[3] == 0);
    mem_free(v);
    assert_int_equal(gltf_accessor(&t, 0, 3, &v, &count), ERR_OK); /* no VEC3 */
    assert_null(v);
    assert_int_equal(gltf_accessor(&t, 1, 1, &v, &count), ERR_OK); /* one too many */
    assert_null(v);
    assert_int_equal(gltf_accessor(&t, 2, 1, &v, &count), ERR_OK); /* no such view */
    assert_null(v);
    assert_int_equal(gltf_accessor(&t, 3, 1, &v, &count), ERR_OK); /* no such accessor */
    assert_null(v);
    uint64_t bytes = 0;
    assert_int_equal(gltf_check(&t, &bytes), ERR_INPUT);
    gltf_close(&t);
    finish(&im, &problems);
}

/* --- Framing ------------------------------------------------------------- */

/* All corners of the model lie within the view, at any scale and place. */
static void the_whole_model_is_framed(void **state)
{
    (void)state;
    static const double sizes[] = {1e-9, 1, 1e9};
    for (size_t i = 0; i < 3; i++) {
        struct import im;
        struct diag_list problems;
        make(&im, &problems);
        add_triangle(&im, sizes[i], 3 * sizes[i]);
        add_triangle(&im, sizes[i], 0);
        import_frame(&im);
        const struct scene_camera *c = &im.scene.camera;
        assert_true(import_camera_valid(c));
        double d[3], distance = 0, radius = 0;
        for (int k = 0; k < 3; k++) {
            d[k] = c->position[k] - c->look_at[k];
            distance += d[k] * d[k];
        }
        radius = sqrt(0.25 + 0.25 + 2.25) * sizes[i];
        assert_true(sqrt(distance) > radius && sqrt(distance) < 8 * radius);
        finish(&im, &problems);
    }
}

static void a_sky_lights_what_has_no_light(void **state)
{
    (void)state;
    struct import im;
    struct job_spec spec;
    struct diag_list problems;
    make(&im, &problems);
    add_triangle(&im, 1, 0);
    assert_int_equal(import_finish(&im, &spec), ERR_OK);
    assert_true(im.scene.envmap.texture != SCENE_NONE);
    assert_int_equal(problems.warning_count, 2); /* sky and camera */
    assert_true(job_spec_valid(&spec, NULL));
    finish(&im, &problems);
}

/* --- Colours of vertices ------------------------------------------------- */

/* COLOR_0 in normalised bytes: 51 / 255 is a fifth, linear, of opacity too; the material then reads
 * them. */
static void gltf_colors_multiply(void **state)
{
    (void)state;
    static const char text[] =
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"mesh\":0}],\"materials\":[{\"alphaMode\":\"BLEND\"}],\"meshes\":[{"
        "\"primitives\":[{"
        "\"material\":0,\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}}]}],\"accessors\":["
        "{\"bufferView\":0,\"componentType\":5126,\"count\":3,\"type\":\"VEC3\","
        "\"min\":[0,0,0],\"max\":[1,1,0]},"
        "{\"bufferView\":1,\"componentType\":5121,\"normalized\":true,\"count\":3,"
        "\"type\":\"VEC4\"}],\"bufferViews\":["
        "{\"buffer\":0,\"byteOffset\":0,\"byteLength\":36},"
        "{\"buffer\":0,\"byteOffset\":36,\"byteLength\":12}],"
        "\"buffers\":[{\"byteLength\":48,\"uri\":\"data:application/octet-stream;base64,"
        "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA/wAzMwD/AP8AAP8A\"}]}";
    char folder[] = "/tmp/tilery-import-XXXXXX";
    assert_non_null(mkdtemp(folder));
    char *path = file_join(folder, "a.gltf");
    assert_int_equal(file_write(path, text, strlen(text)), ERR_OK);
    struct import im;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    assert_int_equal(import_init(&im, path, &problems), ERR_OK);
    assert_int_equal(import_run(&im, &spec), ERR_OK);
    assert_int_equal(im.scene.object_count, 1);
    const struct scene_object *o = &im.scene.objects[0];
    const float *colors = im.scene.meshes[o->mesh].colors;
    assert_non_null(colors);
    const float *alphas = im.scene.meshes[o->mesh].alphas;
    assert_non_null(alphas);
    assert_true(im.scene.materials[o->material].vertex_colors);
    assert_true(im.scene.materials[o->material].alpha_used);
    bool found = false;
    for (size_t i = 0; i < im.scene.meshes[o->mesh].vertex_count; i++)
        found |= colors[3 * i] == 1 && colors[3 * i + 1] == 0 &&
                 fabs((double)colors[3 * i + 2] - 0.2) < 1e-6 &&
                 fabs((double)alphas[i] - 0.2) < 1e-6;
    assert_true(found);
    finish(&im, &problems);
    assert_int_equal(unlink(path), 0);
    assert_int_equal(rmdir(folder), 0);
    mem_free(path);
}

/* --- Backs that are not there ----------------------------------------------- */

/* A tetrahedron, its faces seen from outside counter-clockwise, each with corners of its own. */
static void add_tetrahedron(struct import *im, uint32_t faces, bool by_normals, bool mirrored)
{
    static const double corners[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const uint32_t rings[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct scene_mesh mesh = {.vertex_count = 3 * faces, .triangle_count = faces};
    struct scene_material material;
    struct scene_object object;
    scene_object_init(&object);
    scene_material_init(&material);
    material.type = SCENE_MATERIAL_PRINCIPLED;
    material.backface_culling = true;
    mesh.positions = mem_alloc_array(12, 3 * sizeof *mesh.positions);
    mesh.normals = by_normals ? mem_alloc_array(12, 3 * sizeof *mesh.normals) : NULL;
    mesh.indices = mem_alloc_array(12, sizeof *mesh.indices);
    for (uint32_t i = 0; i < 3 * faces; i++) {
        mesh.indices[i] = i;
        for (int k = 0; k < 3; k++) {
            /* By their normals, every other face is wound the other way. */
            uint32_t at = by_normals && i / 3 % 2 ? 2 - i % 3 : i % 3;
            mesh.positions[3 * i + (uint32_t)k] = corners[rings[i / 3][at]][k];
            if (by_normals) /* from the middle of all */
                mesh.normals[3 * i + (uint32_t)k] =
                    (float)(corners[rings[i / 3][0]][k] + corners[rings[i / 3][1]][k] +
                            corners[rings[i / 3][2]][k] - 0.75);
        }
    }
    if (mirrored)
        object.transform[0] = -1;
    assert_int_equal(import_add_material(im, &material, "m", &object.material), ERR_OK);
    assert_int_equal(import_add_mesh(im, &mesh, &object.mesh), ERR_OK);
    assert_int_equal(import_add_object(im, &object), ERR_OK);
}

static bool keeps_culling(uint32_t faces, int form, const double eye[3], bool parallel)
{
    struct import im;
    struct diag_list problems;
    make(&im, &problems);
    add_tetrahedron(&im, faces, form & 1, form & 2);
    struct scene_camera *c = &im.scene.camera;
    c->type = parallel ? SCENE_CAMERA_ORTHOGRAPHIC : SCENE_CAMERA_PINHOLE;
    for (int k = 0; k < 3; k++) {
        c->position[k] = eye[k];
        c->look_at[k] = parallel ? 0 : 0.1;
    }
    if (form & 2)
        c->position[0] = -c->position[0];
    import_settle_culling(&im);
    bool kept = im.scene.materials[0].backface_culling;
    finish(&im, &problems);
    return kept;
}

static void culling_is_kept_where_it_shows(void **state)
{
    (void)state;
    static const double outside[3] = {5, 5, 5}, below[3] = {-5, -6, -7};
    for (int form = 0; form < 4; form++) {
        for (int parallel = 0; parallel < 2; parallel++) {
            /* Closed: only a camera inside sees backs. */
            assert_false(keeps_culling(4, form, outside, parallel));
            assert_false(keeps_culling(4, form, below, parallel));
            /* The face that looks at (5, 5, 5) is missing: what is behind turns its back. */
            assert_true(keeps_culling(3, form, outside, parallel));
            assert_false(keeps_culling(3, form, below, parallel));
        }
    }
}

/* A triangle turned away, of a material that `of_material` describes. */
static bool gltf_culls(const char *of_material)
{
    char text[1024], folder[] = "/tmp/tilery-import-XXXXXX";
    (void)snprintf(
        text, sizeof text,
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"mesh\":0,\"rotation\":[0,1,0,0]}],\"materials\":[{%s}],"
        "\"meshes\":[{\"primitives\":[{\"material\":0,\"attributes\":{\"POSITION\":0}}]}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":3,"
        "\"type\":\"VEC3\",\"min\":[0,0,0],\"max\":[1,1,0]}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"buffers\":[{\"byteLength\":36,"
        "\"uri\":\"data:application/octet-stream;base64,"
        "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA\"}]}",
        of_material);
    assert_non_null(mkdtemp(folder));
    char *path = file_join(folder, "a.gltf");
    assert_int_equal(file_write(path, text, strlen(text)), ERR_OK);
    struct import im;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    assert_int_equal(import_init(&im, path, &problems), ERR_OK);
    assert_int_equal(import_run(&im, &spec), ERR_OK);
    bool culls = im.scene.materials[im.scene.objects[0].material].backface_culling;
    finish(&im, &problems);
    assert_int_equal(unlink(path), 0);
    assert_int_equal(rmdir(folder), 0);
    mem_free(path);
    return culls;
}

static void gltf_says_what_is_culled(void **state)
{
    (void)state;
    assert_true(gltf_culls(""));
    assert_true(gltf_culls("\"doubleSided\":false"));
    assert_false(gltf_culls("\"doubleSided\":true"));
    assert_false(gltf_culls("\"extensions\":{\"KHR_materials_transmission\":"
                            "{\"transmissionFactor\":1}}"));
}

/* --- Kinds of files ------------------------------------------------------ */

static bool is_model(const char *folder, const char *name, const char *text)
{
    char *path = file_join(folder, name);
    assert_int_equal(file_write(path, text, strlen(text)), ERR_OK);
    bool is = import_is_model(path);
    assert_int_equal(unlink(path), 0);
    mem_free(path);
    return is;
}

static void kinds_are_told_by_contents_first(void **state)
{
    (void)state;
    char folder[] = "/tmp/tilery-import-XXXXXX";
    assert_non_null(mkdtemp(folder));
    assert_true(is_model(folder, "a.json", "{\"asset\": {\"version\": \"2.0\"}}"));
    assert_false(is_model(folder, "a.json", "{\"camera\": {}}"));
    assert_false(is_model(folder, "scene", "{\"camera\": {}}"));
    assert_true(is_model(folder, "a.dat", "ply\nformat ascii 1.0\n"));
    assert_true(is_model(folder, "a.json", "glTF\2"));
    assert_true(is_model(folder, "a.obj", "{"));
    assert_false(is_model(folder, "a.json", "{"));
    assert_false(import_is_model("missing.json"));
    assert_true(import_is_model("missing.obj"));
    assert_int_equal(rmdir(folder), 0);
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
        return import_child_main(argc, argv);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wire_carries_a_scene),
        cmocka_unit_test(wire_takes_hostile_bytes),
        cmocka_unit_test(uris_are_decoded),
        cmocka_unit_test(accessors_are_normalised_and_bounded),
        cmocka_unit_test(the_whole_model_is_framed),
        cmocka_unit_test(a_sky_lights_what_has_no_light),
        cmocka_unit_test(gltf_colors_multiply),
        cmocka_unit_test(culling_is_kept_where_it_shows),
        cmocka_unit_test(gltf_says_what_is_culled),
        cmocka_unit_test(kinds_are_told_by_contents_first),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
