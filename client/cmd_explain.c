/* client/cmd_explain.c: what a scene asks for, measured on the scene and its package. */
#include <string.h>

#include "client/command.h"
#include "client/human.h"
#include "client/load.h"
#include "common/json_put.h"
#include "common/mem.h"

enum feature {
    FEATURE_DIFFUSE,
    FEATURE_MIRROR,
    FEATURE_REFRACTION,
    FEATURE_GLASS,
    FEATURE_CONDUCTOR,
    FEATURE_ROUGH_DIELECTRIC,
    FEATURE_PRINCIPLED,
    FEATURE_AREA_LIGHTS,
    FEATURE_LIGHTS,
    FEATURE_ENVIRONMENT,
    FEATURE_IMAGES,
    FEATURE_NORMALS,
    FEATURE_UVS,
    FEATURE_SPHERES,
    FEATURE_COUNT
};

static const char *const feature_names[FEATURE_COUNT] = {"diffuse",
                                                         "mirror",
                                                         "refraction",
                                                         "glass",
                                                         "rough conductor",
                                                         "rough dielectric",
                                                         "principled",
                                                         "area lights",
                                                         "point-like lights",
                                                         "environment",
                                                         "image textures",
                                                         "vertex normals",
                                                         "texture coordinates",
                                                         "spheres"};

struct facts {
    uint64_t triangles, triangles_drawn, vertices, spheres, lights;
    uint64_t unused_materials, unused_textures, unused_meshes;
    uint64_t package_bytes, mesh_bytes, image_bytes, wire_bytes;
    size_t chunks;
    bool used[FEATURE_COUNT];
};

static void take_material(struct facts *f, const struct scene_material *m)
{
    static const enum feature of_type[] = {
        [SCENE_MATERIAL_DIFFUSE] = FEATURE_DIFFUSE,
        [SCENE_MATERIAL_MIRROR] = FEATURE_MIRROR,
        [SCENE_MATERIAL_REFRACTION] = FEATURE_REFRACTION,
        [SCENE_MATERIAL_GLASS] = FEATURE_GLASS,
        [SCENE_MATERIAL_ROUGH_CONDUCTOR] = FEATURE_CONDUCTOR,
        [SCENE_MATERIAL_ROUGH_DIELECTRIC] = FEATURE_ROUGH_DIELECTRIC,
        [SCENE_MATERIAL_PRINCIPLED] = FEATURE_PRINCIPLED,
        [SCENE_MATERIAL_BLACK] = FEATURE_COUNT,
    };
    if (of_type[m->type] < FEATURE_COUNT)
        f->used[of_type[m->type]] = true;
}

static void take_objects(struct facts *f, const struct scene *s)
{
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->type == SCENE_OBJECT_SPHERE) {
            f->spheres++;
            f->used[FEATURE_SPHERES] = true;
        } else {
            f->triangles_drawn += s->meshes[o->mesh].triangle_count;
        }
        f->lights += o->emits;
        f->used[FEATURE_AREA_LIGHTS] |= o->emits;
        if (o->material != SCENE_NONE)
            take_material(f, &s->materials[o->material]);
    }
}

static void take_scene(struct facts *f, const struct scene *s)
{
    for (size_t i = 0; i < s->mesh_count; i++) {
        f->triangles += s->meshes[i].triangle_count;
        f->vertices += s->meshes[i].vertex_count;
        f->used[FEATURE_NORMALS] |= s->meshes[i].normals != NULL;
        f->used[FEATURE_UVS] |= s->meshes[i].uvs != NULL;
    }
    take_objects(f, s);
    f->lights += s->light_count;
    f->used[FEATURE_LIGHTS] = s->light_count > 0;
    f->used[FEATURE_ENVIRONMENT] = s->envmap.texture != SCENE_NONE;
}

/* What no object refers to: the package leaves it out. False when out of memory. */
static bool take_unused(struct facts *f, const struct scene *s)
{
    bool *seen = mem_calloc(s->material_count + s->mesh_count + 1, sizeof *seen);
    if (!seen)
        return false;
    bool *mesh_seen = seen + s->material_count;
    for (size_t i = 0; i < s->object_count; i++) {
        if (s->objects[i].material != SCENE_NONE)
            seen[s->objects[i].material] = true;
        if (s->objects[i].type == SCENE_OBJECT_MESH)
            mesh_seen[s->objects[i].mesh] = true;
    }
    for (size_t i = 0; i < s->material_count; i++)
        f->unused_materials += !seen[i];
    for (size_t i = 0; i < s->mesh_count; i++)
        f->unused_meshes += !mesh_seen[i];
    mem_free(seen);
    return true;
}

