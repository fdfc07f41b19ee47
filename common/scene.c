#include "common/scene.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"

static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

static void set3(double out[3], double x, double y, double z)
{
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

/* --- Defaults ------------------------------------------------------------ */

void scene_camera_init(struct scene_camera *c)
{
    *c = (struct scene_camera){
        .type = SCENE_CAMERA_PINHOLE, .fov = 45, .focal_length = 1, .ortho_height = 2};
    set3(c->position, 0, 0, 1);
    set3(c->look_at, 0, 0, 0);
    set3(c->ref_up, 0, 1, 0);
}

void scene_texture_init(struct scene_texture *t)
{
    *t = (struct scene_texture){
        .type = SCENE_TEXTURE_CONSTANT, .image = SCENE_NONE, .uv_matrix = {1, 0, 0, 0, 1, 0}};
    set3(t->color[0], 0.4, 0.4, 0.4);
    set3(t->color[1], 0.2, 0.2, 0.2);
}

void scene_image_texture_init(struct scene_texture *t)
{
    scene_texture_init(t);
    t->type = SCENE_TEXTURE_IMAGE;
    t->filter = SCENE_FILTER_MIPMAP;
    set3(t->color[0], 1, 1, 1);
}

void scene_material_init(struct scene_material *m)
{
    *m = (struct scene_material){
        .number = SCENE_NONE,
        .type = SCENE_MATERIAL_DIFFUSE,
        .texture = SCENE_NONE,
        .distribution = SCENE_BECKMANN,
        .bump_texture = SCENE_NONE,
        .bump_scale = 1,
        .alpha_x = 0.1,
        .alpha_y = 0.1,
        .eta = 1.5,
        .roughness = 1,
        .metallic_roughness_texture = SCENE_NONE,
        .emission_texture = SCENE_NONE,
        .normal_texture = SCENE_NONE,
        .normal_scale = 1,
        .transmission_texture = SCENE_NONE,
        .specular = 1,
        .alpha = 1,
        .alpha_cutoff = -1,
    };
    set3(m->color, 1, 1, 1);
    set3(m->R, 1, 1, 1);
    set3(m->T, 1, 1, 1);
    set3(m->etaI, 1, 1, 1);
    set3(m->etaT, 1, 1, 1);
    set3(m->k, 1, 1, 1);
    set3(m->specular_color, 1, 1, 1);
}

void scene_object_init(struct scene_object *o)
{
    *o = (struct scene_object){
        .type = SCENE_OBJECT_MESH, .mesh = SCENE_NONE, .radius = 1, .material = SCENE_NONE};
    memcpy(o->transform, identity, sizeof identity);
    set3(o->radiance, 1, 1, 1);
}

void scene_init(struct scene *s)
{
    *s = (struct scene){.envmap = {.texture = SCENE_NONE, .scale = 1}};
    scene_camera_init(&s->camera);
    memcpy(s->envmap.transform, identity, sizeof identity);
    set3(s->seed_light_position, 0, 5, 0);
    set3(s->seed_light_flux, 1, 1, 1);
}

void scene_mesh_release(struct scene_mesh *m)
{
    mem_free(m->name);
    mem_free(m->positions);
    mem_free(m->normals);
    mem_free(m->uvs);
    mem_free(m->colors);
    mem_free(m->alphas);
    mem_free(m->indices);
    *m = (struct scene_mesh){0};
}

void scene_release(struct scene *s)
{
    for (size_t i = 0; i < s->image_count; i++)
        mem_free(s->images[i].pixels);
    for (size_t i = 0; i < s->texture_count; i++)
        mem_free(s->textures[i].name);
    for (size_t i = 0; i < s->material_count; i++)
        mem_free(s->materials[i].name);
    for (size_t i = 0; i < s->mesh_count; i++)
        scene_mesh_release(&s->meshes[i]);
    mem_free(s->images);
    mem_free(s->textures);
    mem_free(s->materials);
    mem_free(s->meshes);
    mem_free(s->objects);
    mem_free(s->lights);
    scene_init(s);
}

/* --- Invariants ---------------------------------------------------------- */

static bool all_finite(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!(fabs(v[i]) <= SCENE_NUMBER_MAX))
            return false;
    return true;
}

