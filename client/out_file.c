#include "client/out_file.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"

/* A short name of its own, since the place's may be as long as names can be. */
static char *aside_name(const char *path)
{
    static unsigned count;
    const char *slash = strrchr(path, '/');
    int folder_bytes = slash ? (int)(slash + 1 - path) : 0;
    return mem_sprintf("%.*s.tilery-%ld-%u.part", folder_bytes, path, (long)getpid(), count++);
}

/* Where a link leads, so that the file behind it is replaced and not the link. */
static char *place_of(const char *path)
{
    char resolved[PATH_MAX];
    struct stat found;
    bool link = lstat(path, &found) == 0 && S_ISLNK(found.st_mode);
    return mem_strdup(link && realpath(path, resolved) ? resolved : path);
}

static enum err free_space_check(const char *path, uint64_t bytes_needed)
{
    uint64_t free_bytes = out_file_free_bytes(path);
    if (free_bytes == 0 || free_bytes >= bytes_needed)
        return ERR_OK;
    errno = ENOSPC;
    return ERR_NOSPACE;
}

enum err out_file_check(const char *path, uint64_t bytes_needed)
{
    struct stat found;
    size_t bytes = strlen(path);
    if ((stat(path, &found) == 0 && S_ISDIR(found.st_mode)) ||
        (bytes > 0 && path[bytes - 1] == '/')) {
        errno = EISDIR;
        return ERR_IO;
    }
    /* Devices and pipes are written in place by nobody here: they would be replaced by a file. */
    if (out_file_is_stream(path)) {
        errno = EINVAL;
        return ERR_IO;
    }
    struct out_file f;
    TL_TRY(out_file_begin(&f, path));
    out_file_abort(&f);
    return free_space_check(path, bytes_needed);
}

bool out_file_is_stream(const char *path)
{
    struct stat found;
    return stat(path, &found) == 0 && !S_ISREG(found.st_mode) && !S_ISDIR(found.st_mode);
}

static const char *last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* True if both are there, and one thing. */
static bool is_one(const char *a, const char *b)
{
    struct stat x, y;
    return stat(a, &x) == 0 && stat(b, &y) == 0 && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
}

bool out_file_same(const char *a, const char *b)
{
    if (strcmp(a, b) == 0 || is_one(a, b))
        return true;
    char *folders[2] = {file_folder(a), file_folder(b)};
    bool same = folders[0] && folders[1] && strcmp(last_part(a), last_part(b)) == 0 &&
                is_one(folders[0], folders[1]);
    mem_free(folders[0]);
    mem_free(folders[1]);
    return same;
}

uint64_t out_file_free_bytes(const char *path)
{
    struct statvfs disk;
    char *folder = file_folder(path);
    int status = folder ? statvfs(folder, &disk) : -1;
    mem_free(folder);
    return status == 0 ? (uint64_t)disk.f_bavail * disk.f_frsize : 0;
}

enum err out_file_begin(struct out_file *f, const char *path)
{
    *f = (struct out_file){.fd = -1};
    struct out_file made = {.path = place_of(path)};
    made.aside = made.path ? aside_name(made.path) : NULL;
    if (!made.path || !made.aside) {
        mem_free(made.path);
        mem_free(made.aside);
        return ERR_NOMEM;
    }
    made.fd = open(made.aside, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0666);
    if (made.fd < 0) {
        enum err e = err_from_errno(errno);
        int kept = errno;
        mem_free(made.path);
        mem_free(made.aside);
        errno = kept;
        return e;
    }
    *f = made;
    return ERR_OK;
}

static void release(struct out_file *f)
{
    if (f->fd > 0)
        (void)close(f->fd);
    mem_free(f->path);
    mem_free(f->aside);
    *f = (struct out_file){.fd = -1};
}

/* So that the new name survives a power cut, too. */
static void sync_folder(const char *path)
{
    char *folder = file_folder(path);
    int fd = folder ? open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC) : -1;
    if (fd >= 0) {
        (void)fsync(fd);
        (void)close(fd);
    }
    mem_free(folder);
}

enum err out_file_commit(struct out_file *f)
{
    int failed = 0;
    if (fsync(f->fd) != 0)
        failed = errno;
    if (close(f->fd) != 0 && !failed)
        failed = errno;
    f->fd = -1;
    if (!failed && rename(f->aside, f->path) != 0)
        failed = errno;
    if (failed) {
        out_file_abort(f);
        errno = failed;
        return err_from_errno(failed);
    }
    sync_folder(f->path);
    release(f);
    return ERR_OK;
}

void out_file_abort(struct out_file *f)
{
    if (f->aside)
        (void)unlink(f->aside);
    release(f);
}
