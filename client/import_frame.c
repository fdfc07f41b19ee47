/* client/import_frame.c: a camera for a model that brings none.
 *
 * It looks at the whole of an object from outside, and into a room from its open side or from
 * within. Decided by the scene's geometry alone. One thread.
 */
#include <math.h>

#include "client/import_model.h"

/* Vertical field of view of a framed model, and the tangent of its half. */
#define FRAME_FOV     40.0
#define FRAME_TANGENT 0.36397023426620234
/* From inside a closed room. */
#define INSIDE_FOV 75.0

/* A side of the bounding box counts as open below the first share of faces, as closed above the
 * last. */
#define OPEN_SHARE   0.5
#define CLOSED_SHARE 0.8

/* Axis and direction of the sides from which a room may be looked into, in order of preference. */
static const struct side {
    int axis;
    double sign;
} sides[] = {{2, 1}, {2, -1}, {0, 1}, {0, -1}, {1, 1}, {1, -1}};
enum { SIDE_COUNT = sizeof sides / sizeof *sides };

struct frame {
    double low[3], high[3], middle[3], half[3];
};

static struct frame frame_of(const struct import *im)
{
    struct frame f;
    import_bounds(im, f.low, f.high);
    double largest = 0;
    for (int i = 0; i < 3; i++) {
        f.middle[i] = f.low[i] / 2 + f.high[i] / 2;
        f.half[i] = f.high[i] / 2 - f.low[i] / 2;
        largest = fmax(largest, f.half[i]);
    }
    for (int i = 0; i < 3 && !(largest > 0); i++)
        f.half[i] = 1;
    return f;
}

/* --- Objects: from the front, a little from the right and above ----------- */

static void unit(double v[3])
{
    double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int i = 0; i < 3; i++)
        v[i] /= length;
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* The distance along unit `back` at which every corner of the box is within the view. */
static double fitting_distance(const struct frame *f, const double back[3])
{
    double right[3] = {back[2], 0, -back[0]};
    unit(right);
    double up[3] = {back[1] * right[2] - back[2] * right[1],
                    back[2] * right[0] - back[0] * right[2],
                    back[0] * right[1] - back[1] * right[0]};
    double distance = 0;
    for (int corner = 0; corner < 8; corner++) {
        double c[3];
        for (int i = 0; i < 3; i++)
            c[i] = corner >> i & 1 ? f->half[i] : -f->half[i];
        double side = fmax(fabs(dot(c, right)), fabs(dot(c, up)));
        distance = fmax(distance, dot(c, back) + side / FRAME_TANGENT);
    }
    return distance * 1.05;
}

static void frame_object(const struct frame *f, struct scene_camera *c)
{
    double back[3] = {0.55, 0.40, 1.0};
    unit(back);
    double distance = fitting_distance(f, back);
    for (int i = 0; i < 3; i++)
        c->position[i] = f->middle[i] + back[i] * distance;
}

/* --- Rooms: through their most open side ---------------------------------- */

/* Area of a triangle seen along an axis. */
static double area_along(const double p[3][3], int axis)
{
    int a = (axis + 1) % 3, b = (axis + 2) % 3;
    double u0 = p[1][a] - p[0][a], u1 = p[1][b] - p[0][b];
    double v0 = p[2][a] - p[0][a], v1 = p[2][b] - p[0][b];
    return fabs(u0 * v1 - u1 * v0) / 2;
}

static bool lies_on(const struct frame *f, const double p[3][3], const struct side *side)
{
    double plane = side->sign > 0 ? f->high[side->axis] : f->low[side->axis];
    for (int i = 0; i < 3; i++)
        if (fabs(p[i][side->axis] - plane) > 0.04 * f->half[side->axis])
            return false;
    return true;
}

static void add_object_areas(const struct import *im, const struct scene_object *object,
                             const struct frame *f, double area[SIDE_COUNT])
{
    const struct scene_mesh *m = &im->scene.meshes[object->mesh];
    for (size_t t = 0; t < m->triangle_count; t++) {
        double p[3][3];
        for (size_t i = 0; i < 3; i++)
            import_transform_point(object->transform,
                                   m->positions + 3 * (size_t)m->indices[3 * t + i], p[i]);
        for (int s = 0; s < SIDE_COUNT; s++)
            if (lies_on(f, p, &sides[s]))
                area[s] += area_along(p, sides[s].axis);
    }
}

/* How many sides are walls, and in *best the side with the smallest share of faces on it; NULL when
 * none is open. */
static int count_walls(const struct import *im, const struct frame *f, const struct side **best)
{
    double area[SIDE_COUNT] = {0}, least = OPEN_SHARE;
    int wall_count = 0;
    *best = NULL;
    for (size_t o = 0; o < im->scene.object_count; o++)
        add_object_areas(im, &im->scene.objects[o], f, area);
    for (int s = 0; s < SIDE_COUNT; s++) {
        int a = (sides[s].axis + 1) % 3, b = (sides[s].axis + 2) % 3;
        double share = area[s] / (4 * f->half[a] * f->half[b]);
        wall_count += share > CLOSED_SHARE;
        if (share < least - 0.01) { /* a NaN, of a flat model, is no open side */
            least = share;
            *best = &sides[s];
        }
    }
    return wall_count;
}

/* True if something besides lamps is there to be seen from inside. */
static bool has_plain_object(const struct import *im)
{
    for (size_t o = 0; o < im->scene.object_count; o++)
        if (!im->scene.objects[o].emits)
            return true;
    return false;
}

static void frame_room(const struct frame *f, const struct side *side, struct scene_camera *c)
{
    int axis = side->axis;
    int across = axis == 0 ? 2 : 0, along = axis == 1 ? 2 : 1;
    double extent = fmax(f->half[across], f->half[along]);
    double distance = f->half[axis] + 1.02 * extent / FRAME_TANGENT;
    c->position[axis] = f->middle[axis] + side->sign * distance;
    if (axis == 1) {
        c->ref_up[1] = 0;
        c->ref_up[2] = -side->sign;
    }
}

void import_frame(struct import *im)
{
    struct scene_camera *c = &im->scene.camera;
    struct frame f = frame_of(im);
    scene_camera_init(c);
    c->fov = FRAME_FOV;
    for (int i = 0; i < 3; i++)
        c->position[i] = c->look_at[i] = f.middle[i];
    const struct side *open;
    int wall_count = count_walls(im, &f, &open);
    bool is_lit_inside = im->has_lamp && im->scene.light_count == 0;
    if (open && wall_count >= (im->has_lamp ? 3 : SIDE_COUNT - 1)) {
        frame_room(&f, open, c);
    } else if (is_lit_inside && wall_count == SIDE_COUNT && has_plain_object(im)) {
        c->position[2] += 0.9 * f.half[2];
        c->fov = INSIDE_FOV;
    } else {
        frame_object(&f, c);
    }
}

bool import_camera_valid(const struct scene_camera *c)
{
    double to[3], up[3], dd = 0, uu = 0, cc = 0;
    for (int i = 0; i < 3; i++) {
        to[i] = c->look_at[i] - c->position[i];
        up[i] = c->ref_up[i];
        dd += to[i] * to[i];
        uu += up[i] * up[i];
    }
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double cross = to[j] * up[k] - to[k] * up[j];
        cc += cross * cross;
    }
    return isfinite(dd * uu) && dd > 0 && uu > 0 && cc > 1e-12 * dd * uu && c->fov > 0 &&
           c->fov < 180;
}
