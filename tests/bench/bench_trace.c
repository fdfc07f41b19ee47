/* bench_trace: our rays against Embree's, side by side in one process.
 *
 *   bench_trace [--quick] [--json FILE] [--runs N] [--side N] [--scene NAME]
 *               [--isa sse2|avx2|avx512] [--fast | --compact | --sbvh]
 *               [--embree4 LIBRARY]
 *               [--mesh FILE.ply --rays FILE [--shadow]]
 *
 * Each case times ours (one ray a call, and batches) and Embree (one ray a call,
 * default and ROBUST) on the same rays in turn, several times; a ratio above 1 means
 * that ours is faster. Filling each side's ray structures is timed. One thread is timed
 * by the processor's clock, which other work on the machine disturbs less. With --mesh the
 * rays file holds u32 n, then n times 8 floats: origin, tnear, direction, tfar. After each case
 * the answers are compared: single calls against batches bit for bit, and with each peer; where
 * ours and a peer's are apart, brute force in __float128 says which is wrong. Exit status: 0; 1 if
 * an answer of ours was wrong; 2 usage; 3 a file that cannot be read or has no ray to be timed; 5
 * anything else. --side is cut to a multiple of 16. --fast
 * also times scenes with --precision fast, against exact; --compact times compact trees against
 * normal ones, --sbvh those of builder sbvh against sah's. The SAH cost of Embree's builder is that
 * of the tree that its rtcBuildBVH makes of the same boxes, as binary as ours is before it is made
 * wide.
 */
#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/number.h"
#include "common/ply_file.h"
#include "common/scene.h"
#include "tests/bench/trace_agree.h"
#include "tests/bench/trace_peer.h"
#include "tests/bench/trace_pool.h"

enum {
    RUNS_MAX = 99,
    PEERS_MAX = 4,
    THREADS_MAX = 2,
    CHUNK = 1024,
    JUDGED_MAX = 100, /* rays a peer, by brute force */
};

struct options {
    bool quick, shadow;
    enum other { OTHER_NONE, OTHER_FAST, OTHER_COMPACT, OTHER_SBVH } other;
    int runs;
    uint32_t side;
    enum accel_isa isa;
    const char *json, *scene, *embree4, *mesh, *rays;
};

struct bench {
    struct options options;
    FILE *json;
    bool first_case;
    bool wrong;                                       /* an answer of ours was */
    struct trace_peer *peers[THREADS_MAX][PEERS_MAX]; /* [threads - 1] */
    const char *peer_names[PEERS_MAX];
    bool peer_robust[PEERS_MAX];
    int peer_count;
    struct accel *other; /* as options.other says; NULL: none */
};

struct ratio {
    double median, low, high;
};

/* --- Output ----------------------------------------------------------------- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median_of(double *values, int count)
{
    qsort(values, (size_t)count, sizeof *values, compare_doubles);
    return count % 2 ? values[count / 2] : 0.5 * (values[count / 2 - 1] + values[count / 2]);
}

static struct ratio ratio_of(const double *top, const double *bottom, int count)
{
    double r[RUNS_MAX];
    for (int i = 0; i < count; i++)
        r[i] = top[i] / bottom[i];
    struct ratio out = {median_of(r, count), r[0], r[count - 1]};
    return out;
}

static void json_case(struct bench *b, const char *scene, const char *kind, const char *what,
                      int threads, const char *peer, const char *unit, double ours, double theirs,
                      const struct ratio *r)
{
    if (!b->json)
        return;
    fprintf(b->json,
            "%s\n  {\"scene\": \"%s\", \"%s\": \"%s\", \"threads\": %d, \"peer\": \"%s\", "
            "\"unit\": \"%s\", \"ours\": %.6g, \"theirs\": %.6g, \"ratio\": {\"median\": %.4f, "
            "\"min\": %.4f, \"max\": %.4f}, \"runs\": %d}",
            b->first_case ? "" : ",", scene, kind, what, threads, peer, unit, ours, theirs,
            r->median, r->low, r->high, b->options.runs);
    b->first_case = false;
}

static void machine_name(char *out, size_t bytes)
{
    snprintf(out, bytes, "unknown");
    FILE *f = fopen("/proc/cpuinfo", "r");
    char line[256];
    while (f && fgets(line, sizeof line, f)) {
        char *colon = strchr(line, ':');
        if (strncmp(line, "model name", 10) == 0 && colon) {
            colon[strcspn(colon, "\"\\\n")] = 0;
            snprintf(out, bytes, "%s", colon + 2);
            break;
        }
    }
    if (f)
        fclose(f);
}

/* --- Timing ----------------------------------------------------------------- */

