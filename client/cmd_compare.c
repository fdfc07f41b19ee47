/* client/cmd_compare.c: two pictures, how far apart, and whether that may be. */
#include <errno.h>
#include <math.h>
#include <string.h>

#include "client/command.h"
#include "client/flip.h"
#include "client/human.h"
#include "client/metrics.h"
#include "client/out_file.h"
#include "client/picture.h"
#include "common/file_io.h"
#include "common/json_put.h"
#include "common/mem.h"
#include "common/png_file.h"

static int read_picture(const char *path, struct picture *out, struct diag_list *problems)
{
    enum err e = picture_read(path, out, problems);
    if (e == ERR_NOMEM)
        cli_error("no-memory", NULL, "out of memory while reading %s", path);
    return e == ERR_OK ? EXIT_DONE : e == ERR_NOMEM ? EXIT_MACHINE : EXIT_INPUT;
}

static int write_heatmap(const char *path, const struct picture *x, const struct picture *r)
{
    size_t pixels = (size_t)x->width * x->height;
    double *errors = mem_alloc_array(pixels, sizeof *errors);
    unsigned char *rgb = mem_alloc_array(pixels, 3);
    struct buf png;
    buf_init(&png);
    enum err e = errors && rgb ? ERR_OK : ERR_NOMEM;
    if (e == ERR_OK) {
        metrics_error_map(x->rgb, r->rgb, x->width, x->height, errors);
        for (size_t i = 0; i < pixels; i++)
            metrics_heat(errors[i], rgb + 3 * i);
        e = png_write_bytes(rgb, x->width, x->height, 3, &png);
    }
    if (e == ERR_OK)
        e = file_write(path, png.data, png.bytes);
    mem_free(errors);
    mem_free(rgb);
    buf_release(&png);
    return e == ERR_OK ? EXIT_DONE : cli_cannot_write(path, e, 0, 0, NULL);
}

static void put_json(const struct metrics *m, const struct flip *f, const struct picture *p,
                     bool holds, struct buf *out)
{
    const struct {
        const char *key;
        double value;
    } numbers[] = {
        {"rmse", m->rmse},     {"relmse", m->relmse}, {"relmse_trimmed", m->relmse_trimmed},
        {"mape", m->mape},     {"psnr", m->psnr},     {"ssim", m->ssim},
        {"mean_a", m->mean_x}, {"mean_b", m->mean_r}};
    buf_printf(out, "{\"width\":%u,\"height\":%u,\"identical\":%s,\"holds\":%s", p->width,
               p->height, m->identical ? "true" : "false", holds ? "true" : "false");
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        buf_printf(out, ",\"%s\":", numbers[i].key);
        json_put_number(out, numbers[i].value);
    }
    buf_printf(out, ",\"max_difference\":{\"value\":");
    json_put_number(out, m->max_difference);
    buf_printf(out, ",\"x\":%u,\"y\":%u},\"nonfinite_a\":%llu,\"nonfinite_b\":%llu", m->max_x,
               m->max_y, (unsigned long long)m->nonfinite_x, (unsigned long long)m->nonfinite_r);
    if (f) {
        buf_printf(out, ",\"flip_mean\":");
        json_put_number(out, f->mean);
        buf_printf(out, ",\"flip_p95\":");
        json_put_number(out, f->p95);
    }
    buf_printf(out, "}\n");
}

