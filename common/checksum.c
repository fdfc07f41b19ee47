#include "common/checksum.h"

#include <string.h>

enum { LANES = 8 };

/* Odd, its bits well mixed: 2^64 over the golden ratio. Multiplying by it and folding the upper
 * half down are both one to one, so that no step loses a difference. */
static const uint64_t multiplier = UINT64_C(0x9e3779b97f4a7c15);

static uint64_t mix(uint64_t sum, uint64_t word)
{
    sum = (sum ^ word) * multiplier;
    return sum ^ sum >> 32;
}

uint64_t checksum64(const void *data, size_t bytes)
{
    const unsigned char *p = data;
    uint64_t lanes[LANES];
    size_t left = bytes;
    for (size_t k = 0; k < LANES; k++)
        lanes[k] = k + 1;
    for (; left >= sizeof lanes; left -= sizeof lanes, p += sizeof lanes) {
        uint64_t words[LANES];
        memcpy(words, p, sizeof words);
        for (size_t k = 0; k < LANES; k++)
            lanes[k] = mix(lanes[k], words[k]);
    }
    uint64_t rest[LANES] = {0}, sum = bytes;
    if (left > 0)
        memcpy(rest, p, left);
    for (size_t k = 0; k < LANES; k++)
        sum = mix(mix(sum, lanes[k]), rest[k]);
    return sum;
}
