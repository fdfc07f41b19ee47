/* tests/fuzz/mesh_judge.h: what every mesh that a reader gives must be. */
#ifndef TESTS_FUZZ_MESH_JUDGE_H
#define TESTS_FUZZ_MESH_JUDGE_H

#include <math.h>

#include "common/scene.h"

static inline void mesh_judge(const struct scene_mesh *m)
{
    TL_ASSERT(m->triangle_count >= 1);
    for (size_t i = 0; i < (size_t)m->triangle_count * 3; i++)
        TL_ASSERT(m->indices[i] < m->vertex_count);
    for (size_t i = 0; i < (size_t)m->vertex_count * 3; i++) {
        TL_ASSERT(isfinite(m->positions[i]));
        TL_ASSERT(!m->normals || isfinite(m->normals[i]));
    }
    for (size_t i = 0; m->uvs && i < (size_t)m->vertex_count * 2; i++)
        TL_ASSERT(isfinite(m->uvs[i]));
    for (size_t i = 0; m->colors && i < (size_t)m->vertex_count * 3; i++)
        TL_ASSERT(m->colors[i] >= 0 && m->colors[i] <= 1);
    for (size_t i = 0; m->alphas && i < m->vertex_count; i++)
        TL_ASSERT(m->alphas[i] >= 0 && m->alphas[i] <= 1);
}

#endif
