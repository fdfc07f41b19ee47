/* client/cmd_explain.c: what a scene asks for, what is left out, and what it will take: the plan
 * (scene_plan.h) and the package made by it, counted. */
#include <string.h>

#include "client/command.h"
#include "client/human.h"
#include "client/load.h"
#include "client/predict.h"
#include "common/json_put.h"
#include "common/mem.h"
#include "common/package_late.h"
#include "common/scene_plan.h"

enum { CHUNKS_SHOWN = 12 };

struct facts {
    const struct load *load;
    struct scene_plan plan;
    struct scene_plan_memory memory;
    struct scene_plan_lazy lazy;
    uint64_t late_pictures, late_bytes; /* sent when a path of light meets them */
    uint64_t triangles, triangles_drawn, vertices, spheres, lights;
    uint64_t plain_bytes, left_bytes, sent_bytes;
    uint64_t *chunk_sent;               /* of each chunk, as one zstd frame */
    const struct prediction *predicted; /* NULL: not asked for */
};

static void count_scene(struct facts *f, const struct scene *s)
{
    for (size_t i = 0; i < s->mesh_count; i++) {
        f->triangles += s->meshes[i].triangle_count;
        f->vertices += s->meshes[i].vertex_count;
    }
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        f->lights += o->emits;
        if (o->type == SCENE_OBJECT_SPHERE)
            f->spheres++;
        else if (o->type == SCENE_OBJECT_MESH)
            f->triangles_drawn += s->meshes[o->mesh].triangle_count;
    }
    f->lights += s->light_count;
}

/* Which pictures a worker fetches when it needs them: by its own rule, from the root. */
static bool count_late(struct facts *f, const struct package *p)
{
    struct scene tables;
    struct package_index index;
    if (package_tables_read(p->chunks[0].data, p->chunks[0].bytes, &tables, &index) != ERR_OK)
        return false;
    TL_ASSERT(index.count + 1 == p->count);
    bool *late = mem_calloc(index.count, sizeof *late);
    if (late)
        f->late_pictures = package_late_choose(&tables, &index, late);
    for (size_t i = 0; late && i < index.count; i++)
        f->late_bytes += late[i] ? f->chunk_sent[i + 1] : 0;
    bool ok = late != NULL;
    mem_free(late);
    scene_release(&tables);
    package_index_release(&index);
    return ok;
}

/* Compresses each chunk once, as the client does before it sends them. */
static bool count_package(struct facts *f, const struct package *p)
{
    bool ok = true;
    f->chunk_sent = mem_calloc(p->count, sizeof *f->chunk_sent);
    for (size_t i = 0; f->chunk_sent && ok && i < p->count; i++) {
        struct buf frame;
        buf_init(&frame);
        ok = chunk_compress(p->chunks[i].data, p->chunks[i].bytes, &frame) == ERR_OK;
        f->chunk_sent[i] = frame.bytes;
        f->sent_bytes += frame.bytes;
        f->plain_bytes += p->chunks[i].bytes;
        buf_release(&frame);
    }
    for (int i = 0; i < PACKAGE_LEFT_COUNT; i++)
        f->left_bytes += p->left[i].bytes;
    return ok && f->chunk_sent && count_late(f, p);
}

static const char *kind_name(enum package_kind kind)
{
    static const char *const names[] = {[PACKAGE_ROOT] = "tables",
                                        [PACKAGE_MESH] = "mesh",
                                        [PACKAGE_IMAGE] = "picture",
                                        [PACKAGE_BASE] = "base",
                                        [PACKAGE_PIECE] = "piece"};
    return names[kind];
}

/* --- JSON ---------------------------------------------------------------- */

static void put_needs_json(const struct facts *f, bool needed, struct buf *out)
{
    bool first = true;
    for (int i = 0; i < SCENE_FEATURE_COUNT; i++) {
        if (scene_plan_has(&f->plan, (enum scene_feature)i) != needed)
            continue;
        buf_printf(out, "%s", first ? "" : ",");
        json_put_text(out, scene_feature_names[i]);
        first = false;
    }
}

