/* The keys "textures" and "materials". */
#include <string.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/scene_loader.h"

#define ETA_MAX   1e3
#define ALPHA_MIN 1e-6
#define ALPHA_MAX 1e3

/* --- Images -------------------------------------------------------------- */

static uint32_t read_image(struct scene_loader *l, const struct json *v, const char *path,
                           enum image_use use)
{
    struct scene *s = &l->scene;
    struct scene_image image;
    char *full = scene_load_path(l, v, path);
    if (!full)
        return SCENE_NONE;
    size_t problems_before = l->g.problems->count;
    enum err e = image_read_file(full, use, &image, l->g.problems);
    scene_load_name_user(l, v, problems_before);
    s->source_bytes += file_length(full);
    mem_free(full);
    if (e == ERR_OK &&
        scene_load_grow(l, s->images, s->image_count, l->image_capacity, SCENE_TEXTURES_MAX, v)) {
        s->images[s->image_count] = image;
        return (uint32_t)s->image_count++;
    }
    if (e == ERR_OK)
        mem_free(image.pixels);
    l->out_of_memory |= e == ERR_NOMEM;
    return SCENE_NONE;
}

/* Each file is read once for each use. */
static uint32_t load_image(struct scene_loader *l, const struct json *v, const char *path,
                           enum image_use use)
{
    char *key = mem_sprintf("%d %s", (int)use, path);
    uint32_t known = UINT32_MAX, place = 0;
    bool good = key != NULL;
    if (good)
        known = name_table_find(&l->images, key, strlen(key));
    if (good && known == UINT32_MAX)
        good = mem_grow((void **)&l->image_of, l->images.count, &l->image_of_capacity,
                        sizeof *l->image_of) &&
               name_table_add(&l->images, key, strlen(key), &place) == ERR_OK;
    mem_free(key);
    if (!good) {
        l->out_of_memory = true;
        return SCENE_NONE;
    }
    if (known != UINT32_MAX)
        return l->image_of[known];
    l->image_of[place] = read_image(l, v, path, use);
    return l->image_of[place];
}

/* --- textures ------------------------------------------------------------ */

static void load_generator(struct scene_loader *l, const struct json *v, struct scene_texture *t)
{
    static const char *const keys[] = {"type", "scale", "delta", "matrix"};
    static const char *const types[] = {"uvmapping2d"};
    double scale[2] = {1, 1}, delta[2] = {0, 0}, m[6];
    const double limit = SCENE_NUMBER_MAX;
    int type = 0;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)json_get_choice(&l->g, v, "type", types, 1, &type);
    (void)json_get_numbers(&l->g, v, "scale", 2, -limit, limit, scale);
    (void)json_get_numbers(&l->g, v, "delta", 2, -limit, limit, delta);
    memcpy(m, (double[6]){scale[0], 0, delta[0], 0, scale[1], delta[1]}, sizeof m);
    (void)json_get_numbers(&l->g, v, "matrix", 6, -limit, limit, m);
    memcpy(t->uv_matrix, m, sizeof m);
}

/* One name for both directions, or an array of two. */
static void load_wrap(struct scene_loader *l, const struct json *v, struct scene_texture *t)
{
    static const char *const names[] = {"repeat", "clamp", "mirror"};
    const struct json *s = v, *u = v;
    if (!v)
        return;
    if (v->type == JSON_ARRAY) {
        if (v->count != 2) {
            json_get_problem(&l->g, DIAG_ERROR, v, "wrong-length", NULL,
                             "expected one wrap mode, or two for s and t, found %u", v->count);
            return;
        }
        s = v->first;
        u = s->next;
    }
    int first = 0, second = 0;
    (void)json_value_choice(&l->g, s, names, 3, &first);
    if (u == s)
        second = first;
    else
        (void)json_value_choice(&l->g, u, names, 3, &second);
    t->wrap[0] = (enum scene_wrap)first;
    t->wrap[1] = (enum scene_wrap)second;
}

static void load_constant(struct scene_loader *l, const struct json *v, struct scene_texture *t)
{
    static const char *const keys[] = {"type", "color"};
    SCENE_LOAD_KEYS(l, v, keys);
    if (json_get_required(&l->g, v, "color"))
        (void)scene_load_color(l, v, "color", t->color[0]);
}

