#include "worker/tree_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"

struct tree_cache {
    char *folder;
    uint64_t bytes_max;
};

static const char suffix[] = ".tree";

static char *path_of(const struct tree_cache *c, const digest *key)
{
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(key, hex);
    return mem_sprintf("%s/%s%s", c->folder, hex, suffix);
}

void tree_cache_drop(struct tree_cache *c, const digest *key)
{
    char *path = path_of(c, key);
    if (path)
        (void)unlink(path);
    mem_free(path);
}

/* --- Bound --------------------------------------------------------------- */

struct file {
    char *path;
    uint64_t bytes;
    struct timespec used;
};

static int by_use(const void *a, const void *b)
{
    const struct file *x = a, *y = b;
    if (x->used.tv_sec != y->used.tv_sec)
        return x->used.tv_sec < y->used.tv_sec ? -1 : 1;
    return (x->used.tv_nsec > y->used.tv_nsec) - (x->used.tv_nsec < y->used.tv_nsec);
}

/* Every file of the folder, those of writers that were killed among them. */
static struct file *list_files(const struct tree_cache *c, size_t *count)
{
    struct file *files = NULL;
    size_t capacity = 0;
    DIR *dir = opendir(c->folder);
    *count = 0;
    for (struct dirent *f = dir ? readdir(dir) : NULL; f; f = readdir(dir)) {
        struct stat st;
        char *path = mem_sprintf("%s/%s", c->folder, f->d_name);
        if (!path || stat(path, &st) != 0 || !S_ISREG(st.st_mode) ||
            !mem_grow((void **)&files, *count, &capacity, sizeof *files)) {
            mem_free(path);
            continue;
        }
        files[(*count)++] =
            (struct file){.path = path, .bytes = (uint64_t)st.st_size, .used = st.st_mtim};
    }
    if (dir)
        (void)closedir(dir);
    return files;
}

static void trim(const struct tree_cache *c)
{
    size_t count;
    struct file *files = list_files(c, &count);
    uint64_t bytes = 0;
    for (size_t i = 0; i < count; i++)
        bytes += files[i].bytes;
    if (count > 0)
        qsort(files, count, sizeof *files, by_use);
    for (size_t i = 0; i < count; i++) {
        if (bytes > c->bytes_max && unlink(files[i].path) == 0)
            bytes -= files[i].bytes;
        mem_free(files[i].path);
    }
    mem_free(files);
}

/* --- Life ---------------------------------------------------------------- */

enum err tree_cache_new(const char *folder, uint64_t bytes_max, struct tree_cache **out)
{
    struct tree_cache *c = mem_calloc(1, sizeof *c);
    if (!c)
        return ERR_NOMEM;
    c->bytes_max = bytes_max;
    c->folder = mem_sprintf("%s/trees", folder);
    if (!c->folder) {
        tree_cache_free(c);
        return ERR_NOMEM;
    }
    trim(c);
    *out = c;
    return ERR_OK;
}

void tree_cache_free(struct tree_cache *c)
{
    if (!c)
        return;
    mem_free(c->folder);
    mem_free(c);
}

/* --- In and out ---------------------------------------------------------- */

enum err tree_cache_get(struct tree_cache *c, const digest *key, char **owner, const void **data,
                        size_t *bytes)
{
    char *path = path_of(c, key);
    size_t file_bytes = 0;
    if (!path)
        return ERR_NOMEM;
    /* A larger one was never put here: it is dropped unread. */
    enum err e = file_read(path, c->bytes_max, owner, &file_bytes);
    if (e == ERR_LIMIT) {
        log_warn("cache", "tree dropped: larger than the cache file=%s", path);
        (void)unlink(path);
        e = ERR_NOT_FOUND;
    }
    if (e == ERR_OK) {
        digest found = {{0}}, said = {{1}};
        if (file_bytes > DIGEST_BYTES) {
            memcpy(said.bytes, *owner, DIGEST_BYTES);
            found = digest_of(*owner + DIGEST_BYTES, file_bytes - DIGEST_BYTES);
        }
        if (!digest_equal(&found, &said)) {
            log_warn("cache", "tree dropped: the disk has changed it file=%s", path);
            (void)unlink(path);
            mem_free(*owner);
            *owner = NULL;
            e = ERR_NOT_FOUND;
        }
    }
    if (e == ERR_OK) {
        (void)utimensat(AT_FDCWD, path, NULL, 0); /* used now, for every process */
        *data = *owner + DIGEST_BYTES;
        *bytes = file_bytes - DIGEST_BYTES;
    }
    mem_free(path);
    return e;
}

void tree_cache_head(struct buf *file)
{
    static const unsigned char none[DIGEST_BYTES];
    buf_put(file, none, sizeof none);
}

enum err tree_cache_put(struct tree_cache *c, const digest *key, struct buf *file)
{
    TL_TRY(buf_status(file));
    TL_ASSERT(file->bytes > DIGEST_BYTES);
    if (file->bytes > c->bytes_max)
        return ERR_OK;
    digest d = digest_of(file->data + DIGEST_BYTES, file->bytes - DIGEST_BYTES);
    memcpy(file->data, d.bytes, DIGEST_BYTES);
    if (mkdir(c->folder, 0777) != 0 && errno != EEXIST)
        return err_from_errno(errno);
    char *path = path_of(c, key);
    enum err e = path ? file_write(path, file->data, file->bytes) : ERR_NOMEM;
    mem_free(path);
    trim(c);
    return e;
}
