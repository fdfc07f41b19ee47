/* client/import_assimp_material.c: materials and their textures as assimp gives them, as the
 * scene's.
 *
 * What has no counterpart is said once and left out. Runs in the importer's child; one thread.
 */
#include <assimp/material.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "client/import_assimp.h"
#include "common/file_io.h"
#include "common/mem.h"

static double unit_range(double v)
{
    return v >= 0 ? (v <= 1 ? v : 1) : 0;
}

static bool color_of(const struct aiMaterial *m, const char *key, double out[3])
{
    struct aiColor4D c;
    if (aiGetMaterialColor(m, key, 0, 0, &c) != aiReturn_SUCCESS)
        return false;
    const float v[3] = {c.r, c.g, c.b};
    for (int i = 0; i < 3; i++)
        out[i] = v[i] >= 0 && v[i] <= 1e6f ? (double)v[i] : 0;
    return true;
}

static bool number_of(const struct aiMaterial *m, const char *key, double low, double high,
                      double *out)
{
    ai_real v;
    if (aiGetMaterialFloatArray(m, key, 0, 0, &v, NULL) != aiReturn_SUCCESS)
        return false;
    if (!((double)v >= low && (double)v <= high))
        return false;
    *out = (double)v;
    return true;
}

/* --- Textures ------------------------------------------------------------ */

/* A picture inside the model: "*3", or by the name it was saved from. */
static const struct aiTexture *embedded(const struct aiScene *from, const char *path)
{
    unsigned index = 0;
    if (sscanf(path, "*%u", &index) == 1)
        return index < from->mNumTextures ? from->mTextures[index] : NULL;
    for (unsigned i = 0; i < from->mNumTextures; i++)
        if (strcmp(from->mTextures[i]->mFilename.data, path) == 0)
            return from->mTextures[i];
    return NULL;
}

/* The path as written, or its last part if only that is there: it was another machine's. */
static char *picture_path(const struct import *im, const char *written)
{
    char *path = mem_strdup(written);
    if (!path)
        return NULL;
    for (char *c = path; *c; c++)
        if (*c == '\\')
            *c = '/';
    char *joined = file_join(im->folder, path);
    const char *slash = strrchr(path, '/');
    bool there = joined && access(joined, R_OK) == 0;
    mem_free(joined);
    if (!there && slash && slash[1])
        memmove(path, slash + 1, strlen(slash + 1) + 1);
    return path;
}

static enum err add_picture(struct assimp_import *a, const char *path, const char *texture,
                            enum image_use use)
{
    struct import_message *m = a->message;
    if (m->count >= IMPORT_WIRE_PICTURES_MAX)
        return ERR_LIMIT;
    if (!mem_grow((void **)&m->pictures, m->count, &m->capacity, sizeof *m->pictures))
        return ERR_NOMEM;
    const struct aiTexture *inside = embedded(a->from, path);
    struct import_picture p = {.texture = mem_strdup(texture), .use = use};
    if (inside && inside->mHeight == 0) {
        p.data = (const unsigned char *)inside->pcData;
        p.bytes = inside->mWidth;
    } else {
        p.path = picture_path(a->im, path);
    }
    m->pictures[m->count++] = p;
    return p.texture && (p.path || p.data) ? ERR_OK : ERR_NOMEM;
}

static enum scene_wrap wrap_of(enum aiTextureMapMode mode)
{
    return mode == aiTextureMapMode_Clamp || mode == aiTextureMapMode_Decal ? SCENE_WRAP_CLAMP
           : mode == aiTextureMapMode_Mirror                                ? SCENE_WRAP_MIRROR
                                                                            : SCENE_WRAP_REPEAT;
}

/* The first texture of a kind; SCENE_NONE when there is none. */
static enum err texture_of(struct assimp_import *a, const struct aiMaterial *m,
                           enum aiTextureType type, enum image_use use, uint32_t *out)
{
    struct aiString path;
    enum aiTextureMapMode modes[3] = {aiTextureMapMode_Wrap, aiTextureMapMode_Wrap,
                                      aiTextureMapMode_Wrap};
    if (aiGetMaterialTexture(m, type, 0, &path, NULL, NULL, NULL, NULL, modes, NULL) !=
            aiReturn_SUCCESS ||
        path.length == 0)
        return ERR_OK;
    struct scene_texture t;
    char name[32];
    scene_image_texture_init(&t);
    t.type = SCENE_TEXTURE_CONSTANT; /* until the parent has the picture */
    t.wrap[0] = wrap_of(modes[0]);
    t.wrap[1] = wrap_of(modes[1]);
    (void)snprintf(name, sizeof name, "picture%zu", a->message->count);
    TL_TRY(add_picture(a, path.data, name, use));
    return import_add_texture(a->im, &t, name, out);
}

