#include "client/doctor.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/doctor_mesh.h"
#include "client/doctor_scene.h"
#include "common/mem.h"
#include "common/scene_plan.h"

/* --- Findings --------------------------------------------------------------- */

static void print_into(char out[DOCTOR_TEXT_BYTES], const char *format, va_list arguments)
{
    (void)vsnprintf(out, DOCTOR_TEXT_BYTES, format, arguments);
}

/* The last finding of an id that has as many as are listed; NULL while there is room. */
static struct doctor_finding *last_of_many(const struct doctor *d, const char *id)
{
    struct doctor_finding *last = NULL;
    size_t count = 0;
    for (size_t i = 0; i < d->count; i++)
        if (strcmp(d->findings[i].id, id) == 0) {
            last = &d->findings[i];
            count++;
        }
    return count >= DOCTOR_SAME_MAX ? last : NULL;
}

struct doctor_finding *doctor_add(struct doctor_visit *v, const char *id, uint64_t count,
                                  const char *advice, const char *format, ...)
{
    struct doctor *d = v->out;
    va_list arguments;
    struct doctor_finding *last = last_of_many(d, id);
    if (last) {
        last->more++;
        return NULL;
    }
    if (!mem_grow((void **)&d->findings, d->count, &d->capacity, sizeof *d->findings)) {
        v->out_of_memory = true;
        return NULL;
    }
    struct doctor_finding *f = &d->findings[d->count++];
    *f = (struct doctor_finding){
        .id = id, .count = count, .object = SCENE_NONE, .triangle = SCENE_NONE};
    va_start(arguments, format);
    print_into(f->text, format, arguments);
    va_end(arguments);
    (void)snprintf(f->advice, sizeof f->advice, "%s", advice);
    return f;
}

static void to_world(const struct scene_object *o, const double p[3], double out[3])
{
    for (size_t r = 0; r < 3; r++) {
        const double *m = o->transform + 4 * r;
        out[r] = m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3];
    }
}

/* Says that a finding is of an object, first at a triangle (or SCENE_NONE). */
static void place(const struct doctor_visit *v, struct doctor_finding *f, uint32_t object,
                  uint32_t triangle)
{
    if (!f)
        return;
    const struct scene_object *o = &v->scene->objects[object];
    const struct scene_mesh *m = o->type == SCENE_OBJECT_MESH ? &v->scene->meshes[o->mesh] : NULL;
    f->object = object;
    f->triangle = triangle;
    int at = snprintf(f->where, sizeof f->where, "objects[%u]%s%.120s%s", object, m ? " (" : "",
                      m ? m->name : "", m ? ")" : "");
    if (!m || triangle == SCENE_NONE)
        return;
    double middle[3] = {0, 0, 0};
    for (size_t i = 0; i < 3; i++)
        for (size_t k = 0; k < 3; k++)
            middle[k] += m->positions[3 * (size_t)m->indices[3 * (size_t)triangle + i] + k] / 3;
    to_world(o, middle, f->at);
    f->placed = true;
    (void)snprintf(f->where + at, sizeof f->where - (size_t)at,
                   ", triangle %u at (%.6g, %.6g, %.6g)", triangle, f->at[0], f->at[1], f->at[2]);
}

/* --- One mesh ----------------------------------------------------------------- */

static const char *have(uint64_t count)
{
    return count == 1 ? "has" : "have";
}