enum side { OURS_SINGLE, OURS_BATCH, THEIRS };

struct work {
    enum side side;
    const struct accel *accel;
    struct trace_peer *peer;
    const struct trace_rays *rays;
    bool shadow;
    size_t begin, end;
};

static size_t single_count(const struct work *w)
{
    size_t hits = 0;
    for (size_t i = w->begin; i < w->end; i++) {
        struct ray ray = trace_rays_get(w->rays, i);
        struct hit hit;
        if (w->shadow) {
            hits += accel_occluded(w->accel, &ray);
        } else {
            accel_closest(w->accel, &ray, &hit);
            hits += hit.object != SCENE_NONE;
        }
    }
    return hits;
}

static size_t batch_count(const struct work *w)
{
    struct ray rays[CHUNK];
    struct hit hits[CHUNK];
    uint8_t occluded[CHUNK];
    size_t total = 0;
    for (size_t i = w->begin; i < w->end; i += CHUNK) {
        size_t n = w->end - i < CHUNK ? w->end - i : CHUNK;
        for (size_t j = 0; j < n; j++)
            rays[j] = trace_rays_get(w->rays, i + j);
        if (w->shadow)
            accel_occluded_batch(w->accel, rays, n, occluded);
        else
            accel_closest_batch(w->accel, rays, n, hits);
        for (size_t j = 0; j < n; j++)
            total += w->shadow ? occluded[j] : hits[j].object != SCENE_NONE;
    }
    return total;
}

static size_t work_run(const struct work *w)
{
    if (w->side == OURS_SINGLE)
        return single_count(w);
    if (w->side == OURS_BATCH)
        return batch_count(w);
    return trace_peer_count(w->peer, w->rays, w->begin, w->end, w->shadow);
}

struct shared {
    const struct work *whole;
    size_t hits;
};

/* A chunk of the rays. */
static void part_run(void *arg, size_t i)
{
    struct shared *s = arg;
    struct work part = *s->whole;
    part.begin = i * CHUNK;
    part.end = part.end - part.begin < CHUNK ? part.end : part.begin + CHUNK;
    size_t hits = work_run(&part);
    __atomic_fetch_add(&s->hits, hits, __ATOMIC_RELAXED);
}

/* Seconds for all rays on some threads, which take a chunk after the other. */
static double work_time(const struct work *whole, int threads, size_t *hits)
{
    double start = trace_seconds(threads);
    if (threads == 1) {
        *hits = work_run(whole);
    } else {
        struct shared shared = {whole, 0};
        trace_pool_run(NULL, (whole->end + CHUNK - 1) / CHUNK, part_run, &shared);
        *hits = shared.hits;
    }
    return trace_seconds(threads) - start;
}

/* Ours, the peers, and ours again in another way. */
static struct work work_of(const struct bench *b, int way, const struct accel *a,
                           const struct trace_rays *rays, bool shadow, int threads)
{
    struct work w = {.accel = a, .rays = rays, .shadow = shadow, .end = rays->count};
    if (way < 2) {
        w.side = (enum side)way;
    } else if (way < 2 + b->peer_count) {
        w.side = THEIRS;
        w.peer = b->peers[threads - 1][way - 2];
    } else {
        w.side = (enum side)(way - 2 - b->peer_count);
        w.accel = b->other;
    }
    return w;
}

