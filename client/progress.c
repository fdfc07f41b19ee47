#include "client/progress.h"

#include <math.h>
#include <string.h>

#include "client/human.h"
#include "client/term.h"
#include "common/json_put.h"
#include "common/utf8.h"

enum { BAR_CELLS_MAX = 17, BAR_CELLS_MIN = 6, REPEATS_SHOWN = 3, PARTS = 5 };

#define PAINT_EVERY_S 0.2
#define LINE_EVERY_S  300.0
#define STALL_AFTER_S 2.0
#define RATE_SHOWN    500.0 /* rays/s; less is shown as none */

void progress_init(struct progress *p, enum progress_mode mode, int fd, double now_s)
{
    *p = (struct progress){.mode = mode,
                           .fd = fd,
                           .start_s = now_s,
                           .last_paint_s = -PAINT_EVERY_S,
                           .last_line_s = now_s,
                           .next_tenth = 1};
    p->now.relmse = (double)NAN;
}

static int percent(double done)
{
    /* 100 only when all is done. */
    return done >= 1 ? 100 : done <= 0 ? 0 : (int)floor(done * 100);
}

static void bar_text(double done, int cells, char *out, size_t bytes)
{
    char bar[BAR_CELLS_MAX + 1];
    int filled = (int)floor(done * cells);
    for (int i = 0; i < cells; i++)
        bar[i] = i < filled ? '=' : i == filled ? '>' : ' ';
    bar[cells] = '\0';
    (void)snprintf(out, bytes, " [%s]", bar);
}

/* The parts of the line in reading order; a part that has nothing to say is empty. */
static void parts_of(const struct progress_now *now, char parts[PARTS][80])
{
    char text[HUMAN_BYTES];
    bar_text(now->done < 0 ? 0 : now->done > 1 ? 1 : now->done, BAR_CELLS_MAX, parts[0], 80);
    parts[1][0] = parts[4][0] = '\0';
    if (now->has_left && now->done < 1) {
        human_left(now->left_s[0], now->left_s[1], text);
        (void)snprintf(parts[1], 80, " %s left", text);
    } else if (now->done <= 0) {
        (void)snprintf(parts[1], 80, " starting");
    }
    parts[2][0] = parts[3][0] = '\0';
    if (!isnan(now->relmse)) {
        human_error(now->relmse, text);
        (void)snprintf(parts[2], 80, "  relMSE %s", text);
    }
    if (now->rays_s >= RATE_SHOWN) {
        human_rays(now->rays_s, text);
        (void)snprintf(parts[3], 80, "  %s", text);
    }
    if (now->done < 1 && now->workers > 0)
        (void)snprintf(parts[4], 80, "  %u worker%s", now->workers, now->workers == 1 ? "" : "s");
}

static bool is_paused(const struct progress_now *now)
{
    return strcmp(now->state, "paused") == 0;
}

static bool stands_still(const struct progress_now *now)
{
    return is_paused(now) || now->waiting_s >= STALL_AFTER_S;
}

/* Why it stands still, and what would end that. */
static void still_text(const struct progress_now *now, char out[PROGRESS_COLUMNS_MAX])
{
    static const char nobody[] = "no worker";
    const char *note = now->note[0] ? now->note : nobody;
    bool advise = now->advice && strncmp(note, nobody, strlen(nobody)) == 0;
    if (is_paused(now))
        (void)snprintf(out, PROGRESS_COLUMNS_MAX, "%3d%% paused%s%s; go on: tilery resume %s",
                       percent(now->done), now->note[0] ? ": " : "", now->note, now->job);
    else
        (void)snprintf(out, PROGRESS_COLUMNS_MAX, "%3d%% stalled %.0f s: %s%s%s",
                       percent(now->done), now->waiting_s, note, advise ? "; " : "",
                       advise ? now->advice : "");
}

