#include "client/study_page.h"

#include <inttypes.h>
#include <math.h>

#include "client/human.h"
#include "client/metrics.h"
#include "client/study_plot.h"
#include "client/study_write.h"
#include "common/mem.h"
#include "common/png_file.h"

enum { THUMB_SIDE = 112 };

static const char style[] =
    "body { margin: 0 auto; max-width: 72rem; padding: 1.5rem; background: var(--ink0);"
    " color: var(--ink1); font: 16px/1.5 system-ui, sans-serif }\n"
    "h1 { font-size: 1.6rem; margin: 0 0 .3rem } h2 { font-size: 1.2rem; margin: 2rem 0 .5rem }\n"
    "p { max-width: 50rem } .muted { color: var(--ink2) }\n"
    ".cards { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fit, minmax(17rem, "
    "1fr)) }\n"
    ".card { border: 1px solid var(--ink3); border-radius: .5rem; padding: .8rem 1rem }\n"
    ".card h3 { margin: 0; font-size: 1.05rem } .card p { margin: .4rem 0 }\n"
    "code, pre { font: 13px/1.4 ui-monospace, monospace; overflow-x: auto }\n"
    "pre { background: var(--ink3); padding: .4rem .6rem; border-radius: .3rem; margin: .4rem 0 }\n"
    ".scroll { overflow-x: auto } table { border-collapse: collapse; width: 100%;"
    " font-size: .8rem }\n"
    "th, td { text-align: right; padding: .2rem .35rem; border-bottom: 1px solid var(--ink3);"
    " white-space: nowrap } small { color: var(--ink2) } th:first-child, td:first-child, "
    "td:last-child { text-align: left } td:last-child { white-space: normal }\n"
    "tr.base td { font-weight: 600 } .bias { color: var(--ink9); font-weight: 600 }\n"
    ".gallery { display: flex; flex-wrap: wrap; gap: .8rem }\n"
    "figure { margin: 0 } figcaption { font-size: 12px; color: var(--ink2); max-width: 14rem }\n"
    "img { image-rendering: pixelated; vertical-align: top }\n"
    "@media print { .card { break-inside: avoid } }\n";

/* --- Pictures --------------------------------------------------------------- */

static void put_base64(const struct buf *data, struct buf *out)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < data->bytes; i += 3) {
        size_t left = data->bytes - i;
        uint32_t v = (uint32_t)data->data[i] << 16;
        v |= left > 1 ? (uint32_t)data->data[i + 1] << 8 : 0;
        v |= left > 2 ? data->data[i + 2] : 0;
        buf_put_u8(out, (uint8_t)digits[v >> 18]);
        buf_put_u8(out, (uint8_t)digits[v >> 12 & 63]);
        buf_put_u8(out, left > 1 ? (uint8_t)digits[v >> 6 & 63] : '=');
        buf_put_u8(out, left > 2 ? (uint8_t)digits[v & 63] : '=');
    }
}

static void put_image(const struct buf *png, uint32_t width, uint32_t height, const char *alt,
                      struct buf *out)
{
    /* Small ones are shown larger, in whole steps. */
    uint32_t side = width > height ? width : height,
             zoom = side < THUMB_SIDE ? THUMB_SIDE / side : 1;
    buf_printf(out, "<img width=\"%u\" height=\"%u\" alt=\"", zoom * width, zoom * height);
    canvas_put_escaped(out, alt);
    buf_printf(out, "\" src=\"data:image/png;base64,");
    put_base64(png, out);
    buf_printf(out, "\">");
}

/* How many pixels a side become one. */
static uint32_t shrink_of(const struct study *s)
{
    uint32_t side = s->width > s->height ? s->width : s->height;
    uint32_t shrink = (side + THUMB_SIDE - 1) / THUMB_SIDE;
    return shrink ? shrink : 1;
}

