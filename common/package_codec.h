/* common/package_codec.h: the layout of chunks, one description for both directions.
 *
 * Internal to package_write.c, package_read.c, package_tables.c and package_chunks.c.
 * A codec either appends to a buf or takes from a buf_reader; each field has one call
 * for both, so that writer and reader cannot drift apart. In writing, the values are not
 * changed. One thread.
 */
#ifndef COMMON_PACKAGE_CODEC_H
#define COMMON_PACKAGE_CODEC_H

#include "common/buf.h"
#include "common/package.h"

struct codec {
    struct buf *out;       /* writing: not NULL */
    struct buf_reader *in; /* reading: not NULL */
    enum err error;        /* the first that happened */
};

void codec_u8(struct codec *c, uint8_t *v);
void codec_u32(struct codec *c, uint32_t *v);
void codec_u64(struct codec *c, uint64_t *v);
void codec_f64s(struct codec *c, double *v, size_t count);
void codec_bool(struct codec *c, bool *v);     /* 0 or 1, else ERR_CORRUPT */
void codec_name(struct codec *c, char **text); /* reading: you own it */
void codec_bytes(struct codec *c, void *v, size_t bytes);
void codec_fail(struct codec *c, enum err e);

/* Reads an enum in [0, last]. */
#define codec_enum(c, v, last)                                                                     \
    do {                                                                                           \
        uint32_t codec_enum_ = (uint32_t) * (v);                                                   \
        codec_u32((c), &codec_enum_);                                                              \
        if (codec_enum_ > (uint32_t)(last))                                                        \
            codec_fail((c), ERR_CORRUPT);                                                          \
        else                                                                                       \
            *(v) = codec_enum_;                                                                    \
    } while (0)

/* A table: its count (at most `count_max`; reading, what the bytes left can hold at
 * `item_bytes_min` each) and, reading, zeroed memory for it. */
void codec_table(struct codec *c, void **items, size_t *count, size_t count_max, size_t item_bytes,
                 size_t item_bytes_min);

/* "TLYx" and the version: ERR_CORRUPT, ERR_VERSION. */
void codec_magic(struct codec *c, const char magic[4]);

/* The least bytes of a row, its name empty; of an entry of the root's list; of a name. */
enum {
    CODEC_TEXTURE_BYTES = 4 + 8 + 48 + 4 + 8 + 48,
    CODEC_MATERIAL_BYTES = 4 + 78 + 120 + 172,
    CODEC_OBJECT_BYTES = 4 + 4 + 128 + 24 + 8 + 4 + 1 + 24,
    CODEC_LIGHT_BYTES = 4 + 72 + 16,
    CODEC_ENTRY_BYTES = DIGEST_BYTES + 8,
    CODEC_NAME_BYTES = 4,
    CODEC_PIECES_BYTES = 1,  /* whether an image is in pieces */
    CODEC_PIECED_BYTES = 16, /* what is told of one that is, but for their numbers */
};

/* Everything of a scene but the contents of meshes and images. */
void codec_scene(struct codec *c, struct scene *s);

/* True if every coordinate is exactly a float. */
bool package_mesh_fits_f32(const struct scene_mesh *m);

/* Whole chunks. `f32`: positions as floats, which they fit. `stored`: the channels that travel,
 * bit 0 the first; reading, the others are 0. Writing appends to an empty buf; reading takes all
 * bytes, and leaves *m or *image released on failure. */
TL_NODISCARD enum err package_mesh_put(const struct scene_mesh *m, bool f32, struct buf *out);
TL_NODISCARD enum err package_mesh_get(const void *data, size_t bytes, struct scene_mesh *m);
TL_NODISCARD enum err package_image_put(const struct scene_image *image, unsigned stored,
                                        struct buf *out);
TL_NODISCARD enum err package_image_get(const void *data, size_t bytes, struct scene_image *image);

/* A base of levels (rounded, without pixels that are not stored). `detail` tells the pieces that
 * belong to it from others. */
TL_NODISCARD enum err package_base_put(const struct package_base *base, const digest *detail,
                                       unsigned stored, struct buf *out);

/* What a mesh and an image cost in a package when nothing is left out, their entries in the root
 * included. */
uint64_t package_mesh_bytes(const struct scene_mesh *m);
uint64_t package_image_bytes(const struct scene_image *image);

/* The plain bytes of an image's chunk with these channels. */
uint64_t package_image_chunk_bytes(const struct scene_image *image, unsigned stored);

/* ERR_OK only if nothing failed and, reading, no byte is left. */
TL_NODISCARD enum err codec_end(const struct codec *c);

#endif