/* Rates and ratios of single calls and batches of the other way. */
static void print_other(struct bench *b, const char *scene, const char *kind, int threads,
                        const double *first, const double *other, const struct ratio *ratio)
{
    static const char *const calls[2] = {"single", "batch"};
    static const char *const whats[] = {"", "fast", "compact", "sbvh"};
    static const char *const overs[] = {"", "exact", "normal", "sah"};
    const char *what = whats[b->options.other], *over = overs[b->options.other];
    printf("%-10s %-7s %d  %s over %s:", scene, kind, threads, what, over);
    for (int i = 0; i < 2; i++) {
        char name[64];
        snprintf(name, sizeof name, "%s-%s%s", kind, what, i ? "-batch" : "");
        printf(" %s %.2f (%.2f-%.2f)", calls[i], ratio[i].median, ratio[i].low, ratio[i].high);
        json_case(b, scene, "rays", name, threads, over, "Mrays/s", other[i], first[i], &ratio[i]);
    }
    printf("\n");
}

/* All ways to trace one set of rays, in turn, `runs` times. */
static void time_rays(struct bench *b, const char *scene, const char *kind, const struct accel *a,
                      const struct trace_rays *rays, bool shadow, int threads)
{
    enum { WAYS = 4 + PEERS_MAX };
    double seconds[WAYS][RUNS_MAX], rate[WAYS];
    size_t hits[WAYS];
    int peers_end = 2 + b->peer_count, ways = peers_end + (b->other ? 2 : 0);
    int runs = b->options.runs;
    if (rays->count == 0)
        return;
    for (int run = -1; run < runs; run++)
        for (int way = 0; way < ways; way++) {
            struct work w = work_of(b, way, a, rays, shadow, threads);
            seconds[way][run < 0 ? 0 : run] = work_time(&w, threads, &hits[way]);
        }
    struct ratio ratio[2][PEERS_MAX], other[2];
    for (int i = 0; i < 2 && b->other; i++)
        other[i] = ratio_of(seconds[i], seconds[peers_end + i], runs);
    for (int peer = 0; peer < b->peer_count; peer++)
        for (int ours = 0; ours < 2; ours++)
            ratio[ours][peer] = ratio_of(seconds[2 + peer], seconds[ours], runs);
    for (int way = 0; way < ways; way++)
        rate[way] = (double)rays->count / median_of(seconds[way], runs) * 1e-6;
    printf("%-10s %-7s %d  %6.2f %6.2f", scene, kind, threads, rate[0], rate[1]);
    for (int peer = 0; peer < b->peer_count; peer++) {
        struct ratio *s = &ratio[0][peer], *m = &ratio[1][peer];
        printf(" | %6.2f  %4.2f (%4.2f-%4.2f)  %4.2f (%4.2f-%4.2f)", rate[2 + peer], s->median,
               s->low, s->high, m->median, m->low, m->high);
        char name[64];
        for (int ours = 0; ours < 2; ours++) {
            snprintf(name, sizeof name, "%s%s", kind, ours ? "-batch" : "");
            json_case(b, scene, "rays", name, threads, b->peer_names[peer], "Mrays/s", rate[ours],
                      rate[2 + peer], &ratio[ours][peer]);
        }
    }
    printf("  %4.1f%%\n", 100.0 * (double)hits[0] / (double)rays->count);
    if (b->other)
        print_other(b, scene, kind, threads, rate, rate + peers_end, other);
    fflush(stdout);
}

/* --- Agreement -------------------------------------------------------------- */