/* Means of squares of pixels; `out` has room for all. */
static void shrink(const struct study *s, const float *rgb, uint32_t by, float *out)
{
    uint32_t width = s->width / by, height = s->height / by;
    for (uint32_t y = 0; y < height; y++) {
        for (uint32_t x = 0; x < width; x++) {
            for (uint32_t c = 0; c < 3; c++) {
                double sum = 0;
                for (uint32_t k = 0; k < by * by; k++) {
                    size_t at = (size_t)(y * by + k / by) * s->width + x * by + k % by;
                    sum += (double)rgb[3 * at + c];
                }
                out[3 * ((size_t)y * width + x) + c] = (float)(sum / (by * by));
            }
        }
    }
}

static enum err put_thumb(const struct study *s, const float *rgb, const char *alt, struct buf *out)
{
    uint32_t by = shrink_of(s), width = s->width / by, height = s->height / by;
    if (width == 0 || height == 0)
        return ERR_OK; /* a strip too thin to be shown small */
    struct buf png;
    float *small = mem_alloc_array(3 * (size_t)width * height, sizeof *small);
    if (!small)
        return ERR_NOMEM;
    buf_init(&png);
    shrink(s, rgb, by, small);
    enum err e = png_write_rgb(small, width, height, 1, &png);
    if (e == ERR_OK)
        put_image(&png, width, height, alt, out);
    buf_release(&png);
    mem_free(small);
    return e;
}

/* The error of each pixel on the scale of compare --heatmap, every by-th pixel. */
static enum err put_map(const struct study *s, const float *rgb, const float *reference,
                        const char *alt, struct buf *out)
{
    uint32_t by = shrink_of(s), width = s->width / by, height = s->height / by;
    size_t pixels = (size_t)s->width * s->height;
    struct buf png;
    double *errors = mem_alloc_array(pixels, sizeof *errors);
    unsigned char *heat = mem_alloc_array(pixels, 3);
    enum err e = errors && heat ? ERR_OK : ERR_NOMEM;
    buf_init(&png);
    if (e == ERR_OK && width > 0 && height > 0) {
        metrics_error_map(rgb, reference, s->width, s->height, errors);
        for (size_t i = 0; i < (size_t)width * height; i++)
            metrics_heat(errors[i / width * by * s->width + i % width * by], heat + 3 * i);
        e = png_write_bytes(heat, width, height, 3, &png);
        if (e == ERR_OK)
            put_image(&png, width, height, alt, out);
    }
    buf_release(&png);
    mem_free(errors);
    mem_free(heat);
    return e;
}

static enum err put_figure(const struct study *s, const struct study_point *p,
                           const float *reference, struct buf *out)
{
    char alt[80], error[HUMAN_BYTES];
    human_error(p->error.value, error);
    buf_printf(out, "<figure>");
    (void)snprintf(alt, sizeof alt, "%s %s", study_knob_words[p->knob], p->label);
    TL_TRY(put_thumb(s, p->picture, alt, out));
    (void)snprintf(alt, sizeof alt, "where %s %s differs", study_knob_words[p->knob], p->label);
    TL_TRY(put_map(s, p->picture, reference, alt, out));
    buf_printf(out, "<figcaption>%s <b>", study_knob_words[p->knob]);
    canvas_put_escaped(out, p->label);
    buf_printf(out, "</b>: %s</figcaption></figure>\n", error);
    return ERR_OK;
}

static enum err put_gallery(const struct study *s, struct buf *out)
{
    size_t values = 3 * (size_t)s->width * s->height;
    float *reference = mem_alloc_array(values, sizeof *reference);
    if (!reference)
        return ERR_NOMEM;
    for (size_t i = 0; i < values; i++)
        reference[i] = (float)(((double)s->truth.a[i] + (double)s->truth.b[i]) / 2);
    buf_printf(out, "<h2>Pictures</h2>\n<p>The first picture of each setting, and the squared "
                    "relative error of its pixels from dark blue (0.001 and less) over violet and "
                    "orange to yellow (1 and more). Settings that give the base's bits are left "
                    "out.</p>\n<div class=\"gallery\">\n<figure>");
    enum err e = put_thumb(s, reference, "reference", out);
    buf_printf(out, "<figcaption><b>reference</b></figcaption></figure>\n");
    for (uint32_t i = 0; e == ERR_OK && i < s->point_count; i++)
        if (s->points[i].picture && !s->points[i].same_bits)
            e = put_figure(s, &s->points[i], reference, out);
    buf_printf(out, "</div>\n");
    mem_free(reference);
    return e;
}

