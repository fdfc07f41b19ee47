/* Late pictures: a unit tells what it lacks, and with that has the bits of a scene that was whole
 * from the start; what no path meets is never asked for. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_late.h"

enum { SIDE = 32, SPP = 32, ACROSS = 4, SHOWN = ACROSS * ACROSS, HIDDEN = 3, TEXELS = 24 };

/* Picture `number`, of noise. */
static uint32_t add_image(struct scene *s, uint32_t number)
{
    unsigned char *pixels = mem_alloc_array(TEXELS * TEXELS, 3);
    assert_non_null(pixels);
    uint32_t x = number * 2654435761u + 1;
    for (size_t i = 0; i < (size_t)TEXELS * TEXELS * 3; i++) {
        x = x * 1664525u + 1013904223u;
        pixels[i] = (unsigned char)(64 + (x >> 25));
    }
    s->images = mem_realloc_array(s->images, s->image_count + 1, sizeof *s->images);
    s->images[s->image_count] =
        (struct scene_image){TEXELS, TEXELS, 3, SCENE_IMAGE_U8_SRGB, pixels};
    return (uint32_t)s->image_count++;
}

/* A quad that shows a picture, in one of the ways in which a surface can. */
static void add_shown(struct scene *s, uint32_t number, double x, double y, double z)
{
    const double corners[12] = {x, y, z, x + 0.9, y, z, x + 0.9, y + 0.9, z, x, y + 0.9, z};
    static const float uvs[8] = {0, 0, 1, 0, 1, 1, 0, 1};
    struct scene_material *m;
    uint32_t material =
        kit_material(s, number % 4 == 0 ? SCENE_MATERIAL_DIFFUSE : SCENE_MATERIAL_PRINCIPLED, &m);
    uint32_t texture = kit_image_texture(s, add_image(s, number),
                                         number % 2 ? SCENE_FILTER_MIPMAP : SCENE_FILTER_BILINEAR);
    m = &s->materials[material];
    m->texture = number % 4 < 2 ? texture : kit_constant_texture(s, 0.6);
    m->normal_texture = number % 4 == 2 ? texture : SCENE_NONE;
    if (number % 4 == 3) {
        m->metallic_roughness_texture = texture;
        m->bump_texture = texture;
        m->bump_scale = 0.01;
        m->metallic = 0.5;
        m->roughness = 0.7;
    }
    uint32_t quad = kit_quad(s, corners, material);
    struct scene_mesh *mesh = &s->meshes[s->objects[quad].mesh];
    mesh->uvs = mem_alloc_array(8, sizeof *uvs);
    memcpy(mesh->uvs, uvs, sizeof uvs);
}

/* A wall of pictures under a lamp, and more behind a mirror that nothing looks behind. */
static void make_scene(struct scene *s)
{
    scene_init(s);
    for (uint32_t i = 0; i < SHOWN; i++)
        add_shown(s, i, i % ACROSS - ACROSS / 2.0, i / ACROSS - ACROSS / 2.0, 0);
    static const double back[12] = {-9, -9, -0.5, 9, -9, -0.5, 9, 9, -0.5, -9, 9, -0.5};
    (void)kit_quad(s, back, kit_diffuse(s, 0.5, 0.5, 0.5));
    for (uint32_t i = 0; i < HIDDEN; i++)
        add_shown(s, SHOWN + i, i, 0, -5);
    uint32_t lamp = kit_sphere(s, 0, 0, 6, 0.5, kit_diffuse(s, 0, 0, 0));
    kit_emit(s, lamp, 60, 60, 60);
    const double camera[3] = {0.3, 0.2, 5}, at[3] = {0, 0, 0};
    memcpy(s->camera.position, camera, sizeof camera);
    memcpy(s->camera.look_at, at, sizeof at);
    scene_check(s);
}

/* Built without its pictures, as a worker builds it: the images are empty. */
static struct render_scene *build_without(struct scene *s, const struct job_spec *spec)
{
    struct late_chunk late[SHOWN + HIDDEN];
    struct scene_image images[SHOWN + HIDDEN], empty[SHOWN + HIDDEN] = {{0}};
    struct render_scene *rs;
    assert_int_equal(s->image_count, SHOWN + HIDDEN);
    for (uint32_t i = 0; i < SHOWN + HIDDEN; i++)
        late[i] = (struct late_chunk){.late = true, .name = digest_of(&i, sizeof i), .bytes = i};
    struct scene_building how = {.late = late};
    memcpy(images, s->images, sizeof images);
    memcpy(s->images, empty, sizeof empty);
    assert_int_equal(scene_build_as(s, spec, &how, &rs), ERR_OK);
    memcpy(s->images, images, sizeof images);
    assert_int_equal(render_scene_late_count(rs), SHOWN + HIDDEN);
    assert_int_equal(render_scene_late_end(rs), SHOWN + HIDDEN);
    return rs;
}