static void json_check(struct bench *b, const char *scene, const char *kind, const char *with,
                       size_t rays, const struct trace_agreement *g)
{
    if (!b->json)
        return;
    fprintf(b->json,
            "%s\n  {\"scene\": \"%s\", \"rays\": \"%s\", \"check\": \"%s\", \"of\": %zu, "
            "\"differ\": %zu, "
            "\"judged\": %zu, \"wrong\": %zu, \"theirs_wrong\": %zu}",
            b->first_case ? "" : ",", scene, kind, with, rays, g->apart, g->judged, g->wrong,
            g->theirs);
    b->first_case = false;
}

/* Where single calls, batches and peers do not find the same, and who is right. */
static void check_rays(struct bench *b, const char *scene, const char *kind,
                       const struct trace_scene *s, const struct accel *a,
                       const struct trace_rays *rays, bool shadow)
{
    if (rays->count == 0)
        return;
    struct trace_agreement g = {.apart = trace_agree_batch(a, rays, shadow)};
    json_check(b, scene, kind, "batch", rays->count, &g);
    if (g.apart > 0) {
        printf("  single and batch differ on %zu rays\n", g.apart);
        b->wrong = true;
    }
    for (int peer = 0; peer < b->peer_count; peer++) {
        g = trace_agree_peer(a, b->peers[0][peer], s, rays, shadow, JUDGED_MAX);
        json_check(b, scene, kind, b->peer_names[peer], rays->count, &g);
        if (g.apart > 0)
            printf("  %s differs on %zu of %zu rays; of %zu judged, ours are wrong on %zu, its on "
                   "%zu\n",
                   b->peer_names[peer], g.apart, rays->count, g.judged, g.wrong, g.theirs);
        b->wrong = b->wrong || g.wrong > 0;
    }
    fflush(stdout);
}

/* --- Building --------------------------------------------------------------- */

static struct accel *build_ours(const struct trace_scene *s, const struct accel_options *options,
                                int threads, double *seconds)
{
    struct accel_runner runner = {trace_pool_run, NULL, (uint32_t)threads};
    struct accel *a = NULL;
    double start = trace_seconds(threads);
    if (accel_new(&s->input, options, threads > 1 ? &runner : NULL, &a) != ERR_OK) {
        fprintf(stderr, "bench_trace: the scene cannot be built\n");
        exit(5);
    }
    *seconds = trace_seconds(threads) - start;
    return a;
}

static double build_theirs(struct trace_peer *p, const struct trace_scene *s,
                           enum trace_peer_quality quality, int threads)
{
    double start = trace_seconds(threads);
    trace_peer_build(p, s, quality, false);
    return trace_seconds(threads) - start;
}

static void print_build(struct bench *b, const char *scene, int threads, const double *ours,
                        const double *theirs, const char *quality)
{
    double mine[RUNS_MAX], other[RUNS_MAX];
    int runs = b->options.runs;
    struct ratio r = ratio_of(theirs, ours, runs);
    memcpy(mine, ours, sizeof mine);
    memcpy(other, theirs, sizeof other);
    double m = median_of(mine, runs), t = median_of(other, runs);
    printf("%-10s build   %d  %.4f s  %s %s %.4f s  ratio %.2f (%.2f-%.2f)\n", scene, threads, m,
           b->peer_names[0], quality, t, r.median, r.low, r.high);
    json_case(b, scene, "work", quality, threads, b->peer_names[0], "s", m, t, &r);
}

/* A figure of both trees, less of which is better. */
static void print_figure(struct bench *b, const char *scene, const char *what, int threads,
                         const char *unit, double ours, double theirs)
{
    double of = ours > 0.0 ? theirs / ours : 0.0;
    struct ratio r = {of, of, of};
    json_case(b, scene, "work", what, threads, b->peer_names[0], unit, ours, theirs, &r);
}

