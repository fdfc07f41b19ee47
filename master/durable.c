#include "master/durable.h"

#include <errno.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"

static bool forgone;

void durable_forgo(void)
{
    forgone = true;
}

bool durable_wanted(void)
{
    return !forgone;
}

enum err durable_sync(int fd)
{
    return forgone || fsync(fd) == 0 ? ERR_OK : err_from_errno(errno);
}

enum err durable_data_sync(int fd)
{
    return forgone || fdatasync(fd) == 0 ? ERR_OK : err_from_errno(errno);
}

enum err durable_sync_folder(const char *folder)
{
    if (forgone)
        return ERR_OK;
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0)
        return err_from_errno(errno);
    enum err e = durable_sync(fd);
    (void)close(fd);
    return e;
}

enum err durable_sync_name(const char *path)
{
    char *folder = file_folder(path);
    enum err e = folder ? durable_sync_folder(folder) : ERR_NOMEM;
    mem_free(folder);
    return e;
}

enum err durable_make_folder(const char *path)
{
    if (mkdir(path, 0700) == 0)
        return durable_sync_name(path);
    return errno == EEXIST ? ERR_OK : err_from_errno(errno);
}
