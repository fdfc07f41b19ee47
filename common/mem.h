/* common/mem.h: the only door to malloc, and the arena.
 *
 * mem_* can be told to fail the N-th call from now, so that tests walk every
 * out-of-memory path. All return NULL on failure; no other module calls malloc.
 * Any thread; an arena belongs to one thread at a time.
 */
#ifndef COMMON_MEM_H
#define COMMON_MEM_H

#include "common/err.h"

/* Zeroed memory for `count` objects of `bytes` each, aligned for any type;
 * NULL when out of memory or when the product overflows. count 0 gives a
 * pointer that may be freed. */
TL_NODISCARD void *mem_calloc(size_t count, size_t bytes);

/* As calloc, not zeroed. */
TL_NODISCARD void *mem_alloc_array(size_t count, size_t bytes);
TL_NODISCARD void *mem_alloc(size_t bytes);

/* Grows or shrinks to count * bytes; on failure NULL and `p` is as it was. */
TL_NODISCARD void *mem_realloc_array(void *p, size_t count, size_t bytes);

/* `alignment` a power of two >= sizeof(void *); freed by mem_free. Aligned to MEM_HUGE_PAGE the
 * memory is backed by huge pages where the system has them: for big tables met at random. */
enum { MEM_HUGE_PAGE = 2 << 20 };
TL_NODISCARD void *mem_alloc_aligned(size_t bytes, size_t alignment);

void mem_free(void *p);

/* Copies of text; you own the result. NULL when out of memory. */
TL_NODISCARD char *mem_strdup(const char *text);
TL_NODISCARD char *mem_strndup(const char *text, size_t bytes_max);
TL_NODISCARD char *mem_sprintf(const char *format, ...) TL_PRINTF(1, 2);

/* Makes room for one more element in a growing array: doubles *capacity when
 * count == *capacity. false when out of memory; then nothing changed. */
TL_NODISCARD bool mem_grow(void **array, size_t count, size_t *capacity, size_t element_bytes);

/* The call after `calls` more successful ones fails, once; UINT64_MAX: never (the
 * default). The environment variable TILERY_MEM_FAIL sets it at the first call. */
void mem_fail_after(uint64_t calls);

/* How many allocations were made so far by this process. */
uint64_t mem_call_count(void);

/* An arena hands out memory that is freed all at once. */
struct arena {
    struct arena_block *head;
    size_t used, capacity; /* of the head block, in bytes */
    size_t total_bytes;    /* of all blocks */
};

void arena_init(struct arena *a);

/* Zeroed, aligned to 64 bytes; NULL when out of memory. */
TL_NODISCARD void *arena_alloc(struct arena *a, size_t count, size_t bytes);

/* Frees all blocks; the arena is empty and usable again. */
void arena_release(struct arena *a);

#endif
