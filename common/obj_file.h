/* common/obj_file.h: Wavefront OBJ, read in double, with everything the importer needs.
 *
 * v (also "x y z r g b", colours sRGB-encoded from 0 to 1), vt, vn, f (negative indices, polygons),
 * o, g, usemtl, mtllib, line continuation; points and lines are counted and left out; faces that a
 * smoothing group (s) would round but that have no normals are counted, and flat; curves and other
 * keywords are skipped. Polygons are triangulated by ear clipping in the polygon's own plane.
 * Problems carry file:line. Pure apart from memory; one thread.
 */
#ifndef COMMON_OBJ_FILE_H
#define COMMON_OBJ_FILE_H

#include "common/diag.h"

#define OBJ_NONE UINT32_MAX

struct obj_corner {
    uint32_t position, uv, normal; /* uv and normal may be OBJ_NONE */
};

struct obj_triangle {
    struct obj_corner corners[3];
    uint32_t material; /* index into material_names, or OBJ_NONE before the first usemtl */
    uint32_t group;    /* index into group_names, or OBJ_NONE */
};

struct obj_model {
    double *positions; /* 3 each */
    size_t position_count;
    float *colors; /* 3 for each position, as in struct scene_mesh; NULL: none has one */
    double *uvs;   /* 2 each */
    size_t uv_count;
    double *normals; /* 3 each, as the file has them */
    size_t normal_count;
    struct obj_triangle *triangles;
    size_t triangle_count;
    char **material_names; /* in order of first use, distinct */
    size_t material_count;
    char **group_names; /* "o" and "g" names, in order of first use, distinct */
    size_t group_count;
    char **libraries; /* mtllib, as written */
    size_t library_count;
    size_t point_count, line_count; /* elements left out */
    size_t unsmoothed_count;        /* faces of a smoothing group without normals: flat here */
};

/* You release `out`. ERR_INPUT with problems (an index out of range, a coordinate that is not
 * finite ...), ERR_LIMIT, ERR_NOMEM. Faces of fewer than three corners are left out with a warning,
 * as are uv and normal indices out of range and characters glued to a number. No face at all is not
 * an error here. */
TL_NODISCARD enum err obj_read(const char *text, size_t bytes, const char *file,
                               struct obj_model *out, struct diag_list *problems);

/* As obj_read, but uv and normal indices out of range are problems too. */
TL_NODISCARD enum err obj_read_strict(const char *text, size_t bytes, const char *file,
                                      struct obj_model *out, struct diag_list *problems);
void obj_release(struct obj_model *m);

#endif