static void put_text(const struct metrics *m, const struct flip *f, const struct picture *p,
                     struct buf *out)
{
    char relmse[HUMAN_BYTES], trimmed[HUMAN_BYTES];
    human_error(m->relmse, relmse);
    human_error(m->relmse_trimmed, trimmed);
    buf_printf(out, "%ux%u, %s\n", p->width, p->height,
               m->identical ? "identical in every bit" : "different");
    buf_printf(out, "  relMSE   %s (without the worst 0.1 %%: %s)\n", relmse, trimmed);
    buf_printf(out, "  RMSE     %.6g, MAPE %.4g\n", m->rmse, m->mape);
    if (isinf(m->psnr))
        buf_printf(out, "  display  PSNR -, SSIM %.5f\n", m->ssim);
    else
        buf_printf(out, "  display  PSNR %.2f dB, SSIM %.5f\n", m->psnr, m->ssim);
    buf_printf(out, "  largest  %.6g at pixel %u,%u\n", m->max_difference, m->max_x, m->max_y);
    buf_printf(out, "  mean     %.6g, reference %.6g\n", m->mean_x, m->mean_r);
    if (f)
        buf_printf(out, "  FLIP     mean %.4f, 95th percentile %.4f (%u exposures)\n", f->mean,
                   f->p95, f->exposure_count);
    if (m->nonfinite_x || m->nonfinite_r)
        buf_printf(out, "  note     %llu values are not finite, %llu in the reference\n",
                   (unsigned long long)m->nonfinite_x, (unsigned long long)m->nonfinite_r);
}

/* Why the comparison does not hold; NULL if it does. */
static const char *what_fails(const struct cli_line *line, const struct metrics *m)
{
    if (cli_flag(line, CLI_IDENTICAL) && !m->identical)
        return "not identical";
    if (!cli_has(line, CLI_MAX_RELMSE))
        return NULL;
    /* A picture with holes is not within any error. */
    if (m->nonfinite_x != 0 || m->nonfinite_r != 0)
        return "values that are not finite are within no limit";
    return m->relmse <= cli_number(line, CLI_MAX_RELMSE) ? NULL : "relMSE is over the limit";
}

static int report(const struct cli *cli, const struct picture *x, const struct picture *r)
{
    struct metrics m;
    struct buf out;
    struct flip flip;
    bool flips = cli_flag(&cli->line, CLI_FLIP);
    if (metrics_compare(x->rgb, r->rgb, x->width, x->height, &m) != ERR_OK ||
        (flips && flip_compare(x->rgb, r->rgb, x->width, x->height, &flip) != ERR_OK)) {
        cli_error("no-memory", NULL, "out of memory");
        return EXIT_MACHINE;
    }
    const char *failing = what_fails(&cli->line, &m);
    bool holds = !failing;
    buf_init(&out);
    if (cli->json)
        put_json(&m, flips ? &flip : NULL, x, holds, &out);
    else if (!cli->quiet)
        put_text(&m, flips ? &flip : NULL, x, &out);
    bool ok = cli_put_buf(&out);
    buf_release(&out);
    if (!holds)
        cli_error("comparison", NULL, "the comparison did not hold: %s", failing);
    return !ok ? EXIT_MACHINE : holds ? EXIT_DONE : EXIT_FAILED;
}

static int compare(const struct cli *cli, const struct picture *x, const struct picture *r)
{
    if (x->width != r->width || x->height != r->height) {
        cli_error("sizes-differ", "render both with the same --size and --crop",
                  "%s is %ux%u, %s is %ux%u", cli->line.arguments[0], x->width, x->height,
                  cli->line.arguments[1], r->width, r->height);
        return cli_flag(&cli->line, CLI_IDENTICAL) ? EXIT_FAILED : EXIT_INPUT;
    }
    if (cli_has(&cli->line, CLI_HEATMAP)) {
        int status = write_heatmap(cli_text(&cli->line, CLI_HEATMAP), x, r);
        if (status != EXIT_DONE)
            return status;
    }
    return report(cli, x, r);
}

int command_compare(struct cli *cli)
{
    struct picture pictures[2] = {0};
    struct diag_list problems;
    static const enum cli_option_id heatmap = CLI_HEATMAP;
    int status = cli_check_outputs(&cli->line, &heatmap, 1);
    if (status != EXIT_DONE)
        return status;
    diag_init(&problems);
    for (int i = 0; i < 2; i++) {
        int one = read_picture(cli->line.arguments[i], &pictures[i], &problems);
        status = one > status ? one : status;
    }
    if (problems.count)
        (void)cli_problems(&problems, "nothing compared");
    if (status == EXIT_DONE)
        status = compare(cli, &pictures[0], &pictures[1]);
    for (int i = 0; i < 2; i++)
        mem_free(pictures[i].rgb);
    diag_release(&problems);
    return status;
}