static bool take_package(struct facts *f, const struct package *p)
{
    bool ok = true;
    f->chunks = p->count;
    for (size_t i = 0; ok && i < p->count; i++) {
        struct buf frame;
        buf_init(&frame);
        ok = chunk_compress(p->chunks[i].data, p->chunks[i].bytes, &frame) == ERR_OK;
        f->wire_bytes += frame.bytes;
        f->package_bytes += p->chunks[i].bytes;
        f->mesh_bytes += p->chunks[i].kind == PACKAGE_MESH ? p->chunks[i].bytes : 0;
        f->image_bytes += p->chunks[i].kind == PACKAGE_IMAGE ? p->chunks[i].bytes : 0;
        buf_release(&frame);
    }
    f->used[FEATURE_IMAGES] = f->image_bytes > 0;
    return ok;
}

static void put_features(const struct facts *f, bool used, const char *separator, bool quoted,
                         struct buf *out)
{
    bool first = true;
    for (int i = 0; i < FEATURE_COUNT; i++) {
        if (f->used[i] != used)
            continue;
        buf_printf(out, "%s", first ? "" : separator);
        if (quoted)
            json_put_text(out, feature_names[i]);
        else
            buf_printf(out, "%s", feature_names[i]);
        first = false;
    }
    if (first && !quoted)
        buf_printf(out, "nothing");
}

static void put_json(const struct facts *f, const struct load *load, struct buf *out)
{
    buf_printf(out,
               "{\"triangles\":%llu,\"triangles_instanced\":%llu,\"vertices\":%llu,"
               "\"spheres\":%llu,\"lights\":%llu,\"bytes\":{\"package\":%llu,\"meshes\":%llu,"
               "\"images\":%llu,\"sent\":%llu},\"chunks\":%zu,\"uses\":[",
               (unsigned long long)f->triangles, (unsigned long long)f->triangles_drawn,
               (unsigned long long)f->vertices, (unsigned long long)f->spheres,
               (unsigned long long)f->lights, (unsigned long long)f->package_bytes,
               (unsigned long long)f->mesh_bytes, (unsigned long long)f->image_bytes,
               (unsigned long long)f->wire_bytes, f->chunks);
    put_features(f, true, ",", true, out);
    buf_printf(out, "],\"uses_not\":[");
    put_features(f, false, ",", true, out);
    buf_printf(out,
               "],\"left_out\":{\"materials\":%llu,\"meshes\":%llu},\"cost_core_s\":null,"
               "\"spec\":%s}\n",
               (unsigned long long)f->unused_materials, (unsigned long long)f->unused_meshes,
               load->spec_json);
}

static void put_text(const struct facts *f, const struct load *load, struct buf *out)
{
    const struct job_spec *s = &load->spec;
    char a[HUMAN_BYTES], b[HUMAN_BYTES], c[HUMAN_BYTES];
    human_count((double)s->crop.width * s->crop.height * (double)s->spp, a);
    buf_printf(out, "picture   %ux%u, %llu spp: %s samples\n", s->crop.width, s->crop.height,
               (unsigned long long)s->spp, a);
    buf_printf(out, "light     %s, depth %u, %s samples\n", job_integrator_names[s->integrator],
               s->max_depth, job_sampler_names[s->sampler]);
    human_count((double)f->triangles, a);
    human_count((double)f->vertices, b);
    buf_printf(out, "geometry  %s triangles, %s vertices, %llu spheres, %llu lights\n", a, b,
               (unsigned long long)f->spheres, (unsigned long long)f->lights);
    if (f->triangles_drawn != f->triangles) {
        human_count((double)f->triangles_drawn, a);
        buf_printf(out, "          %s triangles with every instance counted\n", a);
    }
    human_bytes((double)f->package_bytes, a);
    human_bytes((double)f->image_bytes, b);
    human_bytes((double)f->wire_bytes, c);
    buf_printf(out, "package   %s in %zu chunks (images %s); %s to send\n", a, f->chunks, b, c);
    buf_printf(out, "uses      ");
    put_features(f, true, ", ", false, out);
    buf_printf(out, "\nuses not  ");
    put_features(f, false, ", ", false, out);
    buf_printf(out, "\nleft out  %llu unused materials, %llu unused meshes\n",
               (unsigned long long)f->unused_materials, (unsigned long long)f->unused_meshes);
    buf_printf(out, "cost      not estimated yet\n");
}

int command_explain(struct cli *cli)
{
    struct load load;
    struct facts facts = {0};
    struct buf out;
    load_scene(&load, &cli->line, true);
    int status = load_explain(&load, NULL);
    if (status == EXIT_DONE) {
        buf_init(&out);
        take_scene(&facts, &load.scene);
        bool ok = take_unused(&facts, &load.scene) && take_package(&facts, &load.package);
        if (cli->json)
            put_json(&facts, &load, &out);
        else
            put_text(&facts, &load, &out);
        out.failed |= !ok;
        status = cli_put_buf(&out) ? EXIT_DONE : EXIT_MACHINE;
        buf_release(&out);
    }
    load_release(&load);
    return status;
}