static void put_left_json(const struct package *p, struct buf *out)
{
    bool first = true;
    for (int i = 0; i < PACKAGE_LEFT_COUNT; i++) {
        const struct package_left *left = &p->left[i];
        if (left->count == 0)
            continue;
        buf_printf(out, "%s{\"what\":", first ? "" : ",");
        json_put_text(out, package_left_what[i]);
        buf_printf(out, ",\"why\":");
        json_put_text(out, package_left_why[i]);
        buf_printf(out, ",\"count\":%llu,\"bytes\":%llu}", (unsigned long long)left->count,
                   (unsigned long long)left->bytes);
        first = false;
    }
}

static void put_chunks_json(const struct facts *f, const struct package *p, struct buf *out)
{
    for (size_t i = 0; i < p->count; i++) {
        char hex[DIGEST_HEX_BYTES];
        digest_to_hex(&p->chunks[i].name, hex);
        buf_printf(out, "%s{\"kind\":\"%s\",\"sha256\":\"%s\",\"bytes\":%zu,\"sent\":%llu}",
                   i ? "," : "", kind_name(p->chunks[i].kind), hex, p->chunks[i].bytes,
                   (unsigned long long)f->chunk_sent[i]);
    }
}

static void put_json(const struct facts *f, struct buf *out)
{
    const struct load *load = f->load;
    buf_printf(out, "{\"needs\":[");
    put_needs_json(f, true, out);
    buf_printf(out, "],\"needs_not\":[");
    put_needs_json(f, false, out);
    buf_printf(out, "],\"left_out\":[");
    put_left_json(&load->package, out);
    buf_printf(out,
               "],\"kernel\":\"%s\",\"bytes\":{\"source\":%llu,\"package\":%llu,\"worker\":%llu,"
               "\"plain\":%llu,\"left_out\":%llu,\"tree\":%llu,\"geometry\":%llu,"
               "\"images\":%llu},",
               job_integrator_names[load->spec.integrator],
               (unsigned long long)load->scene.source_bytes, (unsigned long long)f->sent_bytes,
               (unsigned long long)f->memory.total, (unsigned long long)f->plain_bytes,
               (unsigned long long)f->left_bytes, (unsigned long long)f->memory.tree,
               (unsigned long long)f->memory.geometry, (unsigned long long)f->memory.images);
    buf_printf(out,
               "\"lazy\":{\"objects\":%llu,\"triangles\":%llu},"
               "\"late\":{\"pictures\":%llu,\"sent\":%llu},"
               "\"triangles\":%llu,\"triangles_instanced\":%llu,\"vertices\":%llu,"
               "\"spheres\":%llu,\"lights\":%llu,\"chunks\":[",
               (unsigned long long)f->lazy.objects, (unsigned long long)f->lazy.triangles,
               (unsigned long long)f->late_pictures, (unsigned long long)f->late_bytes,
               (unsigned long long)f->triangles, (unsigned long long)f->triangles_drawn,
               (unsigned long long)f->vertices, (unsigned long long)f->spheres,
               (unsigned long long)f->lights);
    put_chunks_json(f, &load->package, out);
    buf_printf(out, "],\"predicted\":");
    if (f->predicted)
        predict_put_json(f->predicted, out);
    else
        buf_printf(out, "null");
    buf_printf(out, ",\"spec\":%s}\n", load->spec_json);
}

/* --- Text ---------------------------------------------------------------- */

static void put_picture(const struct job_spec *s, struct buf *out)
{
    char a[HUMAN_BYTES];
    human_count((double)s->crop.width * s->crop.height * (double)s->spp, a);
    buf_printf(out, "picture   %ux%u, %llu spp: %s samples\n", s->crop.width, s->crop.height,
               (unsigned long long)s->spp, a);
    buf_printf(out, "light     %s, depth %u, %s samples\n", job_integrator_names[s->integrator],
               s->max_depth, job_sampler_names[s->sampler]);
}