/* What is the same wherever the mesh stands; reported at the first object that shows it. */
static void judge_shape(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m)
{
    const struct scene_mesh *mesh = &v->scene->meshes[v->scene->objects[object].mesh];
    uint32_t all = mesh->triangle_count;
    if (doctor_mesh_is_coarse(m))
        place(v,
              doctor_add(v, "far-from-origin", mesh->vertex_count, DOCTOR_FAR_ADVICE,
                         DOCTOR_FAR_TEXT, m->step, m->reach, m->edge_median,
                         m->edge_median / m->step),
              object, SCENE_NONE);
    if (m->flat.count)
        place(v,
              doctor_add(v, "flat-triangles", m->flat.count,
                         "they are never hit and cost little; a cleaning step of the modeller "
                         "(merge by distance, dissolve degenerate) removes them",
                         "%llu of %u triangles %s no area", (unsigned long long)m->flat.count, all,
                         have(m->flat.count)),
              object, m->flat.first);
    if (m->needles.count)
        place(v,
              doctor_add(v, "needle-triangles", m->needles.count,
                         "hits stay exact, but shading normals across such a triangle mean "
                         "little and trees are slower; remesh or triangulate by shape",
                         "%llu of %u triangles %s over %.0f times longer than high, the worst "
                         "%.3g times",
                         (unsigned long long)m->needles.count, all,
                         m->needles.count == 1 ? "is" : "are", DOCTOR_NEEDLE_ASPECT, m->aspect_max),
              object, m->needles.first);
    if (m->duplicates.count)
        place(v,
              doctor_add(v, "duplicate-triangles", m->duplicates.count,
                         "the one with the lowest number is seen; glass counts each of them, so "
                         "remove the doubles",
                         "%llu of %u triangles %s the very corners of another",
                         (unsigned long long)m->duplicates.count, all, have(m->duplicates.count)),
              object, m->duplicates.first);
    if (m->against.count)
        place(v,
              doctor_add(v, "normals-disagree", m->against.count,
                         "shading jumps there: recalculate the vertex normals, or split them at "
                         "sharp edges",
                         "%llu of %u triangles %s vertex normals on both sides",
                         (unsigned long long)m->against.count, all, have(m->against.count)),
              object, m->against.first);
}

/* --- One object ------------------------------------------------------------------ */

/* How much the transform lengthens, and whether it mirrors. */
static double size_of(const struct scene_object *o, bool *mirrors)
{
    const double *m = o->transform;
    double det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                 m[2] * (m[4] * m[9] - m[5] * m[8]);
    *mirrors = det < 0;
    return cbrt(fabs(det));
}

static void world_box(const struct scene_object *o, const struct doctor_mesh *m, double low[3],
                      double high[3])
{
    for (int corner = 0; corner < 8; corner++) {
        double p[3], q[3];
        for (int k = 0; k < 3; k++)
            p[k] = corner >> k & 1 ? m->high[k] : m->low[k];
        to_world(o, p, q);
        for (int k = 0; k < 3; k++) {
            low[k] = corner == 0 ? q[k] : fmin(low[k], q[k]);
            high[k] = corner == 0 ? q[k] : fmax(high[k], q[k]);
        }
    }
}

static bool emits(const struct scene *s, const struct scene_object *o)
{
    if (o->emits || o->material == SCENE_NONE)
        return o->emits;
    const double *e = s->materials[o->material].emission;
    return e[0] > 0 || e[1] > 0 || e[2] > 0;
}

/* Will the tracer hold the mesh in floats of its own, not around the scene's centre? From its world
 * box, `off` from there: the rules of worker/scene/scene_geometry.c. */
static bool has_own_space(const struct doctor_visit *v, const struct scene_object *o,
                          const double low[3], const double high[3], double off)
{
    double extent = 0;
    for (int k = 0; k < 3; k++)
        extent = fmax(extent, 0.5 * high[k] - 0.5 * low[k]);
    return !emits(v->scene, o) &&
           ((v->uses[o->mesh] > 1 &&
             v->scene->meshes[o->mesh].triangle_count >= SCENE_INSTANCE_TRIANGLES_MIN) ||
            extent < SCENE_OWN_SPACE_MAX * off);
}

/* What is that long, `reach` from the world's origin and `off` from the scene's centre, beside the
 * steps that numbers have there: double's own, and `step`, in which the tracer holds vertices. */
static void judge_steps(struct doctor_visit *v, uint32_t object, double length, double reach,
                        double off, double step)
{
    const double double_steps = 1e4, float_steps = 1e3, finest = off * 0x1p-53;
    if (length < double_steps * reach * 0x1p-53)
        place(v,
              doctor_add(v, "far-in-world", 1,
                         "move the whole scene, camera and lights, towards the origin",
                         "at %.3g from the world's origin even doubles come in steps of %.2g, and "
                         "detail is of about %.2g",
                         reach, reach * 0x1p-53, length),
              object, SCENE_NONE);
    if (length < float_steps * step || length < double_steps * finest)
        place(v,
              doctor_add(v, "coarse-beside-scene", 1,
                         "make what is largest (a ground, a sky dome) smaller or centre it here, "
                         "or use an environment_map for what is far",
                         "detail is of about %.2g, and %.3g from the middle of the scene places "
                         "are held in steps of %.2g",
                         length, off, step > finest ? step : finest),
              object, SCENE_NONE);
}

