#include "common/file_io.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/diag.h"
#include "common/mem.h"

/* --- Reading ------------------------------------------------------------- */

static enum err read_all(int fd, char *data, size_t bytes)
{
    for (size_t done = 0; done < bytes;) {
        ssize_t got = read(fd, data + done, bytes - done);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0) /* 0: the file shrank while it was read */
            return ERR_IO;
        done += (size_t)got;
    }
    return ERR_OK;
}

static enum err read_open(int fd, uint64_t bytes_max, char **data, size_t *bytes)
{
    struct stat st;
    if (fstat(fd, &st) != 0 || !S_ISREG(st.st_mode))
        return ERR_IO;
    if ((uint64_t)st.st_size > bytes_max)
        return ERR_LIMIT;
    size_t size = (size_t)st.st_size;
    char *all = mem_alloc(size + 1);
    if (!all)
        return ERR_NOMEM;
    enum err e = read_all(fd, all, size);
    if (e != ERR_OK) {
        mem_free(all);
        return e;
    }
    all[size] = '\0';
    *data = all;
    *bytes = size;
    return ERR_OK;
}

enum err file_read(const char *path, uint64_t bytes_max, char **data, size_t *bytes)
{
    /* O_NONBLOCK: opening a FIFO must not wait; it is refused as no regular file. */
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0)
        return errno == ENOENT || errno == ENOTDIR ? ERR_NOT_FOUND : ERR_IO;
    enum err e = read_open(fd, bytes_max, data, bytes);
    (void)close(fd);
    return e;
}

const char *file_read_why(const char *path, enum err e)
{
    struct stat st;
    if (e == ERR_NOT_FOUND)
        return "no such file";
    if (e == ERR_LIMIT)
        return "larger than any such file is";
    if (e != ERR_IO)
        return err_text(e);
    if (stat(path, &st) != 0)
        return errno == ELOOP ? "a link that leads back to itself" : err_text(e);
    if (S_ISDIR(st.st_mode))
        return "a folder";
    if (!S_ISREG(st.st_mode))
        return "a device or a pipe, not a file";
    return access(path, R_OK) != 0 ? "no permission" : err_text(e);
}

const char *file_folder_why(const char *path, enum err e)
{
    struct stat st;
    char parent[PATH_MAX];
    if (e != ERR_IO && e != ERR_NOT_FOUND)
        return err_text(e);
    bool there = stat(path, &st) == 0;
    if ((there && !S_ISDIR(st.st_mode)) || (!there && errno == ENOTDIR))
        return "not a folder";
    (void)snprintf(parent, sizeof parent, "%s", path);
    if (!there && stat(dirname(parent), &st) != 0)
        return "the folder that it is to be in is not there";
    (void)snprintf(parent, sizeof parent, "%s", path);
    if (access(there ? path : dirname(parent), W_OK | X_OK) == 0)
        return err_text(e);
    return errno == EROFS ? "its file system is read-only" : "no permission to write there";
}

/* --- Writing ------------------------------------------------------------- */

static enum err write_all(int fd, const char *data, size_t bytes)
{
    for (size_t done = 0; done < bytes;) {
        ssize_t wrote = write(fd, data + done, bytes - done);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote < 0)
            return err_from_errno(errno);
        done += (size_t)wrote;
    }
    return ERR_OK;
}

/* The rename is durable once the folder is synced; where that cannot be done, the file is still
 * whole. */
static void sync_folder(const char *path)
{
    char *folder = file_folder(path);
    int fd = folder ? open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC) : -1;
    mem_free(folder);
    if (fd < 0)
        return;
    (void)fsync(fd);
    (void)close(fd);
}

/* /dev/stdout, pipes and the like are written to as they are. */
static enum err write_special(const char *path, const void *data, size_t bytes)
{
    int fd = open(path, O_WRONLY | O_CLOEXEC);
    if (fd < 0)
        return err_from_errno(errno);
    enum err e = write_all(fd, data, bytes);
    (void)close(fd);
    return e;
}

