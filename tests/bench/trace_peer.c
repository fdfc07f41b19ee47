#include "tests/bench/trace_peer.h"

#include <dlfcn.h>
#include <embree3/rtcore.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <time.h>

#include "common/mem.h"
#include "common/scene.h"

/* Embree 4's forms of the two calls that changed. */
typedef void (*intersect4_fn)(RTCScene scene, struct RTCRayHit *ray, void *arguments);
typedef void (*occluded4_fn)(RTCScene scene, struct RTCRay *ray, void *arguments);

/* clang-format off: it moves a list of this kind to the right at every run */
#define CALLS(X)                                                                                   \
    X(rtcNewDevice)                                                                                \
    X(rtcReleaseDevice)                                                                            \
    X(rtcNewScene)                                                                                 \
    X(rtcReleaseScene)                                                                             \
    X(rtcCommitScene)                                                                              \
    X(rtcSetSceneFlags)                                                                            \
    X(rtcSetSceneBuildQuality)                                                                     \
    X(rtcNewGeometry)                                                                              \
    X(rtcReleaseGeometry)                                                                          \
    X(rtcCommitGeometry)                                                                           \
    X(rtcSetSharedGeometryBuffer)                                                                  \
    X(rtcAttachGeometry)                                                                           \
    X(rtcSetGeometryInstancedScene)                                                                \
    X(rtcSetGeometryTransform)                                                                     \
    X(rtcSetDeviceMemoryMonitorFunction)                                                           \
    X(rtcNewBVH)                                                                                   \
    X(rtcBuildBVH)                                                                                 \
    X(rtcThreadLocalAlloc)                                                                         \
    X(rtcReleaseBVH)
/* clang-format on */

struct calls {
#define CALL_FIELD(name) __typeof__(&(name)) name;
    CALLS(CALL_FIELD)
#undef CALL_FIELD
    intersect4_fn intersect4;
    occluded4_fn occluded4;
};

struct trace_peer {
    struct calls call;
    void *library;
    RTCDevice device;
    RTCScene scene, mesh;
    atomic_int_fast64_t bytes;
};

