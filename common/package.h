/* common/package.h: a scene as content-addressed chunks, and back.
 *
 * A package is one root chunk (camera, textures, materials, objects, lights, and name,
 * size and kind of every other chunk) and one chunk per mesh and per image; a large image
 * that can come late (package_late.h) has several: its base, the coarse levels of its pyramid, and
 * its pieces, squares of its finest level. A chunk is
 * named by the SHA-256 of its contents, so that what two scenes share is sent and kept
 * once. Elsewhere (HTTP, stores, the worker wire) a chunk travels as one zstd frame;
 * its name is always that of the plain bytes. All numbers little-endian.
 *
 *   root:  "TLYR" u32 version, counts of meshes, images and pieces, one {digest, u64 bytes} for
 * each mesh, then each image, then each piece, which pieces make up which image, then the tables in
 * the order of package_tables.c mesh:  "TLYM" u32 version, counts, flags, positions, normals, uvs,
 * indices image: "TLYI" u32 version, width, height, channels, format, stored channels, their
 * planes; a piece too base:  "TLYB" u32 version, what it belongs to, the same fields, then planes
 * of each level
 *
 * The readers take hostile bytes: ERR_CORRUPT, ERR_LIMIT or ERR_VERSION, never a crash, and no
 * allocation larger than the bytes given can fill. Pure apart from memory, and from the threads on
 * which package_write packs large chunks; one thread per object.
 */
#ifndef COMMON_PACKAGE_H
#define COMMON_PACKAGE_H

#include "common/buf.h"
#include "common/digest.h"
#include "common/pyramid.h"
#include "common/scene.h"

enum {
    PACKAGE_VERSION = 10,
    PACKAGE_CHUNKS_MAX = 1 << 21,
    PACKAGE_ROOT_BYTES_MAX = 1 << 30,
};
/* Of one chunk, uncompressed: a mesh of SCENE_TRIANGLES_MAX fits nowhere anyway. */
#define PACKAGE_CHUNK_BYTES_MAX (UINT64_C(16) << 30)

enum package_kind { PACKAGE_ROOT, PACKAGE_MESH, PACKAGE_IMAGE, PACKAGE_BASE, PACKAGE_PIECE };

/* Of an image in pieces (pyramid.h), the levels that its base has. */
enum { PACKAGE_BASE_LEVELS_MAX = 13 }; /* of SCENE_IMAGE_SIDE_MAX, down to one texel */
_Static_assert(SCENE_IMAGE_SIDE_MAX >> PYRAMID_PIECE_LEVELS == 1 << (PACKAGE_BASE_LEVELS_MAX - 1),
               "the largest picture has as many levels");

struct package_chunk {
    digest name;
    unsigned char *data; /* owned by the package */
    size_t bytes;
    enum package_kind kind;
};

/* What a package leaves out: id, what, why. */
#define PACKAGE_LEFT(X)                                                                            \
    X(OBJECTS, "objects", "their opacity is 0: no path of light can meet them")                    \
    X(MESHES, "meshes", "no object that can be met has them")                                      \
    X(COPIES, "copies of meshes and pictures", "equal ones are there once")                        \
    X(VERTICES, "vertices", "no triangle has them")                                                \
    X(UVS, "texture coordinates", "nothing on their meshes is looked up by them")                  \
    X(COLORS, "colours of vertices", "no material on their meshes reads them")                     \
    X(ALPHAS, "opacities of vertices", "no material on their meshes reads them")                   \
    X(DIGITS, "halves of coordinates", "all coordinates of their meshes are exactly floats")       \
    X(MATERIALS, "materials", "no object that can be met has them")                                \
    X(TEXTURES, "textures", "no material in use reads them")                                       \
    X(IMAGES, "pictures", "no texture in use reads them")                                          \
    X(CHANNELS, "channels of pictures", "no material reads them")                                  \
    X(OPAQUE, "alpha channels", "they are opaque everywhere")                                      \
    X(GREY, "channels of pictures", "the picture is grey: one says it all")

enum package_left_kind {
#define PACKAGE_LEFT_ENUM(id, what, why) PACKAGE_LEFT_##id,
    PACKAGE_LEFT(PACKAGE_LEFT_ENUM)
#undef PACKAGE_LEFT_ENUM
        PACKAGE_LEFT_COUNT
};
extern const char *const package_left_what[PACKAGE_LEFT_COUNT];
extern const char *const package_left_why[PACKAGE_LEFT_COUNT];

/* `bytes`: plain, of what the package would have held without the plan. */
struct package_left {
    uint64_t count, bytes;
};

/* chunks[0] is the root; the others are distinct. */
struct package {
    struct package_chunk *chunks;
    size_t count;
    struct package_left left[PACKAGE_LEFT_COUNT];
    int64_t pieces_extra; /* plain bytes that pictures in pieces take more than whole */
};

/* `scene` satisfies scene_check. What no picture with these AOVs depends on (scene_plan.h) is left
 * out. You release `out`. ERR_NOMEM. */