/* What the trees weigh and cost, ours also in the compact layout. */
static void print_tree(struct bench *b, const char *scene, const struct trace_scene *s,
                       const struct accel *a, int threads)
{
    const struct accel_options options = {.isa = b->options.isa, .compact = true};
    double triangles = (double)s->triangle_count, seconds;
    struct accel *compact = build_ours(s, &options, threads, &seconds);
    struct accel_stats stats, packed;
    accel_stats_get(a, &stats);
    accel_stats_get(compact, &packed);
    accel_free(compact);
    double bytes = (double)stats.bytes / triangles, less = (double)packed.bytes / triangles;
    double theirs = (double)trace_peer_bytes(b->peers[threads - 1][0]) / triangles;
    double sah = trace_peer_sah(b->peers[threads - 1][0], s);
    printf("%-10s tree    %d  %.1f bytes/triangle, compact %.1f, theirs %.1f; SAH %.2f wide, %.2f "
           "binary",
           scene, threads, bytes, less, theirs, stats.sah_cost, stats.sah_binary);
    if (sah > 0.0)
        printf(", theirs %.2f", sah);
    printf("; depth %llu, %llu nodes, %llu leaves, %s\n", (unsigned long long)stats.depth_max,
           (unsigned long long)stats.node_count, (unsigned long long)stats.leaf_count,
           accel_isa_name(a));
    print_figure(b, scene, "bytes", threads, "bytes/triangle", bytes, theirs);
    print_figure(b, scene, "bytes-compact", threads, "bytes/triangle", less, theirs);
    if (sah > 0.0)
        print_figure(b, scene, "sah", threads, "half areas of the root", stats.sah_binary, sah);
}

/* Builds both sides in turn and leaves the peers with every variant that is traced. */
static struct accel *time_build(struct bench *b, const char *scene, const struct trace_scene *s,
                                int threads)
{
    double ours[RUNS_MAX], medium[RUNS_MAX], high[RUNS_MAX];
    const struct accel_options normal = {.isa = b->options.isa};
    struct accel *a = NULL;
    for (int run = 0; run < b->options.runs; run++) {
        accel_free(a);
        a = build_ours(s, &normal, threads, &ours[run]);
        medium[run] = build_theirs(b->peers[threads - 1][0], s, PEER_MEDIUM, threads);
        high[run] = build_theirs(b->peers[threads - 1][0], s, PEER_HIGH, threads);
    }
    for (int p = 0; p < b->peer_count; p++)
        trace_peer_build(b->peers[threads - 1][p], s, PEER_MEDIUM, b->peer_robust[p]);
    print_build(b, scene, threads, ours, medium, "build-medium");
    print_build(b, scene, threads, ours, high, "build-high");
    print_tree(b, scene, s, a, threads);
    return a;
}

/* Ours in the other way that options ask for. */
static void build_other(struct bench *b, const char *scene, const struct trace_scene *s,
                        int threads)
{
    enum other other = b->options.other;
    const struct accel_options options = {
        .isa = b->options.isa,
        .builder = other == OTHER_SBVH ? JOB_BUILDER_SBVH : JOB_BUILDER_SAH,
        .precision = other == OTHER_FAST ? JOB_PRECISION_FAST : JOB_PRECISION_EXACT,
        .compact = other == OTHER_COMPACT};
    struct accel_stats stats;
    double seconds[RUNS_MAX];
    if (other == OTHER_NONE)
        return;
    for (int run = 0; run < b->options.runs; run++) {
        accel_free(b->other);
        b->other = build_ours(s, &options, threads, &seconds[run]);
    }
    accel_stats_get(b->other, &stats);
    printf("%-10s other   %d  %.4f s, %.1f bytes/triangle, SAH %.2f wide, %.2f binary\n", scene,
           threads, median_of(seconds, b->options.runs),
           (double)stats.bytes / (double)s->triangle_count, stats.sah_cost, stats.sah_binary);
}

static void free_both(struct bench *b, struct accel *a)
{
    accel_free(a);
    accel_free(b->other);
    b->other = NULL;
}

/* --- Cases ------------------------------------------------------------------ */

