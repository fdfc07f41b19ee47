/* What the package leaves out changes no bit, and is counted to the byte.
 *
 * usage: test_plan [--all]
 *
 * Each scene is rendered as it was read, from a package of everything and from the package
 * that is sent; all three have the same bits under each integrator. The scenes are those
 * of scenes/, one made here that uses every rule, and, where TILERY_TEST_DATA is set, models
 * from there: some of them, or all with --all.
 */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/import.h"
#include "common/mem.h"
#include "common/package.h"
#include "common/scene_json.h"
#include "common/scene_plan.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

static int failures, scenes_seen;

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    const struct package *p = ctx;
    (void)entry;
    *data = p->chunks[1 + i].data;
    *bytes = p->chunks[1 + i].bytes;
    return ERR_OK;
}

static void fail(const char *name, const char *what)
{
    printf("%s: %s\n", name, what);
    failures++;
}

static bool same_picture(const struct kit_picture *a, const struct kit_picture *b)
{
    size_t bytes = (size_t)a->width * a->height * 3 * sizeof *a->mean;
    return memcmp(a->half[0], b->half[0], bytes) == 0 && memcmp(a->half[1], b->half[1], bytes) == 0;
}

static void compare_pictures(const char *name, const struct scene *s, const struct scene *back,
                             const char *what)
{
    static const enum job_integrator integrators[] = {JOB_INTEGRATOR_PATH, JOB_INTEGRATOR_AO,
                                                      JOB_INTEGRATOR_INTERSECTION_TEST};
    for (size_t i = 0; i < sizeof integrators / sizeof *integrators; i++) {
        struct job_spec spec = kit_spec(24, 4);
        spec.integrator = integrators[i];
        struct kit_picture a = kit_render(s, &spec, 0), b = kit_render(back, &spec, 0);
        if (!same_picture(&a, &b))
            fail(name, what);
        kit_picture_free(&a);
        kit_picture_free(&b);
    }
}

static uint64_t plain_bytes(const struct package *p)
{
    uint64_t bytes = 0;
    for (size_t i = 0; i < p->count; i++)
        bytes += p->chunks[i].bytes;
    return bytes;
}

static uint64_t left_bytes(const struct package *p)
{
    uint64_t bytes = 0;
    for (int i = 0; i < PACKAGE_LEFT_COUNT; i++)
        bytes += p->left[i].bytes;
    return bytes;
}

/* Prints what was left out; returns the scene as a worker reads it. */
static struct scene round_trip(const char *name, const struct package *p)
{
    struct scene back;
    TL_ASSERT(package_read(p->chunks[0].data, p->chunks[0].bytes, fetch, (void *)p, &back) ==
              ERR_OK);
    printf("%s: %llu bytes, %llu left out:", name, (unsigned long long)plain_bytes(p),
           (unsigned long long)left_bytes(p));
    for (int i = 0; i < PACKAGE_LEFT_COUNT; i++)
        if (p->left[i].count > 0)
            printf(" %llu %s,", (unsigned long long)p->left[i].count, package_left_what[i]);
    printf("\n");
    return back;
}

/* The estimate of memory beside what is held: within a third, and a block of the arena. */
static void check_memory(const char *name, const struct scene *s, const struct scene *back)
{
    struct scene_plan plan;
    struct render_scene *built;
    struct job_spec spec = kit_spec(24, 4);
    struct accel_stats tree;
    TL_ASSERT(scene_plan_make(s, 0, &plan) == ERR_OK);
    TL_ASSERT(scene_build(back, &spec, NULL, &built) == ERR_OK);
    struct scene_plan_memory memory = scene_plan_memory(s, &plan);
    double held = (double)render_scene_bytes(built), estimate = (double)memory.total;
    render_scene_stats(built, &tree);
    printf("%s: holds %.0f bytes, estimate %.2f of it; tree %llu of %llu\n", name, held,
           estimate / held, (unsigned long long)memory.tree, (unsigned long long)tree.bytes);
    if (estimate > held * 4 / 3 + 262144 || held > estimate * 4 / 3 + 262144)
        fail(name, "the estimate of memory is far off");
    render_scene_free(built);
    scene_plan_release(&plan);
}

/* The same with all pictures in pieces that can be. */
static void check_pieces(const char *name, const struct scene *s)
{
    struct package whole, sent;
    TL_ASSERT(package_write_pieces(s, 0, UINT64_MAX, &whole) == ERR_OK &&
              package_write_pieces(s, 0, 1, &sent) == ERR_OK);
    struct scene back = round_trip(name, &sent);
    compare_pictures(name, s, &back, "other bits from pictures in pieces");
    if (whole.pieces_extra != 0 ||
        plain_bytes(&whole) + left_bytes(&whole) + (uint64_t)sent.pieces_extra !=
            plain_bytes(&sent) + left_bytes(&sent))
        fail(name, "pieces do not add up");
    scene_release(&back);
    package_release(&whole);
    package_release(&sent);
}

