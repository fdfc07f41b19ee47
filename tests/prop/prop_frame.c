/* Random streams of frames, cut at random: the decoder gives back what was put in, in order; and
 * random bytes never give it more than they hold. Prints its seed when it fails.
 *
 *   prop_frame [SEED [ROUNDS]]
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "proto/frame.h"

enum { FRAMES = 12, STREAM_BYTES = FRAMES * (FRAME_HEADER_BYTES + 400 + 3000) };

static uint64_t state, seed;

static uint32_t below(uint32_t n)
{
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (uint32_t)(state >> 33) % n;
}

static void must(bool ok, const char *what)
{
    if (!ok) {
        (void)fprintf(stderr, "prop_frame: %s; seed %llu\n", what, (unsigned long long)seed);
        exit(1);
    }
}

static struct frame_header random_header(void)
{
    struct frame_header h = {.meta_bytes = below(3) ? below(400) : 0};
    do
        h.type = (enum frame_type)(1 + below(18));
    while (frame_type_side((int)h.type) == 0);
    if (frame_type_body_max((int)h.type) > 0)
        h.body_bytes = below(3000);
    return h;
}

static void well_formed(void)
{
    static unsigned char stream[STREAM_BYTES];
    struct frame_header headers[FRAMES];
    size_t starts[FRAMES], bytes = 0, at = 0;
    for (int i = 0; i < FRAMES; i++) {
        headers[i] = random_header();
        frame_header_encode(&headers[i], stream + bytes);
        starts[i] = bytes += FRAME_HEADER_BYTES;
        for (uint32_t k = headers[i].meta_bytes + headers[i].body_bytes; k > 0; k--)
            stream[bytes++] = (unsigned char)below(256);
    }
    struct frame_decoder d;
    struct frame_rules rules = {.peer_side = FRAME_SIDE_BOTH};
    frame_decoder_init(&d, &rules);
    int known = 0;
    while (at < bytes) {
        uint32_t step = 1 + below(below(2) ? 20 : 4000);
        size_t piece = step < bytes - at ? step : bytes - at, used;
        bool ready;
        struct frame f;
        must(frame_decoder_feed(&d, stream + at, piece, &used, &ready, &f) == ERR_OK, "an error");
        must(used > 0 && used <= piece, "took no bytes, or too many");
        at += used;
        if (!ready)
            continue;
        const struct frame_header *h = &headers[known];
        must(memcmp(h, &f.header, sizeof *h) == 0, "another header");
        must(memcmp(f.meta, stream + starts[known], h->meta_bytes) == 0, "another meta");
        must(h->body_bytes == 0 ||
                 memcmp(f.body, stream + starts[known] + h->meta_bytes, h->body_bytes) == 0,
             "another body");
        known++;
    }
    must(known == FRAMES && frame_decoder_idle(&d), "lost frames");
    frame_decoder_release(&d);
}

static void malformed(void)
{
    unsigned char bytes[600];
    size_t at = 0;
    for (size_t i = 0; i < sizeof bytes; i++)
        bytes[i] = (unsigned char)below(256);
    struct frame_header h = random_header();
    frame_header_encode(&h, bytes);
    if (below(2))
        bytes[below(FRAME_HEADER_BYTES)] = (unsigned char)below(256);
    struct frame_decoder d;
    struct frame_rules rules = {.peer_side = FRAME_SIDE_BOTH};
    frame_decoder_init(&d, &rules);
    enum err e = ERR_OK;
    while (at < sizeof bytes && e == ERR_OK) {
        size_t used;
        bool ready;
        struct frame f;
        e = frame_decoder_feed(&d, bytes + at, sizeof bytes - at, &used, &ready, &f);
        at += used;
        must(frame_decoder_held_bytes(&d) <= 2 * 4096, "holds more than came");
    }
    frame_decoder_release(&d);
}

int main(int argc, char **argv)
{
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : 1;
    uint64_t rounds = argc > 2 ? strtoull(argv[2], NULL, 10) : 3000;
    for (seed = first; seed < first + rounds; seed++) {
        state = seed * UINT64_C(0x9e3779b97f4a7c15);
        well_formed();
        malformed();
    }
    return 0;
}
