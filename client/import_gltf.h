/* client/import_gltf.h: a glTF 2.0 document while it is imported.
 *
 * Internal to import_gltf*.c. Geometry and hierarchy come from assimp (import_child_run);
 * what its version leaves out or blurs is read from the JSON here: required extensions,
 * materials with their extensions, textures, cameras, lights, GPU instancing. Every index is
 * checked against its table; problems carry JSON paths. One thread.
 */
#ifndef CLIENT_IMPORT_GLTF_H
#define CLIENT_IMPORT_GLTF_H

#include "client/import_model.h"
#include "common/buf.h"
#include "common/json_get.h"

/* One of the top-level arrays, by index. */
struct gltf_table {
    const struct json **items;
    size_t count;
};

enum gltf_table_id {
    GLTF_ACCESSORS,
    GLTF_BUFFER_VIEWS,
    GLTF_BUFFERS,
    GLTF_CAMERAS,
    GLTF_IMAGES,
    GLTF_LIGHTS, /* of KHR_lights_punctual */
    GLTF_MATERIALS,
    GLTF_MESHES,
    GLTF_NODES,
    GLTF_SAMPLERS,
    GLTF_SCENES,
    GLTF_TEXTURES,
    GLTF_TABLE_COUNT
};

/* The bytes of a buffer, read when first asked for. */
struct gltf_buffer {
    const unsigned char *data; /* NULL: not read yet, or it cannot be */
    size_t bytes;
    void *owned; /* NULL: part of the GLB file */
    bool tried;
};

struct gltf {
    struct import *im;
    struct json_get g;
    struct gltf_table tables[GLTF_TABLE_COUNT];
    const unsigned char *bin; /* the binary chunk of a GLB file, borrowed; or NULL */
    size_t bin_bytes;
    struct gltf_buffer *buffers;
    uint32_t *order; /* the materials as assimp numbers them: those used, by first use */
    size_t order_count;
    uint32_t *material_of;  /* glTF material -> ours; at [count] the default one */
    double (*emission)[3];  /* what objects of that material emit as area lights */
    unsigned char *uv_sets; /* of each material */
    uint32_t *object_nodes; /* of each object that came from the child: struct import's */
    size_t object_node_count;
};

/* Takes apart a GLB file or takes the text as it is, and parses the JSON. */
TL_NODISCARD enum err gltf_open(struct gltf *t, struct import *im, const char *data, size_t bytes);
void gltf_close(struct gltf *t);

/* An entry of a table that member `key` of `v` refers to; NULL when absent, or out of range (with
 * a problem). */
const struct json *gltf_reference(struct gltf *t, const struct json *v, const char *key,
                                  enum gltf_table_id table, uint32_t *index);
/* The same of the member's value. */
const struct json *gltf_entry(struct gltf *t, const struct json *member, enum gltf_table_id table,
                              uint32_t *index);
/* A member of `extensions`, or NULL. */
const struct json *gltf_extension(const struct json *v, const char *name);

/* A number that is clamped to its range; `out` keeps its value when it is absent. */
void gltf_number(struct gltf *t, const struct json *v, const char *key, double low, double high,
                 double *out);
void gltf_numbers(struct gltf *t, const struct json *v, const char *key, size_t count, double low,
                  double high, double *out);

/* The bytes of a buffer view; false when it is out of range or its buffer cannot be had. */
bool gltf_view(struct gltf *t, uint32_t view, const unsigned char **data, size_t *bytes);

/* The elements of an accessor as doubles, `width` each, floats as they are: NaN and infinite too;
 * you own *out. NULL in *out when it is not of that shape or out of range. ERR_NOMEM. */
TL_NODISCARD enum err gltf_accessor(struct gltf *t, uint32_t accessor, uint32_t width, double **out,
                                    size_t *count);

/* "data:...;base64,..." decoded; you own *out. NULL in *out when it is no such text. */
TL_NODISCARD enum err gltf_data_uri(const char *uri, unsigned char **out, size_t *bytes);
/* A copy of a relative URI with %20 and the like as characters; NULL: out of memory. */
TL_NODISCARD char *gltf_uri_path(const char *uri);

/* The largest entry of a node's transform: assimp multiplies them in float. */
#define GLTF_TRANSFORM_MAX 1e30

/* True if a quaternion is one of length 1 but for rounding; its length goes to *length. */
bool gltf_is_rotation(const double turn[4], double *length);

/* Refuses buffers that are not there, views and accessors that reach over their ends, and
 * transforms that are none; adds up the sizes of the buffers. */
TL_NODISCARD enum err gltf_check(struct gltf *t, uint64_t *buffer_bytes);

/* Refuses hierarchies that are no trees, and fills order. */
TL_NODISCARD enum err gltf_order(struct gltf *t);

/* Materials into the scene; fills material_of, emission and uv_sets. */
TL_NODISCARD enum err gltf_materials(struct gltf *t);

/* The document again with floats where vertices are kept in integers, and the floats, which it
 * calls GLTF_FLOATS_NAME; both stay empty when there is nothing to change. In the child. */
#define GLTF_FLOATS_NAME "vertices-as-floats.bin"
TL_NODISCARD enum err gltf_floats(struct import *im, const char *data, size_t bytes,
                                  struct buf *doc, struct buf *floats);

/* Cameras, lights and instances of the scene shown; after the geometry is there. */
TL_NODISCARD enum err gltf_nodes(struct gltf *t);

#endif