/* --- Words and numbers ------------------------------------------------------ */

static void put_intro(const struct study *s, struct buf *out)
{
    char spent[HUMAN_BYTES], relmse[HUMAN_BYTES];
    human_duration(s->spent_s, spent);
    human_error(s->truth.relmse, relmse);
    buf_printf(out, "<h1>");
    canvas_put_escaped(out, s->scene);
    buf_printf(out, ": speed against accuracy</h1>\n<p class=\"muted\">Pictures of %ux%u pixels",
               s->width, s->height);
    if (s->reduced)
        buf_printf(out, " (the scene asks for %ux%u; the budget allows no more)", s->scene_width,
                   s->scene_height);
    buf_printf(out,
               ", base of %" PRIu64 " samples per pixel; %u renders in %s; references of "
               "2 x %" PRIu64
               " samples and paths of up to %u, whose own relMSE of %s is taken out.",
               s->base_spp, s->render_count, spent, s->reference_spp, s->reference_depth, relmse);
    if (s->own_farm)
        buf_printf(out,
                   " Core-seconds are CPU time of the workers; reading the scene and building its "
                   "tree, %.3g core-seconds a job, is taken out.",
                   s->setups[0].median_s);
    else
        buf_printf(out, " Core-seconds are those that the farm reports.");
    if (s->interrupted)
        buf_printf(out, " <b>The study was interrupted: this is what had been measured.</b>");
    buf_printf(out, "</p>\n");
}

static void put_card(const struct study *s, enum study_level level, struct buf *out)
{
    const struct study_preset *p = &s->presets[level];
    const char *name = study_level_names[level];
    char relmse[HUMAN_BYTES], time[HUMAN_BYTES], how[60];
    struct buf preset;
    study_preset_how(p, how, sizeof how);
    human_error(p->expected_relmse, relmse);
    human_duration(p->scene_core_s, time);
    buf_printf(out,
               "<div class=\"card\"><h3>%s</h3>\n<p>relMSE %s (aim %g), %s; %s of one core at "
               "%ux%u</p>\n<pre>",
               name, relmse, p->target, how, time, s->scene_width, s->scene_height);
    buf_init(&preset);
    study_put_preset(s, level, &preset);
    buf_put_u8(&preset, 0);
    /* The settings without the comments above them. */
    for (const char *line = (const char *)preset.data; line && *line;) {
        const char *end = line;
        while (*end && *end != '\n')
            end++;
        if (*line != '#')
            buf_printf(out, "%.*s\n", (int)(end - line), line);
        line = *end ? end + 1 : end;
    }
    buf_release(&preset);
    buf_printf(out, "</pre>\n<p class=\"muted\">");
    canvas_put_escaped(out, p->why);
    buf_printf(out, "</p>\n<code>tilery render ");
    canvas_put_escaped(out, s->scene);
    buf_printf(out, " -o out.exr --preset %s.preset</code></div>\n", name);
}

static void put_presets(const struct study *s, struct buf *out)
{
    if (!s->has_presets)
        return;
    buf_printf(out, "<h2>Recommended settings</h2>\n<div class=\"cards\">\n");
    for (int i = 0; i < STUDY_LEVELS; i++)
        put_card(s, (enum study_level)i, out);
    buf_printf(out, "</div>\n");
}

