/* client/cmd_frames.h: submit --frames: one job a frame, tied together as a shot.
 *
 * Every frame's scene is read and checked before the first job is made, so that a mistake in
 * the last one leaves no half of a shot behind; each is read again when it is its turn to
 * be sent, so that memory holds one at a time. Chunks that frames share are sent once.
 * One thread. Tests: tests/e2e/test_e2e_frames.py.
 */
#ifndef CLIENT_CMD_FRAMES_H
#define CLIENT_CMD_FRAMES_H

#include "client/cli.h"

/* The command line has --frames. The exit status. */
int cmd_frames_submit(struct cli *cli);

#endif
