/* master/provenance.h: who gave the accepted bits of each spot, and which of them are to be
 * checked.
 *
 * Per (block, cell) the worker's number and a hash of the bits, so that a second result can be
 * compared without the first, and what a liar touched can be found. Open checks are units whose
 * bits another worker must confirm. Lives beside the job's film, is saved with its checkpoint, and
 * is made again by the replay of the journal behind that. 12 bytes a spot. Loop thread only, but
 * for save and load of a copy.
 *
 *   u32 cells (0: nothing follows), u32 blocks, u32 checks, u32 0, hashes, workers, checks
 *
 * Tests: tests/unit/test_provenance.c, tests/e2e/test_e2e_proxy.py.
 */
#ifndef MASTER_PROVENANCE_H
#define MASTER_PROVENANCE_H

#include "common/err.h"
#include "common/grid.h"

struct provenance {
    uint32_t cell_count, block_count; /* 0: empty */
    uint64_t *hash;                   /* [block * cell_count + cell]; 0: not known */
    uint32_t *worker;                 /* likewise */
    struct unit *checks;              /* open ones */
    size_t check_count, check_capacity;
};

/* Nothing is known of any spot. ERR_NOMEM. */
TL_NODISCARD enum err provenance_init(struct provenance *p, uint32_t cell_count,
                                      uint32_t block_count);
void provenance_release(struct provenance *p); /* also of a zeroed one */
TL_NODISCARD enum err provenance_copy(const struct provenance *p, struct provenance *out);

/* `cell_hash` has one for each cell of the run. */
void provenance_note(struct provenance *p, struct unit run, uint32_t worker,
                     const uint64_t *cell_hash);
/* Forgets all blocks of these cells, and the checks that touch them. */
void provenance_reset(struct provenance *p, uint32_t cell_begin, uint32_t cell_count);
/* Widens a run of cells to all of each open check that it touches: what is left of a unit whose
 * check a reset ends would never be checked. */
void provenance_widen(const struct provenance *p, uint32_t *cell_begin, uint32_t *cell_count);
/* Did this worker give any block of the cell? */
bool provenance_touched(const struct provenance *p, uint32_t worker, uint32_t cell);

/* ERR_NOMEM; opening twice or closing what is not open changes nothing. */
TL_NODISCARD enum err provenance_open_check(struct provenance *p, struct unit unit);
void provenance_close_check(struct provenance *p, struct unit unit);
/* The accepted bits of a unit that one worker gave whole: who, and the hash of all. False: they are
 * of several workers, or not known. */
bool provenance_of_unit(const struct provenance *p, struct unit unit, uint32_t *worker,
                        uint64_t *hash);

/* Folds the hashes of a unit's cells into one, in cell order, from 0 on. */
uint64_t provenance_fold(uint64_t so_far, uint64_t cell_hash);

/* NULL is saved as empty. load: ERR_CORRUPT unless empty or of this shape; you release *out. */
TL_NODISCARD enum err provenance_save(const struct provenance *p,
                                      enum err (*write)(void *ctx, const void *data, size_t bytes),
                                      void *ctx);
TL_NODISCARD enum err provenance_load(uint32_t cell_count, uint32_t block_count,
                                      enum err (*read)(void *ctx, void *data, size_t bytes),
                                      void *ctx, struct provenance *out);

#endif
