#include "master/sched/cellset.h"

struct cellset_shape cellset_shape_of(uint32_t cell_count)
{
    TL_ASSERT(cell_count > 0 && cell_count <= UINT32_C(1) << 24);
    struct cellset_shape s = {.cell_count = cell_count};
    uint32_t bits = cell_count;
    do {
        TL_ASSERT(s.level_count < CELLSET_LEVELS);
        bits = (bits + 63) / 64;
        s.level_begin[s.level_count++] = s.word_count;
        s.word_count += bits;
    } while (bits > 1);
    return s;
}

bool cellset_has(const struct cellset_shape *s, const uint64_t *words, uint32_t cell)
{
    TL_DASSERT(cell < s->cell_count);
    return words[cell / 64] >> (cell % 64) & 1;
}

void cellset_add(const struct cellset_shape *s, uint64_t *words, uint32_t cell)
{
    TL_DASSERT(cell < s->cell_count);
    uint32_t bit = cell;
    for (uint32_t level = 0; level < s->level_count; level++) {
        uint64_t *w = &words[s->level_begin[level] + bit / 64];
        bool was_empty = *w == 0;
        *w |= UINT64_C(1) << (bit % 64);
        if (!was_empty)
            break;
        bit /= 64;
    }
}

void cellset_remove(const struct cellset_shape *s, uint64_t *words, uint32_t cell)
{
    TL_DASSERT(cell < s->cell_count);
    uint32_t bit = cell;
    for (uint32_t level = 0; level < s->level_count; level++) {
        uint64_t *w = &words[s->level_begin[level] + bit / 64];
        *w &= ~(UINT64_C(1) << (bit % 64));
        if (*w != 0)
            break;
        bit /= 64;
    }
}

void cellset_fill(const struct cellset_shape *s, uint64_t *words)
{
    uint32_t bits = s->cell_count;
    for (uint32_t level = 0; level < s->level_count; level++) {
        uint64_t *w = &words[s->level_begin[level]];
        uint32_t full = bits / 64;
        for (uint32_t i = 0; i < full; i++)
            w[i] = UINT64_MAX;
        if (bits % 64)
            w[full] = (UINT64_C(1) << (bits % 64)) - 1;
        bits = (bits + 63) / 64;
    }
}

uint32_t cellset_next(const struct cellset_shape *s, const uint64_t *words, uint32_t from)
{
    if (from >= s->cell_count)
        return UINT32_MAX;
    /* Climb until a word has a bit at or after the place, */
    uint32_t bit = from, level = 0;
    for (;;) {
        uint32_t index = s->level_begin[level] + bit / 64;
        uint32_t end = level + 1 < s->level_count ? s->level_begin[level + 1] : s->word_count;
        uint64_t w = index < end ? words[index] & (UINT64_MAX << (bit % 64)) : 0;
        if (w != 0) {
            bit = bit / 64 * 64 + (uint32_t)__builtin_ctzll(w);
            break;
        }
        if (++level == s->level_count)
            return UINT32_MAX;
        bit = bit / 64 + 1;
    }
    /* then go down to the first bit below it. */
    while (level > 0) {
        level--;
        uint64_t w = words[s->level_begin[level] + bit];
        TL_DASSERT(w != 0);
        bit = bit * 64 + (uint32_t)__builtin_ctzll(w);
    }
    return bit;
}

uint32_t cellset_run(const struct cellset_shape *s, const uint64_t *words, uint32_t from,
                     uint32_t count_max)
{
    TL_DASSERT(cellset_has(s, words, from));
    uint32_t end = count_max < s->cell_count - from ? from + count_max : s->cell_count;
    uint32_t cell = from;
    while (cell < end) {
        uint64_t gaps = ~words[cell / 64] & (UINT64_MAX << (cell % 64));
        if (gaps != 0) {
            uint32_t gap = cell / 64 * 64 + (uint32_t)__builtin_ctzll(gaps);
            return (gap < end ? gap : end) - from;
        }
        cell = (cell / 64 + 1) * 64;
    }
    return end - from;
}