static void load_checkerboard(struct scene_loader *l, const struct json *v, struct scene_texture *t)
{
    static const char *const keys[] = {"type", "color0", "color1", "filter",
                                       "tex_coordinate_generator"};
    static const char *const filters[] = {"nearest", "mipmap"};
    int filter = 0;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)json_get_choice(&l->g, v, "filter", filters, 2, &filter);
    t->filter = filter == 0 ? SCENE_FILTER_NEAREST : SCENE_FILTER_MIPMAP;
    (void)scene_load_color(l, v, "color0", t->color[0]);
    (void)scene_load_color(l, v, "color1", t->color[1]);
    load_generator(l, json_get_member(v, "tex_coordinate_generator"), t);
}

static void load_image_texture(struct scene_loader *l, const struct json *v,
                               struct scene_texture *t)
{
    static const char *const keys[] = {
        "type", "path", "tex_coordinate_generator", "wrap", "encoding", "color", "filter"};
    static const char *const encodings[] = {"srgb", "linear"};
    static const char *const filters[] = {"nearest", "bilinear", "mipmap"};
    const char *path;
    int encoding = 0, filter = SCENE_FILTER_MIPMAP;
    SCENE_LOAD_KEYS(l, v, keys);
    (void)json_get_choice(&l->g, v, "filter", filters, 3, &filter);
    t->filter = (enum scene_texture_filter)filter;
    t->color[0][0] = t->color[0][1] = t->color[0][2] = 1; /* a factor */
    (void)scene_load_color(l, v, "color", t->color[0]);
    load_generator(l, json_get_member(v, "tex_coordinate_generator"), t);
    load_wrap(l, json_get_member(v, "wrap"), t);
    (void)json_get_choice(&l->g, v, "encoding", encodings, 2, &encoding);
    const struct json *where = json_get_required(&l->g, v, "path");
    if (where && json_value_text(&l->g, where, false, &path))
        t->image = load_image(l, where, path, encoding == 0 ? IMAGE_COLOR : IMAGE_DATA);
}

static void load_texture(struct scene_loader *l, const struct json *v, struct scene_texture *t)
{
    static const char *const types[] = {"constant", "checkerboard", "image"};
    int type;
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    const struct json *which = json_get_required(&l->g, v, "type");
    if (!which || !json_value_choice(&l->g, which, types, 3, &type))
        return;
    t->type = (enum scene_texture_type)type;
    if (t->type == SCENE_TEXTURE_CONSTANT)
        load_constant(l, v, t);
    else if (t->type == SCENE_TEXTURE_CHECKERBOARD)
        load_checkerboard(l, v, t);
    else
        load_image_texture(l, v, t);
}

/* Appends a texture; its name is taken, also on failure. */
static struct scene_texture *add_texture(struct scene_loader *l, const struct json *v, char *name)
{
    struct scene *s = &l->scene;
    if (!name || !scene_load_grow(l, s->textures, s->texture_count, l->texture_capacity,
                                  SCENE_TEXTURES_MAX, v)) {
        mem_free(name);
        return NULL;
    }
    struct scene_texture *t = &s->textures[s->texture_count++];
    scene_texture_init(t);
    t->name = name;
    return t;
}

void scene_load_textures(struct scene_loader *l, const struct json *v)
{
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    for (const struct json *m = v->first; m && !l->out_of_memory; m = m->next) {
        struct scene_texture *t = add_texture(l, m, scene_load_name(l, m));
        uint32_t index;
        if (!t)
            return;
        if (name_table_add(&l->textures, t->name, strlen(t->name), &index) != ERR_OK)
            l->out_of_memory = true;
        load_texture(l, m, t);
    }
}

/* --- materials ----------------------------------------------------------- */

/* "texture_name", or the plain colour that older files give under `old_key`. */
static void load_albedo(struct scene_loader *l, const struct json *v, const char *old_key,
                        bool required, struct scene_material *m)
{
    const struct json *named = json_get_member(v, "texture_name");
    if (named)
        m->texture = scene_load_reference(l, v, "texture_name", &l->textures, "texture");
    else if (required && !json_get_member(v, old_key))
        (void)json_get_required(&l->g, v, "texture_name");
    (void)scene_load_color(l, v, old_key, m->color);
}

