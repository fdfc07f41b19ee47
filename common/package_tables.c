/* The fields and tables of a package's root, each told once for writing and reading alike.
 * Owns the order and width of every field on the way; no state, any thread. */
#include <string.h>

#include "common/mem.h"
#include "common/package_codec.h"

/* --- Fields -------------------------------------------------------------- */

void codec_fail(struct codec *c, enum err e)
{
    if (c->error == ERR_OK)
        c->error = e;
}

void codec_bytes(struct codec *c, void *v, size_t bytes)
{
    if (c->out) {
        buf_put(c->out, v, bytes);
        return;
    }
    const unsigned char *at = buf_get(c->in, bytes);
    if (at && bytes)
        memcpy(v, at, bytes);
}

void codec_u8(struct codec *c, uint8_t *v)
{
    codec_bytes(c, v, sizeof *v);
}

void codec_u32(struct codec *c, uint32_t *v)
{
    codec_bytes(c, v, sizeof *v);
}

void codec_u64(struct codec *c, uint64_t *v)
{
    codec_bytes(c, v, sizeof *v);
}

void codec_f64s(struct codec *c, double *v, size_t count)
{
    codec_bytes(c, v, count * sizeof *v);
}

void codec_bool(struct codec *c, bool *v)
{
    uint8_t byte = c->out ? *v : 0;
    codec_u8(c, &byte);
    if (byte > 1)
        codec_fail(c, ERR_CORRUPT);
    else
        *v = byte != 0;
}

void codec_name(struct codec *c, char **text)
{
    if (c->out)
        buf_put_text(c->out, *text);
    else
        *text = buf_get_text(c->in, SCENE_NAME_BYTES_MAX);
    if (c->in && c->in->no_memory)
        codec_fail(c, ERR_NOMEM); /* before the missing rest is called damage */
}

void codec_table(struct codec *c, void **items, size_t *count, size_t count_max, size_t item_bytes,
                 size_t item_bytes_min)
{
    uint32_t n = c->out ? (uint32_t)*count : 0;
    codec_u32(c, &n);
    if (c->out || c->error != ERR_OK)
        return;
    if (n > count_max) {
        codec_fail(c, ERR_LIMIT);
        return;
    }
    if (c->in->failed || n > buf_left(c->in) / item_bytes_min) {
        codec_fail(c, ERR_CORRUPT);
        return;
    }
    *items = mem_calloc(n, item_bytes);
    if (!*items)
        codec_fail(c, ERR_NOMEM);
    else
        *count = n;
}

void codec_magic(struct codec *c, const char magic[4])
{
    char found[4];
    uint32_t version = PACKAGE_VERSION;
    memcpy(found, magic, sizeof found);
    codec_bytes(c, found, sizeof found);
    codec_u32(c, &version);
    if (memcmp(found, magic, sizeof found) != 0)
        codec_fail(c, ERR_CORRUPT);
    else if (version != PACKAGE_VERSION)
        codec_fail(c, ERR_VERSION);
}

enum err codec_end(const struct codec *c)
{
    if (c->error != ERR_OK)
        return c->error;
    if (c->out)
        return buf_status(c->out);
    TL_TRY(buf_reader_status(c->in));
    return buf_left(c->in) ? ERR_CORRUPT : ERR_OK;
}

/* --- Tables -------------------------------------------------------------- */

static void codec_camera(struct codec *c, struct scene_camera *camera)
{
    codec_enum(c, &camera->type, SCENE_CAMERA_PANORAMA);
    codec_f64s(c, camera->position, 3);
    codec_f64s(c, camera->look_at, 3);
    codec_f64s(c, camera->ref_up, 3);
    codec_f64s(c, &camera->fov, 1);
    codec_f64s(c, &camera->focal_length, 1);
    codec_f64s(c, &camera->aperture_radius, 1);
    codec_f64s(c, &camera->ortho_height, 1);
}

static void codec_texture(struct codec *c, struct scene_texture *t)
{
    codec_name(c, &t->name);
    codec_enum(c, &t->type, SCENE_TEXTURE_IMAGE);
    codec_enum(c, &t->filter, SCENE_FILTER_MIPMAP);
    codec_f64s(c, t->color[0], 3);
    codec_f64s(c, t->color[1], 3);
    codec_u32(c, &t->image);
    codec_enum(c, &t->wrap[0], SCENE_WRAP_MIRROR);
    codec_enum(c, &t->wrap[1], SCENE_WRAP_MIRROR);
    codec_f64s(c, t->uv_matrix, 6);
}

