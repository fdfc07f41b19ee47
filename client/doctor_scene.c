#include "client/doctor_scene.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"

#define HALF_MAX 65504.0

/* --- Light -------------------------------------------------------------------- */

/* The range of what shines, channel by channel, and where its ends are. */
struct range {
    double low, high; /* of values over 0 */
    uint32_t object;  /* of `high`; SCENE_NONE: the sky or a light without a surface */
};

static void range_add(struct range *r, const double *values, double factor, uint32_t object)
{
    for (int k = 0; k < 3; k++) {
        double v = values[k] * factor;
        if (!(v > 0))
            continue;
        if (v > r->high) {
            r->high = v;
            r->object = object;
        }
        r->low = v < r->low ? v : r->low;
    }
}

static void range_add_sky(struct range *r, const struct scene *s)
{
    const struct scene_envmap *e = &s->envmap;
    if (e->texture == SCENE_NONE)
        return;
    const struct scene_texture *t = &s->textures[e->texture];
    if (t->type != SCENE_TEXTURE_IMAGE || s->images[t->image].format != SCENE_IMAGE_F32) {
        range_add(r, t->color[0], e->scale, SCENE_NONE);
        return;
    }
    const struct scene_image *image = &s->images[t->image];
    const float *pixels = image->pixels;
    size_t count = (size_t)image->width * image->height * image->channel_count;
    float high = 0;
    for (size_t i = 0; i < count; i++)
        high = pixels[i] > high ? pixels[i] : high;
    /* Dark pixels of a sky are its night, not a scale. */
    double value[3] = {(double)high, (double)high, (double)high};
    range_add(r, value, e->scale, SCENE_NONE);
}

static struct range radiances(const struct scene *s)
{
    struct range r = {DBL_MAX, 0, SCENE_NONE};
    for (uint32_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->emits)
            range_add(&r, o->radiance, 1, i);
        if (o->material != SCENE_NONE)
            range_add(&r, s->materials[o->material].emission, 1, i);
    }
    range_add_sky(&r, s);
    return r;
}

static void name_object(struct doctor_finding *f, uint32_t object)
{
    if (!f)
        return;
    f->object = object;
    if (object == SCENE_NONE)
        (void)snprintf(f->where, sizeof f->where, "environment_map");
    else
        (void)snprintf(f->where, sizeof f->where, "objects[%u]", object);
}

static void judge_light(struct doctor_visit *v)
{
    const double spread_max = 1e6, tiny = 1e-30;
    struct range r = radiances(v->scene);
    if (!(r.high > 0))
        return;
    if (r.high > (double)FLT_MAX / 4096)
        name_object(doctor_add(v, "radiance-over-float", 1,
                               "give light in units that keep the picture near 1: only ratios show",
                               "radiance up to %.3g: samples beyond %.3g cannot be added up in the "
                               "film's floats, count as 0 and are reported",
                               r.high, (double)FLT_MAX),
                    r.object);
    else if (r.high > HALF_MAX)
        name_object(doctor_add(v, "radiance-over-half", 1,
                               "OpenEXR files of Tilery are float and hold it; programs that make "
                               "half of them clip at 65504",
                               "radiance up to %.3g is over the largest half float", r.high),
                    r.object);
    if (r.high < tiny)
        name_object(doctor_add(v, "radiance-tiny", 1,
                               "give light in units that keep the picture near 1: only ratios show",
                               "the brightest light has radiance %.3g: floats end at 1e-38, and "
                               "the picture with them",
                               r.high),
                    r.object);
    if (r.high > spread_max * r.low)
        name_object(doctor_add(v, "radiance-spread", 1,
                               "what the dim one lights is lost in the noise of the bright one: "
                               "render them apart, or take one out",
                               "the brightest light is %.2g times the dimmest", r.high / r.low),
                    r.object);
}

/* --- Materials ------------------------------------------------------------------ */

static double largest(const double c[3])
{
    return fmax(c[0], fmax(c[1], c[2]));
}

/* The most that the material sends on of what arrives, as far as constants tell. */
static double reflectance(const struct scene *s, const struct scene_material *m)
{
    double most = largest(m->color);
    if (m->texture != SCENE_NONE) {
        const struct scene_texture *t = &s->textures[m->texture];
        double factor = largest(t->color[0]);
        if (t->type == SCENE_TEXTURE_CHECKERBOARD)
            factor = fmax(factor, largest(t->color[1]));
        most *= factor;
    }
    switch (m->type) {
    case SCENE_MATERIAL_MIRROR:
        return largest(m->R);
    case SCENE_MATERIAL_GLASS:
    case SCENE_MATERIAL_ROUGH_DIELECTRIC:
        return fmax(largest(m->R), largest(m->T));
    case SCENE_MATERIAL_DIFFUSE:
    case SCENE_MATERIAL_ROUGH_CONDUCTOR:
    case SCENE_MATERIAL_PRINCIPLED:
        return most;
    default:
        return 0;
    }
}

