/* master/shots.h: jobs that are the frames of one shot.
 *
 * A frame is a job like any other, with its own scene, film and report; it also bears its number
 * and its shot, which is the id of the job that was made first. So what happens to one frame (a
 * loss, a retry, a restart) is what happens to a job. What is added here: only
 * SHOT_FRAMES_AT_ONCE of a shot are with the scheduler, in the order in which they were made,
 * so that first frames are finished first and workers hold few scenes. Two, so that the end of
 * one frame does not wait for the beginning of the next.
 *
 * Loop thread. Tests: tests/e2e/test_e2e_frames.py.
 */
#ifndef MASTER_SHOTS_H
#define MASTER_SHOTS_H

#include "master/farm.h"

enum { SHOT_FRAMES_AT_ONCE = 2 };

/* True if `id` names a job that frames can be added to: the first frame of a shot. */
bool shots_begins(const struct farm *f, uint64_t id);

/* True for a job of no shot, and for a frame whose turn with the scheduler has come. */
bool shots_may_enter(const struct farm *f, const struct job *job);

/* Frames of the shot by their state; all zero for none. */
void shots_count(const struct farm *f, uint64_t shot, uint64_t counts[JOB_STATE_COUNT]);

#endif
