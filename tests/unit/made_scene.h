/* tests/unit/made_scene.h: a scene made by hand, of everything that a package can leave out.
 *
 * Meshes 0 and 2 are equal; mesh 3, texture 2, image 1 and material 1 are not used. For
 * test_package and the seeds of the fuzz targets that read packages. */
#ifndef TESTS_UNIT_MADE_SCENE_H
#define TESTS_UNIT_MADE_SCENE_H

#include "common/scene.h"

/* You release it. */
void made_scene(struct scene *s);

#endif
