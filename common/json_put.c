#include "common/json_put.h"

#include <math.h>
#include <string.h>

#include "common/number.h"
#include "common/utf8.h"

void json_put_text(struct buf *b, const char *text)
{
    if (!text) {
        buf_put(b, "null", 4);
        return;
    }
    buf_put_u8(b, '"');
    const char *end = text + strlen(text);
    while (text < end) {
        size_t bytes = utf8_length(text, end);
        unsigned char c = (unsigned char)*text;
        if (bytes == 0) {
            buf_put(b, "\xEF\xBF\xBD", 3);
            text++;
            continue;
        }
        if (c == '"' || c == '\\')
            buf_printf(b, "\\%c", c);
        else if (c < 0x20 || c == 0x7f)
            buf_printf(b, "\\u%04x", c);
        else
            buf_put(b, text, bytes);
        text += bytes;
    }
    buf_put_u8(b, '"');
}

void json_put_number(struct buf *b, double v)
{
    char text[NUMBER_TEXT_BYTES] = "null";
    if (isfinite(v))
        number_format(v, text);
    buf_put(b, text, strlen(text));
}
