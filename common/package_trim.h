/* common/package_trim.h: a mesh and a picture without what nothing reads.
 *
 * Internal to the writer of packages. A trimmed element borrows what it can from the original and
 * owns the rest; release it before the original. ERR_NOMEM; then there is nothing to release.
 */
#ifndef COMMON_PACKAGE_TRIM_H
#define COMMON_PACKAGE_TRIM_H

#include "common/package.h"
#include "common/scene_plan.h"

struct trimmed_mesh {
    struct scene_mesh mesh;
    bool own_vertices, own_indices;
};

/* `left` counts what goes: texture coordinates, vertices without a triangle, digits that no
 * coordinate uses. */
TL_NODISCARD enum err package_trim_mesh(const struct scene_mesh *m,
                                        const struct scene_plan_mesh *plan,
                                        struct package_left *left, struct trimmed_mesh *out);
void package_trim_mesh_release(struct trimmed_mesh *t);

/* The picture as workers get it: alpha gone where nobody reads it or all of it is opaque, one
 * channel where only one is read or all colours are grey. *stored: of its channels those that
 * travel, bit 0 the first; the others come out 0. *own: its pixels are yours. */
TL_NODISCARD enum err package_trim_image(const struct scene_image *image, unsigned channels_read,
                                         struct package_left *left, struct scene_image *out,
                                         unsigned *stored, bool *own);

#endif
