#include "client/study_write.h"

#include <inttypes.h>
#include <math.h>

#include "client/human.h"
#include "common/json_put.h"

bool study_biased(const struct study_point *p)
{
    return p->parts.bias2 > 2 * p->parts.bias2_se;
}

void study_put_interval(struct stats_interval v, struct buf *out)
{
    char value[HUMAN_BYTES], low[HUMAN_BYTES], high[HUMAN_BYTES];
    human_error(v.value, value);
    human_error(v.low, low);
    human_error(v.high, high);
    buf_printf(out, "%s", value);
    if (isfinite(v.low) && isfinite(v.high))
        buf_printf(out, " (95 %%: %s to %s)", low, high);
}

/* --- CSV -------------------------------------------------------------------- */

/* Empty where there is no number. */
static void csv_number(struct buf *out, double v)
{
    buf_printf(out, ",");
    if (isfinite(v))
        json_put_number(out, v);
}

static void csv_interval(struct buf *out, struct stats_interval v)
{
    csv_number(out, v.value);
    csv_number(out, v.low);
    csv_number(out, v.high);
}

void study_put_csv(const struct study *s, struct buf *out)
{
    buf_printf(out, "knob,value,base,spp,spp_mean,repeats,core_seconds,core_seconds_low,"
                    "core_seconds_high,wall_seconds,relmse,relmse_low,relmse_high,variance,bias2,"
                    "bias2_se,gain,gain_low,gain_high,front,same_bits,file_bytes,rays,nonfinite,"
                    "clamped,image_sha256\n");
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->repeats == 0)
            continue;
        buf_printf(out, "%s,%s,%d,%" PRIu64, study_knob_words[p->knob], p->label, p->own, p->spp);
        csv_number(out, p->spp_mean);
        buf_printf(out, ",%" PRIu32, p->repeats);
        csv_interval(out, p->cost);
        csv_number(out, stats_median(p->wall_s, p->repeats));
        csv_interval(out, p->error);
        csv_number(out, p->parts.variance);
        csv_number(out, p->parts.bias2);
        csv_number(out, p->parts.bias2_se);
        csv_interval(out, study_gain(s, p));
        buf_printf(out, ",%d,%d,%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%" PRIu64 ",%s\n", p->front,
                   p->same_bits, p->file_bytes, p->rays, p->sums.nonfinite, p->clamped, p->sha256);
    }
}

/* --- JSON ------------------------------------------------------------------- */

static void put_number(struct buf *out, const char *key, double v)
{
    buf_printf(out, ",\"%s\":", key);
    json_put_number(out, v);
}

static void put_interval(struct buf *out, const char *key, struct stats_interval v)
{
    buf_printf(out, ",\"%s\":{\"value\":", key);
    json_put_number(out, v.value);
    put_number(out, "low", v.low);
    put_number(out, "high", v.high);
    buf_printf(out, "}");
}

static void put_settings(struct buf *out, const struct study_setting *settings, uint32_t count)
{
    buf_printf(out, ",\"options\":{");
    for (uint32_t i = 0; i < count; i++) {
        buf_printf(out, "%s\"%s\":", i ? "," : "", cli_options[settings[i].option].name);
        json_put_text(out, settings[i].text);
    }
    buf_printf(out, "}");
}

static const char *word(bool v)
{
    return v ? "true" : "false";
}

static void put_runs(struct buf *out, const struct study_point *p)
{
    buf_printf(out, ",\"runs\":[");
    for (uint32_t k = 0; k < p->repeats; k++) {
        buf_printf(out, "%s{\"core_seconds\":", k ? "," : "");
        json_put_number(out, p->core_s[k]);
        put_number(out, "wall_seconds", p->wall_s[k]);
        put_number(out, "relmse", p->relmse[k]);
        buf_printf(out, "}");
    }
    buf_printf(out, "]");
}

static void put_point(const struct study *s, const struct study_point *p, struct buf *out)
{
    buf_printf(out, "{\"knob\":\"%s\",\"value\":", study_knob_words[p->knob]);
    json_put_text(out, p->label);
    put_settings(out, p->settings, p->setting_count);
    buf_printf(out, ",\"base\":%s,\"spp\":%" PRIu64 ",\"repeats\":%" PRIu32, word(p->own), p->spp,
               p->repeats);
    put_number(out, "spp_mean", p->repeats ? p->spp_mean : (double)NAN);
    put_interval(out, "core_seconds", p->cost);
    put_interval(out, "relmse", p->error);
    put_number(out, "variance", p->parts.variance);
    put_number(out, "bias2", p->parts.bias2);
    put_number(out, "bias2_se", p->parts.bias2_se);
    put_interval(out, "gain", study_gain(s, p));
    buf_printf(out,
               ",\"front\":%s,\"same_bits\":%s,\"file_bytes\":%" PRIu64 ",\"rays\":%" PRIu64
               ",\"nonfinite\":%" PRIu64 ",\"clamped\":%" PRIu64 ",\"image_sha256\":",
               word(p->front), word(p->same_bits), p->file_bytes, p->rays, p->sums.nonfinite,
               p->clamped);
    json_put_text(out, p->sha256);
    put_runs(out, p);
    buf_printf(out, "}");
}