static bool all_finite_f32(const float *v, size_t count)
{
    for (size_t i = 0; v && i < count; i++)
        if (!isfinite(v[i]))
            return false;
    return true;
}

static bool none_negative(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!(v[i] >= 0 && v[i] <= SCENE_NUMBER_MAX))
            return false;
    return true;
}

static bool in_unit(double v)
{
    return v >= 0 && v <= 1;
}

static bool positive(double v)
{
    return v > 0 && v <= SCENE_NUMBER_MAX;
}

static bool index_valid(uint32_t index, size_t count)
{
    return index == SCENE_NONE || index < count;
}

bool scene_transform_valid(const double m[16])
{
    if (!all_finite(m, 16) || m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1)
        return false;
    /* Rows scaled to length 1 first: the determinant is then free of over- and underflow. */
    double r[3][3];
    for (int i = 0; i < 3; i++) {
        const double *row = m + (size_t)4 * (size_t)i;
        double largest = fmax(fabs(row[0]), fmax(fabs(row[1]), fabs(row[2])));
        if (largest == 0)
            return false;
        double x = row[0] / largest, y = row[1] / largest, z = row[2] / largest;
        double length = sqrt(x * x + y * y + z * z);
        r[i][0] = x / length;
        r[i][1] = y / length;
        r[i][2] = z / length;
    }
    double det = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1]) -
                 r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0]) +
                 r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
    return fabs(det) > 1e-13;
}

bool scene_image_valid(const struct scene_image *image)
{
    if (!image->pixels || image->width < 1 || image->width > SCENE_IMAGE_SIDE_MAX ||
        image->height < 1 || image->height > SCENE_IMAGE_SIDE_MAX)
        return false;
    if (image->channel_count != 1 && image->channel_count != 3 && image->channel_count != 4)
        return false;
    size_t samples = (size_t)image->width * image->height * image->channel_count;
    return image->format != SCENE_IMAGE_F32 || all_finite_f32(image->pixels, samples);
}

static bool texture_valid(const struct scene *s, const struct scene_texture *t)
{
    return t->name && (unsigned)t->type <= SCENE_TEXTURE_IMAGE &&
           (unsigned)t->filter <= SCENE_FILTER_MIPMAP &&
           (t->type == SCENE_TEXTURE_IMAGE ? t->image < s->image_count : t->image == SCENE_NONE) &&
           (unsigned)t->wrap[0] <= SCENE_WRAP_MIRROR && (unsigned)t->wrap[1] <= SCENE_WRAP_MIRROR &&
           none_negative(t->color[0], 3) && none_negative(t->color[1], 3) &&
           all_finite(t->uv_matrix, 6);
}

static bool material_valid(const struct scene *s, const struct scene_material *m)
{
    bool textures = index_valid(m->texture, s->texture_count) &&
                    index_valid(m->metallic_roughness_texture, s->texture_count) &&
                    index_valid(m->emission_texture, s->texture_count) &&
                    index_valid(m->normal_texture, s->texture_count) &&
                    index_valid(m->bump_texture, s->texture_count) &&
                    index_valid(m->transmission_texture, s->texture_count);
    bool colors = none_negative(m->color, 3) && none_negative(m->R, 3) && none_negative(m->T, 3) &&
                  none_negative(m->etaI, 3) && none_negative(m->etaT, 3) &&
                  none_negative(m->k, 3) && none_negative(m->emission, 3) &&
                  none_negative(m->sheen_color, 3) && none_negative(m->specular_color, 3);
    bool unit = in_unit(m->metallic) && in_unit(m->roughness) && in_unit(m->transmission) &&
                in_unit(m->clearcoat) && in_unit(m->clearcoat_roughness) &&
                in_unit(m->sheen_roughness) && in_unit(m->alpha);
    return m->name && (unsigned)m->type <= SCENE_MATERIAL_BLACK &&
           (unsigned)m->distribution <= SCENE_GGX && textures && colors && unit &&
           positive(m->alpha_x) && positive(m->alpha_y) && positive(m->eta) &&
           none_negative(&m->specular, 1) && all_finite(&m->normal_scale, 1) &&
           all_finite(&m->bump_scale, 1) && all_finite(&m->alpha_cutoff, 1);
}

