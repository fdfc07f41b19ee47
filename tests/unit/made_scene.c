#include "tests/unit/made_scene.h"

#include <string.h>

#include "common/mem.h"

static void add_mesh(struct scene *s, double shift)
{
    struct scene_mesh *m = &s->meshes[s->mesh_count++];
    *m = (struct scene_mesh){.vertex_count = 3, .triangle_count = 1};
    m->name = mem_sprintf("m%zu", s->mesh_count);
    m->positions = mem_calloc(9, sizeof(double));
    m->indices = mem_calloc(3, sizeof(uint32_t));
    m->normals = mem_calloc(9, sizeof(float));
    TL_ASSERT(m->name && m->positions && m->indices && m->normals);
    m->positions[3] = 1 + shift;
    m->positions[7] = 1;
    m->indices[1] = 1;
    m->indices[2] = 2;
    m->normals[2] = 1;
}

static void add_image(struct scene *s, unsigned char value)
{
    struct scene_image *image = &s->images[s->image_count++];
    *image = (struct scene_image){
        .width = 2, .height = 1, .channel_count = 3, .format = SCENE_IMAGE_U8_SRGB};
    image->pixels = mem_calloc(6, 1);
    TL_ASSERT(image->pixels);
    memset(image->pixels, value, 6);
}

void made_scene(struct scene *s)
{
    scene_init(s);
    s->meshes = mem_calloc(4, sizeof *s->meshes);
    s->images = mem_calloc(2, sizeof *s->images);
    s->textures = mem_calloc(3, sizeof *s->textures);
    s->materials = mem_calloc(3, sizeof *s->materials);
    s->objects = mem_calloc(4, sizeof *s->objects);
    s->lights = mem_calloc(1, sizeof *s->lights);
    TL_ASSERT(s->meshes && s->images && s->textures && s->materials && s->objects && s->lights);
    static const double shifts[4] = {0, 0.1, 0, 5};
    for (int i = 0; i < 4; i++)
        add_mesh(s, shifts[i]);
    add_image(s, 10);
    add_image(s, 20);
    for (s->texture_count = 0; s->texture_count < 3; s->texture_count++) {
        struct scene_texture *t = &s->textures[s->texture_count];
        scene_texture_init(t);
        t->name = mem_sprintf("t%zu", s->texture_count);
    }
    s->textures[1].type = s->textures[2].type = SCENE_TEXTURE_IMAGE;
    s->textures[1].filter = SCENE_FILTER_MIPMAP;
    s->textures[1].image = 0;
    s->textures[2].image = 1;
    for (s->material_count = 0; s->material_count < 3; s->material_count++) {
        struct scene_material *m = &s->materials[s->material_count];
        scene_material_init(m);
        m->name = mem_sprintf("m%zu", s->material_count);
    }
    s->materials[1].texture = 2;
    s->materials[2].texture = 1;
    for (; s->object_count < 4; s->object_count++)
        scene_object_init(&s->objects[s->object_count]);
    for (uint32_t i = 0; i < 3; i++)
        s->objects[i].mesh = i;
    s->objects[1].material = 2;
    s->objects[3].type = SCENE_OBJECT_SPHERE;
    s->objects[3].emits = true;
    s->lights[s->light_count++] = (struct scene_light){.intensity = {1, 2, 3}};
    s->envmap.texture = 0;
    scene_check(s);
}