static void load_alpha(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const distributions[] = {"beckmann", "ggx"};
    int distribution = (int)m->distribution;
    (void)json_get_number(&l->g, v, "alpha_x", ALPHA_MIN, ALPHA_MAX, &m->alpha_x);
    (void)json_get_number(&l->g, v, "alpha_y", ALPHA_MIN, ALPHA_MAX, &m->alpha_y);
    (void)json_get_choice(&l->g, v, "distribution", distributions, 2, &distribution);
    m->distribution = (enum scene_distribution)distribution;
}

static void load_bump(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    m->bump_texture = scene_load_reference(l, v, "bump_texture", &l->textures, "texture");
    (void)json_get_number(&l->g, v, "bump_scale", -SCENE_NUMBER_MAX, SCENE_NUMBER_MAX,
                          &m->bump_scale);
}

static void load_eta(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    (void)json_get_number(&l->g, v, "eta", 1 / ETA_MAX, ETA_MAX, &m->eta);
}

static void load_diffuse(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type",          "texture_name", "color",     "twosided",
                                       "vertex_colors", "bump_texture", "bump_scale"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    load_albedo(l, v, "color", true, m);
    (void)json_get_bool(&l->g, v, "vertex_colors", &m->vertex_colors);
    (void)json_get_bool(&l->g, v, "twosided", &m->twosided);
}

static void load_mirror(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type", "R", "bump_texture", "bump_scale"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    (void)scene_load_color(l, v, "R", m->R);
}

static void load_refraction(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type", "eta"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_eta(l, v, m);
}

static void load_glass(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type", "eta", "R", "T", "bump_texture", "bump_scale"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    load_eta(l, v, m);
    (void)scene_load_color(l, v, "R", m->R);
    (void)scene_load_color(l, v, "T", m->T);
}

