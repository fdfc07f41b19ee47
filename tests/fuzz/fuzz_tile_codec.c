/* The tile codec. First byte even: the rest is decoded as 1 to 4096 values (two bytes say how
 * many), and what comes out must survive encoding. Odd: the rest are floats, there and back. */
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "proto/tile_codec.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

enum { COUNT_MAX = 4096 };

static void must_round_trip(const float *values, size_t count)
{
    static float back[COUNT_MAX];
    unsigned char *encoded;
    size_t bytes;
    if (tile_codec_encode(values, count, &encoded, &bytes) != ERR_OK ||
        tile_codec_decode(encoded, bytes, back, count) != ERR_OK ||
        memcmp(back, values, count * sizeof *back) != 0)
        abort();
    mem_free(encoded);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    static float values[COUNT_MAX];
    if (bytes < 4)
        return 0;
    if (data[0] % 2 == 1) {
        size_t count = (bytes - 1) / sizeof(float);
        if (count == 0 || count > COUNT_MAX)
            return 0;
        memcpy(values, data + 1, count * sizeof(float));
        must_round_trip(values, count);
        return 0;
    }
    size_t count = 1 + (data[1] | (size_t)data[2] << 8) % COUNT_MAX;
    if (tile_codec_decode(data + 3, bytes - 3, values, count) == ERR_OK)
        must_round_trip(values, count);
    return 0;
}
