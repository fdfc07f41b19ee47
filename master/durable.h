/* master/durable.h: what has been written reaches the disk before it counts; or not.
 *
 * The store, the chunks and the checkpoints of a farm outlive a crash of the machine. A private
 * farm (`tilery render`) ends with its client anyway: it has only to outlive the death of its
 * processes, for which what the kernel holds is enough, and need not wait for a disk.
 *
 * Set once, before the first thread starts; then any thread.
 */
#ifndef MASTER_DURABLE_H
#define MASTER_DURABLE_H

#include "common/err.h"

/* From now on nothing waits for the disk. */
void durable_forgo(void);
bool durable_wanted(void);

/* fsync and fdatasync where that is wanted. ERR_NOSPACE, ERR_IO. */
TL_NODISCARD enum err durable_sync(int fd);
TL_NODISCARD enum err durable_data_sync(int fd);

/* What was made, renamed or removed in a folder. ERR_NOT_FOUND, ERR_IO. */
TL_NODISCARD enum err durable_sync_folder(const char *folder);
/* The same for the folder in which `path` lies. ERR_NOMEM too. */
TL_NODISCARD enum err durable_sync_name(const char *path);
/* Makes a folder, if it is not there, whose name is on disk. */
TL_NODISCARD enum err durable_make_folder(const char *path);

#endif
