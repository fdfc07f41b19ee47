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

void scene_material_init(struct scene_material *m)
{
    *m = (struct scene_material){
        .type = SCENE_MATERIAL_DIFFUSE,
        .texture = SCENE_NONE,
        .distribution = SCENE_BECKMANN,
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

static void check_finite(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        TL_ASSERT(isfinite(v[i]));
}

static void check_index(uint32_t index, size_t count)
{
    TL_ASSERT(index == SCENE_NONE || index < count);
}

static void check_image(const struct scene_image *image)
{
    TL_ASSERT(image->pixels);
    TL_ASSERT(image->width >= 1 && image->width <= SCENE_IMAGE_SIDE_MAX);
    TL_ASSERT(image->height >= 1 && image->height <= SCENE_IMAGE_SIDE_MAX);
    TL_ASSERT(image->channel_count == 1 || image->channel_count == 3 || image->channel_count == 4);
}

static void check_material(const struct scene *s, const struct scene_material *m)
{
    check_index(m->texture, s->texture_count);
    check_index(m->metallic_roughness_texture, s->texture_count);
    check_index(m->emission_texture, s->texture_count);
    check_index(m->normal_texture, s->texture_count);
    check_index(m->transmission_texture, s->texture_count);
    TL_ASSERT(isfinite(m->alpha_x) && m->alpha_x > 0 && isfinite(m->alpha_y) && m->alpha_y > 0);
    TL_ASSERT(isfinite(m->eta) && m->eta > 0);
}

static void check_mesh(const struct scene_mesh *m)
{
    TL_ASSERT(m->triangle_count >= 1 && m->triangle_count <= SCENE_TRIANGLES_MAX);
    check_finite(m->positions, (size_t)m->vertex_count * 3);
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++)
        TL_ASSERT(m->indices[i] < m->vertex_count);
}

static void check_object(const struct scene *s, const struct scene_object *o)
{
    TL_ASSERT(o->type == SCENE_OBJECT_SPHERE || o->mesh < s->mesh_count);
    TL_ASSERT(o->type == SCENE_OBJECT_MESH || (isfinite(o->radius) && o->radius > 0));
    check_index(o->material, s->material_count);
    check_finite(o->transform, 16);
    check_finite(o->center, 3);
    check_finite(o->radiance, 3);
}

void scene_check(const struct scene *s)
{
    TL_ASSERT(s->texture_count <= SCENE_TEXTURES_MAX && s->material_count <= SCENE_MATERIALS_MAX);
    TL_ASSERT(s->mesh_count <= SCENE_MESHES_MAX && s->object_count <= SCENE_OBJECTS_MAX);
    TL_ASSERT(s->light_count <= SCENE_LIGHTS_MAX);
    TL_ASSERT(s->camera.fov > 0 && s->camera.fov < 180);
    check_finite(s->camera.position, 3);
    check_finite(s->camera.look_at, 3);
    check_finite(s->camera.ref_up, 3);
    check_index(s->envmap.texture, s->texture_count);
    check_finite(s->envmap.transform, 16);
    for (size_t i = 0; i < s->image_count; i++)
        check_image(&s->images[i]);
    for (size_t i = 0; i < s->texture_count; i++) {
        check_index(s->textures[i].image, s->image_count);
        TL_ASSERT(s->textures[i].type != SCENE_TEXTURE_IMAGE || s->textures[i].image != SCENE_NONE);
        check_finite(s->textures[i].color[0], 6);
        check_finite(s->textures[i].uv_matrix, 6);
    }
    for (size_t i = 0; i < s->material_count; i++)
        check_material(s, &s->materials[i]);
    for (size_t i = 0; i < s->mesh_count; i++)
        check_mesh(&s->meshes[i]);
    for (size_t i = 0; i < s->object_count; i++)
        check_object(s, &s->objects[i]);
    for (size_t i = 0; i < s->light_count; i++) {
        check_finite(s->lights[i].position, 3);
        check_finite(s->lights[i].direction, 3);
        check_finite(s->lights[i].intensity, 3);
    }
}
