#include "common/scene_plan.h"

#include <string.h>

#include "common/aov.h"
#include "common/mem.h"

const char *const scene_feature_names[SCENE_FEATURE_COUNT] = {
#define SCENE_FEATURE_NAME(id, name) name,
    SCENE_FEATURES(SCENE_FEATURE_NAME)
#undef SCENE_FEATURE_NAME
};

/* --- What a material reads ----------------------------------------------- */

bool scene_object_is_nothing(const struct scene *scene, const struct scene_object *o)
{
    if (o->type == SCENE_OBJECT_NOTHING)
        return true;
    if (o->emits || o->material == SCENE_NONE)
        return false;
    const struct scene_material *m = &scene->materials[o->material];
    bool dark = !(m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0);
    /* Blended by 0, or masked by more than 0 can reach. */
    return m->alpha_used && dark && m->alpha == 0 && m->alpha_cutoff != 0;
}

static bool reads_color(const struct scene_material *m)
{
    return m->alpha_used || (m->type != SCENE_MATERIAL_GLASS && m->type != SCENE_MATERIAL_BLACK);
}

static bool reads_metallic_roughness(const struct scene_material *m)
{
    return m->type == SCENE_MATERIAL_PRINCIPLED && (m->metallic > 0 || m->roughness > 0);
}

static bool reads_transmission(const struct scene_material *m)
{
    return m->type == SCENE_MATERIAL_PRINCIPLED && m->transmission > 0;
}

struct scene_material scene_plan_material(const struct scene_material *m, bool emission)
{
    struct scene_material out = *m;
    if (!reads_color(m))
        out.texture = SCENE_NONE;
    if (!reads_metallic_roughness(m))
        out.metallic_roughness_texture = SCENE_NONE;
    if (!reads_transmission(m))
        out.transmission_texture = SCENE_NONE;
    if (!emission)
        out.emission_texture = SCENE_NONE;
    return out;
}

/* The material's emission texture counts on spheres and on meshes with texture coordinates, where
 * the object has no radiance of its own (worker/scene). */
static bool object_reads_emission(const struct scene *s, const struct scene_object *o)
{
    const struct scene_material *m = &s->materials[o->material];
    return !o->emits && m->emission_texture != SCENE_NONE &&
           (m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0) &&
           (o->type != SCENE_OBJECT_MESH || s->meshes[o->mesh].uvs);
}

/* So do the colours of its vertices. */
static bool object_reads_emission_colors(const struct scene *s, const struct scene_object *o)
{
    const struct scene_material *m = &s->materials[o->material];
    return !o->emits && m->emission_vertex_colors &&
           (m->emission[0] > 0 || m->emission[1] > 0 || m->emission[2] > 0);
}

/* A texture that is the same everywhere needs no coordinates. */
static bool varies(const struct scene *s, uint32_t texture)
{
    return texture != SCENE_NONE && s->textures[texture].type != SCENE_TEXTURE_CONSTANT;
}

/* Whether a hit's coordinates are read: by a texture, or for the direction in which u grows. */
static bool reads_uvs(const struct scene *s, const struct scene_material *m)
{
    return m->alpha_x != m->alpha_y || m->normal_texture != SCENE_NONE ||
           m->bump_texture != SCENE_NONE || m->emission_texture != SCENE_NONE ||
           varies(s, m->texture) || varies(s, m->metallic_roughness_texture) ||
           varies(s, m->transmission_texture);
}

/* --- Marking ------------------------------------------------------------- */

static void need(struct scene_plan *p, enum scene_feature f)
{
    p->features |= UINT32_C(1) << f;
}

static void mark_texture(struct scene_plan *p, const struct scene *s, uint32_t index, int channels)
{
    if (index == SCENE_NONE)
        return;
    const struct scene_texture *t = &s->textures[index];
    p->textures[index] = true;
    if (t->type == SCENE_TEXTURE_CHECKERBOARD)
        need(p, SCENE_FEATURE_PATTERNS);
    /* The sky is looked up at points. */
    if (t->filter == SCENE_FILTER_MIPMAP && t->type != SCENE_TEXTURE_CONSTANT &&
        index != s->envmap.texture)
        need(p, SCENE_FEATURE_FILTERED);
    if (t->type != SCENE_TEXTURE_IMAGE)
        return;
    need(p, SCENE_FEATURE_IMAGES);
    p->channels[t->image] |= (uint8_t)channels;
}