static void put_head(const struct study *s, struct buf *out)
{
    buf_printf(out, "{\"tilery_tradeoff\":1,\"scene\":");
    json_put_text(out, s->scene);
    buf_printf(out, ",\"width\":%u,\"height\":%u,\"scene_width\":%u,\"scene_height\":%u", s->width,
               s->height, s->scene_width, s->scene_height);
    buf_printf(out, ",\"reduced\":%s,\"interrupted\":%s", word(s->reduced), word(s->interrupted));
    put_number(out, "budget_seconds", s->budget_s);
    put_number(out, "spent_seconds", s->spent_s);
    buf_printf(out, ",\"renders\":%u,\"workers\":%u,\"threads\":%u,\"cost\":\"%s\"",
               s->render_count, s->workers, s->threads, s->own_farm ? "cpu" : "reported");
    buf_printf(out, ",\"setup_core_seconds\":{\"sah\":");
    json_put_number(out, s->setups[JOB_BUILDER_SAH].median_s);
    for (int i = JOB_BUILDER_SAH + 1; i < JOB_BUILDER_NONE; i++)
        put_number(out, job_builder_names[i], s->setups[i].median_s);
    buf_printf(out, "},\"base_spp\":%" PRIu64 ",\"reference\":{\"spp\":%" PRIu64, s->base_spp,
               2 * s->reference_spp);
    buf_printf(out, ",\"max_depth\":%u", s->reference_depth);
    put_number(out, "relmse", s->truth.relmse);
    buf_printf(out, "}");
}

static void put_preset(const struct study *s, enum study_level level, struct buf *out)
{
    const struct study_preset *p = &s->presets[level];
    buf_printf(out, "{\"name\":\"%s\",\"file\":\"%s.preset\"", study_level_names[level],
               study_level_names[level]);
    put_settings(out, p->settings, p->setting_count);
    buf_printf(out, ",\"half\":%s,\"measured\":%s", word(p->half), word(p->rendered_spp == p->spp));
    put_number(out, "target_relmse", p->target);
    put_number(out, "relmse", p->expected_relmse);
    put_number(out, "core_seconds", p->expected_core_s);
    put_number(out, "scene_core_seconds", p->scene_core_s);
    buf_printf(out, ",\"why\":");
    json_put_text(out, p->why);
    buf_printf(out, "}");
}

void study_put_json(const struct study *s, struct buf *out)
{
    put_head(s, out);
    buf_printf(out, ",\n\"points\":[");
    for (uint32_t i = 0; i < s->point_count; i++) {
        buf_printf(out, i ? ",\n " : "\n ");
        put_point(s, &s->points[i], out);
    }
    buf_printf(out, "],\n\"presets\":[");
    for (int i = 0; s->has_presets && i < STUDY_LEVELS; i++) {
        buf_printf(out, i ? ",\n " : "\n ");
        put_preset(s, (enum study_level)i, out);
    }
    buf_printf(out, "]}\n");
}

void study_preset_how(const struct study_preset *p, char *out, size_t bytes)
{
    if (p->rendered_spp == 0)
        (void)snprintf(out, bytes, "expected, not rendered");
    else if (p->rendered_spp == p->spp)
        (void)snprintf(out, bytes, "measured");
    else
        (void)snprintf(out, bytes, "expected, from a render of %" PRIu64 " spp", p->rendered_spp);
}

/* --- Presets ---------------------------------------------------------------- */

void study_put_preset(const struct study *s, enum study_level level, struct buf *out)
{
    const struct study_preset *p = &s->presets[level];
    char relmse[HUMAN_BYTES], time[HUMAN_BYTES];
    char how[60];
    human_error(p->expected_relmse, relmse);
    human_duration(p->scene_core_s, time);
    study_preset_how(p, how, sizeof how);
    buf_printf(out, "# %s settings for %s, by tilery tradeoff\n", study_level_names[level],
               s->scene);
    buf_printf(out, "# relMSE %s %s (aim %g); %s of one core at %ux%u\n", relmse, how, p->target,
               time, s->scene_width, s->scene_height);
    buf_printf(out, "# %s\n", p->why);
    for (uint32_t i = 0; i < p->setting_count; i++)
        buf_printf(out, "%s = %s\n", cli_options[p->settings[i].option].name, p->settings[i].text);
    if (p->half)
        buf_printf(out, "half = true\n");
}