static void put_cell(struct stats_interval v, struct buf *out)
{
    char value[HUMAN_BYTES], low[HUMAN_BYTES], high[HUMAN_BYTES];
    human_error(v.value, value);
    human_error(v.low, low);
    human_error(v.high, high);
    buf_printf(out, "<td>%s", value);
    if (isfinite(v.low) && isfinite(v.high))
        buf_printf(out, " <small>%s to %s</small>", low, high);
    buf_printf(out, "</td>");
}

static void put_remarks(const struct study_point *p, struct buf *out)
{
    const char *const texts[] = {p->own ? "base" : NULL, p->front ? "front" : NULL,
                                 p->same_bits ? "base's bits" : NULL};
    const char *before = "";
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        if (!texts[i])
            continue;
        buf_printf(out, "%s%s", before, texts[i]);
        before = ", ";
    }
    if (p->knob == KNOB_ADAPTIVE)
        buf_printf(out, "%smean %.1f spp", before, p->spp_mean);
}

static void put_row(const struct study *s, const struct study_point *p, struct buf *out)
{
    char variance[HUMAN_BYTES], bias[HUMAN_BYTES], se[HUMAN_BYTES], bytes[HUMAN_BYTES];
    human_error(p->parts.variance, variance);
    human_error(p->parts.bias2, bias);
    human_error(p->parts.bias2_se, se);
    human_bytes((double)p->file_bytes, bytes);
    buf_printf(out, "<tr%s><td>%s ", p->own ? " class=\"base\"" : "", study_knob_words[p->knob]);
    canvas_put_escaped(out, p->label);
    buf_printf(out, "</td><td>%u</td>", p->repeats);
    put_cell(p->cost, out);
    put_cell(p->error, out);
    put_cell(study_gain(s, p), out);
    buf_printf(out, "<td>%s</td>", variance);
    buf_printf(out, "<td%s>%s &plusmn; %s</td><td>%s</td><td>",
               study_biased(p) ? " class=\"bias\"" : "", bias, se, bytes);
    put_remarks(p, out);
    buf_printf(out, "</td></tr>\n");
}

static void put_table(const struct study *s, struct buf *out)
{
    buf_printf(out,
               "<h2>All points</h2>\n<p class=\"muted\">Small: 95 %% intervals. Gain: how many "
               "times less work than the base for one error. Bias&sup2; in bold is surely there: "
               "more samples do not take it away.</p>\n<div "
               "class=\"scroll\"><table>\n<tr><th>setting</th><th>renders</th>"
               "<th>core-seconds</th><th>relMSE</th><th>gain</th><th>variance</th>"
               "<th>bias&sup2; &plusmn; se</th><th>file</th><th></th></tr>\n");
    for (uint32_t i = 0; i < s->point_count; i++)
        if (s->points[i].repeats > 0)
            put_row(s, &s->points[i], out);
    buf_printf(out, "</table></div>\n");
}

enum err study_put_page(const struct study *s, const struct buf *svg, struct buf *out)
{
    buf_printf(out, "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
                    "<meta name=\"viewport\" content=\"width=device-width\">\n"
                    "<meta name=\"color-scheme\" content=\"light dark\">\n<title>");
    canvas_put_escaped(out, s->scene);
    buf_printf(out, ": speed against accuracy</title>\n<style>\n");
    canvas_put_colors(out);
    buf_printf(out, "%s</style>\n</head>\n<body>\n", style);
    put_intro(s, out);
    put_presets(s, out);
    buf_printf(out, "<h2>The trade</h2>\n");
    buf_put(out, svg->data, svg->bytes);
    buf_printf(out,
               "<p>Down and to the left is better. On a dotted diagonal ten times the work buys "
               "a tenth of the error; a point below the base's diagonal is worth more than "
               "more samples.</p>\n");
    put_table(s, out);
    TL_TRY(put_gallery(s, out));
    buf_printf(out, "</body>\n</html>\n");
    return buf_status(out);
}
