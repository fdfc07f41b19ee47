/* master/journal.h: one rendered unit as a record of a segment file.
 *
 * A record is a header of fixed size and the result's body as the worker sent it
 * (tile codec), both under one SHA-256, so that a torn tail, a flipped bit or a stale block of
 * the disk is never taken for a result. Segment files are only appended to; which records count is
 * what the store's index says (store.h): append, sync, commit, then acknowledge.
 *
 *   bytes  0  magic "TLR1", u32 body_bytes, then the fields of struct journal_result in order,
 *        104  SHA-256 of the SHA-256 of bytes 0..103 and that of the body
 *        136  the body
 *
 * Pure; any thread. Tests: tests/unit/test_journal.c (every prefix, every flipped bit).
 */
#ifndef MASTER_JOURNAL_H
#define MASTER_JOURNAL_H

#include "common/digest.h"
#include "common/grid.h"

enum { JOURNAL_HEADER_BYTES = 136, JOURNAL_BODY_BYTES_MAX = 1 << 30 };

struct journal_result {
    uint64_t job;
    uint64_t sequence; /* order of arrival in this job, from 1; never used twice */
    struct unit unit;
    uint32_t worker; /* number of who rendered it */
    uint64_t epoch;
    uint64_t samples, rays;
    uint64_t nonfinite, nonfinite_pixel, nonfinite_sample;
    uint64_t render_us;
    uint32_t raw_bytes; /* of the decoded body */
    uint32_t body_bytes;
};

/* Writes the header of a record whose body is r->body_bytes at `body`; gives the digest in it. */
digest journal_header(const struct journal_result *r, const void *body,
                      unsigned char out[JOURNAL_HEADER_BYTES]);

/* One record at the start of `data`. ERR_CORRUPT: there is none, or it is cut or damaged. `body`
 * points into `data`. */
TL_NODISCARD enum err journal_read(const void *data, size_t bytes, struct journal_result *out,
                                   digest *record_digest, const unsigned char **body);

#endif