/* The scattering feature of a material; the light without one scatters nothing. */
static void need_scattering(struct scene_plan *p, enum scene_material_type type)
{
    static const enum scene_feature of_type[] = {
        [SCENE_MATERIAL_DIFFUSE] = SCENE_FEATURE_DIFFUSE,
        [SCENE_MATERIAL_MIRROR] = SCENE_FEATURE_MIRROR,
        [SCENE_MATERIAL_REFRACTION] = SCENE_FEATURE_REFRACTION,
        [SCENE_MATERIAL_GLASS] = SCENE_FEATURE_GLASS,
        [SCENE_MATERIAL_ROUGH_CONDUCTOR] = SCENE_FEATURE_CONDUCTOR,
        [SCENE_MATERIAL_ROUGH_DIELECTRIC] = SCENE_FEATURE_ROUGH_DIELECTRIC,
        [SCENE_MATERIAL_PRINCIPLED] = SCENE_FEATURE_PRINCIPLED,
        [SCENE_MATERIAL_BLACK] = SCENE_FEATURE_COUNT,
    };
    if (of_type[type] < SCENE_FEATURE_COUNT)
        need(p, of_type[type]);
}

static void mark_material(struct scene_plan *p, const struct scene *s, uint32_t index)
{
    struct scene_material m = scene_plan_material(&s->materials[index], p->emissions[index]);
    int packed = (m.roughness > 0 ? SCENE_CHANNEL_G : 0) | (m.metallic > 0 ? SCENE_CHANNEL_B : 0);
    need_scattering(p, m.type);
    mark_texture(p, s, m.texture, SCENE_CHANNELS_RGB | (m.alpha_used ? SCENE_CHANNEL_A : 0));
    mark_texture(p, s, m.metallic_roughness_texture, packed);
    mark_texture(p, s, m.transmission_texture, SCENE_CHANNEL_R);
    mark_texture(p, s, m.emission_texture, SCENE_CHANNELS_RGB);
    mark_texture(p, s, m.normal_texture, SCENE_CHANNELS_RGB);
    mark_texture(p, s, m.bump_texture, SCENE_CHANNELS_RGB);
    if (m.bump_texture != SCENE_NONE)
        need(p, SCENE_FEATURE_BUMPS);
    if (m.normal_texture != SCENE_NONE)
        need(p, SCENE_FEATURE_NORMAL_MAPS);
    if (m.alpha_used && (m.texture != SCENE_NONE || m.alpha < 1))
        need(p, SCENE_FEATURE_OPACITY);
    if (m.backface_culling)
        need(p, SCENE_FEATURE_CULLING);
}

/* Objects first: they say which materials count, and whether an emission texture is read. */
static void mark_objects(struct scene_plan *p, const struct scene *s)
{
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        p->objects[i] = !scene_object_is_nothing(s, o);
        if (!p->objects[i])
            continue;
        if (o->type == SCENE_OBJECT_MESH)
            p->meshes[o->mesh].uses++;
        else
            need(p, SCENE_FEATURE_SPHERES);
        bool emits = o->emits;
        if (o->material != SCENE_NONE) {
            const double *e = s->materials[o->material].emission;
            emits |= e[0] > 0 || e[1] > 0 || e[2] > 0;
            p->materials[o->material] = true;
            p->emissions[o->material] |= object_reads_emission(s, o);
        }
        if (emits)
            need(p, SCENE_FEATURE_AREA_LIGHTS);
    }
}

static bool all_floats(const struct scene_mesh *m)
{
    size_t count = (size_t)m->vertex_count * 3;
    for (size_t i = 0; i < count; i++)
        if ((double)(float)m->positions[i] != m->positions[i])
            return false;
    return true;
}

