/* master/checkpoint.h: a job's film, and who rendered it, as one file, whole or not there.
 *
 * Written aside, synced, renamed over the old one, and the folder synced. The file holds the
 * film (film_save), the totals of the results in it, and the sequence up to which the journal is
 * covered; a SHA-256 at its end is over everything before it. Blocking: for the store thread and
 * the pool, with film_read_begin held on the film.
 *
 *   "TLC2", u32 numbers_bytes, u64 job, u64 covered_sequence, numbers (job_record.h), film,
 *   provenance, SHA-256
 *
 * "TLC1" had no provenance, and is still read.
 *
 * Tests: tests/unit/test_store.c.
 */
#ifndef MASTER_CHECKPOINT_H
#define MASTER_CHECKPOINT_H

#include "master/film.h"
#include "master/job_record.h"
#include "master/provenance.h"

struct checkpoint {
    uint64_t job, covered_sequence;
    struct job_totals totals;
    struct job_stats stats;
    struct provenance provenance; /* empty: not known, or of no use any more */
};

/* ERR_NOSPACE, ERR_IO, ERR_NOMEM: the old file, if any, is as it was. */
TL_NODISCARD enum err checkpoint_write(const char *path, const struct checkpoint *c,
                                       const struct film *film);

/* ERR_NOT_FOUND: no such file; ERR_CORRUPT: damaged or of another job. You own *film and the
 * provenance in *out. */
TL_NODISCARD enum err checkpoint_read(const char *path, uint64_t job, const struct grid *grid,
                                      const struct job_blocks *blocks, struct checkpoint *out,
                                      struct film **film);

#endif
