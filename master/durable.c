#include "master/durable.h"

#include <errno.h>
#include <unistd.h>

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