static void put_geometry(const struct facts *f, struct buf *out)
{
    char a[HUMAN_BYTES], b[HUMAN_BYTES], c[HUMAN_BYTES], d[HUMAN_BYTES];
    human_things((double)f->triangles, "triangle", "triangles", a);
    human_things((double)f->vertices, "vertex", "vertices", b);
    human_things((double)f->spheres, "sphere", "spheres", c);
    human_things((double)f->lights, "light", "lights", d);
    buf_printf(out, "geometry  %s, %s, %s, %s\n", a, b, c, d);
    if (f->triangles_drawn != f->triangles) {
        human_count((double)f->triangles_drawn, a);
        buf_printf(out, "          %s triangles with every instance counted\n", a);
    }
}

/* The features, wrapped. */
static void put_needs(const struct facts *f, struct buf *out)
{
    enum { COLUMN_MAX = 78 };
    size_t column = 10;
    bool first = true;
    buf_printf(out, "needs     ");
    for (int i = 0; i < SCENE_FEATURE_COUNT; i++) {
        const char *name = scene_feature_names[i];
        if (!scene_plan_has(&f->plan, (enum scene_feature)i))
            continue;
        if (!first && column + strlen(name) + 2 > COLUMN_MAX) {
            buf_printf(out, ",\n          ");
            column = 10;
            first = true;
        }
        buf_printf(out, "%s%s", first ? "" : ", ", name);
        column += strlen(name) + (first ? 0 : 2);
        first = false;
    }
    buf_printf(out, "%s\n", f->plan.features ? "" : "nothing");
}

static void put_left(const struct facts *f, const struct package *p, struct buf *out)
{
    char a[HUMAN_BYTES], b[HUMAN_BYTES];
    const char *head = "left out";
    for (int i = 0; i < PACKAGE_LEFT_COUNT; i++) {
        if (p->left[i].count == 0)
            continue;
        human_bytes((double)p->left[i].bytes, a);
        human_count((double)p->left[i].count, b);
        buf_printf(out, "%-10s%8s  %s %s: %s\n", head, a, b, package_left_what[i],
                   package_left_why[i]);
        head = "";
    }
    if (f->left_bytes == 0) {
        buf_printf(out, "%-10snothing\n", head);
        return;
    }
    uint64_t whole = f->plain_bytes + f->left_bytes;
    human_bytes((double)f->left_bytes, a);
    human_bytes((double)whole, b);
    buf_printf(out, "saves     %s of %s, %.0f %%\n", a, b,
               100.0 * (double)f->left_bytes / (double)whole);
}

/* The place of the next largest chunk behind `before` in (sent, place) order. */
static size_t next_largest(const struct facts *f, size_t count, size_t before)
{
    size_t best = count;
    for (size_t i = 0; i < count; i++) {
        bool behind = before == count || f->chunk_sent[i] < f->chunk_sent[before] ||
                      (f->chunk_sent[i] == f->chunk_sent[before] && i > before);
        if (behind && (best == count || f->chunk_sent[i] > f->chunk_sent[best]))
            best = i;
    }
    return best;
}

static void put_chunks(const struct facts *f, const struct package *p, struct buf *out)
{
    char a[HUMAN_BYTES], b[HUMAN_BYTES], c[HUMAN_BYTES];
    human_bytes((double)f->load->scene.source_bytes, a);
    human_bytes((double)f->plain_bytes, b);
    human_bytes((double)f->sent_bytes, c);
    buf_printf(out, "sends     %s once to each worker: %s in %zu chunk%s", c, b, p->count,
               p->count == 1 ? "" : "s");
    if (f->load->scene.source_bytes > 0)
        buf_printf(out, "; source files %s", a);
    buf_printf(out, "\n");
    size_t at = p->count;
    for (size_t shown = 0; shown < p->count && shown < CHUNKS_SHOWN; shown++) {
        char hex[DIGEST_HEX_BYTES];
        at = next_largest(f, p->count, at);
        digest_to_hex(&p->chunks[at].name, hex);
        human_bytes((double)p->chunks[at].bytes, a);
        human_bytes((double)f->chunk_sent[at], b);
        buf_printf(out, "          %-8s %.8s  %9s, sent as %s\n", kind_name(p->chunks[at].kind),
                   hex, a, b);
    }
    if (p->count > CHUNKS_SHOWN)
        buf_printf(out, "          and %zu smaller ones\n", p->count - CHUNKS_SHOWN);
}

