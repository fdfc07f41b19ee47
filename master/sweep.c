/* Bounded disk: chunks that no kept job needs. See farm.h and chunks.h. */
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "master/farm.h"

enum { SWEEP_S = 3600 }; /* between two looks; so long a chunk may wait for its job */

static int by_digest(const void *a, const void *b)
{
    return memcmp(a, b, sizeof(digest));
}

static void swept(void *ctx)
{
    struct farm *f = ctx;
    f->sweeping = false;
    f->swept_ms = farm_now_ms(f);
}

void sweep_chunks(struct farm *f)
{
    const int64_t grace_ms = f->retention_s > 0 && f->retention_s < SWEEP_S
                                 ? (int64_t)f->retention_s * 1000 + 1
                                 : (int64_t)SWEEP_S * 1000;
    int64_t now = farm_now_ms(f);
    if (f->sweeping || f->stopping || now - f->swept_ms < grace_ms || chunks_count(f->chunks) == 0)
        return;
    digest *roots = mem_alloc_array(f->job_count, sizeof *roots);
    if (!roots)
        return;
    for (size_t i = 0; i < f->job_count; i++)
        roots[i] = f->jobs[i]->rec.package;
    qsort(roots, f->job_count, sizeof *roots, by_digest);
    size_t count = 0;
    for (size_t i = 0; i < f->job_count; i++)
        if (count == 0 || memcmp(&roots[count - 1], &roots[i], sizeof *roots) != 0)
            roots[count++] = roots[i];
    uint64_t before = now > grace_ms ? (uint64_t)(now - grace_ms) : 0;
    f->sweeping = chunks_sweep(f->chunks, roots, count, before, swept, f) == ERR_OK;
}