static void codec_principled(struct codec *c, struct scene_material *m)
{
    codec_f64s(c, &m->metallic, 1);
    codec_f64s(c, &m->roughness, 1);
    codec_u32(c, &m->metallic_roughness_texture);
    codec_f64s(c, m->emission, 3);
    codec_u32(c, &m->emission_texture);
    codec_bool(c, &m->emission_vertex_colors);
    codec_bool(c, &m->emission_twosided);
    codec_bool(c, &m->backface_culling);
    codec_u32(c, &m->normal_texture);
    codec_f64s(c, &m->normal_scale, 1);
    codec_f64s(c, &m->transmission, 1);
    codec_u32(c, &m->transmission_texture);
    codec_f64s(c, &m->clearcoat, 1);
    codec_f64s(c, &m->clearcoat_roughness, 1);
    codec_f64s(c, m->sheen_color, 3);
    codec_f64s(c, &m->sheen_roughness, 1);
    codec_f64s(c, &m->specular, 1);
    codec_f64s(c, m->specular_color, 3);
    codec_f64s(c, &m->alpha, 1);
    codec_f64s(c, &m->alpha_cutoff, 1);
    codec_bool(c, &m->alpha_used);
}

static void codec_material(struct codec *c, struct scene_material *m)
{
    codec_name(c, &m->name);
    codec_u32(c, &m->number);
    codec_enum(c, &m->type, SCENE_MATERIAL_BLACK);
    codec_u32(c, &m->texture);
    codec_f64s(c, m->color, 3);
    codec_bool(c, &m->twosided);
    codec_bool(c, &m->vertex_colors);
    codec_enum(c, &m->distribution, SCENE_GGX);
    codec_u32(c, &m->bump_texture);
    codec_f64s(c, &m->bump_scale, 1);
    codec_f64s(c, &m->alpha_x, 1);
    codec_f64s(c, &m->alpha_y, 1);
    codec_f64s(c, &m->eta, 1);
    codec_f64s(c, m->R, 3);
    codec_f64s(c, m->T, 3);
    codec_f64s(c, m->etaI, 3);
    codec_f64s(c, m->etaT, 3);
    codec_f64s(c, m->k, 3);
    codec_principled(c, m);
}

static void codec_object(struct codec *c, struct scene_object *o)
{
    codec_enum(c, &o->type, SCENE_OBJECT_NOTHING);
    codec_u32(c, &o->mesh);
    codec_f64s(c, o->transform, 16);
    codec_f64s(c, o->center, 3);
    codec_f64s(c, &o->radius, 1);
    codec_u32(c, &o->material);
    codec_bool(c, &o->emits);
    codec_f64s(c, o->radiance, 3);
}

static void codec_light(struct codec *c, struct scene_light *l)
{
    codec_enum(c, &l->type, SCENE_LIGHT_DIRECTIONAL);
    codec_f64s(c, l->position, 3);
    codec_f64s(c, l->direction, 3);
    codec_f64s(c, l->intensity, 3);
    codec_f64s(c, &l->cos_inner, 1);
    codec_f64s(c, &l->cos_outer, 1);
}

/* A table of `field` items, each at least `bytes_min` long, through `item`. */
#define codec_items(c, s, field, count_max, bytes_min, item)                                       \
    do {                                                                                           \
        void *items_ = (s)->field##s;                                                              \
        codec_table((c), &items_, &(s)->field##_count, (count_max), sizeof *(s)->field##s,         \
                    (bytes_min));                                                                  \
        (s)->field##s = items_;                                                                    \
        for (size_t i_ = 0; (c)->error == ERR_OK && i_ < (s)->field##_count; i_++)                 \
            item((c), &(s)->field##s[i_]);                                                         \
    } while (0)

void codec_scene(struct codec *c, struct scene *s)
{
    codec_camera(c, &s->camera);
    codec_bool(c, &s->uvs_left_out);
    codec_u32(c, &s->envmap.texture);
    codec_f64s(c, &s->envmap.scale, 1);
    codec_f64s(c, s->envmap.transform, 16);
    codec_f64s(c, s->seed_light_position, 3);
    codec_f64s(c, s->seed_light_flux, 3);
    codec_items(c, s, texture, SCENE_TEXTURES_MAX, CODEC_TEXTURE_BYTES, codec_texture);
    codec_items(c, s, material, SCENE_MATERIALS_MAX, CODEC_MATERIAL_BYTES, codec_material);
    codec_items(c, s, object, SCENE_OBJECTS_MAX, CODEC_OBJECT_BYTES, codec_object);
    codec_items(c, s, light, SCENE_LIGHTS_MAX, CODEC_LIGHT_BYTES, codec_light);
}