enum err file_open_aside(const char *path, char **aside, int *fd)
{
    static atomic_uint counter;
    for (;;) {
        char *name = mem_sprintf("%s.%ld.%u.tmp", path, (long)getpid(), counter++);
        if (!name)
            return ERR_NOMEM;
        *fd = open(name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
        *aside = name;
        if (*fd >= 0)
            return ERR_OK;
        mem_free(name);
        *aside = NULL;
        if (errno != EEXIST)
            return err_from_errno(errno);
    }
}

enum err file_close_aside(const char *path, char *aside, int fd, enum err e)
{
    if (close(fd) != 0 && e == ERR_OK)
        e = err_from_errno(errno);
    if (e == ERR_OK && rename(aside, path) != 0)
        e = err_from_errno(errno);
    if (e != ERR_OK)
        (void)unlink(aside);
    mem_free(aside);
    return e;
}

enum err file_write(const char *path, const void *data, size_t bytes)
{
    struct stat st;
    if (stat(path, &st) == 0 && !S_ISREG(st.st_mode))
        return S_ISDIR(st.st_mode) ? ERR_IO : write_special(path, data, bytes);
    char *aside;
    int fd;
    TL_TRY(file_open_aside(path, &aside, &fd));
    enum err e = write_all(fd, data, bytes);
    if (e == ERR_OK && fsync(fd) != 0)
        e = err_from_errno(errno);
    e = file_close_aside(path, aside, fd, e);
    if (e == ERR_OK)
        sync_folder(path);
    return e;
}

/* --- Names --------------------------------------------------------------- */

char *file_folder(const char *path)
{
    const char *slash = strrchr(path, '/');
    if (!slash)
        return mem_strdup(".");
    return slash == path ? mem_strdup("/") : mem_strndup(path, (size_t)(slash - path));
}

char *file_join(const char *folder, const char *path)
{
    if (path[0] == '/' || strcmp(folder, ".") == 0)
        return mem_strdup(path);
    size_t bytes = strlen(folder);
    return mem_sprintf("%s%s%s", folder, bytes && folder[bytes - 1] == '/' ? "" : "/", path);
}

char *file_other_case(const char *path)
{
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    char *folder = file_folder(path), *found = NULL;
    DIR *dir = folder ? opendir(folder) : NULL;
    mem_free(folder);
    if (!dir)
        return NULL;
    for (struct dirent *entry = readdir(dir); entry && !found; entry = readdir(dir))
        if (strcasecmp(entry->d_name, name) == 0 && strcmp(entry->d_name, name) != 0)
            found = mem_sprintf("%.*s%s", (int)(name - path), path, entry->d_name);
    (void)closedir(dir);
    return found;
}

/* The name in a folder that is nearest to `name`; you own it, NULL: none is near. */
static char *nearest_in(DIR *dir, const char *name)
{
    enum { NAMES_MAX = 4000 };
    char *best = NULL;
    size_t count = 0;
    for (struct dirent *entry = readdir(dir); entry && count < NAMES_MAX; entry = readdir(dir)) {
        const char *const two[] = {best ? best : entry->d_name, entry->d_name};
        count++;
        const char *near = entry->d_name[0] == '.' ? NULL : diag_nearest(name, two, 2);
        if (!near || near == best)
            continue;
        char *copy = mem_strdup(near);
        mem_free(best);
        best = copy;
    }
    return best;
}

char *file_missing_hint(const char *path)
{
    char here[4096];
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    char *folder = file_folder(path), *other = file_other_case(path), *hint = NULL;
    DIR *dir = folder ? opendir(folder) : NULL;
    char *near = dir && !other ? nearest_in(dir, name) : NULL;
    if (other)
        hint = mem_sprintf("did you mean %s?", other);
    else if (near)
        hint = mem_sprintf("did you mean %.*s%s?", (int)(name - path), path, near);
    else if (folder && !dir && errno == ENOENT)
        hint = mem_sprintf("there is no folder %s", folder);
    else if (path[0] != '/' && getcwd(here, sizeof here))
        hint = mem_sprintf("paths begin at %s", here);
    if (dir)
        (void)closedir(dir);
    mem_free(near);
    mem_free(other);
    mem_free(folder);
    return hint;
}

uint64_t file_length(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0 && S_ISREG(st.st_mode) ? (uint64_t)st.st_size : 0;
}
