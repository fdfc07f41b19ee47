#include "client/report_text.h"

#include <math.h>
#include <string.h>

#include "client/human.h"

static double number(const struct json *object, const char *key)
{
    return reply_number(object, key, (double)NAN);
}

static const struct json *part(const struct json *report, const char *key)
{
    const struct json *v = json_get_member(report, key);
    return v && v->type == JSON_OBJECT ? v : NULL;
}

static void put_spp(const struct json *r, struct buf *out)
{
    double low = number(r, "spp_min"), high = number(r, "spp_max"), mean = number(r, "spp_mean");
    if (isnan(low) || isnan(high))
        return;
    if (low == high)
        buf_printf(out, ", %.0f spp", low);
    else
        buf_printf(out, ", %.0f to %.0f spp (mean %.0f)", low, high, isnan(mean) ? low : mean);
}

/* A crop's file has the size of the crop: that is said, and of what it is a part. */
static void put_size(const struct json *r, struct buf *out)
{
    double width = reply_number(r, "width", 0), height = reply_number(r, "height", 0);
    const struct json *spec = part(r, "spec");
    const struct json *crop = spec ? json_get_member(spec, "crop") : NULL;
    if (crop && crop->type == JSON_ARRAY && crop->count == 4) {
        const struct json *w = crop->first->next->next;
        if (w->number != width || w->next->number != height) {
            buf_printf(out, "%.0fx%.0f of %.0fx%.0f", w->number, w->next->number, width, height);
            return;
        }
    }
    buf_printf(out, "%.0fx%.0f", width, height);
}

static void put_head(const struct json *r, const char *title, struct buf *out)
{
    char text[HUMAN_BYTES];
    const char *state = reply_text(r, "state", "");
    double total = number(part(r, "seconds"), "total");
    buf_printf(out, "%s  ", cli_safe(title));
    put_size(r, out);
    put_spp(r, out);
    buf_printf(out, ", %s", cli_safe(state));
    if (!isnan(total)) {
        human_duration(total, text);
        buf_printf(out, "%s %s", strcmp(state, "done") == 0 ? " in" : " after", text);
    }
    buf_printf(out, "\n");
}

static void put_error(const struct json *error, struct buf *out)
{
    char mid[HUMAN_BYTES], low[HUMAN_BYTES], high[HUMAN_BYTES];
    double relmse = number(error, "relmse");
    if (isnan(relmse))
        return;
    human_error(relmse, mid);
    human_error(number(error, "relmse_low"), low);
    human_error(number(error, "relmse_high"), high);
    buf_printf(out, "  error    relMSE %s", mid);
    if (strcmp(low, "-") != 0 && strcmp(high, "-") != 0)
        buf_printf(out, " (95 %%: %s to %s)", low, high);
    buf_printf(out, "\n");
    const struct json *heavy = json_get_member(error, "heavy_tail");
    if (heavy && heavy->type == JSON_BOOL && heavy->truth)
        buf_printf(out,
                   "           heavy tail: not to be trusted (effective size %.0f, under 32)\n",
                   floor(number(error, "effective_size")));
}

/* What ended a job that was not asked for a number of samples. */
static void put_end(const struct json *r, struct buf *out)
{
    const char *end = reply_text(r, "stopped_by", "spp");
    const struct json *spec = part(r, "spec");
    if (strcmp(end, "max-spp") == 0)
        buf_printf(out, "  stopped  by --max-spp %.0f\n", number(spec, "spp"));
    else if (strcmp(end, "error") == 0)
        buf_printf(out, "  stopped  the error is under %g\n", number(spec, "target_error"));
    else if (strcmp(end, "time") == 0)
        buf_printf(out, "  stopped  by --time-limit %g\n", number(spec, "time_limit"));
}

static void put_time(const struct json *r, struct buf *out)
{
    static const char *const keys[] = {"load", "build", "render", "gather"};
    const struct json *seconds = part(r, "seconds");
    double core = number(r, "core_seconds");
    bool first = true;
    struct buf line;
    buf_init(&line);
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) {
        double v = number(seconds, keys[i]);
        if (isnan(v))
            continue;
        buf_printf(&line, "%s%s %.*f", first ? "" : ", ", keys[i], v < 0.95 ? 2 : 1, v);
        first = false;
    }
    if (!first)
        buf_printf(&line, " s");
    if (!isnan(core) && !(first && core == 0))
        buf_printf(&line, core < 120 ? "%s%.1f core-s" : "%s%.1f core-min", first ? "" : "; ",
                   core < 120 ? core : core / 60);
    if (line.bytes > 0 && buf_status(&line) == ERR_OK)
        buf_printf(out, "  time     %.*s\n", (int)line.bytes, (const char *)line.data);
    buf_release(&line);
}

static void put_farm(const struct json *r, struct buf *out)
{
    const struct json *units = part(r, "units");
    double workers = number(r, "workers"), lost = number(r, "workers_lost");
    if (isnan(workers) && !units)
        return;
    /* Those that gave results; before the first one, those that are at it. */
    if (!(workers > 0))
        workers = reply_number(r, "workers_now", 0);
    if (workers > 0)
        buf_printf(out, "  farm     %.0f worker%s", workers, workers == 1 ? "" : "s");
    else
        buf_printf(out, "  farm     no worker yet");
    if (lost > 0)
        buf_printf(out, ", %.0f lost", lost);
    double total = units ? reply_number(units, "total", 0) : 0;
    if (units)
        buf_printf(out, "; %.0f unit%s, %.0f retried, %.0f rejected", total, total == 1 ? "" : "s",
                   reply_number(units, "retried", 0), reply_number(units, "rejected", 0));
    if (units && reply_number(units, "verified", 0) > 0)
        buf_printf(out, ", %.0f verified", reply_number(units, "verified", 0));
    buf_printf(out, "\n");
}

static void put_notes(const struct json *r, struct buf *out)
{
    double bad = reply_number(r, "nonfinite_samples", 0);
    const struct json *first = part(r, "nonfinite_first");
    const char *note = reply_text(r, "note", "");
    if (bad > 0) {
        buf_printf(out, "  note     %.0f non-finite sample%s counted as black", bad,
                   bad == 1 ? "" : "s");
        if (first)
            buf_printf(out, "; first: pixel %.0f,%.0f sample %.0f", reply_number(first, "x", 0),
                       reply_number(first, "y", 0), reply_number(first, "sample", 0));
        buf_printf(out, "\n");
    }
    if (note[0])
        buf_printf(out, "  note     %s\n", cli_safe(note));
}

void report_text(const struct json *report, const char *title, struct buf *out)
{
    const char *hash = reply_text(report, "image_sha256", NULL);
    put_head(report, title, out);
    put_error(part(report, "error"), out);
    put_end(report, out);
    put_time(report, out);
    put_farm(report, out);
    if (hash)
        buf_printf(out, "  sha256   %s\n", cli_safe(hash));
    put_notes(report, out);
}
