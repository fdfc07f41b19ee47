/* Files as assimp sees them: whole in memory, some of them not on disk. */
#include <assimp/cfileio.h>
#include <string.h>

#include "client/import_assimp.h"
#include "common/file_io.h"
#include "common/mem.h"

#define FILE_BYTES_MAX (UINT64_C(2) << 30)

struct open_file {
    const char *data;
    char *owned; /* NULL: one of the documents made here */
    size_t bytes, at;
};

static struct open_file *file_of(struct aiFile *f)
{
    return (struct open_file *)f->UserData;
}

static size_t read_file(struct aiFile *f, char *to, size_t size, size_t count)
{
    struct open_file *o = file_of(f);
    size_t left = o->bytes - o->at;
    size_t items = size ? left / size : 0;
    items = items < count ? items : count;
    memcpy(to, o->data + o->at, items * size);
    o->at += items * size;
    return items;
}

static size_t write_file(struct aiFile *f, const char *from, size_t size, size_t count)
{
    (void)f;
    (void)from;
    (void)size;
    (void)count;
    return 0;
}

static size_t tell_file(struct aiFile *f)
{
    return file_of(f)->at;
}

static size_t size_file(struct aiFile *f)
{
    return file_of(f)->bytes;
}

static enum aiReturn seek_file(struct aiFile *f, size_t offset, enum aiOrigin origin)
{
    struct open_file *o = file_of(f);
    size_t base = origin == aiOrigin_SET ? 0 : origin == aiOrigin_CUR ? o->at : o->bytes;
    if (base + offset > o->bytes)
        return aiReturn_FAILURE;
    o->at = base + offset;
    return aiReturn_SUCCESS;
}

static void flush_file(struct aiFile *f)
{
    (void)f;
}

static bool ends_with(const char *path, const char *name)
{
    size_t a = strlen(path), b = strlen(name);
    return a >= b && strcmp(path + a - b, name) == 0;
}

static bool find_contents(const struct assimp_import *a, const char *path, struct open_file *o)
{
    if (a->doc.bytes > 0 && strcmp(path, a->im->path) == 0) {
        *o = (struct open_file){.data = (const char *)a->doc.data, .bytes = a->doc.bytes};
        return true;
    }
    if (a->doc.bytes > 0 && ends_with(path, GLTF_FLOATS_NAME)) {
        *o = (struct open_file){.data = (const char *)a->floats.data, .bytes = a->floats.bytes};
        return true;
    }
    char *decoded = gltf_uri_path(path);
    bool there = file_read(path, FILE_BYTES_MAX, &o->owned, &o->bytes) == ERR_OK ||
                 (decoded && file_read(decoded, FILE_BYTES_MAX, &o->owned, &o->bytes) == ERR_OK);
    mem_free(decoded);
    o->data = o->owned;
    return there;
}

static struct aiFile *open_file(struct aiFileIO *io, const char *path, const char *mode)
{
    struct open_file found = {0};
    if (mode[0] != 'r' || !find_contents((const struct assimp_import *)io->UserData, path, &found))
        return NULL;
    struct aiFile *f = mem_calloc(1, sizeof *f);
    struct open_file *o = mem_calloc(1, sizeof *o);
    if (!f || !o) {
        mem_free(f);
        mem_free(o);
        mem_free(found.owned);
        return NULL;
    }
    *o = found;
    *f = (struct aiFile){.ReadProc = read_file,
                         .WriteProc = write_file,
                         .TellProc = tell_file,
                         .FileSizeProc = size_file,
                         .SeekProc = seek_file,
                         .FlushProc = flush_file,
                         .UserData = (char *)o};
    return f;
}

static void close_file(struct aiFileIO *io, struct aiFile *f)
{
    (void)io;
    mem_free(file_of(f)->owned);
    mem_free(f->UserData);
    mem_free(f);
}

struct aiFileIO assimp_files(struct assimp_import *a)
{
    return (struct aiFileIO){.OpenProc = open_file, .CloseProc = close_file, .UserData = (char *)a};
}
