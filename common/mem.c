#include "common/mem.h"

#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

enum {
    ARENA_ALIGN = 64,
    ARENA_BLOCK_BYTES = 256 * 1024,
    HUGE_BYTES_MIN = 2 * MEM_HUGE_PAGE,
    PAGE_BYTES = 4096
};

static atomic_uint_fast64_t call_count;
static atomic_uint_fast64_t fail_at = UINT64_MAX;
static atomic_flag environment_read = ATOMIC_FLAG_INIT;

static bool must_fail(void)
{
    if (!atomic_flag_test_and_set_explicit(&environment_read, memory_order_relaxed)) {
        const char *text = getenv("TILERY_MEM_FAIL");
        if (text)
            mem_fail_after(strtoull(text, NULL, 10));
    }
    uint64_t call = atomic_fetch_add_explicit(&call_count, 1, memory_order_relaxed);
    return call == atomic_load_explicit(&fail_at, memory_order_relaxed);
}

void mem_fail_after(uint64_t calls)
{
    uint64_t now = atomic_load(&call_count);
    atomic_store(&fail_at, calls > UINT64_MAX - now ? UINT64_MAX : now + calls);
}

uint64_t mem_call_count(void)
{
    return atomic_load(&call_count);
}

/* Large memory that will be written whole: huge pages spare it hundreds of page faults each. A
 * wish; without it all works, slower. All its pages alike: what realloc moves must be one mapping.
 */
static void *wish_huge(void *p, size_t bytes)
{
    if (p && bytes >= HUGE_BYTES_MIN) {
        uintptr_t begin = (uintptr_t)p, end = begin + bytes;
        begin = begin / PAGE_BYTES * PAGE_BYTES;
        end = (end + PAGE_BYTES - 1) / PAGE_BYTES * PAGE_BYTES;
        (void)madvise((void *)begin, end - begin, MADV_HUGEPAGE);
    }
    return p;
}

void *mem_calloc(size_t count, size_t bytes)
{
    if (must_fail())
        return NULL;
    return calloc(count ? count : 1, bytes ? bytes : 1);
}

void *mem_alloc_array(size_t count, size_t bytes)
{
    return mem_realloc_array(NULL, count, bytes);
}

void *mem_alloc(size_t bytes)
{
    return mem_realloc_array(NULL, bytes, 1);
}

void *mem_realloc_array(void *p, size_t count, size_t bytes)
{
    size_t total;
    if (must_fail() || __builtin_mul_overflow(count, bytes, &total))
        return NULL;
    return wish_huge(realloc(p, total ? total : 1), total);
}

void *mem_alloc_aligned(size_t bytes, size_t alignment)
{
    TL_ASSERT(alignment >= sizeof(void *) && (alignment & (alignment - 1)) == 0);
    void *p = NULL;
    if (must_fail() || posix_memalign(&p, alignment, bytes ? bytes : alignment) != 0)
        return NULL;
    if (alignment >= MEM_HUGE_PAGE && bytes >= MEM_HUGE_PAGE)
        (void)madvise(p, bytes, MADV_HUGEPAGE); /* a wish; without it all works, slower */
    return p;
}

void mem_free(void *p)
{
    free(p);
}

char *mem_strndup(const char *text, size_t bytes_max)
{
    size_t bytes = strnlen(text, bytes_max);
    char *copy = mem_alloc(bytes + 1);
    if (!copy)
        return NULL;
    memcpy(copy, text, bytes);
    copy[bytes] = '\0';
    return copy;
}

char *mem_strdup(const char *text)
{
    return mem_strndup(text, strlen(text));
}

char *mem_sprintf(const char *format, ...)
{
    va_list args;
    va_start(args, format);
    int bytes = vsnprintf(NULL, 0, format, args);
    va_end(args);
    if (bytes < 0)
        return NULL;
    char *text = mem_alloc((size_t)bytes + 1);
    if (!text)
        return NULL;
    va_start(args, format);
    (void)vsnprintf(text, (size_t)bytes + 1, format, args);
    va_end(args);
    return text;
}

bool mem_grow(void **array, size_t count, size_t *capacity, size_t element_bytes)
{
    TL_ASSERT(count <= *capacity);
    if (count < *capacity)
        return true;
    size_t wanted = *capacity ? *capacity * 2 : 16;
    void *grown = mem_realloc_array(*array, wanted, element_bytes);
    if (!grown)
        return false;
    *array = grown;
    *capacity = wanted;
    return true;
}

/* Blocks come zeroed, big ones as fresh pages that nobody has to write: a table that stays empty
 * costs nothing. */
struct arena_block {
    struct arena_block *next;
    unsigned char *data; /* the first aligned byte behind this */
};

void arena_init(struct arena *a)
{
    *a = (struct arena){0};
}

void *arena_alloc(struct arena *a, size_t count, size_t bytes)
{
    size_t total;
    if (__builtin_mul_overflow(count, bytes, &total) || total > SIZE_MAX - 2 * ARENA_ALIGN)
        return NULL;
    total = (total + ARENA_ALIGN - 1) / ARENA_ALIGN * ARENA_ALIGN;
    if (!a->head || a->capacity - a->used < total) {
        size_t capacity = total > ARENA_BLOCK_BYTES ? total : ARENA_BLOCK_BYTES;
        struct arena_block *block = mem_calloc(1, sizeof *block + ARENA_ALIGN + capacity);
        if (!block)
            return NULL;
        uintptr_t behind = (uintptr_t)(block + 1);
        block->data = (unsigned char *)(block + 1) + (ARENA_ALIGN - behind % ARENA_ALIGN);
        block->next = a->head;
        a->head = block;
        a->used = 0;
        a->capacity = capacity;
        a->total_bytes += capacity;
    }
    void *p = a->head->data + a->used;
    a->used += total;
    return p;
}

void arena_release(struct arena *a)
{
    while (a->head) {
        struct arena_block *next = a->head->next;
        mem_free(a->head);
        a->head = next;
    }
    arena_init(a);
}