void progress_text(const struct progress_now *now, int columns, char out[PROGRESS_COLUMNS_MAX])
{
    char parts[PARTS][80];
    /* From the least wanted: workers, rate, error, bar; the time left stays longest. */
    static const int drop_order[PARTS] = {4, 3, 2, 0, 1};
    if (stands_still(now)) {
        still_text(now, out);
        if (columns > 0 && columns < PROGRESS_COLUMNS_MAX)
            out[columns] = '\0';
        return;
    }
    parts_of(now, parts);
    size_t width = 4;
    for (int i = 0; i < PARTS; i++)
        width += strlen(parts[i]);
    for (int i = 0; i < PARTS && columns > 0 && width > (size_t)columns; i++) {
        width -= strlen(parts[drop_order[i]]);
        parts[drop_order[i]][0] = '\0';
    }
    (void)snprintf(out, PROGRESS_COLUMNS_MAX, "%3d%%%s%s%s%s%s", percent(now->done), parts[0],
                   parts[1], parts[2], parts[3], parts[4]);
}

static void erase_bar(struct progress *p)
{
    if (p->painted)
        term_write(p->fd, "\r\x1b[K", 4);
    p->painted = false;
}

void progress_hide(struct progress *p)
{
    erase_bar(p);
    p->last_paint_s = -PAINT_EVERY_S;
}

static void paint_bar(struct progress *p, double now_s)
{
    char text[PROGRESS_COLUMNS_MAX], line[PROGRESS_COLUMNS_MAX + 16];
    /* The last column stays free: some terminals wrap there. */
    progress_text(&p->now, term_columns(p->fd) - 1, text);
    int bytes = snprintf(line, sizeof line, "\r%s\x1b[K", text);
    term_cursor_hide(p->fd);
    term_write(p->fd, line, (size_t)bytes);
    p->painted = true;
    p->last_paint_s = now_s;
}

static void write_line(struct progress *p, const char *text, double now_s)
{
    char line[PROGRESS_COLUMNS_MAX + 2];
    int bytes = snprintf(line, sizeof line, "%s\n", text);
    term_write(p->fd, line, (size_t)bytes < sizeof line ? (size_t)bytes : sizeof line - 1);
    p->last_line_s = now_s;
    p->line_count++;
}

static void plain_line(struct progress *p, double now_s)
{
    char text[PROGRESS_COLUMNS_MAX];
    bool tenth = percent(p->now.done) >= 10 * p->next_tenth;
    bool still = stands_still(&p->now), stops = still && !p->stalled;
    p->stalled = still;
    if (!tenth && !stops && now_s - p->last_line_s < LINE_EVERY_S)
        return;
    while (percent(p->now.done) >= 10 * p->next_tenth)
        p->next_tenth++;
    progress_text(&p->now, 0, text);
    write_line(p, text, now_s);
}

void progress_json(struct progress *p, const char *event, const char *members, double now_s)
{
    if (p->mode != PROGRESS_JSON)
        return;
    struct buf line;
    buf_init(&line);
    buf_printf(&line, "{\"event\":\"%s\",\"t\":%.3f%s%s}\n", event, now_s - p->start_s,
               members[0] ? "," : "", members);
    if (buf_status(&line) == ERR_OK)
        term_write(p->fd, (const char *)line.data, line.bytes);
    buf_release(&line);
}

static void json_line(struct progress *p, double now_s)
{
    const struct progress_now *n = &p->now;
    struct buf b;
    if (now_s - p->last_paint_s < PAINT_EVERY_S && n->done < 1)
        return;
    p->last_paint_s = now_s;
    buf_init(&b);
    buf_printf(&b, "\"job\":\"%s\",\"done\":", n->job);
    json_put_number(&b, n->done);
    if (n->has_left)
        buf_printf(&b, ",\"left_s\":[%.1f,%.1f]", n->left_s[0], n->left_s[1]);
    else
        buf_printf(&b, ",\"left_s\":null");
    buf_printf(&b, ",\"relmse\":");
    json_put_number(&b, n->relmse);
    buf_printf(&b, ",\"workers\":%u", n->workers);
    buf_put_u8(&b, 0);
    if (buf_status(&b) == ERR_OK)
        progress_json(p, "progress", (const char *)b.data, now_s);
    buf_release(&b);
}

