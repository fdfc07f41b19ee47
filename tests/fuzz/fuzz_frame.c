/* The frame decoder: any bytes in any pieces give the same frames as all at once, and never more
 * memory than came. First byte: who sends and how the rest is cut. */
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "proto/message.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

/* What a decoder says about a stream: enough to tell two apart. */
struct account {
    enum err error;
    uint64_t frames, sum;
};

static void add(struct account *a, const unsigned char *data, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        a->sum = (a->sum ^ data[i]) * UINT64_C(0x100000001b3);
}

static struct account read_stream(const uint8_t *data, size_t bytes, int side, size_t piece_max)
{
    struct account a = {.error = ERR_OK};
    struct frame_rules rules = {.peer_side = side};
    struct frame_decoder d;
    frame_decoder_init(&d, &rules);
    for (size_t at = 0; at < bytes && a.error == ERR_OK;) {
        size_t piece = bytes - at < piece_max ? bytes - at : piece_max, used;
        bool ready;
        struct frame f;
        a.error = frame_decoder_feed(&d, data + at, piece, &used, &ready, &f);
        if (used > piece || (used == 0 && a.error == ERR_OK) ||
            frame_decoder_held_bytes(&d) > 2 * bytes + 8192)
            abort();
        at += used;
        if (!ready)
            continue;
        a.frames++;
        add(&a, (const unsigned char *)&f.header, sizeof f.header);
        add(&a, f.meta, f.header.meta_bytes);
        add(&a, f.body, f.header.body_bytes);
        struct message m;
        enum err ignored = message_decode(f.header.type, f.meta, f.header.meta_bytes, &m);
        (void)ignored;
    }
    frame_decoder_release(&d);
    return a;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes < 1)
        return 0;
    int side = 1 + data[0] % 3;
    struct account whole = read_stream(data + 1, bytes - 1, side, SIZE_MAX);
    struct account cut = read_stream(data + 1, bytes - 1, side, 1 + data[0] / 3u);
    if (whole.error != cut.error || whole.frames != cut.frames || whole.sum != cut.sum)
        abort();
    return 0;
}