TL_NODISCARD enum err package_write(const struct scene *scene, uint32_t aov, struct package *out);

/* The same with pictures of so many plain bytes or more in pieces, where package_write has
 * PACKAGE_SPLIT_BYTES_MIN: for tests, which then do with small ones. */
TL_NODISCARD enum err package_write_pieces(const struct scene *scene, uint32_t aov,
                                           uint64_t split_bytes_min, struct package *out);

/* Everything the scene holds, in full: for who wants it back as it was. */
TL_NODISCARD enum err package_write_whole(const struct scene *scene, struct package *out);
void package_release(struct package *p);

/* What a root needs, in the order in which package_read asks for it. */
struct package_index_entry {
    digest name;
    uint64_t bytes;
    enum package_kind kind;
};

/* The pieces of an image, row by row: numbers of entries of the index. */
struct package_pieces {
    uint32_t across, down; /* 0: the image is one chunk */
    const uint32_t *entries;
};

/* Entries: meshes, images (of one in pieces its base), pieces. An image in pieces has its width,
 * height, channels and format in the scene's tables, too. */
struct package_index {
    struct package_index_entry *entries;
    size_t count;
    uint64_t bytes;                /* of all of them */
    struct package_pieces *pieces; /* of each image */
    uint32_t *piece_entries;       /* of all images in pieces */
};

/* Checks the whole root, not only its list. */
TL_NODISCARD enum err package_root_read(const void *root, size_t bytes, struct package_index *out);
void package_index_release(struct package_index *index);

/* The same, and the scene's tables: its meshes have names only, its images nothing. You release
 * both; untouched on failure. */
TL_NODISCARD enum err package_tables_read(const void *root, size_t bytes, struct scene *tables,
                                          struct package_index *index);

/* Gives the plain bytes of entry `i` of the index, which stay valid until the next call or the
 * end of package_read. Their digest has been checked by whoever stored or decompressed them. */
typedef enum err package_fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                               const unsigned char **data, size_t *bytes);

/* The scene of a root. `out` satisfies scene_check and is yours; untouched on failure. */
TL_NODISCARD enum err package_read(const void *root, size_t bytes, package_fetch *fetch, void *ctx,
                                   struct scene *out);

/* The levels of a base, from PYRAMID_PIECE_LEVELS on; `picture` is their whole, without pixels. */
struct package_base {
    struct scene_image picture;
    uint32_t level_count;
    struct scene_image levels[PACKAGE_BASE_LEVELS_MAX];
};

/* Decodes a base. ERR_CORRUPT, ERR_NOMEM; then there is nothing to release. */
TL_NODISCARD enum err package_base_get(const void *data, size_t bytes, struct package_base *out);
void package_base_release(struct package_base *base);

/* A chunk decoded before the rest of its scene is there. */
struct package_part {
    bool there;
    struct scene_mesh mesh; /* one of the two; of a base, which a scene is not made of, neither */
    struct scene_image image;
};

/* Decodes a chunk of that kind (no root). ERR_CORRUPT, ERR_LIMIT, ERR_NOMEM; then *out is not
 * there. What it holds is judged when the scene is read. */
TL_NODISCARD enum err package_part_get(enum package_kind kind, const void *data, size_t bytes,
                                       struct package_part *out);
void package_part_release(struct package_part *part);

/* package_read with a part for each entry of the index: those that are there are taken from it and
 * not fetched; you release what is left. Entries i with late[i] (pictures: package_late.h) are not
 * fetched, and their images have no pixels; NULL: all are. */
TL_NODISCARD enum err package_read_parts(const void *root, size_t bytes, struct package_part *parts,
                                         const bool *late, package_fetch *fetch, void *ctx,
                                         struct scene *out);

/* One zstd frame of a chunk (level 1, with checksum and content size), appended to `out`. */
TL_NODISCARD enum err chunk_compress(const void *data, size_t bytes, struct buf *out);

/* Appends the plain bytes of one frame to `out`, which must come to exactly `bytes_expected`
 * (or any size up to `bytes_max` with chunk_decompress_any) and hash to `name`. Memory grows with
 * what really comes out; taken at once for what the frame claims are at most 64 times its bytes.
 * ERR_CORRUPT, ERR_LIMIT, ERR_NOMEM; then `out` is as it was. */
TL_NODISCARD enum err chunk_decompress(const void *frame, size_t frame_bytes, const digest *name,
                                       uint64_t bytes_expected, struct buf *out);
TL_NODISCARD enum err chunk_decompress_any(const void *frame, size_t frame_bytes,
                                           const digest *name, uint64_t bytes_max, struct buf *out);

/* The same judgement without the plain bytes: their number in *bytes. */
TL_NODISCARD enum err chunk_check(const void *frame, size_t frame_bytes, const digest *name,
                                  uint64_t bytes_max, uint64_t *bytes);

#endif
