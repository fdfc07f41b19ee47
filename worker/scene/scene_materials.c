/* Images, textures and materials of a scene to those that shading reads: pixels are copied, factors
 * folded in. Owns the bounds on roughness; memory is the scene's arena. One thread. */
#include "worker/scene/scene_parts.h"

#include "common/scene_plan.h"

/* Sheen finer than this is a line. */
static const double SHEEN_ALPHA_MIN = 1e-2;

/* Facets smoother than this are a mirror to any light, and densities stay far from overflow. */
static const double ALPHA_MIN = 1e-4;

static void make_texture(const struct scene_texture *from, const struct texture_image *images,
                         struct texture *out)
{
    *out = (struct texture){.type = from->type,
                            .filter = from->filter,
                            .color = {rgb_of(from->color[0]), rgb_of(from->color[1])},
                            .wrap = {from->wrap[0], from->wrap[1]}};
    memcpy(out->uv_matrix, from->uv_matrix, sizeof out->uv_matrix);
    if (from->type == SCENE_TEXTURE_IMAGE)
        out->image = &images[from->image];
}

/* A constant texture becomes the material's colour, so that nothing is looked up per hit. */
static void make_albedo(const struct scene *scene, const struct scene_material *from,
                        struct material *out)
{
    out->color = rgb_of(from->color);
    out->texture = from->texture;
    if (from->texture == SCENE_NONE)
        return;
    const struct scene_texture *t = &scene->textures[from->texture];
    if (t->type == SCENE_TEXTURE_CONSTANT) {
        out->color = rgb_mul(out->color, rgb_of(t->color[0]));
        out->texture = SCENE_NONE;
    }
}

/* A conductor of such an index reflects all but 4e-30 of the light, and the squares of squares that
 * Fresnel's formulas take stay far from overflow. */
static const double CONDUCTOR_INDEX_MAX = 1e30;

/* An index over that outside; zero outside means vacuum. */
static double index_over(double inside, double outside)
{
    double index = outside > 0 ? inside / outside : inside;
    return index < CONDUCTOR_INDEX_MAX ? index : CONDUCTOR_INDEX_MAX;
}

static rgb indices_over(const double a[3], const double b[3])
{
    return (rgb){index_over(a[0], b[0]), index_over(a[1], b[1]), index_over(a[2], b[2])};
}

/* A rough dielectric whose index is this close to 1 bends nothing: it has no facets to sample. */
static const double ETA_STEP_MIN = 1e-6;

static void make_principled(const struct scene_material *from, struct material *out)
{
    out->metallic = from->metallic;
    out->roughness = from->roughness;
    out->transmission = from->transmission;
    out->metallic_roughness_texture = from->metallic_roughness_texture;
    out->transmission_texture = from->transmission_texture;
    out->specular = from->specular;
    out->specular_color = rgb_of(from->specular_color);
    out->clearcoat = from->clearcoat;
    out->clearcoat_roughness = from->clearcoat_roughness;
    out->sheen_color = rgb_of(from->sheen_color);
    double sheen = from->sheen_roughness * from->sheen_roughness;
    out->sheen_alpha = sheen > SHEEN_ALPHA_MIN ? sheen : SHEEN_ALPHA_MIN;
    out->normal_texture = from->normal_texture;
    out->normal_scale = from->normal_scale;
    out->alpha = from->alpha;
    out->alpha_cutoff = from->alpha_cutoff;
    out->backface_culling = from->type == SCENE_MATERIAL_PRINCIPLED && from->backface_culling;
    out->has_alpha = from->alpha_used && (from->texture != SCENE_NONE || from->alpha < 1);
    if (from->type == SCENE_MATERIAL_PRINCIPLED && rgb_max(out->sheen_color) > 0)
        principled_prepare(out);
}

