/* The event stream: any bytes in any pieces give the same events as all at once. First byte: how
 * the rest is cut. */
#include <stdlib.h>
#include <string.h>

#include "client/sse.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

/* Enough of a stream's events to tell two apart. */
struct account {
    uint64_t events, sum;
    char last_id[SSE_ID_BYTES];
};

static void add(struct account *a, const char *data, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        a->sum = (a->sum ^ (unsigned char)data[i]) * UINT64_C(0x100000001b3);
}

static void on_event(void *ctx, const char *name, const char *data, size_t bytes)
{
    struct account *a = ctx;
    if (data[bytes] != '\0' || strlen(name) >= SSE_NAME_BYTES)
        abort();
    a->events++;
    add(a, name, strlen(name) + 1);
    add(a, data, bytes);
}

static struct account read_stream(const char *data, size_t bytes, size_t piece_max)
{
    struct account a = {.events = 0};
    struct sse s;
    sse_init(&s, on_event, &a);
    for (size_t at = 0; at < bytes;) {
        size_t piece = bytes - at < piece_max ? bytes - at : piece_max;
        sse_feed(&s, data + at, piece);
        at += piece;
    }
    memcpy(a.last_id, s.last_id, sizeof a.last_id);
    sse_release(&s);
    return a;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes == 0)
        return 0;
    const char *text = (const char *)data + 1;
    struct account whole = read_stream(text, bytes - 1, bytes);
    struct account cut = read_stream(text, bytes - 1, 1 + data[0] % 7);
    if (whole.events != cut.events || whole.sum != cut.sum ||
        strcmp(whole.last_id, cut.last_id) != 0)
        abort();
    return 0;
}
