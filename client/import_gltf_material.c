/* client/import_gltf_material.c: images, samplers and materials of glTF as the scene's.
 *
 * What the renderer has no counterpart for becomes a warning. One thread.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "client/import_gltf.h"
#include "common/dmath.h"
#include "common/mem.h"

/* --- Images and samplers ------------------------------------------------- */

static enum err image_from_view(struct gltf *t, const struct json *image, uint32_t number,
                                enum image_use use, uint32_t *out)
{
    uint32_t view;
    const unsigned char *data;
    size_t bytes;
    char key[24] = "#";
    *out = SCENE_NONE;
    if (!gltf_reference(t, image, "bufferView", GLTF_BUFFER_VIEWS, &view))
        return ERR_OK;
    if (!gltf_view(t, view, &data, &bytes)) {
        json_get_problem(&t->g, DIAG_WARNING, image, "missing-image",
                         "the model is shown without this picture",
                         "the picture lies outside its buffer");
        return ERR_OK;
    }
    (void)snprintf(key, sizeof key, "#image%u", number);
    return import_image_bytes(t->im, key, data, bytes, use, out);
}

static enum err image_from_uri(struct gltf *t, const char *uri, uint32_t number, enum image_use use,
                               uint32_t *out)
{
    unsigned char *data;
    size_t bytes;
    char key[24];
    if (strncmp(uri, "data:", 5) != 0) {
        char *path = gltf_uri_path(uri);
        enum err e = path ? import_image_file(t->im, path, use, out) : ERR_NOMEM;
        mem_free(path);
        return e;
    }
    *out = SCENE_NONE;
    TL_TRY(gltf_data_uri(uri, &data, &bytes));
    if (!data) {
        import_warn(t->im, "missing-image", "the model is shown without this picture",
                    "picture %u is no base64 data", number);
        return ERR_OK;
    }
    (void)snprintf(key, sizeof key, "#image%u", number);
    enum err e = import_image_bytes(t->im, key, data, bytes, use, out);
    mem_free(data);
    return e;
}

static enum err read_image(struct gltf *t, const struct json *image, uint32_t number,
                           enum image_use use, uint32_t *out)
{
    const struct json *uri = json_get_member(image, "uri");
    if (uri && uri->type == JSON_STRING)
        return image_from_uri(t, uri->text, number, use, out);
    return image_from_view(t, image, number, use, out);
}

static enum scene_wrap wrap_of(struct gltf *t, const struct json *sampler, const char *key)
{
    uint32_t mode = 10497;
    (void)json_get_u32(&t->g, sampler, key, 0, UINT32_MAX, &mode);
    return mode == 33071 ? SCENE_WRAP_CLAMP : mode == 33648 ? SCENE_WRAP_MIRROR : SCENE_WRAP_REPEAT;
}

/* --- Textures ------------------------------------------------------------ */

/* KHR_texture_transform turns, then shifts, with v down; ours has v up on both sides:
 * v' = 1 - (d u + e (1 - v) + f). */
static void set_uv_matrix(struct gltf *t, const struct json *info, double m[6])
{
    const struct json *x = gltf_extension(info, "KHR_texture_transform");
    double offset[2] = {0, 0}, scale[2] = {1, 1}, turn = 0;
    const double limit = 1e6;
    gltf_numbers(t, x, "offset", 2, -limit, limit, offset);
    gltf_numbers(t, x, "scale", 2, -limit, limit, scale);
    gltf_number(t, x, "rotation", -limit, limit, &turn);
    double c = dmath_cos(turn), s = dmath_sin(turn);
    double a = c * scale[0], b = s * scale[1], d = -s * scale[0], e = c * scale[1];
    const double made[6] = {a, 0 - b, b + offset[0], 0 - d, e, 1 - e - offset[1]};
    memcpy(m, made, sizeof made);
}

static uint32_t uv_set_of(struct gltf *t, const struct json *info)
{
    uint32_t set = 0;
    const struct json *x = gltf_extension(info, "KHR_texture_transform");
    (void)json_get_u32(&t->g, info, "texCoord", 0, UINT32_MAX, &set);
    (void)json_get_u32(&t->g, x, "texCoord", 0, UINT32_MAX, &set);
    return set;
}

struct material_reader {
    struct gltf *t;
    const struct json *v;
    struct scene_material *out;
    uint32_t uv_set; /* that of the first texture; UINT32_MAX before */
};