double trace_seconds(int threads)
{
    struct timespec t;
    clock_gettime(threads == 1 ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static bool calls_load(struct trace_peer *p, const char *library)
{
    p->library = dlopen(library, RTLD_NOW | RTLD_LOCAL | RTLD_DEEPBIND);
    if (!p->library)
        return false;
    bool all = true;
#define CALL_LOAD(name)                                                                            \
    *(void **)&p->call.name = dlsym(p->library, #name);                                            \
    all = all && p->call.name;
    CALLS(CALL_LOAD)
#undef CALL_LOAD
    *(void **)&p->call.intersect4 = dlsym(p->library, "rtcIntersect1");
    *(void **)&p->call.occluded4 = dlsym(p->library, "rtcOccluded1");
    return all && p->call.intersect4 && p->call.occluded4;
}

static bool count_bytes(void *ctx, ssize_t bytes, bool post)
{
    struct trace_peer *p = ctx;
    (void)post;
    atomic_fetch_add(&p->bytes, bytes);
    return true;
}

static struct trace_peer *peer_of(const char *library, const char *config)
{
    struct trace_peer *p = mem_calloc(1, sizeof *p);
    if (!p)
        return NULL;
#define CALL_LINK(name) p->call.name = name;
    CALLS(CALL_LINK)
#undef CALL_LINK
    if (!library || calls_load(p, library))
        p->device = p->call.rtcNewDevice(config);
    if (!p->device) {
        mem_free(p);
        return NULL;
    }
    p->call.rtcSetDeviceMemoryMonitorFunction(p->device, count_bytes, p);
    return p;
}

struct trace_peer *trace_peer_new(const char *library, uint32_t threads)
{
    char config[64];
    snprintf(config, sizeof config, "threads=%u,set_affinity=0", threads);
    return peer_of(library, config);
}

struct trace_peer *trace_peer_new_isa(const char *isa)
{
    char config[64];
    snprintf(config, sizeof config, "threads=1,set_affinity=0,isa=%s", isa);
    return peer_of(NULL, config);
}

static void drop_scenes(struct trace_peer *p)
{
    if (p->scene)
        p->call.rtcReleaseScene(p->scene);
    if (p->mesh)
        p->call.rtcReleaseScene(p->mesh);
    p->scene = p->mesh = NULL;
}

void trace_peer_free(struct trace_peer *p)
{
    if (!p)
        return;
    drop_scenes(p);
    p->call.rtcReleaseDevice(p->device);
    mem_free(p);
}

static RTCScene new_scene(struct trace_peer *p, enum trace_peer_quality quality, bool robust)
{
    RTCScene scene = p->call.rtcNewScene(p->device);
    p->call.rtcSetSceneFlags(scene, robust ? RTC_SCENE_FLAG_ROBUST : RTC_SCENE_FLAG_NONE);
    p->call.rtcSetSceneBuildQuality(scene, quality == PEER_HIGH ? RTC_BUILD_QUALITY_HIGH
                                                                : RTC_BUILD_QUALITY_MEDIUM);
    return scene;
}

static void attach(struct trace_peer *p, RTCScene scene, RTCGeometry geometry)
{
    p->call.rtcCommitGeometry(geometry);
    p->call.rtcAttachGeometry(scene, geometry);
    p->call.rtcReleaseGeometry(geometry);
}

static void attach_mesh(struct trace_peer *p, RTCScene scene, const struct accel_mesh *m)
{
    RTCGeometry g = p->call.rtcNewGeometry(p->device, RTC_GEOMETRY_TYPE_TRIANGLE);
    p->call.rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                       m->positions, 0, 12, m->vertex_count);
    p->call.rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, m->indices, 0,
                                       12, m->triangle_count);
    attach(p, scene, g);
}

void trace_peer_build(struct trace_peer *p, const struct trace_scene *s,
                      enum trace_peer_quality quality, bool robust)
{
    drop_scenes(p);
    p->scene = new_scene(p, quality, robust);
    attach_mesh(p, p->scene, &s->views[0]);
    if (s->input.object_count > 1) {
        p->mesh = new_scene(p, quality, robust);
        attach_mesh(p, p->mesh, &s->views[1]);
        p->call.rtcCommitScene(p->mesh);
    }
    for (size_t i = 1; i < s->input.object_count; i++) {
        float m[12];
        for (int k = 0; k < 12; k++)
            m[k] = (float)s->input.objects[i].to_scene[k];
        RTCGeometry g = p->call.rtcNewGeometry(p->device, RTC_GEOMETRY_TYPE_INSTANCE);
        p->call.rtcSetGeometryInstancedScene(g, p->mesh);
        p->call.rtcSetGeometryTransform(g, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, m);
        attach(p, p->scene, g);
    }
    p->call.rtcCommitScene(p->scene);
}

int64_t trace_peer_bytes(const struct trace_peer *p)
{
    return atomic_load(&p->bytes);
}

/* --- The cost of its builder's tree ------------------------------------------- */

struct box {
    float lo[3], hi[3];
};

struct sah_build {
    struct calls *call;
    double cost; /* of the children's boxes so far: the root's is added at the end */
};

static double box_half_area(const struct box *b)
{
    double x = (double)b->hi[0] - (double)b->lo[0], y = (double)b->hi[1] - (double)b->lo[1];
    double z = (double)b->hi[2] - (double)b->lo[2];
    return x * y + y * z + z * x;
}

static void *sah_create(RTCThreadLocalAllocator allocator, unsigned children, void *ctx)
{
    struct sah_build *b = ctx;
    (void)children;
    return b->call->rtcThreadLocalAlloc(allocator, 16, 16); /* never looked into */
}

static void sah_set_children(void *node, void **children, unsigned count, void *ctx)
{
    (void)node, (void)children, (void)count, (void)ctx;
}

/* One thread builds, so the sum needs no lock. */
static void sah_set_bounds(void *node, const struct RTCBounds **bounds, unsigned count, void *ctx)
{
    struct sah_build *b = ctx;
    (void)node;
    for (unsigned i = 0; i < count; i++) {
        struct box box = {{bounds[i]->lower_x, bounds[i]->lower_y, bounds[i]->lower_z},
                          {bounds[i]->upper_x, bounds[i]->upper_y, bounds[i]->upper_z}};
        b->cost += box_half_area(&box);
    }
}

static void *sah_create_leaf(RTCThreadLocalAllocator allocator,
                             const struct RTCBuildPrimitive *primitives, size_t count, void *ctx)
{
    struct sah_build *b = ctx;
    (void)primitives, (void)count;
    return b->call->rtcThreadLocalAlloc(allocator, 16, 16);
}

static void sah_primitive(const struct accel_mesh *m, uint32_t i, struct RTCBuildPrimitive *out,
                          struct box *all)
{
    struct box b = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    for (size_t j = 0; j < 3; j++)
        for (size_t k = 0; k < 3; k++) {
            float x = m->positions[3 * (size_t)m->indices[3 * (size_t)i + j] + k];
            b.lo[k] = x < b.lo[k] ? x : b.lo[k];
            b.hi[k] = x > b.hi[k] ? x : b.hi[k];
            all->lo[k] = x < all->lo[k] ? x : all->lo[k];
            all->hi[k] = x > all->hi[k] ? x : all->hi[k];
        }
    *out = (struct RTCBuildPrimitive){b.lo[0], b.lo[1], b.lo[2], 0, b.hi[0], b.hi[1], b.hi[2], i};
}

double trace_peer_sah(struct trace_peer *p, const struct trace_scene *s)
{
    const struct accel_mesh *m = &s->views[0];
    struct box all = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    struct RTCBuildPrimitive *primitives = NULL;
    if (s->input.object_count == 1)
        primitives = mem_alloc_aligned(m->triangle_count * sizeof *primitives, 64);
    if (!primitives)
        return -1.0;
    for (uint32_t i = 0; i < m->triangle_count; i++)
        sah_primitive(m, i, &primitives[i], &all);
    struct sah_build build = {&p->call, 0.0};
    RTCBVH bvh = p->call.rtcNewBVH(p->device);
    struct RTCBuildArguments args = rtcDefaultBuildArguments();
    args.byteSize = sizeof args;
    args.buildQuality = RTC_BUILD_QUALITY_MEDIUM;
    args.maxBranchingFactor = 2;
    args.maxDepth = 64;
    args.sahBlockSize = args.maxLeafSize = 4;
    args.bvh = bvh;
    args.primitives = primitives;
    args.primitiveCount = args.primitiveArrayCapacity = m->triangle_count;
    args.createNode = sah_create;
    args.setNodeChildren = sah_set_children;
    args.setNodeBounds = sah_set_bounds;
    args.createLeaf = sah_create_leaf;
    args.userPtr = &build;
    bool built = p->call.rtcBuildBVH(&args) != NULL;
    p->call.rtcReleaseBVH(bvh);
    mem_free(primitives);
    return built ? 1.0 + build.cost / box_half_area(&all) : -1.0;
}

static inline void fill_ray(struct RTCRay *r, const float ray[8])
{
    r->org_x = ray[0];
    r->org_y = ray[1];
    r->org_z = ray[2];
    r->tnear = ray[3];
    r->dir_x = ray[4];
    r->dir_y = ray[5];
    r->dir_z = ray[6];
    r->tfar = ray[7];
    r->time = 0.0f;
    r->mask = UINT32_MAX;
    r->flags = 0;
}

static inline void closest(struct trace_peer *p, const float ray[8], struct RTCRayHit *rh)
{
    fill_ray(&rh->ray, ray);
    rh->hit.geomID = rh->hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    if (p->call.intersect4) {
        p->call.intersect4(p->scene, rh, NULL);
    } else {
        struct RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcIntersect1(p->scene, &context, rh);
    }
}

static inline bool occluded(struct trace_peer *p, const float ray[8])
{
    struct RTCRay r;
    fill_ray(&r, ray);
    if (p->call.occluded4) {
        p->call.occluded4(p->scene, &r, NULL);
    } else {
        struct RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcOccluded1(p->scene, &context, &r);
    }
    return r.tfar < 0.0f;
}

void trace_peer_closest(struct trace_peer *p, const float ray[8], struct trace_peer_hit *hit)
{
    struct RTCRayHit rh;
    closest(p, ray, &rh);
    hit->t = rh.ray.tfar;
    hit->primitive = rh.hit.primID;
    hit->object = rh.hit.geomID == RTC_INVALID_GEOMETRY_ID      ? SCENE_NONE
                  : rh.hit.instID[0] == RTC_INVALID_GEOMETRY_ID ? rh.hit.geomID
                                                                : rh.hit.instID[0];
}

bool trace_peer_occluded(struct trace_peer *p, const float ray[8])
{
    return occluded(p, ray);
}

size_t trace_peer_count(struct trace_peer *p, const struct trace_rays *r, size_t begin, size_t end,
                        bool shadow)
{
    size_t hits = 0;
    for (size_t i = begin; i < end; i++) {
        if (shadow) {
            hits += occluded(p, r->ray[i]);
        } else {
            struct RTCRayHit rh __attribute__((aligned(16)));
            closest(p, r->ray[i], &rh);
            hits += rh.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        }
    }
    return hits;
}