static void show(struct progress *p, double now_s)
{
    switch (p->mode) {
    case PROGRESS_NONE:
        return;
    case PROGRESS_BAR:
        if (now_s - p->last_paint_s >= PAINT_EVERY_S)
            paint_bar(p, now_s);
        return;
    case PROGRESS_LINES:
        plain_line(p, now_s);
        return;
    case PROGRESS_JSON:
        json_line(p, now_s);
        return;
    }
}

void progress_update(struct progress *p, const struct progress_now *now, double now_s)
{
    p->now = *now;
    if (now->done > p->done_max)
        p->done_max = now->done;
    bool grew = now->done < p->done_max - 0.01;
    if (grew && !p->grew)
        progress_event(p, "more samples needed than was planned", now_s);
    p->grew |= grew;
    p->now.done = p->done_max;
    show(p, now_s);
}

void progress_tick(struct progress *p, double now_s)
{
    if (p->mode == PROGRESS_BAR)
        show(p, now_s);
    else if (p->mode == PROGRESS_LINES)
        plain_line(p, now_s);
}

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* "unit 118 failed on w2: ..." and "unit 120 failed on w1: ..." are of one kind: "unit N failed on
 * wN: ...". */
static void kind_of(const char *line, char out[PROGRESS_KIND_BYTES])
{
    size_t used = 0;
    for (; *line && used + 1 < PROGRESS_KIND_BYTES; line++)
        if (!is_digit(*line))
            out[used++] = *line;
        else if (!is_digit(line[1]))
            out[used++] = 'N';
    out[used] = '\0';
}

static bool shown_often(struct progress *p, const char *line)
{
    char kind[PROGRESS_KIND_BYTES];
    kind_of(line, kind);
    for (size_t i = 0; i < p->kind_count; i++)
        if (strcmp(p->kinds[i].kind, kind) == 0)
            return ++p->kinds[i].count > REPEATS_SHOWN;
    if (p->kind_count < PROGRESS_KINDS_MAX) {
        memcpy(p->kinds[p->kind_count].kind, kind, sizeof kind);
        p->kinds[p->kind_count++].count = 1;
    }
    return false;
}

void progress_event(struct progress *p, const char *line, double now_s)
{
    char safe[PROGRESS_COLUMNS_MAX];
    if (p->mode == PROGRESS_NONE)
        return;
    (void)snprintf(safe, sizeof safe, "%s", line);
    utf8_mask(safe);
    if (p->mode == PROGRESS_JSON) {
        struct buf b;
        buf_init(&b);
        buf_printf(&b, "\"line\":");
        json_put_text(&b, safe);
        buf_put_u8(&b, 0);
        if (buf_status(&b) == ERR_OK)
            progress_json(p, "log", (const char *)b.data, now_s);
        buf_release(&b);
        return;
    }
    if (shown_often(p, safe))
        return;
    bool bar = p->painted;
    erase_bar(p);
    write_line(p, safe, now_s);
    if (bar)
        paint_bar(p, now_s);
}

void progress_end(struct progress *p)
{
    erase_bar(p);
    for (size_t i = 0; i < p->kind_count; i++) {
        char text[PROGRESS_COLUMNS_MAX];
        if (p->kinds[i].count <= REPEATS_SHOWN)
            continue;
        (void)snprintf(text, sizeof text, "and %u more like: %s", p->kinds[i].count - REPEATS_SHOWN,
                       p->kinds[i].kind);
        write_line(p, text, p->last_line_s);
    }
    p->kind_count = 0;
    term_cursor_show();
    if (p->mode != PROGRESS_JSON)
        p->mode = PROGRESS_NONE;
}