static void mark_meshes(struct scene_plan *p, const struct scene *s, bool uvs_shown)
{
    for (size_t i = 0; i < s->mesh_count; i++)
        p->meshes[i].uvs = uvs_shown && s->meshes[i].uvs;
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (!p->objects[i] || o->type != SCENE_OBJECT_MESH || o->material == SCENE_NONE)
            continue;
        struct scene_material m =
            scene_plan_material(&s->materials[o->material], p->emissions[o->material]);
        p->meshes[o->mesh].uvs |= s->meshes[o->mesh].uvs && reads_uvs(s, &m);
        p->meshes[o->mesh].colors |=
            s->meshes[o->mesh].colors && (m.vertex_colors || object_reads_emission_colors(s, o));
        p->meshes[o->mesh].alphas |= s->meshes[o->mesh].alphas && m.vertex_colors && m.alpha_used;
    }
    for (size_t i = 0; i < s->mesh_count; i++) {
        if (p->meshes[i].uses == 0)
            continue;
        if (s->meshes[i].normals)
            need(p, SCENE_FEATURE_NORMALS);
        if (p->meshes[i].uvs)
            need(p, SCENE_FEATURE_UVS);
        if (p->meshes[i].colors)
            need(p, SCENE_FEATURE_COLORS);
        if (p->meshes[i].alphas)
            need(p, SCENE_FEATURE_OPACITY);
        if (!scene_plan_has(p, SCENE_FEATURE_DOUBLES) && !all_floats(&s->meshes[i]))
            need(p, SCENE_FEATURE_DOUBLES);
    }
}

static void mark_scene(struct scene_plan *p, const struct scene *s, bool uvs_shown)
{
    mark_objects(p, s);
    for (uint32_t i = 0; i < s->material_count; i++)
        if (p->materials[i])
            mark_material(p, s, i);
    mark_meshes(p, s, uvs_shown);
    mark_texture(p, s, s->envmap.texture, SCENE_CHANNELS_RGB);
    if (s->envmap.texture != SCENE_NONE)
        need(p, SCENE_FEATURE_ENVIRONMENT);
    if (s->light_count > 0)
        need(p, SCENE_FEATURE_LIGHTS);
    if (s->camera.type == SCENE_CAMERA_THIN_LENS)
        need(p, SCENE_FEATURE_LENS);
}

/* --- Life ---------------------------------------------------------------- */

static enum err plan_alloc(const struct scene *s, struct scene_plan *p)
{
    p->objects = mem_calloc(s->object_count, sizeof *p->objects);
    p->materials = mem_calloc(s->material_count, sizeof *p->materials);
    p->emissions = mem_calloc(s->material_count, sizeof *p->emissions);
    p->textures = mem_calloc(s->texture_count, sizeof *p->textures);
    p->channels = mem_calloc(s->image_count, sizeof *p->channels);
    p->meshes = mem_calloc(s->mesh_count, sizeof *p->meshes);
    return p->objects && p->materials && p->emissions && p->textures && p->channels && p->meshes
               ? ERR_OK
               : ERR_NOMEM;
}

void scene_plan_release(struct scene_plan *p)
{
    mem_free(p->objects);
    mem_free(p->materials);
    mem_free(p->emissions);
    mem_free(p->textures);
    mem_free(p->channels);
    mem_free(p->meshes);
    *p = (struct scene_plan){0};
}

enum err scene_plan_make(const struct scene *scene, uint32_t aov, struct scene_plan *out)
{
    struct scene_plan p = {0};
    enum err e = plan_alloc(scene, &p);
    if (e == ERR_OK)
        mark_scene(&p, scene, aov_has(aov, AOV_UV));
    else
        scene_plan_release(&p);
    *out = p;
    return e;
}

enum err scene_plan_keep_all(const struct scene *scene, struct scene_plan *out)
{
    TL_TRY(scene_plan_make(scene, 0, out));
    for (size_t i = 0; i < scene->object_count; i++)
        out->objects[i] = true;
    for (size_t i = 0; i < scene->material_count; i++)
        out->materials[i] = out->emissions[i] = true;
    for (size_t i = 0; i < scene->texture_count; i++)
        out->textures[i] = true;
    for (size_t i = 0; i < scene->image_count; i++)
        out->channels[i] = SCENE_CHANNELS_RGB | SCENE_CHANNEL_A;
    for (size_t i = 0; i < scene->mesh_count; i++)
        out->meshes[i] =
            (struct scene_plan_mesh){.uses = 1, .uvs = true, .colors = true, .alphas = true};
    out->whole = true;
    return ERR_OK;
}
