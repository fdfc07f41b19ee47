/* master/film_impl.h: the film's tables, shared by film.c, film_error.c and film_file.c only. */
#ifndef MASTER_FILM_IMPL_H
#define MASTER_FILM_IMPL_H

#include "master/film.h"

/* A unit whose payload is not wholly in the sums. */
struct film_wait {
    struct film_wait *next;
    struct unit unit;
    uint32_t cells_left; /* neither added nor dropped yet */
    uint64_t pixels;
    /* Owned; planes of `pixels` finite floats. A cell that was dropped by a reset has a NaN for its
     * first value. NULL: the entry is a held-back reset of the unit's cells. */
    float *values;
};

struct film {
    const struct grid *grid; /* borrowed */
    struct job_blocks blocks;
    uint64_t pixels;
    uint64_t *cell_offset;       /* cell_count + 1: first pixel of a cell in grid order */
    double *sum[FILM_HALVES];    /* grid->plane_count planes of `pixels` */
    uint16_t *next[FILM_HALVES]; /* per cell: blocks of the half that are added */
    uint64_t *present;           /* bit block * cell_count + cell */
    struct film_wait *waiting[JOB_BLOCKS_MAX];
    struct film_wait *held, **held_end; /* arrived while somebody reads, oldest first */
    uint32_t readers;
    uint64_t added_count, present_count; /* cell-blocks */

    /* Where cells get different numbers of blocks. */
    uint16_t *limit;      /* per cell; NULL: all blocks */
    uint64_t limit_total; /* their sum */
    bool planned;         /* the estimate has begun */
    bool pilot_kept;      /* and the pilot's samples are part of it */
    uint64_t waiting_bytes;
};

_Static_assert(JOB_BLOCKS_MAX / 2 <= UINT16_MAX, "next[] counts blocks of a half");

/* Samples of one half that the sums of a cell have. */
uint64_t film_half_samples(const struct film *f, uint32_t half, uint32_t cell);

/* Saving and loading work on these. */
uint32_t film_half_blocks(const struct film *f, uint32_t half);
void film_set_present(struct film *f, struct unit u);
/* True while the cell of a waiting unit is neither in the sums nor dropped. */
bool film_is_left(const struct film *f, const struct film_wait *w, uint32_t cell);

#endif
