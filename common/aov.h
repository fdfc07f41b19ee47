/* common/aov.h: the further channels that a picture can have, AOVs (arbitrary output variables).
 *
 * A set of AOVs is a bit per entry of the table, 0 for none, and costs nothing then. What
 * a worker finds travels as planes of floats behind R, G and B in a unit's payload, in the
 * order of the table; the film adds them in block order as it does colours. Three kinds:
 *
 *   CENTRE  what one ray through the middle of the pixel (and of the lens) meets. Only the
 *           job's first block has it, all others send zeros: the film's sum is the value
 *           itself, exact, whatever spp and seed. Ids must not be averaged; positions, depths
 *           and uvs would be of no surface at an edge if they were.
 *   MEAN    the mean over the pixel's samples, filtered as the picture is: antialiased.
 *   FILM    what the master knows by itself; no plane.
 *
 * Pure; any thread. Tests: test_job_spec, test_aov, test_film, test_e2e_render.py.
 */
#ifndef COMMON_AOV_H
#define COMMON_AOV_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* X(enum suffix, name, letters of its components or "" for a single one, kind) */
#define AOVS(X)                                                                                    \
    X(DEPTH, "depth", "", CENTRE)          /* distance from where the camera ray starts */         \
    X(POSITION, "position", "XYZ", CENTRE) /* world */                                             \
    X(UV, "uv", "UV", CENTRE)                                                                      \
    X(OBJECT, "object", "", CENTRE)     /* place in the scene's list, from 1; 0: nothing */        \
    X(MATERIAL, "material", "", CENTRE) /* the same */                                             \
    X(NORMAL, "normal", "XYZ", MEAN)    /* shading normal, world */                                \
    X(NG, "ng", "XYZ", MEAN)            /* geometric normal, world */                              \
    X(ALBEDO, "albedo", "RGB", MEAN)    /* colour of the first surface */                          \
    X(SAMPLES, "samples", "", FILM)     /* taken in the pixel */                                   \
    X(ERROR, "error", "", FILM)         /* standard error of the pixel, from its halves */

enum aov {
#define AOV_ENUM(suffix, name, components, kind) AOV_##suffix,
    AOVS(AOV_ENUM)
#undef AOV_ENUM
        AOV_COUNT
};

enum aov_kind { AOV_CENTRE, AOV_MEAN, AOV_FILM };

struct aov_info {
    const char *name;
    const char *components; /* a letter each */
    enum aov_kind kind;
    uint32_t channel_count; /* 1 to 3 */
};

extern const struct aov_info aov_table[AOV_COUNT];

enum {
    AOV_MEAN_PLANES_MAX = 9,
    AOV_PLANES_MAX = 17,    /* of CENTRE and MEAN together */
    AOV_CHANNELS_MAX = 19,  /* of all */
    AOV_CHANNEL_BYTES = 16, /* of a channel's name, with its end */
    AOV_LIST_BYTES = 80,    /* of the list that names them all, with its end */
};

static inline bool aov_has(uint32_t set, enum aov a)
{
    return set >> a & 1;
}

/* Reads "depth,normal". False at the first name that is none of the table's or comes twice, or is
 * empty: then *bad (may be NULL) gets the name, cut to its size. */
bool aov_parse(const char *list, uint32_t *set, char bad[AOV_LIST_BYTES]);

/* The list in the table's order, "" for none. */
void aov_list(uint32_t set, char out[AOV_LIST_BYTES]);

/* Planes that the AOVs of one kind have in a payload: 0 for AOV_FILM. */
uint32_t aov_planes(uint32_t set, enum aov_kind kind);

/* "depth", "normal.X": the channel's name in a file. */
void aov_channel_name(enum aov a, uint32_t component, char out[AOV_CHANNEL_BYTES]);

#endif