static void bring(struct render_scene *rs, const struct scene *s, uint32_t image)
{
    struct picture_need need;
    struct picture *picture;
    size_t before = render_scene_late_count(rs), bytes = render_scene_bytes(rs);
    assert_true(render_scene_need(rs, image, &need));
    assert_int_equal(need.number, image);
    assert_int_equal(need.bytes, image);
    digest name = digest_of(&image, sizeof image);
    assert_true(digest_equal(&need.name, &name));
    assert_int_equal(picture_make(&need, &s->images[image], &picture), ERR_OK);
    render_scene_put(rs, image, picture);
    assert_false(render_scene_need(rs, image, &need));
    assert_int_equal(render_scene_late_count(rs), before - 1);
    assert_true(render_scene_bytes(rs) > bytes + TEXELS * TEXELS * 3);
    /* Once more is as good as once. */
    need.number = image;
    assert_int_equal(picture_make(&need, &s->images[image], &picture), ERR_OK);
    render_scene_put(rs, image, picture);
    assert_int_equal(render_scene_late_count(rs), before - 1);
}

struct unit_run {
    struct grid grid;
    struct unit unit;
    struct render_scratch *scratch;
    struct render_counters counters;
    size_t values;
    float *out;
};

static void run_init(struct unit_run *r, const struct job_spec *spec, uint32_t parts, uint32_t part)
{
    assert_int_equal(grid_init(&r->grid, spec), ERR_OK);
    uint32_t count = r->grid.cell_count / parts;
    r->unit = (struct unit){.cell_begin = part * count, .cell_count = count, .block = 0};
    assert_int_equal(render_scratch_new(&r->scratch), ERR_OK);
    r->values = r->grid.plane_count * (size_t)grid_pixels(&r->grid, r->unit.cell_begin, count);
    r->out = mem_alloc_array(r->values, sizeof *r->out);
    assert_non_null(r->out);
}

static enum err run(struct unit_run *r, const struct render_scene *rs)
{
    return render_unit(rs, &r->grid, r->unit, r->scratch, NULL, r->out, &r->counters);
}

static void run_release(struct unit_run *r)
{
    mem_free(r->out);
    render_scratch_free(r->scratch);
    grid_release(&r->grid);
}

static void with_integrator(enum job_integrator integrator, uint32_t aov)
{
    struct scene s;
    make_scene(&s);
    struct job_spec spec = kit_spec(SIDE, SPP);
    spec.integrator = integrator;
    spec.aov = aov;
    struct unit_run whole, late;
    run_init(&whole, &spec, 1, 0);
    run_init(&late, &spec, 1, 0);
    struct render_scene *eager, *rs = build_without(&s, &spec);
    assert_int_equal(scene_build(&s, &spec, NULL, &eager), ERR_OK);
    assert_int_equal(run(&whole, eager), ERR_OK);
    assert_int_equal(render_scene_late_count(eager), 0);

    uint32_t runs = 0, brought = 0;
    enum err e;
    while ((e = run(&late, rs)) == ERR_NOT_FOUND) {
        const uint32_t *lacks;
        uint64_t calls = mem_call_count();
        assert_int_equal(run(&late, rs), ERR_NOT_FOUND); /* as often as one likes */
        assert_int_equal(mem_call_count(), calls);
        size_t count = render_lacks(late.scratch, &lacks);
        assert_true(count > 0 && count <= RENDER_LACKS_MAX);
        for (size_t i = 0; i < count; i++) {
            assert_true(lacks[i] < SHOWN); /* none that is hidden */
            bring(rs, &s, lacks[i]);
        }
        brought += (uint32_t)count;
        assert_true(++runs <= 3);
    }
    assert_int_equal(e, ERR_OK);
    assert_int_equal(brought, SHOWN);
    assert_int_equal(render_scene_late_count(rs), HIDDEN);
    assert_memory_equal(late.out, whole.out, whole.values * sizeof *whole.out);
    assert_memory_equal(&late.counters, &whole.counters, sizeof whole.counters);
    run_release(&whole);
    run_release(&late);
    render_scene_free(rs);
    render_scene_free(eager);
    scene_release(&s);
}