static struct package check_scene(const char *name, const struct scene *s)
{
    struct package whole, sent;
    TL_ASSERT(package_write_whole(s, &whole) == ERR_OK && package_write(s, 0, &sent) == ERR_OK);
    struct scene all = round_trip(name, &whole), back = round_trip(name, &sent);
    compare_pictures(name, s, &all, "other bits from the package of everything");
    compare_pictures(name, s, &back, "other bits from the package that is sent");
    if (plain_bytes(&whole) + left_bytes(&whole) + (uint64_t)sent.pieces_extra !=
        plain_bytes(&sent) + left_bytes(&sent))
        fail(name, "what is left out does not add up");
    check_memory(name, s, &back);
    if (s->image_count > 0)
        check_pieces(name, s);
    scenes_seen++;
    scene_release(&all);
    scene_release(&back);
    package_release(&whole);
    return sent;
}

static void check_file(const char *path)
{
    struct scene s;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    enum err e = import_is_model(path) ? import_model(path, &s, &spec, &problems)
                                       : scene_json_read_file(path, &s, &spec, &problems);
    if (e == ERR_OK) {
        struct package p = check_scene(path, &s);
        package_release(&p);
        scene_release(&s);
    } else {
        printf("%s: not read\n", path);
    }
    diag_release(&problems);
}

/* --- A scene of all rules -------------------------------------------------- */

enum { IMAGE_SIDE = 8 };

static uint32_t add_image(struct scene *s, uint32_t channels, bool grey, unsigned char alpha)
{
    struct scene_image *image = &s->images[s->image_count];
    *image = (struct scene_image){.width = IMAGE_SIDE,
                                  .height = IMAGE_SIDE,
                                  .channel_count = channels,
                                  .format = SCENE_IMAGE_U8_SRGB};
    unsigned char *at = mem_alloc_array(IMAGE_SIDE * IMAGE_SIDE, channels);
    image->pixels = at;
    TL_ASSERT(at);
    for (uint32_t i = 0; i < IMAGE_SIDE * IMAGE_SIDE; i++)
        for (uint32_t k = 0; k < channels; k++)
            *at++ = k == 3 ? alpha : (unsigned char)(37 * (i + 1) + (grey ? 0 : 91 * k));
    struct scene_texture *t = &s->textures[s->texture_count];
    scene_image_texture_init(t);
    t->name = mem_sprintf("t%zu", s->texture_count);
    t->image = (uint32_t)s->image_count++;
    return (uint32_t)s->texture_count++;
}

/* A quad with texture coordinates and two vertices that no triangle has, one far away. */
static uint32_t add_quad(struct scene *s, double z, uint32_t material)
{
    const double corners[12] = {-1, -1, z, 1, -1, z, 1, 1, z, -1, 1, z};
    uint32_t object = kit_quad(s, corners, material);
    struct scene_mesh *m = &s->meshes[s->objects[object].mesh];
    double *positions = mem_calloc(18, sizeof *positions);
    m->uvs = mem_calloc(12, sizeof *m->uvs);
    TL_ASSERT(positions && m->uvs);
    memcpy(positions, m->positions, 3 * sizeof *positions);
    memcpy(positions + 6, m->positions + 3, 9 * sizeof *positions);
    positions[3] = 1e6;
    for (size_t i = 0; i < 6; i++)
        m->indices[i] += m->indices[i] > 0;
    mem_free(m->positions);
    m->positions = positions;
    m->vertex_count = 6;
    for (size_t v = 0; v < 5; v++) {
        m->uvs[2 * v] = positions[3 * v] > 0;
        m->uvs[2 * v + 1] = positions[3 * v + 1] > 0;
    }
    return object;
}

static void add_colors(struct scene *s, uint32_t object)
{
    struct scene_mesh *m = &s->meshes[s->objects[object].mesh];
    m->colors = mem_calloc(m->vertex_count, 3 * sizeof *m->colors);
    m->alphas = mem_calloc(m->vertex_count, sizeof *m->alphas);
    TL_ASSERT(m->colors && m->alphas);
    for (size_t i = 0; i < m->vertex_count; i++)
        m->alphas[i] = (float)(i % 5) / 4;
    for (size_t i = 0; i < (size_t)m->vertex_count * 3; i++)
        m->colors[i] = (float)(i % 7) / 6;
}