/* One set of coordinates per mesh: the first texture decides which. */
static bool fits_uv_set(struct material_reader *r, const struct json *info)
{
    uint32_t set = uv_set_of(r->t, info);
    if (r->uv_set == UINT32_MAX)
        r->uv_set = set < 8 ? set : 0;
    if (set == r->uv_set)
        return true;
    if (import_once(r->t->im, IMPORT_ONCE_UV_SET))
        json_get_problem(&r->t->g, DIAG_WARNING, info, "left-out", NULL,
                         "a texture that uses other coordinates than the material's first is left "
                         "out");
    return false;
}

/* The texture that `info` ({index, texCoord}) refers to; *out keeps SCENE_NONE when there is none
 * or its picture cannot be had. */
static enum err read_texture(struct material_reader *r, const struct json *info, enum image_use use,
                             uint32_t *out)
{
    struct gltf *t = r->t;
    uint32_t index, source;
    if (!info || !json_get_is(&t->g, info, JSON_OBJECT))
        return ERR_OK;
    const struct json *v = gltf_reference(t, info, "index", GLTF_TEXTURES, &index);
    if (!v || !fits_uv_set(r, info))
        return ERR_OK;
    const struct json *image = gltf_reference(t, v, "source", GLTF_IMAGES, &source);
    if (!image)
        return ERR_OK;
    const struct json *sampler = gltf_reference(t, v, "sampler", GLTF_SAMPLERS, &index);
    struct scene_texture made;
    scene_image_texture_init(&made);
    made.wrap[0] = wrap_of(t, sampler, "wrapS");
    made.wrap[1] = wrap_of(t, sampler, "wrapT");
    set_uv_matrix(t, info, made.uv_matrix);
    TL_TRY(read_image(t, image, source, use, &made.image));
    if (made.image == SCENE_NONE)
        return ERR_OK;
    const struct json *name = json_get_member(image, "name");
    return import_add_texture(t->im, &made, name && name->type == JSON_STRING ? name->text : NULL,
                              out);
}

static void leave_out(struct material_reader *r, const struct json *v, const char *const *keys,
                      size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (json_get_member(v, keys[i]) && import_once(r->t->im, IMPORT_ONCE_DETAIL_MAP))
            json_get_problem(&r->t->g, DIAG_WARNING, json_get_member(v, keys[i]), "left-out", NULL,
                             "textures of specular, clearcoat and sheen are left out; their "
                             "factors are used");
}

/* --- Extensions ---------------------------------------------------------- */

static void read_coat_and_sheen(struct material_reader *r)
{
    static const char *const coat_maps[] = {"clearcoatTexture", "clearcoatRoughnessTexture",
                                            "clearcoatNormalTexture"};
    static const char *const sheen_maps[] = {"sheenColorTexture", "sheenRoughnessTexture"};
    const struct json *coat = gltf_extension(r->v, "KHR_materials_clearcoat");
    const struct json *sheen = gltf_extension(r->v, "KHR_materials_sheen");
    struct scene_material *m = r->out;
    gltf_number(r->t, coat, "clearcoatFactor", 0, 1, &m->clearcoat);
    gltf_number(r->t, coat, "clearcoatRoughnessFactor", 0, 1, &m->clearcoat_roughness);
    gltf_numbers(r->t, sheen, "sheenColorFactor", 3, 0, 1, m->sheen_color);
    gltf_number(r->t, sheen, "sheenRoughnessFactor", 0, 1, &m->sheen_roughness);
    leave_out(r, coat, coat_maps, sizeof coat_maps / sizeof *coat_maps);
    leave_out(r, sheen, sheen_maps, sizeof sheen_maps / sizeof *sheen_maps);
}

static void read_specular(struct material_reader *r)
{
    static const char *const maps[] = {"specularTexture", "specularColorTexture"};
    const struct json *specular = gltf_extension(r->v, "KHR_materials_specular");
    const struct json *ior = gltf_extension(r->v, "KHR_materials_ior");
    gltf_number(r->t, specular, "specularFactor", 0, 1, &r->out->specular);
    gltf_numbers(r->t, specular, "specularColorFactor", 3, 0, 1e3, r->out->specular_color);
    leave_out(r, specular, maps, 2);
    double eta = 1.5;
    gltf_number(r->t, ior, "ior", 0, 100, &eta);
    r->out->eta = eta >= 1 ? eta : 1.5; /* 0 asks for a mode of old files */
}