static void what_is_lacked_makes_the_same_bits(void **state)
{
    (void)state;
    with_integrator(JOB_INTEGRATOR_PATH, 0);
}

static void in_direct_light_too(void **state)
{
    (void)state;
    with_integrator(JOB_INTEGRATOR_DIRECT, 0);
}

static void in_aovs_too(void **state)
{
    (void)state;
    with_integrator(JOB_INTEGRATOR_AO, 1u << AOV_ALBEDO | 1u << AOV_NORMAL | 1u << AOV_DEPTH);
}

/* More pictures than the list holds: the next run finds those that found no room. */
static void a_long_list_takes_more_runs(void **state)
{
    (void)state;
    enum { WALL = 10, COUNT = WALL * WALL };
    struct scene s;
    scene_init(&s);
    for (uint32_t i = 0; i < COUNT; i++)
        add_shown(&s, i, i % WALL - WALL / 2.0, i / WALL - WALL / 2.0, 0);
    kit_emit(&s, kit_sphere(&s, 0, 0, 20, 0.5, kit_diffuse(&s, 0, 0, 0)), 60, 60, 60);
    const double camera[3] = {0, 0, 16}, at[3] = {0, 0, 0};
    memcpy(s.camera.position, camera, sizeof camera);
    memcpy(s.camera.look_at, at, sizeof at);
    struct job_spec spec = kit_spec(8 * WALL, 2);
    struct late_chunk chunks[COUNT] = {{0}};
    for (size_t i = 0; i < COUNT; i++)
        chunks[i].late = true;
    struct scene_building how = {.late = chunks};
    struct render_scene *rs;
    assert_int_equal(scene_build_as(&s, &spec, &how, &rs), ERR_OK);
    struct unit_run late;
    run_init(&late, &spec, 1, 0);
    size_t left = COUNT;
    while (run(&late, rs) == ERR_NOT_FOUND) {
        const uint32_t *lacks;
        struct picture_need need;
        struct picture *picture;
        size_t count = render_lacks(late.scratch, &lacks);
        assert_int_equal(count, left < RENDER_LACKS_MAX ? left : RENDER_LACKS_MAX);
        for (size_t i = 0; i < count; i++) {
            assert_true(render_scene_need(rs, lacks[i], &need)); /* each once */
            assert_int_equal(picture_make(&need, &s.images[lacks[i]], &picture), ERR_OK);
            render_scene_put(rs, lacks[i], picture);
        }
        left -= count;
    }
    assert_int_equal(left, 0);
    run_release(&late);
    render_scene_free(rs);
    scene_release(&s);
}

/* A surface that is only met where a path ends shows nothing. */
static void the_last_vertex_lacks_nothing(void **state)
{
    (void)state;
    struct scene s;
    make_scene(&s);
    struct job_spec spec = kit_spec(SIDE, SPP);
    spec.max_depth = 1;
    struct unit_run late;
    run_init(&late, &spec, 1, 0);
    struct render_scene *rs = build_without(&s, &spec);
    assert_int_equal(run(&late, rs), ERR_OK);
    run_release(&late);
    render_scene_free(rs);
    scene_release(&s);
}

/* What the job before has brought is there for the next one. */
static void jobs_share_pictures(void **state)
{
    (void)state;
    struct scene s;
    make_scene(&s);
    struct job_spec spec = kit_spec(SIDE, SPP), other = spec;
    other.seed = 5;
    struct render_scene *rs = build_without(&s, &spec), *view, *alone = build_without(&s, &spec);
    assert_int_equal(render_scene_share(rs, &other, &view), ERR_OK);
    assert_true(render_scene_is_one(rs, view));
    assert_false(render_scene_is_one(alone, view));
    for (uint32_t i = 0; i < SHOWN + HIDDEN; i++)
        bring(i % 2 ? rs : view, &s, i);
    assert_int_equal(render_scene_late_count(rs), 0);
    assert_int_equal(render_scene_late_count(view), 0);
    struct picture_need need;
    assert_false(render_scene_need(view, SHOWN + HIDDEN, &need)); /* no image */
    struct unit_run late;
    run_init(&late, &other, 1, 0);
    (void)render_scene_free(rs);
    assert_int_equal(run(&late, view), ERR_OK);
    run_release(&late);
    render_scene_free(view);
    render_scene_free(alone);
    scene_release(&s);
}

