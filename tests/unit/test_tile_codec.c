/* The tile codec: exact for any bits, and unmoved by hostile ones. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <string.h>
#include <zstd.h>

#include "common/mem.h"
#include "proto/tile_codec.h"

enum { VALUES = 3 * 256 };

static void fill_bits(float *values, size_t count, uint32_t (*bits)(size_t i))
{
    for (size_t i = 0; i < count; i++) {
        uint32_t b = bits(i);
        memcpy(values + i, &b, sizeof b);
    }
}

static uint32_t special_bits(size_t i)
{
    static const uint32_t special[] = {0x00000000, 0x80000000, 0x7f800000, 0xff800000, 0x7fc00000,
                                       0xffc00001, 0x7f800001, 0x7fbfffff, 0x00000001, 0x807fffff,
                                       0x7f7fffff, 0x3f800000, 0xffffffff, 0x00800000};
    return special[i % (sizeof special / sizeof *special)];
}

static uint32_t random_bits(size_t i)
{
    uint64_t x = (i + 1) * UINT64_C(0x9e3779b97f4a7c15);
    x ^= x >> 31;
    x *= UINT64_C(0xbf58476d1ce4e5b9);
    return (uint32_t)(x >> 32);
}

static uint32_t black(size_t i)
{
    (void)i;
    return 0;
}

static void round_trip(size_t count, uint32_t (*bits)(size_t), size_t bytes_most)
{
    float *values = mem_alloc_array(count, sizeof *values),
          *back = mem_alloc_array(count, sizeof *back);
    assert_true(values && back);
    fill_bits(values, count, bits);
    unsigned char *encoded;
    size_t bytes;
    assert_int_equal(tile_codec_encode(values, count, &encoded, &bytes), ERR_OK);
    assert_true(bytes <= tile_codec_bound(count));
    assert_true(bytes <= bytes_most);
    memset(back, 0x55, count * sizeof *back);
    assert_int_equal(tile_codec_decode(encoded, bytes, back, count), ERR_OK);
    assert_memory_equal(back, values, count * sizeof *values);
    mem_free(encoded);
    mem_free(values);
    mem_free(back);
}

static void any_bits(void **state)
{
    (void)state;
    for (size_t count = 1; count < 40; count++) {
        round_trip(count, special_bits, SIZE_MAX);
        round_trip(count, random_bits, SIZE_MAX);
    }
    round_trip(VALUES, special_bits, SIZE_MAX);
    round_trip(VALUES, black, 64);
    round_trip(1 << 20, random_bits, SIZE_MAX); /* more than one window */
    round_trip(1 << 20, black, 4096);
}

static size_t encode_specials(unsigned char **out)
{
    float values[VALUES];
    size_t bytes;
    fill_bits(values, VALUES, special_bits);
    assert_int_equal(tile_codec_encode(values, VALUES, out, &bytes), ERR_OK);
    return bytes;
}

static void another_size_is_corrupt(void **state)
{
    (void)state;
    float values[VALUES + 3];
    unsigned char *encoded;
    size_t bytes = encode_specials(&encoded);
    assert_int_equal(tile_codec_decode(encoded, bytes, values, VALUES - 3), ERR_CORRUPT);
    assert_int_equal(tile_codec_decode(encoded, bytes, values, VALUES + 3), ERR_CORRUPT);
    for (size_t cut = 0; cut < bytes; cut++)
        assert_int_not_equal(tile_codec_decode(encoded, cut, values, VALUES), ERR_OK);
    mem_free(encoded);
}

/* The checksum sees each flipped bit that decoding does not, but for those in places where zstd
 * says the same in another way; then the values are the same too. */
static void every_flipped_bit(void **state)
{
    (void)state;
    float values[VALUES], back[VALUES];
    fill_bits(values, VALUES, special_bits);
    unsigned char *encoded;
    size_t bytes = encode_specials(&encoded);
    for (size_t bit = 0; bit < 8 * bytes; bit++) {
        encoded[bit / 8] ^= (unsigned char)(1u << bit % 8);
        if (tile_codec_decode(encoded, bytes, back, VALUES) == ERR_OK)
            assert_memory_equal(back, values, sizeof values);
        encoded[bit / 8] ^= (unsigned char)(1u << bit % 8);
    }
    mem_free(encoded);
}

static size_t compress_with(ZSTD_cParameter parameter, int value, const void *raw, size_t raw_bytes,
                            unsigned char *out, size_t capacity)
{
    ZSTD_CCtx *ctx = ZSTD_createCCtx();
    assert_non_null(ctx);
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_checksumFlag, 1);
    (void)ZSTD_CCtx_setParameter(ctx, parameter, value);
    size_t n = ZSTD_compress2(ctx, out, capacity, raw, raw_bytes);
    assert_false(ZSTD_isError(n));
    ZSTD_freeCCtx(ctx);
    return n;
}

static void frames_outside_the_rules(void **state)
{
    (void)state;
    static float raw[1 << 19], values[1 << 19]; /* 2 MiB */
    static unsigned char out[3 << 20];
    fill_bits(raw, 1 << 19, random_bits);
    size_t n = compress_with(ZSTD_c_windowLog, 21, raw, sizeof raw, out, sizeof out);
    assert_int_equal(tile_codec_decode(out, n, values, 1 << 19), ERR_LIMIT);
    n = compress_with(ZSTD_c_windowLog, 20, raw, sizeof raw, out, sizeof out);
    assert_int_equal(tile_codec_decode(out, n, values, 1 << 19), ERR_OK);
    n = compress_with(ZSTD_c_checksumFlag, 0, raw, 4096, out, sizeof out);
    assert_int_equal(tile_codec_decode(out, n, values, 1024), ERR_CORRUPT);
    n = compress_with(ZSTD_c_contentSizeFlag, 0, raw, 4096, out, sizeof out);
    assert_int_equal(tile_codec_decode(out, n, values, 1024), ERR_CORRUPT);

    /* Two frames, and one with bytes after it. */
    n = compress_with(ZSTD_c_compressionLevel, 1, raw, 2048, out, sizeof out);
    memcpy(out + n, out, n);
    assert_int_equal(tile_codec_decode(out, 2 * n, values, 512), ERR_CORRUPT);
    assert_int_equal(tile_codec_decode(out, 2 * n, values, 1024), ERR_CORRUPT);
    assert_int_equal(tile_codec_decode(out, n + 1, values, 512), ERR_CORRUPT);
    assert_int_equal(tile_codec_decode("", 0, values, 1), ERR_CORRUPT);
}

static void out_of_memory(void **state)
{
    (void)state;
    float values[VALUES] = {0};
    unsigned char *encoded = NULL;
    size_t bytes = 0;
    for (uint64_t n = 0; n < 2; n++) {
        mem_fail_after(n);
        assert_int_equal(tile_codec_encode(values, VALUES, &encoded, &bytes), ERR_NOMEM);
    }
    mem_fail_after(2); /* only giving back memory fails: no reason to lose the result */
    assert_int_equal(tile_codec_encode(values, VALUES, &encoded, &bytes), ERR_OK);
    mem_fail_after(0);
    assert_int_equal(tile_codec_decode(encoded, bytes, values, VALUES), ERR_NOMEM);
    mem_fail_after(UINT64_MAX);
    mem_free(encoded);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(any_bits),          cmocka_unit_test(another_size_is_corrupt),
        cmocka_unit_test(every_flipped_bit), cmocka_unit_test(frames_outside_the_rules),
        cmocka_unit_test(out_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
