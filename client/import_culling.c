/* client/import_culling.c: which single-sided materials need their backs culled.
 *
 * A surface that is not there from behind costs every ray that meets it a look at its side. Most
 * models never show one: their meshes are closed, or turn their front to the camera. Only materials
 * of a mesh that is open and has a back before the camera keep their culling. One thread.
 */
#include <string.h>

#include "client/import_model.h"

static uint64_t mix(uint64_t x)
{
    x = (x ^ x >> 32) * UINT64_C(0x9e3779b97f4a7c15);
    x = (x ^ x >> 29) * UINT64_C(0xbf58476d1ce4e5b9);
    return x ^ x >> 32;
}

static uint64_t place_hash(const double p[3])
{
    uint64_t hash = 0;
    for (int i = 0; i < 3; i++) {
        double x = p[i] + 0.0; /* one zero */
        uint64_t bits;
        memcpy(&bits, &x, sizeof bits);
        hash = mix(hash ^ bits);
    }
    return hash;
}

struct triangle {
    const double *p[3];
    double n[3]; /* on the side that its vertices' normals say, else on that of its winding */
    bool turned; /* against its winding */
};

static struct triangle triangle_of(const struct scene_mesh *m, uint32_t t)
{
    struct triangle out;
    const uint32_t *k = m->indices + (size_t)3 * t;
    double e[2][3];
    for (int c = 0; c < 3; c++)
        out.p[c] = m->positions + (size_t)3 * k[c];
    for (int i = 0; i < 3; i++) {
        e[0][i] = out.p[1][i] - out.p[0][i];
        e[1][i] = out.p[2][i] - out.p[0][i];
    }
    for (int i = 0; i < 3; i++)
        out.n[i] = e[0][(i + 1) % 3] * e[1][(i + 2) % 3] - e[0][(i + 2) % 3] * e[1][(i + 1) % 3];
    const float *normal = m->normals ? m->normals + (size_t)3 * k[0] : NULL;
    out.turned = normal && out.n[0] * (double)normal[0] + out.n[1] * (double)normal[1] +
                                   out.n[2] * (double)normal[2] <
                               0;
    for (int i = 0; i < 3 && out.turned; i++)
        out.n[i] = -out.n[i];
    return out;
}

/* Whether each edge is run along as often one way as the other, whatever the vertices' numbers: the
 * sum over all of a number that the way back takes off again is 0 then, and else hardly ever. */
static bool is_closed(const struct scene_mesh *m)
{
    uint64_t sum = 0;
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        struct triangle tri = triangle_of(m, t);
        uint64_t at[3];
        for (int c = 0; c < 3; c++)
            at[c] = place_hash(tri.p[tri.turned ? 2 - c : c]);
        for (int c = 0; c < 3; c++)
            sum += mix(at[c] + 2 * at[(c + 1) % 3]) - mix(at[(c + 1) % 3] + 2 * at[c]);
    }
    return sum == 0;
}

/* A point or a direction of the world in the object's space: by the adjugate over the determinant.
 */
static void to_object(const double m[16], const double world[3], bool is_point, double out[3])
{
    double rows[3][3], v[3], det = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            rows[i][k] = m[4 * ((k + 1) % 3) + (i + 1) % 3] * m[4 * ((k + 2) % 3) + (i + 2) % 3] -
                         m[4 * ((k + 1) % 3) + (i + 2) % 3] * m[4 * ((k + 2) % 3) + (i + 1) % 3];
    for (int k = 0; k < 3; k++) {
        v[k] = world[k] - (is_point ? m[4 * k + 3] : 0);
        det += rows[0][k] * m[4 * k];
    }
    for (int i = 0; i < 3; i++)
        out[i] = (rows[i][0] * v[0] + rows[i][1] * v[1] + rows[i][2] * v[2]) / det;
}

static bool shows_back(const struct scene *s, const struct scene_object *o)
{
    const struct scene_camera *c = &s->camera;
    const struct scene_mesh *m = &s->meshes[o->mesh];
    bool parallel = c->type == SCENE_CAMERA_ORTHOGRAPHIC;
    double from[3], eye[3];
    for (int i = 0; i < 3; i++)
        from[i] = parallel ? c->position[i] - c->look_at[i] : c->position[i];
    to_object(o->transform, from, !parallel, eye);
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        struct triangle tri = triangle_of(m, t);
        double side = 0;
        for (int i = 0; i < 3; i++)
            side += tri.n[i] * (eye[i] - (parallel ? 0 : tri.p[0][i]));
        if (side < 0)
            return true;
    }
    return false;
}

void import_settle_culling(struct import *im)
{
    struct scene *s = &im->scene;
    for (uint32_t i = 0; i < s->material_count; i++) {
        if (!s->materials[i].backface_culling)
            continue;
        bool seen = false;
        for (size_t k = 0; k < s->object_count && !seen; k++) {
            const struct scene_object *o = &s->objects[k];
            seen = o->type == SCENE_OBJECT_MESH && o->material == i && shows_back(s, o) &&
                   !is_closed(&s->meshes[o->mesh]);
        }
        s->materials[i].backface_culling = seen;
    }
}