/* Absorption on the way through becomes a tint of the surface, for the thickness that is given. */
static void read_volume(struct material_reader *r)
{
    const struct json *v = gltf_extension(r->v, "KHR_materials_volume");
    double color[3] = {1, 1, 1}, thickness = 0, distance = HUGE_VAL;
    if (!v || r->out->transmission <= 0)
        return;
    gltf_numbers(r->t, v, "attenuationColor", 3, 1e-3, 1, color);
    gltf_number(r->t, v, "thicknessFactor", 0, 1e9, &thickness);
    gltf_number(r->t, v, "attenuationDistance", 1e-9, SCENE_NUMBER_MAX, &distance);
    if (color[0] == 1 && color[1] == 1 && color[2] == 1)
        return;
    for (int i = 0; i < 3; i++)
        r->out->color[i] *= dmath_pow(color[i], thickness / distance);
    if (import_once(r->t->im, IMPORT_ONCE_VOLUME))
        json_get_problem(&r->t->g, DIAG_WARNING, v, "left-out", NULL,
                         "absorption inside is shown as a tint of the surface");
}

static enum err read_transmission(struct material_reader *r)
{
    const struct json *v = gltf_extension(r->v, "KHR_materials_transmission");
    gltf_number(r->t, v, "transmissionFactor", 0, 1, &r->out->transmission);
    TL_TRY(read_texture(r, json_get_member(v, "transmissionTexture"), IMAGE_DATA,
                        &r->out->transmission_texture));
    read_volume(r);
    return ERR_OK;
}

/* The older workflow: its specular colour over the 4 % of index 1.5. */
static enum err read_specular_glossiness(struct material_reader *r, const struct json *v)
{
    struct scene_material *m = r->out;
    double color[4] = {1, 1, 1, 1}, specular[3] = {1, 1, 1}, glossiness = 1;
    gltf_numbers(r->t, v, "diffuseFactor", 4, 0, 1, color);
    gltf_numbers(r->t, v, "specularFactor", 3, 0, 1, specular);
    gltf_number(r->t, v, "glossinessFactor", 0, 1, &glossiness);
    memcpy(m->color, color, sizeof m->color);
    m->alpha = color[3];
    m->metallic = 0;
    m->roughness = 1 - glossiness;
    for (int i = 0; i < 3; i++)
        m->specular_color[i] = specular[i] / 0.04;
    if (json_get_member(v, "specularGlossinessTexture") &&
        import_once(r->t->im, IMPORT_ONCE_SPECULAR_GLOSSINESS))
        json_get_problem(&r->t->g, DIAG_WARNING, v, "left-out", NULL,
                         "textures of specular and glossiness are left out; their factors are "
                         "used");
    return read_texture(r, json_get_member(v, "diffuseTexture"), IMAGE_COLOR, &m->texture);
}

/* --- The core ------------------------------------------------------------ */

static enum err read_base(struct material_reader *r)
{
    const struct json *v = json_get_member(r->v, "pbrMetallicRoughness");
    const struct json *old = gltf_extension(r->v, "KHR_materials_pbrSpecularGlossiness");
    struct scene_material *m = r->out;
    double color[4] = {1, 1, 1, 1};
    if (old)
        return read_specular_glossiness(r, old);
    gltf_numbers(r->t, v, "baseColorFactor", 4, 0, 1, color);
    memcpy(m->color, color, sizeof m->color);
    m->alpha = color[3];
    gltf_number(r->t, v, "metallicFactor", 0, 1, &m->metallic);
    gltf_number(r->t, v, "roughnessFactor", 0, 1, &m->roughness);
    TL_TRY(read_texture(r, json_get_member(v, "baseColorTexture"), IMAGE_COLOR, &m->texture));
    return read_texture(r, json_get_member(v, "metallicRoughnessTexture"), IMAGE_DATA,
                        &m->metallic_roughness_texture);
}

static enum err read_normal(struct material_reader *r)
{
    const struct json *v = json_get_member(r->v, "normalTexture");
    gltf_number(r->t, v, "scale", -1e3, 1e3, &r->out->normal_scale);
    return read_texture(r, v, IMAGE_DATA, &r->out->normal_texture);
}

