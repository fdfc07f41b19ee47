/* What people are told of a job: its share, rate, note and events. See farm.h. */
#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/json_put.h"
#include "common/log.h"
#include "common/utf8.h"
#include "master/shots.h"

enum { NEWS_MS = 500 /* between two events of the same job that are not urgent */ };

double jobs_done_share(const struct farm *f, const struct job *job)
{
    struct sched_job_info info;
    if (job->rec.state == JOB_STATE_DONE)
        return 1;
    if (job->plan && !job_state_ended(job->rec.state))
        return job_plan_share(job);
    if (job->in_sched && sched_job_info(f->sched, job->rec.id, &info))
        return info.done;
    return job->done_share;
}

void jobs_left(const struct job *job, struct sched_job_info *info)
{
    double seconds;
    if (!job_plan_left(job, &seconds))
        return;
    info->left_known = true;
    info->left_low_s = info->left_high_s = seconds;
}

/* Jobs ahead of this one in the queue. */
static size_t jobs_before(const struct farm *f, const struct job *job)
{
    size_t count = 0;
    for (size_t i = 0; i < f->job_count; i++) {
        const struct job *other = f->jobs[i];
        if (other != job && !job_state_ended(other->rec.state) &&
            other->rec.state != JOB_STATE_PAUSED &&
            (other->rec.priority > job->rec.priority ||
             (other->rec.priority == job->rec.priority && other->rec.id < job->rec.id)))
            count++;
    }
    return count;
}

const char *jobs_note(const struct farm *f, const struct job *job)
{
    static char text[32 + TAG_LIST_BYTES]; /* the loop thread's alone */
    char tags[TAG_LIST_BYTES];
    size_t before;
    struct sched_job_info info;
    if (job->rec.note[0] || job_state_ended(job->rec.state))
        return job->rec.note;
    if (!job->in_sched && !shots_may_enter(f, job))
        return "waits for frames before it";
    if (!job->in_sched || !sched_job_info(f->sched, job->rec.id, &info))
        info.wait = SCHED_WAIT_BEHIND;
    switch (info.wait) {
    case SCHED_WAIT_WORKER:
        if (job->spec.tags.count == 0)
            return "no worker";
        tags_list(&job->spec.tags, tags);
        (void)snprintf(text, sizeof text, "no worker has the tags %s", tags);
        return text;
    case SCHED_WAIT_SECOND_WORKER:
        return "a check waits for a second worker";
    case SCHED_WAIT_THIRD_WORKER:
        return "two workers differ; waits for a third";
    case SCHED_WAIT_BEHIND:
        if (job->rec.state != JOB_STATE_QUEUED)
            return "";
        before = jobs_before(f, job);
        (void)snprintf(text, sizeof text, "behind %zu job%s", before, before == 1 ? "" : "s");
        return text;
    case SCHED_WAIT_NOTHING:
        break;
    }
    return "";
}

double jobs_rays_s(const struct farm *f, const struct job *job)
{
    return rate_per_s(&job->rate, farm_now_ms(f));
}

/* Nobody works at it: the rate begins anew with the next lease. */
static void rest_rate(struct farm *f, struct job *job)
{
    struct sched_job_info info = {0};
    if (!job->in_sched || !sched_job_info(f->sched, job->rec.id, &info) || info.workers == 0)
        rate_end(&job->rate);
}

static void put_news(struct farm *f, struct job *job)
{
    struct sched_job_info info = {0};
    bool known = job->in_sched && sched_job_info(f->sched, job->rec.id, &info);
    jobs_left(job, &info);
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"id\":\"j%" PRIu64 "\",\"rev\":%" PRIu64 ",\"state\":\"%s\",\"done\":",
               job->rec.id, job->rev, job_state_names[job->rec.state]);
    json_put_number(&b, jobs_done_share(f, job));
    buf_printf(&b, ",\"left_s\":");
    if (known && info.left_known && !job_state_ended(job->rec.state))
        buf_printf(&b, "[%.3f,%.3f]", info.left_low_s, info.left_high_s);
    else
        buf_printf(&b, "null");
    buf_printf(&b, ",\"relmse\":");
    if (job->rec.stats.error_known)
        json_put_number(&b, job->rec.stats.relmse);
    else
        buf_printf(&b, "null");
    buf_printf(&b, ",\"workers\":%" PRIu32 ",\"rays_s\":%.0f,\"note\":", known ? info.workers : 0,
               jobs_rays_s(f, job));
    json_put_text(&b, jobs_note(f, job));
    buf_put_u8(&b, '}');
    buf_put_u8(&b, '\0');
    if (buf_status(&b) == ERR_OK)
        events_add(f->events, job->rec.id, "job", (const char *)b.data);
    buf_release(&b);
    job->news_at_ms = farm_now_ms(f);
    job->news_due = false;
}

void jobs_changed(struct farm *f, struct job *job, bool urgent)
{
    job->rev++;
    if (urgent || farm_now_ms(f) - job->news_at_ms >= NEWS_MS)
        put_news(f, job);
    else
        job->news_due = true;
}

void jobs_log(struct farm *f, struct job *job, const char *format, ...)
{
    char whole[512], text[sizeof job->events[0].text];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(whole, sizeof whole, format, args);
    va_end(args);
    utf8_copy(text, sizeof text, whole);
    int64_t at_us = farm_wall_us();
    struct job_event *event = &job->events[job->event_count++ % FARM_EVENTS_SHOWN];
    event->at_us = at_us;
    memcpy(event->text, text, sizeof text);
    if (store_put_event(f->store, job->rec.id, at_us, text) != ERR_OK)
        log_warn("jobs", "event not stored job=j%" PRIu64, job->rec.id);
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"job\":\"j%" PRIu64 "\",\"line\":", job->rec.id);
    json_put_text(&b, text);
    buf_put_u8(&b, '}');
    buf_put_u8(&b, '\0');
    if (buf_status(&b) == ERR_OK)
        events_add(f->events, job->rec.id, "log", (const char *)b.data);
    buf_release(&b);
}

void job_news_tick(struct farm *f, struct job *job)
{
    if (job->news_due && farm_now_ms(f) - job->news_at_ms >= NEWS_MS)
        put_news(f, job);
    if (job->rate.running)
        rest_rate(f, job);
}
