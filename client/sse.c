#include "client/sse.h"

#include <stdio.h>
#include <string.h>

void sse_init(struct sse *s, sse_event *on_event, void *ctx)
{
    *s = (struct sse){.on_event = on_event, .ctx = ctx};
}

void sse_release(struct sse *s)
{
    buf_release(&s->line);
    buf_release(&s->data);
}

void sse_restart(struct sse *s)
{
    buf_clear(&s->line);
    buf_clear(&s->data);
    s->name[0] = '\0';
    s->after_cr = s->too_long = false;
    memcpy(s->id, s->last_id, sizeof s->id);
}

static void end_event(struct sse *s)
{
    memcpy(s->last_id, s->id, sizeof s->last_id);
    if (s->data.bytes > 0 && !s->too_long) {
        s->data.bytes--; /* the newline after the last data line */
        s->data.data[s->data.bytes] = '\0';
        if (!s->data.failed)
            s->on_event(s->ctx, s->name[0] ? s->name : "message", (const char *)s->data.data,
                        s->data.bytes);
    }
    buf_clear(&s->data);
    s->name[0] = '\0';
    s->too_long = false;
}

static void take_field(struct sse *s, const char *line, size_t bytes)
{
    const char *colon = memchr(line, ':', bytes);
    size_t field_bytes = colon ? (size_t)(colon - line) : bytes;
    const char *value = colon ? colon + 1 : line + bytes;
    if (value < line + bytes && *value == ' ')
        value++;
    size_t value_bytes = (size_t)(line + bytes - value);
    if (field_bytes == 4 && memcmp(line, "data", 4) == 0) {
        if (s->data.bytes + value_bytes > SSE_BYTES_MAX) {
            s->too_long = true;
            return;
        }
        buf_put(&s->data, value, value_bytes);
        buf_put_u8(&s->data, '\n');
    } else if (field_bytes == 5 && memcmp(line, "event", 5) == 0) {
        (void)snprintf(s->name, sizeof s->name, "%.*s", (int)value_bytes, value);
    } else if (field_bytes == 2 && memcmp(line, "id", 2) == 0 && value_bytes < SSE_ID_BYTES &&
               !memchr(value, 0, value_bytes)) {
        (void)snprintf(s->id, sizeof s->id, "%.*s", (int)value_bytes, value);
    }
}

static void end_line(struct sse *s)
{
    if (s->line.bytes == 0)
        end_event(s);
    else if (!s->line.failed && s->line.data[0] != ':')
        take_field(s, (const char *)s->line.data, s->line.bytes);
    buf_clear(&s->line);
}

void sse_feed(struct sse *s, const char *bytes, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        bool second_of_crlf = s->after_cr && bytes[i] == '\n';
        s->after_cr = bytes[i] == '\r';
        if (second_of_crlf)
            continue;
        if (bytes[i] == '\n' || bytes[i] == '\r')
            end_line(s);
        else if (s->line.bytes <= SSE_BYTES_MAX)
            buf_put_u8(&s->line, (uint8_t)bytes[i]);
    }
}
