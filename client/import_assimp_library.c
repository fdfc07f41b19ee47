/* client/import_assimp_library.c: assimp, loaded when the importer's child first calls it.
 *
 * Linked, assimp and what it brings along (the C++ library, draco) cost every command 2 ms of
 * start; only the child that imports needs them. Each function below is the C API's own by that
 * name and hands the call on. One thread. A library that cannot be loaded ends the child, which
 * its parent reports.
 */
#include <assimp/cimport.h>
#include <assimp/material.h>
#include <dlfcn.h>
#include <stdio.h>
#include <unistd.h>

static void *symbol(const char *name)
{
    static void *library;
    if (!library)
        library = dlopen("libassimp.so.5", RTLD_NOW | RTLD_LOCAL);
    void *found = library ? dlsym(library, name) : NULL;
    if (!found) {
        (void)fprintf(stderr, "tilery: %s; install libassimp5\n", dlerror());
        _exit(5);
    }
    return found;
}

/* The library's function of the same name as the caller, as a pointer of the caller's type. */
#define FORWARD(function) ((__typeof__(&function))symbol(#function))

const struct aiScene *aiImportFileExWithProperties(const char *file, unsigned int flags,
                                                   struct aiFileIO *io,
                                                   const struct aiPropertyStore *properties)
{
    return FORWARD(aiImportFileExWithProperties)(file, flags, io, properties);
}

const char *aiGetErrorString(void)
{
    return FORWARD(aiGetErrorString)();
}

struct aiPropertyStore *aiCreatePropertyStore(void)
{
    return FORWARD(aiCreatePropertyStore)();
}

void aiReleasePropertyStore(struct aiPropertyStore *p)
{
    FORWARD(aiReleasePropertyStore)(p);
}

void aiSetImportPropertyInteger(struct aiPropertyStore *store, const char *name, int value)
{
    FORWARD(aiSetImportPropertyInteger)(store, name, value);
}

enum aiReturn aiGetMaterialFloatArray(const struct aiMaterial *material, const char *key,
                                      unsigned int type, unsigned int index, ai_real *out,
                                      unsigned int *max)
{
    return FORWARD(aiGetMaterialFloatArray)(material, key, type, index, out, max);
}

enum aiReturn aiGetMaterialColor(const struct aiMaterial *material, const char *key,
                                 unsigned int type, unsigned int index, struct aiColor4D *out)
{
    return FORWARD(aiGetMaterialColor)(material, key, type, index, out);
}

enum aiReturn aiGetMaterialString(const struct aiMaterial *material, const char *key,
                                  unsigned int type, unsigned int index, struct aiString *out)
{
    return FORWARD(aiGetMaterialString)(material, key, type, index, out);
}

enum aiReturn aiGetMaterialTexture(const struct aiMaterial *mat, enum aiTextureType type,
                                   unsigned int index, struct aiString *path,
                                   enum aiTextureMapping *mapping, unsigned int *uvindex,
                                   ai_real *blend, enum aiTextureOp *op,
                                   enum aiTextureMapMode *mapmode, unsigned int *flags)
{
    return FORWARD(aiGetMaterialTexture)(mat, type, index, path, mapping, uvindex, blend, op,
                                         mapmode, flags);
}
