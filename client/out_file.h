/* client/out_file.h: a picture that appears at its place whole or not at all.
 *
 * out_file_check before a render, so that hours are not spent on what cannot be stored;
 * then begin, write through `fd`, commit. The bytes lie beside the place under a hidden
 * name until they are on the disk. One thread.
 */
#ifndef CLIENT_OUT_FILE_H
#define CLIENT_OUT_FILE_H

#include <stdbool.h>

#include "common/err.h"

struct out_file {
    char *path, *aside; /* owned */
    int fd;             /* for writing; never 0 */
};

/* Whether `path` could be written now: its folder exists and takes new files, it is no folder
 * itself, and `bytes_needed` are free. ERR_NOT_FOUND (no such folder), ERR_NOSPACE, ERR_IO, with
 * errno set. Nothing is left behind. */
TL_NODISCARD enum err out_file_check(const char *path, uint64_t bytes_needed);

/* True if two paths name one file, whether it is there yet or not. */
bool out_file_same(const char *a, const char *b);

/* True if it is there and no file or folder: a pipe, a terminal, another device. */
bool out_file_is_stream(const char *path);

/* Free bytes of the disk that holds `path`'s folder; 0 if unknown. */
uint64_t out_file_free_bytes(const char *path);

TL_NODISCARD enum err out_file_begin(struct out_file *f, const char *path);

/* Syncs and renames. On failure the place is as it was and nothing is left beside it. Releases
 * `f` either way. */
TL_NODISCARD enum err out_file_commit(struct out_file *f);

/* Removes what was written aside; `f` may have been released or never begun (zeroed). */
void out_file_abort(struct out_file *f);

#endif