static bool is_doublesided(const struct material_reader *r)
{
    bool both = false;
    (void)json_get_bool(&r->t->g, r->v, "doubleSided", &both);
    return both;
}

/* Emission that a texture varies, or that both sides have, belongs to the material, other emission
 * to area lights. */
static enum err read_emission(struct material_reader *r, double emission[3])
{
    const struct json *x = gltf_extension(r->v, "KHR_materials_emissive_strength");
    double factor[3] = {0, 0, 0}, strength = 1;
    gltf_numbers(r->t, r->v, "emissiveFactor", 3, 0, 1e6, factor);
    gltf_number(r->t, x, "emissiveStrength", 0, 1e9, &strength);
    for (int i = 0; i < 3; i++)
        factor[i] *= strength;
    TL_TRY(read_texture(r, json_get_member(r->v, "emissiveTexture"), IMAGE_COLOR,
                        &r->out->emission_texture));
    r->out->emission_twosided = is_doublesided(r);
    bool textured = r->out->emission_texture != SCENE_NONE;
    if (textured || r->out->emission_twosided)
        memcpy(r->out->emission, factor, sizeof factor);
    if (!textured)
        memcpy(emission, factor, sizeof factor);
    return ERR_OK;
}

static void read_alpha(struct material_reader *r)
{
    static const char *const modes[] = {"OPAQUE", "MASK", "BLEND"};
    int mode = 0;
    double cutoff = 0.5;
    (void)json_get_choice(&r->t->g, r->v, "alphaMode", modes, 3, &mode);
    gltf_number(r->t, r->v, "alphaCutoff", 0, 1, &cutoff);
    r->out->alpha_used = mode != 0;
    r->out->alpha_cutoff = mode == 1 ? cutoff : -1;
    if (mode == 0)
        r->out->alpha = 1;
}

/* Shown as it is, whatever lights it: it emits its colour, reflects nothing and lets nothing
 * through. */
static void make_unlit(struct scene_material *m)
{
    memcpy(m->emission, m->color, sizeof m->emission);
    m->emission_texture = m->texture;
    m->emission_vertex_colors = true;
    m->normal_texture = m->metallic_roughness_texture = m->transmission_texture = SCENE_NONE;
    for (int i = 0; i < 3; i++)
        m->color[i] = m->sheen_color[i] = 0;
    m->metallic = m->specular = m->clearcoat = m->transmission = 0;
    m->roughness = 1;
}

static enum err read_material(struct material_reader *r, double emission[3])
{
    TL_TRY(read_base(r));
    TL_TRY(read_normal(r));
    TL_TRY(read_emission(r, emission));
    read_specular(r);
    TL_TRY(read_transmission(r));
    read_coat_and_sheen(r);
    read_alpha(r);
    /* Glass has two sides by its nature: light that is in must get out. */
    r->out->backface_culling = !is_doublesided(r) && !(r->out->transmission > 0);
    if (gltf_extension(r->v, "KHR_materials_unlit")) {
        make_unlit(r->out);
        emission[0] = emission[1] = emission[2] = 0;
    }
    return ERR_OK;
}

enum err gltf_materials(struct gltf *t)
{
    size_t count = t->tables[GLTF_MATERIALS].count;
    t->material_of = mem_alloc_array(count + 1, sizeof *t->material_of);
    t->emission = mem_calloc(count + 1, sizeof *t->emission);
    t->uv_sets = mem_calloc(count + 1, 1);
    if (!t->material_of || !t->emission || !t->uv_sets)
        return ERR_NOMEM;
    for (size_t i = 0; i <= count; i++) {
        struct scene_material m;
        struct material_reader r = {.t = t, .out = &m, .uv_set = UINT32_MAX};
        r.v = i < count ? t->tables[GLTF_MATERIALS].items[i] : NULL;
        scene_material_init(&m);
        m.type = SCENE_MATERIAL_PRINCIPLED;
        m.distribution = SCENE_GGX;
        m.metallic = 1;
        m.twosided = true;
        TL_TRY(read_material(&r, t->emission[i]));
        t->uv_sets[i] = r.uv_set == UINT32_MAX ? 0 : (unsigned char)r.uv_set;
        const struct json *name = json_get_member(r.v, "name");
        const char *text = name && name->type == JSON_STRING ? name->text : NULL;
        TL_TRY(import_add_material(t->im, &m, i < count ? text : "default", &t->material_of[i]));
    }
    return ERR_OK;
}