static void put_memory(const struct facts *f, struct buf *out)
{
    char a[HUMAN_BYTES], b[HUMAN_BYTES], c[HUMAN_BYTES], d[HUMAN_BYTES];
    human_bytes((double)f->memory.total, a);
    human_bytes((double)f->memory.tree, b);
    human_bytes((double)f->memory.geometry, c);
    human_bytes((double)f->memory.images, d);
    buf_printf(out, "memory    about %s in each worker: tree %s, vertices %s, pictures %s\n", a, b,
               c, d);
    if (f->lazy.objects > 0) {
        human_count((double)f->lazy.triangles, c);
        buf_printf(out,
                   "          at most: the trees of %llu objects, %s triangles, are built when a "
                   "ray first meets them\n",
                   (unsigned long long)f->lazy.objects, c);
    }
    if (f->late_pictures > 0) {
        human_bytes((double)f->late_bytes, c);
        buf_printf(out,
                   "          at most: %llu pictures, sent as %s, are fetched when a path of light "
                   "first meets them\n",
                   (unsigned long long)f->late_pictures, c);
    }
}

static void put_text(const struct facts *f, struct buf *out)
{
    const struct load *load = f->load;
    put_picture(&load->spec, out);
    put_geometry(f, out);
    put_needs(f, out);
    put_left(f, &load->package, out);
    put_chunks(f, &load->package, out);
    put_memory(f, out);
    buf_printf(out, "kernel    %s\n", job_integrator_names[load->spec.integrator]);
    if (f->predicted)
        predict_put_text(f->predicted, out);
    else
        buf_printf(out, "cost      --spp, --target-error or --time-limit predicts it by a pilot\n");
}

static int explain(struct cli *cli, const struct load *load, const struct prediction *predicted)
{
    struct facts facts = {.load = load, .predicted = predicted};
    struct buf out;
    buf_init(&out);
    bool ok = scene_plan_make(&load->scene, load->spec.aov, &facts.plan) == ERR_OK;
    if (ok) {
        count_scene(&facts, &load->scene);
        facts.memory = scene_plan_memory(&load->scene, &facts.plan);
        facts.lazy = scene_plan_lazy(&load->scene, &facts.plan);
        ok = count_package(&facts, &load->package);
    }
    if (ok && cli->json)
        put_json(&facts, &out);
    else if (ok)
        put_text(&facts, &out);
    out.failed |= !ok;
    int status = cli_put_buf(&out) ? EXIT_DONE : EXIT_MACHINE;
    buf_release(&out);
    mem_free(facts.chunk_sent);
    scene_plan_release(&facts.plan);
    return status;
}

int command_explain(struct cli *cli)
{
    if (cli_has(&cli->line, CLI_NUMERICS))
        return command_doctor(cli);
    struct load load;
    struct prediction prediction;
    bool predicts = predict_wanted(&cli->line);
    load_scene(&load, &cli->line, true);
    /* The pilot's farm reads the scene once more, and says then what there is to say. */
    int status = predicts && load.status == EXIT_DONE ? EXIT_DONE : load_explain(&load, NULL);
    if (status == EXIT_DONE && predicts)
        status = predict_run(cli, &load.spec, &prediction);
    if (status == EXIT_DONE)
        status = explain(cli, &load, predicts ? &prediction : NULL);
    load_release(&load);
    return status;
}