static void bench_scene(struct bench *b, enum trace_scene_id id)
{
    struct trace_scene s;
    if (trace_scene_make(&s, id) != ERR_OK)
        exit(5);
    int threads_max = b->options.quick ? 1 : THREADS_MAX;
    for (int threads = 1; threads <= threads_max; threads++) {
        struct accel *a = time_build(b, trace_scene_names[id], &s, threads);
        build_other(b, trace_scene_names[id], &s, threads);
        for (int kind = 0; kind < TRACE_RAYS_COUNT; kind++) {
            struct trace_rays rays;
            if (trace_rays_make(&rays, a, id, (enum trace_rays_id)kind, b->options.side) != ERR_OK)
                exit(5);
            time_rays(b, trace_scene_names[id], trace_rays_names[kind], a, &rays,
                      kind == TRACE_SHADOW, threads);
            if (threads == 1)
                check_rays(b, trace_scene_names[id], trace_rays_names[kind], &s, a, &rays,
                           kind == TRACE_SHADOW);
            trace_rays_release(&rays);
        }
        free_both(b, a);
    }
    trace_scene_release(&s);
}

static char *read_file(const char *path, size_t *bytes)
{
    FILE *f = fopen(path, "rb");
    long size = -1;
    struct stat what;
    if (f && fstat(fileno(f), &what) == 0 && S_ISDIR(what.st_mode))
        errno = EISDIR;
    else if (f && fseek(f, 0, SEEK_END) == 0)
        size = ftell(f);
    char *data = size >= 0 ? mem_alloc((size_t)size + 1) : NULL;
    if (!data || fseek(f, 0, SEEK_SET) != 0 || fread(data, 1, (size_t)size, f) != (size_t)size) {
        fprintf(stderr, "bench_trace: %s cannot be read: %s\n", path, strerror(errno));
        exit(3);
    }
    fclose(f);
    *bytes = (size_t)size;
    return data;
}

static void read_mesh(const char *path, struct gen_mesh *out)
{
    size_t bytes;
    char *data = read_file(path, &bytes);
    struct diag_list problems;
    struct scene_mesh mesh;
    diag_init(&problems);
    if (ply_read_mesh(data, bytes, path, &mesh, &problems) != ERR_OK) {
        diag_print(&problems, stderr);
        exit(3);
    }
    gen_mesh_init(out);
    out->vertex_count = mesh.vertex_count;
    out->triangle_count = mesh.triangle_count;
    out->positions = mem_alloc_array(3 * out->vertex_count, sizeof *out->positions);
    if (!out->positions)
        exit(5);
    for (size_t i = 0; i < 3 * out->vertex_count; i++)
        out->positions[i] = (float)mesh.positions[i];
    out->indices = mesh.indices;
    mesh.indices = NULL;
    scene_mesh_release(&mesh);
    diag_release(&problems);
    mem_free(data);
}

/* Embree's assertions stop the program at such a ray; ours hits nothing with it. */
static bool ray_is_sane(const float ray[8])
{
    bool finite = true, directed = false;
    for (int k = 0; k < 3; k++) {
        finite = finite && __builtin_isfinite(ray[k]) && __builtin_isfinite(ray[4 + k]);
        directed = directed || ray[4 + k] != 0.0f;
    }
    return finite && directed && ray[3] >= 0.0f && ray[3] <= ray[7];
}

static void rays_keep_sane(const char *path, struct trace_rays *rays)
{
    size_t kept = 0;
    for (size_t i = 0; i < rays->count; i++)
        if (ray_is_sane(rays->ray[i]))
            memmove(rays->ray[kept++], rays->ray[i], sizeof *rays->ray);
    if (kept < rays->count)
        fprintf(stderr,
                "bench_trace: %s: %zu of %zu rays left out: not finite, without direction, or "
                "tnear not within 0 to tfar\n",
                path, rays->count - kept, rays->count);
    rays->count = kept;
}

