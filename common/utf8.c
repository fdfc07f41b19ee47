#include "common/utf8.h"

#include <stdbool.h>
#include <string.h>

static int is_tail(unsigned char c)
{
    return (c & 0xC0) == 0x80;
}

size_t utf8_length(const char *at, const char *end)
{
    const unsigned char *p = (const unsigned char *)at;
    size_t left = (size_t)(end - at);
    if (left >= 1 && p[0] < 0x80)
        return 1;
    if (left >= 2 && p[0] >= 0xC2 && p[0] <= 0xDF)
        return is_tail(p[1]) ? 2 : 0;
    if (left >= 3 && (p[0] & 0xF0) == 0xE0) {
        int overlong = p[0] == 0xE0 && p[1] < 0xA0;
        int surrogate = p[0] == 0xED && p[1] > 0x9F;
        return is_tail(p[1]) && is_tail(p[2]) && !overlong && !surrogate ? 3 : 0;
    }
    if (left >= 4 && p[0] >= 0xF0 && p[0] <= 0xF4) {
        int overlong = p[0] == 0xF0 && p[1] < 0x90;
        int beyond = p[0] == 0xF4 && p[1] > 0x8F;
        return is_tail(p[1]) && is_tail(p[2]) && is_tail(p[3]) && !overlong && !beyond ? 4 : 0;
    }
    return 0;
}

void utf8_copy(char *out, size_t bytes, const char *text)
{
    const char *end = text + strlen(text);
    size_t used = 0;
    while (text < end) {
        size_t length = utf8_length(text, end), taken = length ? length : 1;
        if (used + taken >= bytes)
            break;
        memcpy(out + used, length ? text : "?", taken);
        used += taken;
        text += taken;
    }
    out[used] = '\0';
}

static uint32_t decode(const char *at, size_t length)
{
    static const unsigned char masks[5] = {0, 0x7F, 0x1F, 0x0F, 0x07};
    uint32_t code = (unsigned char)at[0] & masks[length];
    for (size_t i = 1; i < length; i++)
        code = code << 6 | ((unsigned char)at[i] & 0x3F);
    return code;
}

/* By Unicode's categories Cc, Zl, Zp and the format characters that reorder or show nothing. */
static int is_unseen(uint32_t code)
{
    return code < 0x20 || (code >= 0x7F && code <= 0x9F) || code == 0x61C || code == 0x200B ||
           code == 0x200E || code == 0x200F || (code >= 0x2028 && code <= 0x202E) ||
           (code >= 0x2060 && code <= 0x206F) || code == 0xFEFF || code >= 0xE0000;
}

void utf8_mask(char *text)
{
    const char *from = text, *end = text + strlen(text);
    char *to = text;
    while (from < end) {
        size_t length = utf8_length(from, end);
        bool shown = length > 0 && !is_unseen(decode(from, length));
        size_t taken = length ? length : 1;
        if (shown)
            memmove(to, from, taken);
        else
            *to = '?';
        to += shown ? taken : 1;
        from += taken;
    }
    *to = '\0';
}

size_t utf8_encode(uint32_t code, char out[4])
{
    if (code < 0x80) {
        out[0] = (char)code;
        return 1;
    }
    size_t bytes = code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
    static const unsigned char marks[5] = {0, 0, 0xC0, 0xE0, 0xF0};
    for (size_t i = bytes - 1; i > 0; i--) {
        out[i] = (char)(0x80 | (code & 0x3F));
        code >>= 6;
    }
    out[0] = (char)(marks[bytes] | code);
    return bytes;
}
