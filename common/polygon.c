#include "common/polygon.h"

#include <math.h>

/* Point-in-triangle tests allowed per corner: hostile zigzags then end as fans. */
enum { TESTS_PER_CORNER = 1000 };

typedef struct point2 {
    double x, y;
} point2;

struct clipper {
    point2 points[POLYGON_EARS_MAX];
    uint32_t next[POLYGON_EARS_MAX], previous[POLYGON_EARS_MAX];
    uint32_t left;
    uint64_t tests_left;
};

/* Drops the largest axis of the Newell normal, so that the corners run counter-clockwise. */
static void project(const double *positions, size_t count, point2 *points)
{
    double n[3] = {0, 0, 0};
    for (size_t i = 0; i < count; i++) {
        const double *a = positions + 3 * i, *b = positions + 3 * ((i + 1) % count);
        n[0] += (a[1] - b[1]) * (a[2] + b[2]);
        n[1] += (a[2] - b[2]) * (a[0] + b[0]);
        n[2] += (a[0] - b[0]) * (a[1] + b[1]);
    }
    int axis = fabs(n[0]) > fabs(n[1]) ? 0 : 1;
    axis = fabs(n[2]) > fabs(n[axis]) ? 2 : axis;
    int u = (axis + 1) % 3, v = (axis + 2) % 3;
    for (size_t i = 0; i < count; i++) {
        points[i].x = positions[3 * i + (size_t)u];
        points[i].y = n[axis] < 0 ? -positions[3 * i + (size_t)v] : positions[3 * i + (size_t)v];
    }
}

/* Twice the signed area of a triangle. */
static double area2(point2 a, point2 b, point2 c)
{
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}

static bool same(point2 a, point2 b)
{
    return a.x == b.x && a.y == b.y;
}

static bool is_ear(struct clipper *k, uint32_t i)
{
    point2 a = k->points[k->previous[i]], b = k->points[i], c = k->points[k->next[i]];
    if (!(area2(a, b, c) > 0))
        return false;
    for (uint32_t j = k->next[k->next[i]]; j != k->previous[i]; j = k->next[j]) {
        point2 p = k->points[j];
        if (k->tests_left == 0)
            return true;
        k->tests_left--;
        bool inside = area2(a, b, p) >= 0 && area2(b, c, p) >= 0 && area2(c, a, p) >= 0;
        if (inside && !same(p, a) && !same(p, b) && !same(p, c))
            return false;
    }
    return true;
}

/* An ear from corner `i` on, or `i` itself when there is none. */
static uint32_t find_ear(struct clipper *k, uint32_t i)
{
    uint32_t candidate = i;
    for (uint32_t tried = 0; tried < k->left; tried++) {
        if (is_ear(k, candidate))
            return candidate;
        candidate = k->next[candidate];
    }
    return i;
}

static void split_fan(size_t count, uint32_t (*triangles)[3])
{
    for (size_t i = 0; i + 2 < count; i++) {
        triangles[i][0] = 0;
        triangles[i][1] = (uint32_t)i + 1;
        triangles[i][2] = (uint32_t)i + 2;
    }
}

void polygon_split(const double *positions, size_t count, uint32_t (*triangles)[3])
{
    TL_ASSERT(count >= 3);
    if (count == 3 || count > POLYGON_EARS_MAX) {
        split_fan(count, triangles);
        return;
    }
    struct clipper k = {.left = (uint32_t)count, .tests_left = count * TESTS_PER_CORNER};
    project(positions, count, k.points);
    for (uint32_t i = 0; i < count; i++) {
        k.next[i] = (uint32_t)((i + 1) % count);
        k.previous[i] = (uint32_t)((i + count - 1) % count);
    }
    uint32_t i = 1;
    for (size_t t = 0; t + 2 < count; t++, k.left--) {
        i = find_ear(&k, i);
        triangles[t][0] = k.previous[i];
        triangles[t][1] = i;
        triangles[t][2] = k.next[i];
        k.next[k.previous[i]] = k.next[i];
        k.previous[k.next[i]] = k.previous[i];
        i = k.next[i];
    }
}