static void judge_place(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m)
{
    const struct scene_object *o = &v->scene->objects[object];
    bool mirrors;
    double low[3], high[3], reach = 0, off = 0, middle = 0;
    double edge = m->edge_median * size_of(o, &mirrors);
    world_box(o, m, low, high);
    for (int k = 0; k < 3; k++) {
        reach = fmax(reach, fmax(fabs(low[k]), fabs(high[k])));
        off = fmax(off, fmax(v->center[k] - low[k], high[k] - v->center[k]));
        middle = fmax(middle, fabs(0.5 * low[k] + 0.5 * high[k] - v->center[k]));
    }
    if (edge > 0)
        judge_steps(v, object, edge, reach, off,
                    has_own_space(v, o, low, high, middle) ? 0 : off * 0x1p-24);
}

static void judge_sphere(struct doctor_visit *v, uint32_t object)
{
    const struct scene_object *o = &v->scene->objects[object];
    double reach = 0, off = 0;
    for (int k = 0; k < 3; k++) {
        reach = fmax(reach, fabs(o->center[k]));
        off = fmax(off, fabs(o->center[k] - v->center[k]));
    }
    judge_steps(v, object, o->radius, reach, off, 0);
}

static bool is_glass(const struct scene_material *m)
{
    return m->type == SCENE_MATERIAL_REFRACTION || m->type == SCENE_MATERIAL_GLASS ||
           m->type == SCENE_MATERIAL_ROUGH_DIELECTRIC ||
           (m->type == SCENE_MATERIAL_PRINCIPLED && m->transmission > 0);
}

static bool holds_camera(const struct scene *s, const double low[3], const double high[3])
{
    bool inside = true;
    for (int k = 0; k < 3; k++)
        inside = inside && s->camera.position[k] >= low[k] && s->camera.position[k] <= high[k];
    return inside;
}

/* What an object's sides mean to its material. */
enum sides { SIDES_ALIKE, SIDES_BLACK, SIDES_LAMP, SIDES_GLASS };

static enum sides sides_of(const struct scene *s, const struct scene_object *o)
{
    const struct scene_material *m = o->material == SCENE_NONE ? NULL : &s->materials[o->material];
    if (m && is_glass(m))
        return SIDES_GLASS;
    if (o->emits)
        return SIDES_LAMP;
    bool one_sided =
        m && !m->twosided &&
        (m->type == SCENE_MATERIAL_DIFFUSE || m->type == SCENE_MATERIAL_ROUGH_CONDUCTOR);
    return one_sided ? SIDES_BLACK : SIDES_ALIKE;
}

static void judge_closed(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m)
{
    const struct scene_object *o = &v->scene->objects[object];
    if (m->closed)
        return;
    place(v,
          doctor_add(v, "open-glass", m->open_edges.count,
                     "light that enters never leaves as it should: close the mesh, give it "
                     "thickness, or use eta 1",
                     "%.60s is a medium with an inside, but %llu edge%s of the mesh %s open",
                     v->scene->materials[o->material].name, (unsigned long long)m->open_edges.count,
                     m->open_edges.count == 1 ? "" : "s", m->open_edges.count == 1 ? "is" : "are"),
          object, m->open_edges.count ? m->open_edges.first : m->fans.first);
}

static void judge_winding(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m,
                          enum sides sides)
{
    static const char *const advice[] = {
        [SIDES_BLACK] = "one of the two is black where the other is seen; recalculate the normals, "
                        "or use a material with \"twosided\"",
        [SIDES_LAMP] = "one of the two is dark where the other shines; recalculate the normals",
        [SIDES_GLASS] = "at one of the two light leaves where it should enter; recalculate the "
                        "normals"};
    if (m->turned.count && advice[sides])
        place(v,
              doctor_add(v, "mixed-winding", m->turned.count, advice[sides],
                         "along %llu edge%s two triangles face opposite ways",
                         (unsigned long long)m->turned.count, m->turned.count == 1 ? "" : "s"),
              object, m->turned.first);
}

static void judge_inside(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m,
                         enum sides sides)
{
    static const char *const advice[] = {
        [SIDES_BLACK] = "it is black from outside: flip the normals, or use a material with "
                        "\"twosided\"",
        [SIDES_LAMP] = "it lights its inside only: flip the normals",
        [SIDES_GLASS] = "glass and air change places: flip the normals"};
    const struct scene *s = v->scene;
    const struct scene_object *o = &s->objects[object];
    double low[3], high[3];
    bool mirrors;
    (void)size_of(o, &mirrors);
    world_box(o, m, low, high);
    /* Where there are vertex normals the winding follows them, mirrored or not. */
    bool inward = (m->volume_signed < 0) != (mirrors && !s->meshes[o->mesh].normals);
    bool room = sides == SIDES_BLACK && holds_camera(s, low, high);
    if (m->closed && !m->turned.count && !m->fans.count && inward && advice[sides] && !room)
        place(v,
              doctor_add(v, "inside-out", s->meshes[o->mesh].triangle_count, advice[sides],
                         "the mesh is closed and all its normals point inward"),
              object, SCENE_NONE);
}

