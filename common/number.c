#include "common/number.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"

/* Up to this many digits fit a uint64; powers of ten up to the second are exact doubles. */
enum { DIGITS_EXACT = 19, TEN_POWER_EXACT = 22, COPY_BYTES = 128, EXPONENT_MAX = 100000 };

static const double tens[TEN_POWER_EXACT + 1] = {
    1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
};

static bool is_digit(const char *at, const char *end)
{
    return at < end && *at >= '0' && *at <= '9';
}

struct decimal {
    bool negative;
    uint64_t digits; /* the first DIGITS_EXACT significant ones */
    int digit_count; /* significant ones read, capped where `digits` is full */
    bool truncated;  /* more digits than `digits` holds */
    int exponent;    /* value = digits * 10^exponent, unless truncated */
};

static void add_digit(struct decimal *d, int digit, int exponent_step)
{
    if (d->digit_count < DIGITS_EXACT) {
        d->digits = d->digits * 10 + (uint64_t)digit;
        d->digit_count += d->digits != 0;
        if (d->exponent > -EXPONENT_MAX)
            d->exponent += exponent_step;
    } else {
        d->truncated = true;
    }
}

/* The exponent part, if it is complete; else stays where it is. */
static const char *scan_exponent(const char *at, const char *end, struct decimal *d)
{
    const char *e = at;
    if (e == end || (*e != 'e' && *e != 'E'))
        return at;
    e++;
    bool negative = e < end && *e == '-';
    if (e < end && (*e == '-' || *e == '+'))
        e++;
    if (!is_digit(e, end))
        return at;
    int value = 0;
    for (; is_digit(e, end); e++)
        if (value < EXPONENT_MAX)
            value = value * 10 + (*e - '0');
    d->exponent += negative ? -value : value;
    return e;
}

static const char *scan(const char *at, const char *end, struct decimal *d)
{
    if (at < end && (*at == '-' || *at == '+'))
        d->negative = *at++ == '-';
    const char *first = at;
    for (; is_digit(at, end); at++)
        add_digit(d, *at - '0', 0);
    size_t digit_count = (size_t)(at - first);
    if (at < end && *at == '.') {
        const char *point = at++;
        for (; is_digit(at, end); at++)
            add_digit(d, *at - '0', -1);
        digit_count += (size_t)(at - point - 1);
    }
    return digit_count ? scan_exponent(at, end, d) : NULL;
}

/* strtod on a copy that ends with NUL; the grammar was checked before. */
static double slow(const char *at, size_t bytes)
{
    char small[COPY_BYTES];
    char *copy = bytes < sizeof small ? small : mem_alloc(bytes + 1);
    if (!copy)
        return (double)__builtin_inf(); /* out of memory: refused like an overflow */
    memcpy(copy, at, bytes);
    copy[bytes] = '\0';
    double v = strtod(copy, NULL);
    if (copy != small)
        mem_free(copy);
    return v;
}

const char *number_parse(const char *at, const char *end, double *out)
{
    struct decimal d = {0};
    const char *after = scan(at, end, &d);
    if (!after)
        return NULL;
    /* Both factors are exact doubles: one rounding, so the result is the nearest (Clinger 1990). */
    bool exact = !d.truncated && d.digits <= (UINT64_C(1) << 53) &&
                 d.exponent >= -TEN_POWER_EXACT && d.exponent <= TEN_POWER_EXACT;
    if (!exact) {
        *out = slow(at, (size_t)(after - at));
        return after;
    }
    double v = (double)d.digits;
    v = d.exponent < 0 ? v / tens[-d.exponent] : v * tens[d.exponent];
    *out = d.negative ? -v : v;
    return after;
}

const char *number_parse_int(const char *at, const char *end, int64_t *out)
{
    bool negative = at < end && *at == '-';
    if (at < end && (*at == '-' || *at == '+'))
        at++;
    if (!is_digit(at, end))
        return NULL;
    int64_t v = 0;
    for (; is_digit(at, end); at++)
        if (__builtin_mul_overflow(v, 10, &v) || __builtin_sub_overflow(v, *at - '0', &v))
            return NULL;
    if (!negative && __builtin_sub_overflow(0, v, &v))
        return NULL;
    *out = v;
    return at;
}

void number_format(double v, char out[NUMBER_TEXT_BYTES])
{
    for (int digits = 15; digits <= 17; digits++) {
        (void)snprintf(out, NUMBER_TEXT_BYTES, "%.*g", digits, v);
        if (digits == 17 || strtod(out, NULL) == v)
            return;
    }
}
