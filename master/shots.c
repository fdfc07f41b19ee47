#include "master/shots.h"

#include <string.h>

bool shots_begins(const struct farm *f, uint64_t id)
{
    const struct job *job = farm_job(f, id);
    return job && job->rec.shot == id;
}

/* Index of the first job that can be a frame of the shot: frames are made after their first. */
static size_t begin_of(const struct farm *f, uint64_t shot)
{
    size_t low = 0, high = f->job_count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        if (f->jobs[middle]->rec.id < shot)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

bool shots_may_enter(const struct farm *f, const struct job *job)
{
    if (job->rec.shot == 0)
        return true;
    uint32_t at_once = 0;
    for (size_t i = begin_of(f, job->rec.shot); i < f->job_count; i++) {
        const struct job *other = f->jobs[i];
        if (other->rec.shot != job->rec.shot || other == job)
            continue;
        /* One that has been rendered and is being put together counts no more. */
        if (other->in_sched && ++at_once >= SHOT_FRAMES_AT_ONCE)
            return false;
    }
    return true;
}

void shots_count(const struct farm *f, uint64_t shot, uint64_t counts[JOB_STATE_COUNT])
{
    memset(counts, 0, JOB_STATE_COUNT * sizeof *counts);
    for (size_t i = begin_of(f, shot); shot && i < f->job_count; i++)
        if (f->jobs[i]->rec.shot == shot)
            counts[f->jobs[i]->rec.state]++;
}