static void read_rays(const char *path, struct trace_rays *out)
{
    size_t bytes;
    char *data = read_file(path, &bytes);
    uint32_t count = 0;
    if (bytes >= sizeof count)
        memcpy(&count, data, sizeof count);
    if (bytes != sizeof count + (size_t)count * sizeof *out->ray) {
        fprintf(
            stderr,
            "bench_trace: %s: expected a count and 8 floats for each ray: %zu bytes for %" PRIu32
            " rays, not %zu\n",
            path, sizeof count + (size_t)count * sizeof *out->ray, count, bytes);
        exit(3);
    }
    out->count = count;
    out->ray = mem_alloc_array(count, sizeof *out->ray);
    if (!out->ray)
        exit(5);
    memcpy(out->ray, data + sizeof count, count * sizeof *out->ray);
    mem_free(data);
    rays_keep_sane(path, out);
    if (out->count == 0) {
        fprintf(stderr, "bench_trace: %s: there is no ray to be timed\n", path);
        exit(3);
    }
}

static void bench_files(struct bench *b)
{
    struct gen_mesh mesh;
    struct trace_scene s;
    struct trace_rays rays;
    read_mesh(b->options.mesh, &mesh);
    read_rays(b->options.rays, &rays);
    trace_scene_wrap(&s, &mesh);
    for (int threads = 1; threads <= (b->options.quick ? 1 : THREADS_MAX); threads++) {
        struct accel *a = time_build(b, "mesh", &s, threads);
        build_other(b, "mesh", &s, threads);
        time_rays(b, "mesh", b->options.shadow ? "shadow" : "closest", a, &rays, b->options.shadow,
                  threads);
        if (threads == 1)
            check_rays(b, "mesh", b->options.shadow ? "shadow" : "closest", &s, a, &rays,
                       b->options.shadow);
        free_both(b, a);
    }
    trace_rays_release(&rays);
    trace_scene_release(&s);
}

static void add_peer(struct bench *b, const char *name, const char *library, bool robust)
{
    for (uint32_t threads = 1; threads <= THREADS_MAX; threads++) {
        b->peers[threads - 1][b->peer_count] = trace_peer_new(library, threads);
        if (!b->peers[threads - 1][b->peer_count]) {
            fprintf(stderr, "bench_trace: %s cannot be loaded\n", library ? library : "Embree");
            exit(5);
        }
    }
    b->peer_names[b->peer_count] = name;
    b->peer_robust[b->peer_count++] = robust;
}

static int usage(void)
{
    fprintf(stderr, "usage: bench_trace [--quick] [--json FILE] [--runs N] [--side N] "
                    "[--scene NAME]\n                   [--isa sse2|avx2|avx512] [--fast | "
                    "--compact | --sbvh]\n"
                    "                   [--embree4 LIBRARY] "
                    "[--mesh FILE.ply --rays FILE [--shadow]]\n");
    return 2;
}

static bool parse_isa(const char *name, enum accel_isa *out)
{
    const char *names[] = {"auto", "sse2", "avx2", "avx512"};
    for (int i = 0; i < 4; i++)
        if (strcmp(name, names[i]) == 0) {
            *out = (enum accel_isa)i;
            return true;
        }
    return false;
}

/* A whole number from low to high and nothing else; says so if it is none. */
static bool parse_count(const char *option, const char *text, int64_t low, int64_t high,
                        int64_t *out)
{
    const char *end = text + strlen(text);
    if (number_parse_int(text, end, out) == end && *out >= low && *out <= high)
        return true;
    fprintf(stderr,
            "bench_trace: --%s: expected a whole number from %" PRId64 " to %" PRId64
            ", not \"%s\"\n",
            option, low, high, text);
    return false;
}