static void load_rough_conductor(struct scene_loader *l, const struct json *v,
                                 struct scene_material *m)
{
    static const char *const keys[] = {"type",         "texture_name", "R",         "alpha_x",
                                       "alpha_y",      "etaI",         "etaT",      "k",
                                       "distribution", "bump_texture", "bump_scale"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    load_albedo(l, v, "R", true, m);
    load_alpha(l, v, m);
    (void)scene_load_color(l, v, "etaI", m->etaI);
    (void)scene_load_color(l, v, "etaT", m->etaT);
    (void)scene_load_color(l, v, "k", m->k);
}

static void load_rough_dielectric(struct scene_loader *l, const struct json *v,
                                  struct scene_material *m)
{
    static const char *const keys[] = {
        "type",         "eta",          "R",         "T", "alpha_x", "alpha_y",
        "distribution", "bump_texture", "bump_scale"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    load_eta(l, v, m);
    load_alpha(l, v, m);
    (void)scene_load_color(l, v, "R", m->R);
    (void)scene_load_color(l, v, "T", m->T);
}

static void load_black(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type"};
    SCENE_LOAD_KEYS(l, v, keys);
    m->type = SCENE_MATERIAL_BLACK;
}

static void load_unit(struct scene_loader *l, const struct json *v, const char *key, double *out)
{
    (void)json_get_number(&l->g, v, key, 0, 1, out);
}

static void load_principled_textures(struct scene_loader *l, const struct json *v,
                                     struct scene_material *m)
{
    const struct {
        const char *key;
        uint32_t *texture;
    } uses[] = {{"metallic_roughness_texture", &m->metallic_roughness_texture},
                {"emission_texture", &m->emission_texture},
                {"normal_texture", &m->normal_texture},
                {"transmission_texture", &m->transmission_texture}};
    for (size_t i = 0; i < sizeof uses / sizeof *uses; i++)
        *uses[i].texture = scene_load_reference(l, v, uses[i].key, &l->textures, "texture");
    (void)json_get_number(&l->g, v, "normal_scale", -1e6, 1e6, &m->normal_scale);
}

static void load_opacity(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const modes[] = {"opaque", "mask", "blend"};
    int mode = 0;
    double cutoff = 0.5;
    load_unit(l, v, "alpha", &m->alpha);
    load_unit(l, v, "alpha_cutoff", &cutoff);
    (void)json_get_choice(&l->g, v, "alpha_mode", modes, 3, &mode);
    m->alpha_used = mode != 0;
    m->alpha_cutoff = mode == 1 ? cutoff : -1;
}

static void load_principled(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const keys[] = {"type",
                                       "texture_name",
                                       "color",
                                       "metallic",
                                       "roughness",
                                       "eta",
                                       "emission",
                                       "transmission",
                                       "clearcoat",
                                       "clearcoat_roughness",
                                       "sheen_color",
                                       "sheen_roughness",
                                       "specular",
                                       "specular_color",
                                       "alpha",
                                       "alpha_mode",
                                       "alpha_cutoff",
                                       "normal_scale",
                                       "bump_texture",
                                       "bump_scale",
                                       "twosided",
                                       "vertex_colors",
                                       "emission_vertex_colors",
                                       "emission_twosided",
                                       "backface_culling",
                                       "metallic_roughness_texture",
                                       "emission_texture",
                                       "normal_texture",
                                       "transmission_texture"};
    SCENE_LOAD_KEYS(l, v, keys);
    load_bump(l, v, m);
    m->distribution = SCENE_GGX;
    load_albedo(l, v, "color", false, m);
    load_eta(l, v, m);
    load_unit(l, v, "metallic", &m->metallic);
    load_unit(l, v, "roughness", &m->roughness);
    load_unit(l, v, "transmission", &m->transmission);
    load_unit(l, v, "clearcoat", &m->clearcoat);
    load_unit(l, v, "clearcoat_roughness", &m->clearcoat_roughness);
    load_unit(l, v, "sheen_roughness", &m->sheen_roughness);
    (void)json_get_number(&l->g, v, "specular", 0, 1e6, &m->specular);
    (void)scene_load_color(l, v, "specular_color", m->specular_color);
    (void)scene_load_color(l, v, "sheen_color", m->sheen_color);
    (void)scene_load_color(l, v, "emission", m->emission);
    (void)json_get_bool(&l->g, v, "twosided", &m->twosided);
    (void)json_get_bool(&l->g, v, "vertex_colors", &m->vertex_colors);
    (void)json_get_bool(&l->g, v, "emission_vertex_colors", &m->emission_vertex_colors);
    (void)json_get_bool(&l->g, v, "emission_twosided", &m->emission_twosided);
    (void)json_get_bool(&l->g, v, "backface_culling", &m->backface_culling);
    load_principled_textures(l, v, m);
    load_opacity(l, v, m);
}

typedef void load_fn(struct scene_loader *l, const struct json *v, struct scene_material *m);

static void load_material(struct scene_loader *l, const struct json *v, struct scene_material *m)
{
    static const char *const types[] = {"diffuse",        "mirror",          "refraction", "glass",
                                        "roughconductor", "roughdielectric", "principled", "black"};
    static load_fn *const loaders[] = {
        load_diffuse,         load_mirror,           load_refraction, load_glass,
        load_rough_conductor, load_rough_dielectric, load_principled, load_black};
    int type = SCENE_MATERIAL_DIFFUSE;
    if (!json_get_is(&l->g, v, JSON_OBJECT) ||
        !json_get_choice(&l->g, v, "type", types, SCENE_MATERIAL_BLACK + 1, &type))
        return;
    m->type = (enum scene_material_type)type;
    loaders[type](l, v, m);
}

static struct scene_material *add_material(struct scene_loader *l, const struct json *v, char *name)
{
    struct scene *s = &l->scene;
    if (!name || !scene_load_grow(l, s->materials, s->material_count, l->material_capacity,
                                  SCENE_MATERIALS_MAX, v)) {
        mem_free(name);
        return NULL;
    }
    struct scene_material *m = &s->materials[s->material_count++];
    scene_material_init(m);
    m->name = name;
    return m;
}

void scene_load_materials(struct scene_loader *l, const struct json *v)
{
    if (!json_get_is(&l->g, v, JSON_OBJECT))
        return;
    for (const struct json *e = v->first; e && !l->out_of_memory; e = e->next) {
        struct scene_material *m = add_material(l, e, scene_load_name(l, e));
        uint32_t index;
        if (!m)
            return;
        if (name_table_add(&l->materials, m->name, strlen(m->name), &index) != ERR_OK)
            l->out_of_memory = true;
        load_material(l, e, m);
    }
}