/* --- Pictures come while others render ---------------------------------------------- */

enum { THREADS = 3 };

struct shared {
    pthread_mutex_t lock;
    struct render_scene *rs;
    const struct scene *scene;
    const struct job_spec *spec;
};

struct worker {
    struct shared *shared;
    struct unit_run run;
    uint32_t runs;
    enum err error;
};

static void *work(void *arg)
{
    struct worker *w = arg;
    while ((w->error = run(&w->run, w->shared->rs)) == ERR_NOT_FOUND && w->runs++ < 2 * SHOWN) {
        const uint32_t *lacks;
        struct picture_need need;
        struct picture *picture;
        size_t count = render_lacks(w->run.scratch, &lacks);
        /* The first alone: so that many come while the others are at work. */
        (void)pthread_mutex_lock(&w->shared->lock);
        if (count > 0 && render_scene_need(w->shared->rs, lacks[0], &need) &&
            picture_make(&need, &w->shared->scene->images[lacks[0]], &picture) == ERR_OK)
            render_scene_put(w->shared->rs, lacks[0], picture);
        (void)pthread_mutex_unlock(&w->shared->lock);
    }
    return NULL;
}

static void pictures_come_while_others_render(void **state)
{
    (void)state;
    struct scene s;
    make_scene(&s);
    struct job_spec spec = kit_spec(2 * SIDE, SPP);
    struct render_scene *eager;
    struct shared shared = {.rs = build_without(&s, &spec), .scene = &s, .spec = &spec};
    assert_int_equal(pthread_mutex_init(&shared.lock, NULL), 0);
    assert_int_equal(scene_build(&s, &spec, NULL, &eager), ERR_OK);
    struct worker workers[THREADS];
    pthread_t threads[THREADS];
    for (uint32_t i = 0; i < THREADS; i++) {
        workers[i] = (struct worker){.shared = &shared};
        run_init(&workers[i].run, &spec, 4, i);
    }
    for (uint32_t i = 0; i < THREADS; i++)
        assert_int_equal(pthread_create(&threads[i], NULL, work, &workers[i]), 0);
    for (uint32_t i = 0; i < THREADS; i++)
        assert_int_equal(pthread_join(threads[i], NULL), 0);
    for (uint32_t i = 0; i < THREADS; i++) {
        struct unit_run whole;
        assert_int_equal(workers[i].error, ERR_OK);
        run_init(&whole, &spec, 4, i);
        assert_int_equal(run(&whole, eager), ERR_OK);
        assert_memory_equal(workers[i].run.out, whole.out, whole.values * sizeof *whole.out);
        run_release(&whole);
        run_release(&workers[i].run);
    }
    (void)pthread_mutex_destroy(&shared.lock);
    render_scene_free(shared.rs);
    render_scene_free(eager);
    scene_release(&s);
}

/* Every allocation of a picture may fail; then there is none, and nothing is lost. */
static void no_memory_no_picture(void **state)
{
    (void)state;
    struct scene s;
    make_scene(&s);
    struct picture_need need = {.kind = PACKAGE_IMAGE, .pyramid = true};
    struct picture *picture = NULL;
    uint64_t failed = 0;
    for (uint64_t i = 0; i < 1000; i++) {
        mem_fail_after(i);
        enum err e = picture_make(&need, &s.images[0], &picture);
        mem_fail_after(UINT64_MAX);
        if (e == ERR_OK)
            break;
        assert_int_equal(e, ERR_NOMEM);
        assert_null(picture);
        failed++;
    }
    assert_true(failed >= 3);
    picture_free(picture);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_lacked_makes_the_same_bits),
        cmocka_unit_test(in_direct_light_too),
        cmocka_unit_test(in_aovs_too),
        cmocka_unit_test(a_long_list_takes_more_runs),
        cmocka_unit_test(the_last_vertex_lacks_nothing),
        cmocka_unit_test(jobs_share_pictures),
        cmocka_unit_test(pictures_come_while_others_render),
        cmocka_unit_test(no_memory_no_picture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
