/* common/mtl_file.h: Wavefront material libraries.
 *
 * The classic words (Kd Ks Ke Ka Tf Ns Ni d Tr illum and their maps) and the physically
 * based ones that exporters write (Pr Pm Ps Pc Pcr norm and their maps). Numbers are finite
 * and clamped to what they can mean; a line that makes no sense is a warning with file:line
 * and leaves the value as it was. Words we do not know are skipped. Map options (-s -o
 * -clamp -bm; others are skipped with their arguments) are read; file names may hold
 * blanks. Lines end in "\n", "\r\n" or "\r". Pure apart from memory; one thread.
 */
#ifndef COMMON_MTL_FILE_H
#define COMMON_MTL_FILE_H

#include "common/diag.h"

enum mtl_map_id {
    MTL_MAP_KD,
    MTL_MAP_KE,
    MTL_MAP_KS,
    MTL_MAP_D,
    MTL_MAP_NORMAL, /* norm, map_Kn */
    MTL_MAP_BUMP,   /* map_Bump, bump: heights, or normals in disguise */
    MTL_MAP_PR,
    MTL_MAP_PM,
    MTL_MAP_COUNT
};

struct mtl_map {
    char *path; /* as written, '\\' made '/'; NULL: none */
    double scale[2], offset[2];
    double bump; /* -bm, 1 when not given */
    bool clamp;
};

struct mtl_material {
    char *name; /* "" when newmtl names none */
    uint64_t line;
    double kd[3], ks[3], ke[3], ka[3], tf[3];
    bool has_kd, has_ke,
        has_d;      /* has_d: by d; Tr is then not read, since exporters disagree on it */
    double ns;      /* 0 .. 1e6 */
    double ni;      /* 0: not given */
    double opacity; /* d, or 1 - Tr; 0..1 */
    int illum;      /* -1: not given */
    double roughness, metallic, sheen, clearcoat, clearcoat_roughness;
    bool has_roughness, has_metallic;
    struct mtl_map maps[MTL_MAP_COUNT];
};

struct mtl_library {
    struct mtl_material *materials; /* of two with one name, the first counts */
    size_t count;
};

/* You release `out`. ERR_NOMEM; what is wrong with the text is a warning. */
TL_NODISCARD enum err mtl_read(const char *text, size_t bytes, const char *file,
                               struct mtl_library *out, struct diag_list *problems);
void mtl_release(struct mtl_library *library);

#endif
