/* master/store_files.h: the segment files of all jobs, as the store thread sees them.
 *
 *   DIR/jobs/ID/film        the checkpoint (checkpoint.h)
 *   DIR/jobs/ID/seg-N       records (journal.h), appended; N grows
 *
 * Appended bytes count only once segments_commit was called after segments_sync; segments_rollback
 * cuts the files back to what counted before. Store thread only (segment_read: any).
 * Tests: tests/unit/test_store_files.c, tests/unit/test_store.c.
 */
#ifndef MASTER_STORE_FILES_H
#define MASTER_STORE_FILES_H

#include "master/journal.h"

enum { SEGMENTS_OPEN_MAX = 32 };

struct segment {
    uint64_t job, number; /* job 0: free */
    int fd;
    uint64_t bytes, bytes_counted; /* written, and committed */
    uint64_t used_at;
};

struct segments {
    char *dir; /* owned */
    struct segment open[SEGMENTS_OPEN_MAX];
    uint64_t clock;
};

struct segment_place {
    uint64_t segment, offset, bytes;
    digest record;
};

/* `dir` holds jobs/. ERR_NOMEM. */
TL_NODISCARD enum err segments_init(struct segments *s, const char *dir);
void segments_release(struct segments *s);

/* Path of a job's checkpoint, its folder, or one segment; you own it. */
char *segments_film_path(const char *dir, uint64_t job);
char *segments_job_path(const char *dir, uint64_t job);
char *segments_path(const char *dir, uint64_t job, uint64_t number);

/* Makes the job's folder if it is not there. */
TL_NODISCARD enum err segments_make_folder(const struct segments *s, uint64_t job);

TL_NODISCARD enum err segments_append(struct segments *s, const struct journal_result *r,
                                      const void *body, struct segment_place *out);
TL_NODISCARD enum err segments_sync(struct segments *s);
void segments_commit(struct segments *s);
void segments_rollback(struct segments *s);

/* The job's next record begins a new file; then files numbered below `keep_from` are deleted
 * (UINT64_MAX: all). */
void segments_roll(struct segments *s, uint64_t job, uint64_t keep_from);

/* Deletes the job's folder and all in it. */
void segments_delete_job(struct segments *s, uint64_t job);

/* Cuts a file back to the bytes that the index knows: the tail of a crash. */
void segments_truncate(const char *dir, uint64_t job, uint64_t number, uint64_t bytes);

/* Reads a record back and checks it against the index. You own *data; *body points into it. */
TL_NODISCARD enum err segment_read(const char *dir, uint64_t job, const struct segment_place *place,
                                   unsigned char **data, struct journal_result *out,
                                   const unsigned char **body);

#endif