static bool parse_options(int argc, char **argv, struct options *o)
{
    static const struct option table[] = {
        {"quick", no_argument, NULL, 'q'},       {"json", required_argument, NULL, 'j'},
        {"runs", required_argument, NULL, 'n'},  {"side", required_argument, NULL, 's'},
        {"scene", required_argument, NULL, 'c'}, {"isa", required_argument, NULL, 'i'},
        {"fast", no_argument, NULL, 'f'},        {"embree4", required_argument, NULL, '4'},
        {"mesh", required_argument, NULL, 'm'},  {"rays", required_argument, NULL, 'r'},
        {"shadow", no_argument, NULL, 'o'},      {"compact", no_argument, NULL, 'p'},
        {"sbvh", no_argument, NULL, 'h'},        {NULL, 0, NULL, 0},
    };
    *o = (struct options){.runs = 7};
    int64_t count;
    int c;
    while ((c = getopt_long(argc, argv, "", table, NULL)) != -1) {
        switch (c) {
        case 'q':
            o->quick = true;
            break;
        case 'j':
            o->json = optarg;
            break;
        case 'n':
            if (!parse_count("runs", optarg, 1, RUNS_MAX, &count))
                return false;
            o->runs = (int)count;
            break;
        case 's':
            if (!parse_count("side", optarg, 16, 16384, &count))
                return false;
            o->side = (uint32_t)count / 16 * 16;
            break;
        case 'c':
            o->scene = optarg;
            break;
        case 'i':
            if (!parse_isa(optarg, &o->isa))
                return false;
            break;
        case 'f':
        case 'p':
        case 'h':
            if (o->other != OTHER_NONE)
                return false;
            o->other = c == 'f' ? OTHER_FAST : c == 'p' ? OTHER_COMPACT : OTHER_SBVH;
            break;
        case '4':
            o->embree4 = optarg;
            break;
        case 'm':
            o->mesh = optarg;
            break;
        case 'r':
            o->rays = optarg;
            break;
        case 'o':
            o->shadow = true;
            break;
        default:
            return false;
        }
    }
    if (o->side == 0)
        o->side = o->quick ? 192 : 512;
    return optind == argc && !o->mesh == !o->rays;
}

int main(int argc, char **argv)
{
    struct bench b = {.first_case = true};
    if (!parse_options(argc, argv, &b.options))
        return usage();
    add_peer(&b, "embree3", NULL, false);
    add_peer(&b, "embree3-robust", NULL, true);
    if (b.options.embree4) {
        add_peer(&b, "embree4", b.options.embree4, false);
        add_peer(&b, "embree4-robust", b.options.embree4, true);
    }
    char machine[256];
    machine_name(machine, sizeof machine);
    if (b.options.json && !(b.json = fopen(b.options.json, "w"))) {
        fprintf(stderr, "bench_trace: %s: %s\n", b.options.json, strerror(errno));
        return 5;
    }
    if (b.json)
        fprintf(b.json, "{\"machine\": \"%s\", \"cases\": [", machine);
    printf("%s; Mrays/s of ours (single, batch), then for each peer its Mrays/s and the ratios\n"
           "of our single and batch calls to it: median (min-max) of %d runs\n%-10s %-7s th single "
           " batch",
           machine, b.options.runs, "scene", "rays");
    for (int p = 0; p < b.peer_count; p++)
        printf(" | %s", b.peer_names[p]);
    printf("\n");
    bool found = b.options.mesh != NULL;
    if (found)
        bench_files(&b);
    for (int id = 0; id < TRACE_SCENE_COUNT && !b.options.mesh; id++)
        if (!b.options.scene || strcmp(b.options.scene, trace_scene_names[id]) == 0) {
            bench_scene(&b, (enum trace_scene_id)id);
            found = true;
        }
    if (b.json) {
        fprintf(b.json, "\n]}\n");
        if (fclose(b.json) != 0)
            return 5;
    }
    for (int p = 0; p < b.peer_count; p++)
        for (int threads = 0; threads < THREADS_MAX; threads++)
            trace_peer_free(b.peers[threads][p]);
    return !found ? usage() : b.wrong ? 1 : 0;
}
