/* client/shot.h: which jobs a command is about when its JOB may be a shot of many frames.
 *
 * The id of a shot is that of its first frame's job. A command on it is about every frame;
 * with --frame N about that one; on any other job about that job alone. One thread.
 */
#ifndef CLIENT_SHOT_H
#define CLIENT_SHOT_H

#include "client/farm_api.h"

struct shot_frame {
    char id[FARM_ID_BYTES], state[16];
    uint32_t number;
    double done; /* 0..1 */
};

struct shot {
    struct shot_frame *frames; /* owned; by the order in which they were made; at least one */
    size_t count;
    bool whole; /* JOB is a shot and all of its frames are meant */
};

/* Looks up JOB (the command line's first argument) and --frame. Has said what is wrong: 4 for an
 * unknown job or frame. */
TL_NODISCARD int shot_find(struct farm *f, const struct cli *cli, struct shot *out);
void shot_release(struct shot *s);

#endif
