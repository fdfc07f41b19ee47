/* gen_mesh: writes a generated mesh as a binary PLY.
 *
 *   gen_mesh ball SIDE BUMPS [SEED] FILE.ply   12 * SIDE^2 triangles
 *   gen_mesh needles COUNT WIDTH FILE.ply
 *   gen_mesh cornell|room FILE.ply
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "scenes/gen_mesh.h"

enum { SIDE_MAX = 4096 };

static enum err make(struct gen_mesh *m, int argc, char **argv)
{
    const double origin[3] = {0, 0, 0};
    if ((argc == 5 || argc == 6) && strcmp(argv[1], "ball") == 0) {
        long side = strtol(argv[2], NULL, 10), seed = argc == 6 ? strtol(argv[4], NULL, 10) : 1;
        if (side < 1 || side > SIDE_MAX || seed < 0 || seed > INT32_MAX)
            return ERR_USAGE;
        return gen_ball(m, (uint32_t)side, origin, 0.7, strtod(argv[3], NULL), (uint32_t)seed);
    }
    if (argc == 5 && strcmp(argv[1], "needles") == 0) {
        long count = strtol(argv[2], NULL, 10);
        if (count < 1 || count > 1 << 28)
            return ERR_USAGE;
        return gen_needles(m, (uint32_t)count, 0.8, 0.5, strtod(argv[3], NULL), 1);
    }
    if (argc == 3 && strcmp(argv[1], "cornell") == 0)
        return gen_cornell(m);
    return argc == 3 && strcmp(argv[1], "room") == 0 ? gen_room(m) : ERR_USAGE;
}

static bool write_ply(const struct gen_mesh *m, FILE *f)
{
    fprintf(f,
            "ply\nformat binary_little_endian 1.0\nelement vertex %zu\nproperty float x\n"
            "property float y\nproperty float z\nelement face %zu\n"
            "property list uchar uint vertex_indices\nend_header\n",
            m->vertex_count, m->triangle_count);
    fwrite(m->positions, 3 * sizeof *m->positions, m->vertex_count, f);
    for (size_t i = 0; i < m->triangle_count; i++) {
        fputc(3, f);
        fwrite(&m->indices[3 * i], sizeof *m->indices, 3, f);
    }
    return !ferror(f);
}

int main(int argc, char **argv)
{
    struct gen_mesh mesh;
    gen_mesh_init(&mesh);
    enum err err = make(&mesh, argc, argv);
    if (err) {
        fprintf(stderr,
                "gen_mesh: %s\nusage: gen_mesh ball SIDE BUMPS [SEED] FILE | needles COUNT WIDTH "
                "FILE | cornell FILE | room FILE\n",
                err_text(err));
        gen_mesh_release(&mesh);
        return err_exit_status(err);
    }
    FILE *f = fopen(argv[argc - 1], "wb");
    bool ok = f && write_ply(&mesh, f);
    if (f && fclose(f) != 0)
        ok = false;
    if (!ok)
        fprintf(stderr, "gen_mesh: %s cannot be written\n", argv[argc - 1]);
    gen_mesh_release(&mesh);
    return ok ? 0 : err_exit_status(ERR_IO);
}