static bool all_in_unit_f32(const float *v, size_t count)
{
    for (size_t i = 0; v && i < count; i++)
        if (!(v[i] >= 0 && v[i] <= 1))
            return false;
    return true;
}

static bool mesh_valid(const struct scene_mesh *m)
{
    if (!m->name || m->triangle_count < 1 || m->triangle_count > SCENE_TRIANGLES_MAX)
        return false;
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++)
        if (m->indices[i] >= m->vertex_count)
            return false;
    return all_finite(m->positions, (size_t)m->vertex_count * 3) &&
           all_finite_f32(m->normals, (size_t)m->vertex_count * 3) &&
           all_finite_f32(m->uvs, (size_t)m->vertex_count * 2) &&
           all_in_unit_f32(m->colors, (size_t)m->vertex_count * 3) &&
           all_in_unit_f32(m->alphas, m->vertex_count);
}

static bool object_valid(const struct scene *s, const struct scene_object *o)
{
    bool shape = o->type == SCENE_OBJECT_MESH ? o->mesh < s->mesh_count
                                              : (unsigned)o->type <= SCENE_OBJECT_NOTHING &&
                                                    o->mesh == SCENE_NONE && positive(o->radius);
    if (o->type == SCENE_OBJECT_NOTHING && o->emits)
        return false;
    return shape && index_valid(o->material, s->material_count) && all_finite(o->center, 3) &&
           scene_transform_valid(o->transform) && none_negative(o->radiance, 3);
}

static bool light_valid(const struct scene_light *l)
{
    return (unsigned)l->type <= SCENE_LIGHT_DIRECTIONAL && all_finite(l->position, 3) &&
           all_finite(l->direction, 3) && none_negative(l->intensity, 3) &&
           fabs(l->cos_inner) <= 1 && fabs(l->cos_outer) <= 1;
}

static bool camera_valid(const struct scene_camera *c)
{
    return (unsigned)c->type <= SCENE_CAMERA_PANORAMA && all_finite(c->position, 3) &&
           all_finite(c->look_at, 3) && all_finite(c->ref_up, 3) && c->fov > 0 && c->fov < 180 &&
           positive(c->focal_length) && none_negative(&c->aperture_radius, 1) &&
           positive(c->ortho_height);
}

static bool counts_valid(const struct scene *s)
{
    return s->texture_count <= SCENE_TEXTURES_MAX && s->material_count <= SCENE_MATERIALS_MAX &&
           s->image_count <= SCENE_TEXTURES_MAX && s->mesh_count <= SCENE_MESHES_MAX &&
           s->object_count <= SCENE_OBJECTS_MAX && s->light_count <= SCENE_LIGHTS_MAX;
}

bool scene_tables_valid(const struct scene *s)
{
    bool good = counts_valid(s) && camera_valid(&s->camera) &&
                index_valid(s->envmap.texture, s->texture_count) &&
                none_negative(&s->envmap.scale, 1) && scene_transform_valid(s->envmap.transform) &&
                all_finite(s->seed_light_position, 3) && none_negative(s->seed_light_flux, 3);
    for (size_t i = 0; good && i < s->texture_count; i++)
        good = texture_valid(s, &s->textures[i]);
    for (size_t i = 0; good && i < s->material_count; i++)
        good = material_valid(s, &s->materials[i]);
    for (size_t i = 0; good && i < s->object_count; i++)
        good = object_valid(s, &s->objects[i]);
    for (size_t i = 0; good && i < s->light_count; i++)
        good = light_valid(&s->lights[i]);
    return good;
}

bool scene_valid(const struct scene *s)
{
    return scene_valid_without(s, NULL);
}

bool scene_valid_without(const struct scene *s, const bool *late)
{
    bool good = scene_tables_valid(s);
    for (size_t i = 0; good && i < s->image_count; i++)
        good = (late && late[i]) || scene_image_valid(&s->images[i]);
    for (size_t i = 0; good && i < s->mesh_count; i++)
        good = mesh_valid(&s->meshes[i]);
    return good;
}

void scene_check(const struct scene *s)
{
    TL_ASSERT(scene_valid(s));
}

bool scene_mesh_in_order(const struct scene_mesh *m)
{
    uint32_t next = 0;
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++) {
        if (m->indices[i] > next)
            return false;
        next += m->indices[i] == next;
    }
    return next == m->vertex_count;
}
