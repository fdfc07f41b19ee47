/* The child process: assimp under limits. */
#include <assimp/cimport.h>
#include <assimp/config.h>
#include <assimp/postprocess.h>
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include "client/import.h"
#include "client/import_assimp.h"
#include "common/file_io.h"
#include "common/mem.h"

#define ADDRESS_BYTES_MAX (UINT64_C(1) << 30)

/* Sanitizers reserve terabytes of addresses and must be heard. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define IS_SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) ||                         \
    __has_feature(memory_sanitizer)
#define IS_SANITIZED 1
#endif
#endif
#ifndef IS_SANITIZED
#define IS_SANITIZED 0
#endif

/* --- Limits -------------------------------------------------------------- */

static bool limit(int resource, rlim_t soft, rlim_t hard)
{
    struct rlimit now;
    if (getrlimit((__rlimit_resource_t)resource, &now) != 0)
        return false;
    struct rlimit wanted = {.rlim_cur = soft < now.rlim_max ? soft : now.rlim_max,
                            .rlim_max = hard < now.rlim_max ? hard : now.rlim_max};
    return setrlimit((__rlimit_resource_t)resource, &wanted) == 0;
}

/* No more memory, time and files than reading a model takes; none of it outlives the parent. */
static bool confine(uint64_t cpu_s)
{
    if (!IS_SANITIZED) {
        int quiet = open("/dev/null", O_WRONLY);
        if (quiet >= 0)
            (void)dup2(quiet, STDERR_FILENO);
        if (!limit(RLIMIT_AS, ADDRESS_BYTES_MAX, ADDRESS_BYTES_MAX))
            return false;
    }
    (void)signal(SIGPIPE, SIG_DFL);
    (void)signal(SIGXFSZ, SIG_DFL);
    return prctl(PR_SET_PDEATHSIG, SIGKILL) == 0 && prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
           limit(RLIMIT_CORE, 0, 0) && limit(RLIMIT_CPU, cpu_s, cpu_s + 1) &&
           limit(RLIMIT_FSIZE, 0, 0) && limit(RLIMIT_NOFILE, 256, 256);
}

/* --- Reading ------------------------------------------------------------- */

/* True if the JSON of a glTF file has a percent sign, as escaped names do. */
static bool has_percent(const char *data, size_t bytes)
{
    struct buf_reader in = buf_reader_of(data, bytes);
    if (bytes >= 20 && memcmp(data, "glTF", 4) == 0) {
        (void)buf_get(&in, 12);
        uint32_t text_bytes = buf_get_u32(&in);
        data += 20;
        bytes = text_bytes < bytes - 20 ? text_bytes : bytes - 20;
    }
    return memchr(data, '%', bytes) != NULL;
}

/* Vertices in integers become floats before assimp sees them. */
static enum err prepare(struct assimp_import *a)
{
    char *data;
    size_t bytes;
    buf_init(&a->doc);
    buf_init(&a->floats);
    if (!a->uv_sets || file_read(a->im->path, UINT64_C(4) << 30, &data, &bytes) != ERR_OK)
        return ERR_OK;
    a->has_escapes = has_percent(data, bytes);
    enum err e = gltf_floats(a->im, data, bytes, &a->doc, &a->floats);
    mem_free(data);
    return e;
}

static const struct aiScene *read_model(struct assimp_import *a)
{
    unsigned steps = aiProcess_Triangulate | aiProcess_SortByPType | aiProcess_GenUVCoords |
                     aiProcess_ValidateDataStructure;
    struct aiPropertyStore *settings = aiCreatePropertyStore();
    if (!settings)
        return NULL;
    aiSetImportPropertyInteger(settings, AI_CONFIG_IMPORT_NO_SKELETON_MESHES, 1);
    struct aiFileIO files = assimp_files(a);
    const struct aiScene *scene = aiImportFileExWithProperties(
        a->im->path, steps, a->doc.bytes || a->has_escapes ? &files : NULL, settings);
    aiReleasePropertyStore(settings);
    return scene;
}

static enum err refuse(struct import *im)
{
    const char *why = aiGetErrorString();
    if (strstr(why, "bad_alloc"))
        return ERR_NOMEM;
    if (strstr(why, "No suitable reader"))
        return import_fail(im, "unknown-format",
                           "a scene is JSON; models are OBJ, PLY, glTF, and STL, DAE, FBX, 3DS or "
                           "OFF among others",
                           "neither a scene nor a model that can be read, by its name and its "
                           "first bytes");
    return import_fail(im, "bad-model", NULL, "%s", *why ? why : "not a model we can read");
}

static enum err convert(struct assimp_import *a)
{
    size_t meshes = a->from->mNumMeshes, materials = a->from->mNumMaterials;
    a->mesh_of = mem_alloc_array(meshes, sizeof *a->mesh_of);
    a->material_of = mem_alloc_array(materials, sizeof *a->material_of);
    a->emission = mem_calloc(materials, sizeof *a->emission);
    if (!a->mesh_of || !a->material_of || !a->emission)
        return ERR_NOMEM;
    for (size_t i = 0; i < meshes; i++)
        a->mesh_of[i] = SCENE_NONE;
    for (size_t i = 0; i < materials; i++)
        a->material_of[i] = SCENE_NONE;
    TL_TRY(assimp_materials(a));
    TL_TRY(assimp_hierarchy(a));
    if (!scene_valid(&a->im->scene))
        return import_fail(a->im, "bad-model", NULL, "a number in it is out of range");
    return ERR_OK;
}

/* The process ends after this, so nothing is given back. */
static int run(const char *path, const char *uv_sets)
{
    struct diag_list problems;
    struct import im;
    struct import_message message = {0};
    diag_init(&problems);
    if (import_init(&im, path, &problems) != ERR_OK)
        return IMPORT_CHILD_NOMEM;
    struct assimp_import a = {.im = &im, .message = &message, .uv_sets = uv_sets};
    enum err e = prepare(&a);
    if (e == ERR_OK) {
        a.from = read_model(&a);
        e = a.from ? convert(&a) : refuse(&im);
    }
    if (e == ERR_NOMEM)
        return IMPORT_CHILD_NOMEM;
    e = import_wire_send(IMPORT_CHILD_FD, &im, &message, e);
    return e == ERR_OK ? 0 : e == ERR_NOMEM ? IMPORT_CHILD_NOMEM : IMPORT_CHILD_FAILED;
}

int import_child_main(int argc, char **argv)
{
    if (argc != 5)
        return IMPORT_CHILD_FAILED;
    uint64_t cpu_s = strtoull(argv[3], NULL, 10);
    if (!confine(cpu_s))
        return IMPORT_CHILD_FAILED;
    _exit(run(argv[2], strcmp(argv[4], "-") == 0 ? NULL : argv[4]));
}