static void make_material(const struct scene *scene, const struct scene_material *from,
                          struct material *out)
{
    *out = (struct material){.type = from->type,
                             .twosided = from->twosided,
                             .vertex_colors = from->vertex_colors,
                             .distribution = from->distribution,
                             .bump_texture = from->bump_texture,
                             .alpha_x = from->alpha_x > ALPHA_MIN ? from->alpha_x : ALPHA_MIN,
                             .alpha_y = from->alpha_y > ALPHA_MIN ? from->alpha_y : ALPHA_MIN,
                             .eta = from->eta,
                             .R = rgb_of(from->R),
                             .T = rgb_of(from->T),
                             .conductor_eta = indices_over(from->etaT, from->etaI),
                             .conductor_k = indices_over(from->k, from->etaI)};
    make_albedo(scene, from, out);
    make_principled(from, out);
    if (from->type == SCENE_MATERIAL_ROUGH_DIELECTRIC && fabs(from->eta - 1) < ETA_STEP_MIN)
        out->type = SCENE_MATERIAL_GLASS;
    out->is_delta = out->type == SCENE_MATERIAL_MIRROR || out->type == SCENE_MATERIAL_REFRACTION ||
                    out->type == SCENE_MATERIAL_GLASS || out->type == SCENE_MATERIAL_BLACK;
    out->transmits = out->type == SCENE_MATERIAL_ROUGH_DIELECTRIC ||
                     (out->type == SCENE_MATERIAL_PRINCIPLED && out->transmission > 0);
    out->one_lobe = out->type != SCENE_MATERIAL_GLASS &&
                    out->type != SCENE_MATERIAL_ROUGH_DIELECTRIC &&
                    out->type != SCENE_MATERIAL_PRINCIPLED;
    out->is_anisotropic = from->alpha_x != from->alpha_y;
    out->needs_uv = out->texture != SCENE_NONE || out->is_anisotropic ||
                    out->metallic_roughness_texture != SCENE_NONE ||
                    out->transmission_texture != SCENE_NONE || out->normal_texture != SCENE_NONE ||
                    out->bump_texture != SCENE_NONE || from->emission_texture != SCENE_NONE;
}

/* True if a lookup over a footprint may differ from one at a point. */
static bool is_filtered(const struct render_scene *rs, uint32_t texture)
{
    return texture != SCENE_NONE && rs->textures[texture].filter == SCENE_FILTER_MIPMAP &&
           rs->textures[texture].type != SCENE_TEXTURE_CONSTANT;
}

static void make_materials(struct render_scene *rs, const struct scene *scene)
{
    bool shows_uv = aov_has(rs->spec.aov, AOV_UV);
    for (size_t i = 0; i < scene->material_count; i++) {
        const struct scene_material *from = &scene->materials[i];
        struct material *m = &rs->materials[i];
        make_material(scene, from, m);
        m->number = from->number == SCENE_NONE ? (uint32_t)i : from->number;
        m->needs_uv |= shows_uv;
        m->filtered = is_filtered(rs, m->texture) || is_filtered(rs, from->emission_texture) ||
                      is_filtered(rs, m->metallic_roughness_texture) ||
                      is_filtered(rs, m->transmission_texture) ||
                      is_filtered(rs, m->normal_texture) || is_filtered(rs, m->bump_texture);
        m->bump_scale = from->bump_scale * rs->scale;
    }
    rs->materials[scene->material_count] = (struct material){.type = SCENE_MATERIAL_BLACK,
                                                             .texture = SCENE_NONE,
                                                             .normal_texture = SCENE_NONE,
                                                             .bump_texture = SCENE_NONE,
                                                             .needs_uv = shows_uv,
                                                             .is_delta = true};
}

static bool reads_alphas(const struct scene *scene, const struct scene_object *o)
{
    const struct scene_material *m = &scene->materials[o->material];
    return o->type == SCENE_OBJECT_MESH && m->vertex_colors && m->alpha_used &&
           scene->meshes[o->mesh].alphas;
}

enum err scene_build_materials(struct render_scene *rs, const struct scene *scene,
                               const struct scene_building *how)
{
    TL_TRY(scene_build_images(rs, scene, how));
    rs->texture_count = scene->texture_count;
    rs->textures = arena_alloc(&rs->arena, scene->texture_count, sizeof *rs->textures);
    rs->material_count = scene->material_count + 1;
    rs->materials = arena_alloc(&rs->arena, rs->material_count, sizeof *rs->materials);
    if (!rs->textures || !rs->materials)
        return ERR_NOMEM;
    for (size_t i = 0; i < scene->texture_count; i++)
        make_texture(&scene->textures[i], rs->images, &rs->textures[i]);
    make_materials(rs, scene);
    for (size_t i = 0; i < scene->object_count; i++) {
        uint32_t material = scene->objects[i].material;
        if (material == SCENE_NONE || scene_object_is_nothing(scene, &scene->objects[i]))
            continue;
        rs->materials[material].has_alpha |= reads_alphas(scene, &scene->objects[i]);
        rs->has_alpha |=
            rs->materials[material].has_alpha || rs->materials[material].backface_culling;
        rs->has_filtered |= rs->materials[material].filtered;
        enum scene_material_type type = rs->materials[material].type;
        rs->has_glass |= type == SCENE_MATERIAL_GLASS || type == SCENE_MATERIAL_REFRACTION;
    }
    return ERR_OK;
}