static void expect(const struct package *p, enum package_left_kind kind, uint64_t count)
{
    if (p->left[kind].count == count)
        return;
    printf("%s left out: %llu, expected %llu\n", package_left_what[kind],
           (unsigned long long)p->left[kind].count, (unsigned long long)count);
    failures++;
}

/* A job that shows coordinates gets them, and is refused a package made without. */
static void check_shown_uvs(const struct scene *s)
{
    struct job_spec spec = kit_spec(8, 1);
    spec.aov = 1u << AOV_UV;
    for (int shown = 0; shown < 2; shown++) {
        struct package p;
        struct render_scene *built;
        TL_ASSERT(package_write(s, shown ? spec.aov : 0, &p) == ERR_OK);
        struct scene back = round_trip(shown ? "uv shown" : "uv not shown", &p);
        enum err e = scene_build(&back, &spec, NULL, &built);
        if (e != (shown ? ERR_OK : ERR_INPUT))
            fail("uv", "a job got coordinates that are not there, or none");
        if (e == ERR_OK)
            render_scene_free(built);
        expect(&p, PACKAGE_LEFT_UVS, shown ? 0 : 6);
        scene_release(&back);
        package_release(&p);
    }
}

/* Rows of walls behind each other, each with a material that reads less than it names. */
static void check_rules(void)
{
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    s.images = mem_calloc(8, sizeof *s.images);
    s.textures = mem_calloc(8, sizeof *s.textures);
    TL_ASSERT(s.images && s.textures);
    uint32_t color = add_image(&s, 4, false, 90), opaque = add_image(&s, 4, false, 255);
    uint32_t packed = add_image(&s, 3, false, 0), through = add_image(&s, 3, false, 0);
    uint32_t grey = add_image(&s, 3, true, 0), glow = add_image(&s, 3, false, 0);
    kit_constant_sky(&s, 0.5);

    uint32_t masked = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m); /* reads an opaque alpha */
    m->texture = opaque;
    m->alpha_used = true;
    kit_emit(&s, add_quad(&s, 0, masked), 1, 1, 1); /* one light of two triangles, either way */
    uint32_t rough = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->texture = color; /* its alpha is not read */
    m->metallic_roughness_texture = packed;
    m->metallic = 0.5; /* green and blue are */
    m->transmission_texture = through;
    m->transmission = 0.5;      /* red is */
    m->emission_texture = glow; /* emits nothing: not read */
    add_quad(&s, -1, rough);
    uint32_t plain = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
    m->texture = grey;
    add_quad(&s, -2, plain);
    uint32_t glass = kit_material(&s, SCENE_MATERIAL_GLASS, &m);
    m->texture = color; /* glass has no colour of its own: needs no coordinates */
    add_quad(&s, 0.4, glass);
    uint32_t nothing = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
    m->alpha_used = true;
    m->alpha = 0;
    uint32_t unseen = add_quad(&s, 0.5, nothing);      /* moves the objects */
    s.objects[unseen].transform[3] = 100;              /* no extent either */
    (void)kit_material(&s, SCENE_MATERIAL_MIRROR, &m); /* of no object */
    scene_check(&s);

    struct package p = check_scene("all rules", &s);
    expect(&p, PACKAGE_LEFT_OBJECTS, 1);
    expect(&p, PACKAGE_LEFT_MESHES, 1);
    expect(&p, PACKAGE_LEFT_VERTICES, 8);
    expect(&p, PACKAGE_LEFT_UVS, 6);
    expect(&p, PACKAGE_LEFT_MATERIALS, 2);
    expect(&p, PACKAGE_LEFT_TEXTURES, 1);
    expect(&p, PACKAGE_LEFT_IMAGES, 1);
    expect(&p, PACKAGE_LEFT_OPAQUE, 1);
    expect(&p, PACKAGE_LEFT_CHANNELS, 1 + 1 + 2);
    expect(&p, PACKAGE_LEFT_GREY, 2);
    expect(&p, PACKAGE_LEFT_DIGITS, 3 * 4 * 4 - 3 * 4); /* 0.4 is no float */
    package_release(&p);
    check_shown_uvs(&s);
    scene_release(&s);
}