static bool bends_light(const struct scene_material *m)
{
    return m->type == SCENE_MATERIAL_REFRACTION || m->type == SCENE_MATERIAL_GLASS ||
           m->type == SCENE_MATERIAL_ROUGH_DIELECTRIC;
}

static void judge_material(struct doctor_visit *v, const struct scene_material *m)
{
    double most = reflectance(v->scene, m);
    struct doctor_finding *f = NULL;
    if (most > 1) {
        f = doctor_add(v, "albedo-over-one", 1,
                       "nothing sends on more light than it gets: the picture grows with "
                       "max_depth and roulette cannot end paths; keep it at most 1",
                       "reflectance %.3g", most);
        if (f)
            (void)snprintf(f->where, sizeof f->where, "materials.%.200s", m->name);
    }
    if (bends_light(m) && m->eta < 1) {
        f = doctor_add(v, "ior-below-one", 1,
                       "right for a bubble in water; for glass in air give inside over outside, "
                       "such as 1.5",
                       "eta %.6g: the inside is the thinner medium", m->eta);
        if (f)
            (void)snprintf(f->where, sizeof f->where, "materials.%.200s", m->name);
    }
}

/* --- Objects in one place -------------------------------------------------------- */

static int compare_objects(const void *a, const void *b)
{
    const struct scene_object *x = *(const struct scene_object *const *)a;
    const struct scene_object *y = *(const struct scene_object *const *)b;
    if (x->mesh != y->mesh)
        return x->mesh < y->mesh ? -1 : 1;
    int order = memcmp(x->transform, y->transform, sizeof x->transform);
    order = order ? order : memcmp(x->center, y->center, sizeof x->center);
    order = order ? order : memcmp(&x->radius, &y->radius, sizeof x->radius);
    return order ? order : (x > y) - (x < y);
}

/* The same shape twice, in the same place. */
static enum err judge_places(struct doctor_visit *v)
{
    const struct scene *s = v->scene;
    const struct scene_object **sorted = mem_alloc_array(s->object_count, sizeof *sorted);
    uint64_t count = 0;
    uint32_t first = SCENE_NONE;
    if (!sorted)
        return s->object_count ? ERR_NOMEM : ERR_OK;
    for (size_t i = 0; i < s->object_count; i++)
        sorted[i] = &s->objects[i];
    qsort(sorted, s->object_count, sizeof *sorted, compare_objects);
    for (size_t i = 1; i < s->object_count; i++) {
        const struct scene_object *a = sorted[i - 1], *b = sorted[i];
        if (a->mesh != b->mesh || memcmp(a->transform, b->transform, sizeof a->transform) != 0 ||
            memcmp(a->center, b->center, sizeof a->center) != 0 || a->radius != b->radius)
            continue;
        uint32_t object = (uint32_t)(b - s->objects);
        first = object < first ? object : first;
        count++;
    }
    mem_free(sorted);
    if (count)
        name_object(doctor_add(v, "coincident-objects", count,
                               "the first of them is seen, but light that enters glass enters "
                               "twice; remove the doubles",
                               "%llu objects are where another of the same shape is",
                               (unsigned long long)count),
                    first);
    return ERR_OK;
}

/* --- All -------------------------------------------------------------------------- */

/* What a warning tells of how the scene is shown, not of what is in it; `far-from-origin` is found
 * here too, with its object. */
static bool is_other_matter(const char *id)
{
    static const char *const others[] = {"camera-added", "integrator-replaced", "no-effect",
                                         "light-scaled", "far-from-origin"};
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        if (strcmp(id, others[i]) == 0)
            return true;
    return false;
}

/* "sky.exr: 41 samples are infinite ..."; 1 where no number leads. */
static uint64_t leading_count(const char *text)
{
    for (const char *colon = strstr(text, ": "); colon; colon = strstr(text, ": "))
        text = colon + 2;
    char *end;
    unsigned long long count = strtoull(text, &end, 10);
    return end != text && *end == ' ' && count > 0 ? count : 1;
}

/* What reading said, such as samples of a picture that are no numbers. */
static void take_loaded(struct doctor_visit *v, const struct diag_list *loaded)
{
    for (size_t i = 0; i < loaded->count; i++) {
        const struct diag *d = &loaded->items[i];
        if (is_other_matter(d->id))
            continue;
        struct doctor_finding *f = doctor_add(v, d->id, 1, d->hint ? d->hint : "", "%s", d->text);
        if (!f)
            return;
        char line[24] = "";
        if (d->line)
            (void)snprintf(line, sizeof line, ":%llu", (unsigned long long)d->line);
        (void)snprintf(f->where, sizeof f->where, "%s%s%s%s", d->file ? d->file : "", line,
                       d->file && d->path ? ": " : "", d->path ? d->path : "");
        f->count = leading_count(d->text);
    }
}

enum err doctor_judge_scene(struct doctor_visit *v, const struct diag_list *loaded)
{
    judge_light(v);
    for (size_t i = 0; i < v->scene->material_count; i++)
        judge_material(v, &v->scene->materials[i]);
    take_loaded(v, loaded);
    return judge_places(v);
}
