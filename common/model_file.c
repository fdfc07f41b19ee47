#include "common/model_file.h"

#include <math.h>
#include <string.h>
#include <strings.h>

#include "common/dmath.h"
#include "common/file_io.h"
#include "common/mem.h"
#include "common/obj_mesh.h"
#include "common/ply_file.h"

#define MODEL_BYTES_MAX (UINT64_C(4) << 30)

static bool has_extension(const char *path, const char *extension)
{
    size_t bytes = strlen(path), tail = strlen(extension);
    return bytes > tail && strcasecmp(path + bytes - tail, extension) == 0;
}

static enum err problem(struct diag_list *problems, const char *file, const char *id,
                        const char *hint, const char *text)
{
    diag_add(problems, DIAG_ERROR, (struct diag_place){.file = file}, id, hint, "%s", text);
    return ERR_INPUT;
}

static enum err read_obj(const char *text, size_t bytes, const char *shown, struct scene_mesh *out,
                         struct diag_list *problems)
{
    struct obj_model model;
    TL_TRY(obj_read_strict(text, bytes, shown, &model, problems));
    enum err e = ERR_OK;
    if (model.triangle_count > 0) {
        e = obj_mesh(&model, OBJ_MATERIAL_ALL, out);
    } else {
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = shown}, "empty-mesh",
                 "export the mesh with its faces",
                 "no face in it: %zu vertices, %zu points, %zu lines", model.position_count,
                 model.point_count, model.line_count);
        e = ERR_INPUT;
    }
    obj_release(&model);
    return e;
}

static enum err read_text(const char *text, size_t bytes, const char *path, const char *shown,
                          struct scene_mesh *out, struct diag_list *problems)
{
    if (has_extension(path, ".obj"))
        return read_obj(text, bytes, shown, out, problems);
    if (has_extension(path, ".ply"))
        return ply_read_mesh(text, bytes, shown, out, problems);
    return problem(problems, shown, "unknown-format", "convert it: tilery import",
                   "not a mesh file by its name, expected .obj or .ply");
}

enum err model_read_mesh(const char *path, const char *shown, struct scene_mesh *out,
                         struct diag_list *problems)
{
    char *text;
    size_t bytes;
    enum err e = file_read(path, MODEL_BYTES_MAX, &text, &bytes);
    if (e == ERR_NOMEM)
        return e;
    if (e == ERR_NOT_FOUND)
        return problem(problems, shown, "missing-file", NULL, "no such file");
    if (e == ERR_LIMIT)
        return problem(problems, shown, "file-too-large", NULL, "over 4 GiB");
    if (e != ERR_OK) {
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = shown}, "unreadable-file", NULL,
                 "cannot be read: %s", file_read_why(path, e));
        return ERR_INPUT;
    }
    struct scene_mesh mesh = {0};
    e = read_text(text, bytes, path, shown, &mesh, problems);
    mem_free(text);
    if (e == ERR_LIMIT)
        e = problem(problems, shown, "file-too-large", NULL, "too many triangles");
    if (e == ERR_OK && !mesh.name)
        mesh.name = mem_strndup(shown, SCENE_NAME_BYTES_MAX);
    if (e == ERR_OK && !mesh.name) {
        scene_mesh_release(&mesh);
        e = ERR_NOMEM;
    }
    if (e == ERR_OK)
        *out = mesh;
    return e;
}

/* (b - a) x (c - a) . n, scaled so that it neither over- nor underflows to a wrong sign. */
static double facing(const double *a, const double *b, const double *c, const float *n)
{
    double u[3], v[3], largest = 0;
    for (int i = 0; i < 3; i++) {
        u[i] = b[i] - a[i];
        v[i] = c[i] - a[i];
        largest = fmax(largest, fmax(fabs(u[i]), fabs(v[i])));
    }
    if (!(largest > 0))
        return 0;
    for (int i = 0; i < 3; i++) {
        u[i] /= largest;
        v[i] /= largest;
    }
    return (u[1] * v[2] - u[2] * v[1]) * (double)n[0] + (u[2] * v[0] - u[0] * v[2]) * (double)n[1] +
           (u[0] * v[1] - u[1] * v[0]) * (double)n[2];
}

uint32_t model_fix_winding(struct scene_mesh *m)
{
    uint32_t flipped = 0;
    for (size_t t = 0; m->normals && t < m->triangle_count; t++) {
        uint32_t *corner = m->indices + 3 * t;
        const double *p[3];
        for (size_t i = 0; i < 3; i++)
            p[i] = m->positions + 3 * (size_t)corner[i];
        if (facing(p[0], p[1], p[2], m->normals + 3 * (size_t)corner[0]) < 0) {
            uint32_t second = corner[1];
            corner[1] = corner[2];
            corner[2] = second;
            flipped++;
        }
    }
    return flipped;
}

float model_vertex_color(double value, bool encoded)
{
    double v = value > 0 ? (value < 1 ? value : 1) : 0;
    return (float)(encoded ? dmath_srgb_decode(v) : v);
}