/* Of two coloured walls one shows its colours. */
static void check_colors(void)
{
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    kit_constant_sky(&s, 0.5);
    uint32_t shows = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
    m->vertex_colors = true;
    add_colors(&s, add_quad(&s, 0, shows));
    add_colors(&s, add_quad(&s, -1, kit_diffuse(&s, 0.5, 0.5, 0.5)));
    uint32_t veil = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->vertex_colors = m->alpha_used = true;
    uint32_t lamp = add_quad(&s, 0.5, veil);
    add_colors(&s, lamp);
    kit_emit(&s, lamp, 1, 1, 1);
    uint32_t unlit = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->emission[0] = m->emission[2] = 1;
    m->emission_vertex_colors = true;
    add_colors(&s, add_quad(&s, 0.7, unlit));
    scene_check(&s);
    struct package p = check_scene("colours", &s);
    expect(&p, PACKAGE_LEFT_COLORS, 6);
    expect(&p, PACKAGE_LEFT_ALPHAS, 6 + 6 + 6);
    if (p.left[PACKAGE_LEFT_ALPHAS].bytes != 18 * 4)
        fail("colours", "bytes left out are not those of the opacities");
    if (p.left[PACKAGE_LEFT_COLORS].bytes != 6 * 12)
        fail("colours", "bytes left out are not those of the colours");
    package_release(&p);
    scene_release(&s);
}

/* --- Files ------------------------------------------------------------------ */

static bool ends_in(const char *name, const char *end)
{
    size_t n = strlen(name), k = strlen(end);
    return n >= k && strcmp(name + n - k, end) == 0;
}

static int by_name(const void *a, const void *b)
{
    return strcmp(*(char *const *)a, *(char *const *)b);
}

/* Every model in the folders of a folder. */
static void check_folder(const char *folder, int depth)
{
    char *names[1024];
    int count = 0;
    DIR *dir = opendir(folder);
    for (struct dirent *f = dir ? readdir(dir) : NULL; f && count < 1024; f = readdir(dir))
        if (f->d_name[0] != '.')
            TL_ASSERT((names[count++] = mem_sprintf("%s/%s", folder, f->d_name)) != NULL);
    if (dir)
        (void)closedir(dir);
    qsort(names, (size_t)count, sizeof *names, by_name);
    for (int i = 0; i < count; i++) {
        const char *n = names[i];
        if (ends_in(n, ".obj") || ends_in(n, ".ply") || ends_in(n, ".glb") || ends_in(n, ".gltf"))
            check_file(n);
        else if (depth > 0)
            check_folder(n, depth - 1);
        mem_free(names[i]);
    }
}

static void check_data(const char *data, bool all)
{
    static const char *const folders[] = {"obj", "ply", "gltf", "cornell"};
    static const char *const some[] = {
        "gltf/Avocado", "gltf/AlphaBlendModeTest", "gltf/SimpleInstancing", "gltf/Box", "obj/spot",
        "ply/tinyply",  "obj/glass_of_milk"};
    size_t count = all ? sizeof folders / sizeof *folders : sizeof some / sizeof *some;
    for (size_t i = 0; i < count; i++) {
        char *folder = mem_sprintf("%s/%s", data, all ? folders[i] : some[i]);
        TL_ASSERT(folder);
        check_folder(folder, all ? 3 : 0);
        mem_free(folder);
    }
}

/* Meshes too big to build here: from the limit on a tree is estimated as a compact one. */
static void check_memory_of_many(void)
{
    double tree[2];
    for (uint32_t i = 0; i < 2; i++) {
        struct scene_mesh mesh = {.triangle_count = SCENE_COMPACT_TRIANGLES_MIN - 1 + i};
        struct scene_object object = {.type = SCENE_OBJECT_MESH, .material = SCENE_NONE};
        struct scene s = {.meshes = &mesh, .mesh_count = 1, .objects = &object, .object_count = 1};
        struct scene_plan_mesh use = {.uses = 1};
        bool kept = true;
        struct scene_plan plan = {.objects = &kept, .meshes = &use};
        s.envmap.texture = SCENE_NONE;
        tree[i] = (double)scene_plan_memory(&s, &plan).tree;
    }
    if (!(tree[1] < 0.6 * tree[0] && tree[1] > 0.5 * tree[0]))
        fail("many triangles", "the estimate is not that of a compact tree");
}

int main(int argc, char **argv)
{
    static const char *const scenes[] = {
        "cbox_no_light", "cbox_no_light_refract", "cbox",  "glass_cbox",
        "veach",         "two_spheres",           "sphere"};
    if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
        return import_child_main(argc, argv);
    check_rules();
    check_colors();
    check_memory_of_many();
    for (size_t i = 0; i < sizeof scenes / sizeof *scenes; i++) {
        char path[100];
        (void)snprintf(path, sizeof path, "scenes/%s.json", scenes[i]);
        check_file(path);
    }
    const char *data = getenv("TILERY_TEST_DATA");
    if (data)
        check_data(data, argc > 1 && strcmp(argv[1], "--all") == 0);
    printf("plan: %d scenes, %d failures\n", scenes_seen, failures);
    return failures != 0 || scenes_seen < 8;
}