static void judge_object(struct doctor_visit *v, uint32_t object, const struct doctor_mesh *m)
{
    enum sides sides = sides_of(v->scene, &v->scene->objects[object]);
    judge_place(v, object, m);
    if (sides == SIDES_GLASS)
        judge_closed(v, object, m);
    judge_winding(v, object, m, sides);
    judge_inside(v, object, m, sides);
}

/* --- All ------------------------------------------------------------------------- */

static enum err visit_meshes(struct doctor_visit *v, struct doctor_mesh *meshes)
{
    const struct scene *s = v->scene;
    for (uint32_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->type == SCENE_OBJECT_MESH && v->uses[o->mesh]++ == 0) {
            TL_TRY(doctor_mesh_examine(&s->meshes[o->mesh], &meshes[o->mesh]));
            v->out->meshes++;
            v->out->triangles += s->meshes[o->mesh].triangle_count;
            judge_shape(v, i, &meshes[o->mesh]);
        }
    }
    return ERR_OK;
}

/* The box around everything: its middle is the tracer's origin (worker/scene). */
static void measure_scene(struct doctor_visit *v, const struct doctor_mesh *meshes)
{
    double low[3] = {DBL_MAX, DBL_MAX, DBL_MAX}, high[3] = {-DBL_MAX, -DBL_MAX, -DBL_MAX};
    for (uint32_t i = 0; i < v->scene->object_count; i++) {
        const struct scene_object *o = &v->scene->objects[i];
        double l[3], h[3];
        for (int k = 0; k < 3; k++) {
            l[k] = o->center[k] - o->radius;
            h[k] = o->center[k] + o->radius;
        }
        if (o->type == SCENE_OBJECT_MESH)
            world_box(o, &meshes[o->mesh], l, h);
        for (int k = 0; k < 3; k++) {
            low[k] = fmin(low[k], l[k]);
            high[k] = fmax(high[k], h[k]);
        }
    }
    for (int k = 0; k < 3 && v->scene->object_count; k++)
        v->center[k] = 0.5 * low[k] + 0.5 * high[k];
}

enum err doctor_examine(const struct scene *s, const struct diag_list *loaded, struct doctor *out)
{
    struct doctor_visit v = {.scene = s, .out = out};
    struct doctor_mesh *meshes = mem_calloc(s->mesh_count + 1, sizeof *meshes);
    *out = (struct doctor){0};
    v.uses = mem_calloc(s->mesh_count + 1, sizeof *v.uses);
    enum err e = meshes && v.uses ? visit_meshes(&v, meshes) : ERR_NOMEM;
    if (e == ERR_OK) {
        measure_scene(&v, meshes);
        for (uint32_t i = 0; i < s->object_count; i++)
            if (s->objects[i].type == SCENE_OBJECT_MESH)
                judge_object(&v, i, &meshes[s->objects[i].mesh]);
            else
                judge_sphere(&v, i);
        e = doctor_judge_scene(&v, loaded);
    }
    mem_free(v.uses);
    mem_free(meshes);
    return v.out_of_memory ? ERR_NOMEM : e;
}

void doctor_release(struct doctor *d)
{
    mem_free(d->findings);
    *d = (struct doctor){0};
}

enum err doctor_warn_precision(const struct scene *s, struct diag_list *problems)
{
    for (size_t i = 0; i < s->mesh_count; i++) {
        struct doctor_mesh m;
        if (!doctor_mesh_may_be_coarse(&s->meshes[i]))
            continue;
        TL_TRY(doctor_mesh_measure(&s->meshes[i], &m));
        if (doctor_mesh_is_coarse(&m))
            diag_add(problems, DIAG_WARNING, (struct diag_place){.file = s->meshes[i].name},
                     "far-from-origin", DOCTOR_FAR_ADVICE, DOCTOR_FAR_TEXT, m.step, m.reach,
                     m.edge_median, m.edge_median / m.step);
    }
    return ERR_OK;
}
