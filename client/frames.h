/* client/frames.h: frame numbers and the names of numbered files.
 *
 * A run of '#' in a path stands for a frame's number, padded with zeros to the run's length:
 * "shot.####.json" is "shot.0007.json" for frame 7 (and "shot.12345.json" for 12345). The last
 * run counts. Pure; any thread. Tests: tests/unit/test_cli_frames.c.
 */
#ifndef CLIENT_FRAMES_H
#define CLIENT_FRAMES_H

#include "common/err.h"

enum { FRAMES_MAX = 100000 /* of one shot */ };

struct frames {
    uint32_t first, last; /* first <= last */
};

/* "A-B" or "A", at most FRAMES_MAX of them. */
TL_NODISCARD bool frames_parse(const char *text, struct frames *out);

/* True if the path has a place for a number. */
bool frames_marked(const char *path);

/* The path of one frame; a path without a mark as it is. False: longer than `bytes` allows. */
TL_NODISCARD bool frames_path(const char *path, uint32_t frame, char *out, size_t bytes);

#endif
