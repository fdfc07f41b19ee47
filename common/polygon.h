/* common/polygon.h: polygons of mesh files into triangles. Pure; any thread. */
#ifndef COMMON_POLYGON_H
#define COMMON_POLYGON_H

#include "common/err.h"

/* Splits a polygon of `count` >= 3 corners (positions, 3 doubles each, in order) into count - 2
 * triangles of corner numbers, by ear clipping in its own plane; a convex one gives the fan of its
 * first corner. Polygons of over POLYGON_EARS_MAX corners, and what no ear is found in, are cut as
 * fans. */
enum { POLYGON_EARS_MAX = 1024 };
void polygon_split(const double *positions, size_t count, uint32_t (*triangles)[3]);

#endif