/* --- Materials ----------------------------------------------------------- */

static double largest(const double c[3])
{
    return fmax(c[0], fmax(c[1], c[2]));
}

/* Blinn's exponent as microfacets of the same width; 0 means that there is no highlight. */
static void take_highlight(const struct aiMaterial *m, struct scene_material *out)
{
    double specular[3] = {0, 0, 0}, exponent = 0, strength = 1;
    (void)color_of(m, "$clr.specular", specular);
    (void)number_of(m, "$mat.shininess", 0, 1e6, &exponent);
    (void)number_of(m, "$mat.shinpercent", 0, 1, &strength);
    double ks = largest(specular) * strength;
    if (exponent <= 0)
        ks = 0;
    out->roughness = exponent > 0 ? sqrt(sqrt(2 / (exponent + 2))) : 1;
    out->specular = fmin(2 * ks, 1);
    for (int i = 0; i < 3 && ks > 0; i++)
        out->specular_color[i] = fmin(specular[i] * strength / ks, 1);
}

static void take_surface(const struct aiMaterial *m, struct scene_material *out)
{
    double metallic = 0, roughness = 1, opacity = 1;
    bool physical = number_of(m, "$mat.metallicFactor", 0, 1, &metallic);
    physical |= number_of(m, "$mat.roughnessFactor", 0, 1, &roughness);
    if (physical) {
        out->metallic = metallic;
        out->roughness = roughness;
    } else {
        take_highlight(m, out);
    }
    if (number_of(m, "$mat.refracti", 1.001, 10, &out->eta) == false)
        out->eta = 1.5;
    (void)number_of(m, "$mat.opacity", 0, 1, &opacity);
    if (opacity > 0 && opacity < 1) {
        out->alpha = opacity;
        out->alpha_used = true;
    }
}

static bool is_plain(const struct scene_material *m)
{
    return m->metallic == 0 && m->specular == 0 && !m->alpha_used &&
           m->normal_texture == SCENE_NONE && m->bump_texture == SCENE_NONE &&
           m->emission_texture == SCENE_NONE && m->metallic_roughness_texture == SCENE_NONE;
}

static enum err take_material(struct assimp_import *a, const struct aiMaterial *m,
                              double emission[3], struct scene_material *out)
{
    out->type = SCENE_MATERIAL_PRINCIPLED;
    out->distribution = SCENE_GGX;
    out->twosided = true;
    if (!color_of(m, "$clr.base", out->color) && !color_of(m, "$clr.diffuse", out->color))
        out->color[0] = out->color[1] = out->color[2] = 0.7;
    for (int i = 0; i < 3; i++)
        out->color[i] = unit_range(out->color[i]);
    TL_TRY(texture_of(a, m, aiTextureType_BASE_COLOR, IMAGE_COLOR, &out->texture));
    if (out->texture == SCENE_NONE)
        TL_TRY(texture_of(a, m, aiTextureType_DIFFUSE, IMAGE_COLOR, &out->texture));
    TL_TRY(texture_of(a, m, aiTextureType_NORMALS, IMAGE_DATA, &out->normal_texture));
    TL_TRY(texture_of(a, m, aiTextureType_HEIGHT, IMAGE_DATA, &out->bump_texture));
    (void)number_of(m, "$mat.bumpscaling", -1e6, 1e6, &out->bump_scale);
    TL_TRY(texture_of(a, m, aiTextureType_EMISSIVE, IMAGE_COLOR, &out->emission_texture));
    if (out->texture != SCENE_NONE && largest(out->color) <= 0)
        out->color[0] = out->color[1] = out->color[2] = 1;
    take_surface(m, out);
    (void)color_of(m, "$clr.emissive", emission);
    if (out->emission_texture != SCENE_NONE) {
        for (int i = 0; i < 3; i++) {
            out->emission[i] = largest(emission) > 0 ? emission[i] : 1;
            emission[i] = 0;
        }
    }
    if (is_plain(out))
        out->type = SCENE_MATERIAL_DIFFUSE;
    return ERR_OK;
}

enum err assimp_materials(struct assimp_import *a)
{
    for (unsigned i = 0; i < a->from->mNumMaterials; i++) {
        struct scene_material material;
        struct aiString name = {.length = 0};
        char number[32 + sizeof name.data];
        scene_material_init(&material);
        (void)aiGetMaterialString(a->from->mMaterials[i], AI_MATKEY_NAME, &name);
        (void)snprintf(number, sizeof number, "%u:%s", i, name.data);
        if (!a->uv_sets)
            TL_TRY(take_material(a, a->from->mMaterials[i], a->emission[i], &material));
        TL_TRY(import_add_material(a->im, &material, a->uv_sets ? number : name.data,
                                   &a->material_of[i]));
    }
    return ERR_OK;
}
