/* common/file_io.h: whole files in and out, nothing half-written.
 *
 * Blocking; not for a daemon's loop thread. Any thread.
 */
#ifndef COMMON_FILE_IO_H
#define COMMON_FILE_IO_H

#include "common/buf.h"

/* The contents of a regular file, followed by a NUL that is not counted; you own *data
 * (mem_free). ERR_NOT_FOUND, ERR_IO (a folder, unreadable), ERR_LIMIT (over bytes_max). */
TL_NODISCARD enum err file_read(const char *path, uint64_t bytes_max, char **data, size_t *bytes);

/* Why file_read gave `e`, for people: "no such file", "a folder", "a device or a pipe, not a file",
 * "no permission", ...; static. */
const char *file_read_why(const char *path, enum err e);

/* Why a folder could not be made or written in, with `e`: "not a folder", "no permission to write
 * there", "its file system is read-only", ...; static. */
const char *file_folder_why(const char *path, enum err e);

/* What to do about a file that is not there: the one in its folder whose name is nearest, or where
 * relative paths begin. You own it; NULL when there is nothing to say. */
TL_NODISCARD char *file_missing_hint(const char *path);

/* Bytes of a file; 0 when there is none. */
uint64_t file_length(const char *path);

/* Writes beside `path`, syncs, and renames over it: afterwards the file is whole or as before.
 * ERR_NOSPACE, ERR_NOT_FOUND (no such folder), ERR_IO. */
TL_NODISCARD enum err file_write(const char *path, const void *data, size_t bytes);

/* A new file beside `path`, open for writing as *fd, its name in *aside: for file_close_aside.
 * ERR_NOSPACE, ERR_NOT_FOUND, ERR_IO, ERR_NOMEM. */
TL_NODISCARD enum err file_open_aside(const char *path, char **aside, int *fd);

/* Closes it, renames it over `path` and frees its name; where `e`, what became of the writing, is
 * an error, or another one comes, it is removed instead. Syncs nothing. */
TL_NODISCARD enum err file_close_aside(const char *path, char *aside, int fd, enum err e);

/* The folder part of a path ("" for none is "."), and a path relative to a folder (absolute ones
 * stay). You own the result; NULL when out of memory. */
TL_NODISCARD char *file_folder(const char *path);
TL_NODISCARD char *file_join(const char *folder, const char *path);

/* A file in the folder of `path` whose name is the same but for case, as the user would write it;
 * you own it. NULL: none. */
TL_NODISCARD char *file_other_case(const char *path);

#endif
