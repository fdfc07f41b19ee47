/* A job's picture as a file: see farm.h.
 *
 * Pictures are for people, and can be large. Only PICTURES_AT_ONCE are made at a time, so that
 * results, chunks and the ends of jobs find room on the pool however many look; others wait in
 * the farm's list, in order. A film is held only while its picture is drawn: the results that
 * come meanwhile wait for that. */
#include <inttypes.h>
#include <stdio.h>

#include "common/exr_file.h"
#include "common/half.h"
#include "common/mem.h"
#include "common/png_file.h"
#include "master/farm.h"

enum { PICTURES_AT_ONCE = 2 }; /* of the pool's four threads */

struct picture {
    struct picture *next; /* that waits for its turn */
    uv_work_t request;
    struct farm *farm;
    uint64_t job;
    struct job_spec spec;
    struct job_stats stats; /* of the report, when finished */
    bool finished;
    struct job_blocks blocks;
    const struct film *film; /* the job's, held while it is drawn, or NULL: read from `path` */
    char *path;              /* NULL: there is nothing to be read */
    enum picture_format format;
    char software[64], job_text[24], seed[24], image[DIGEST_HEX_BYTES];
    char name[JOB_NAME_BYTES];
    enum err result;
    uint64_t clamped; /* values too large for a half */
    struct buf file;
    picture_done *done;
    void *ctx;
};

static enum film_aov film_aov_of(enum aov a)
{
    switch (aov_table[a].kind) {
    case AOV_CENTRE:
        return FILM_AOV_SUM;
    case AOV_MEAN:
        return FILM_AOV_MEAN;
    case AOV_FILM:
        break;
    }
    return a == AOV_SAMPLES ? FILM_AOV_SAMPLES : FILM_AOV_ERROR;
}

/* The channels of a file with their names and pixels. */
struct channels {
    struct exr_channel list[FILM_CHANNELS + AOV_CHANNELS_MAX];
    char names[AOV_CHANNELS_MAX][AOV_CHANNEL_BYTES];
    uint32_t count;
};

/* Appends the job's AOVs, planes of `pixels` floats in `out`; without a film they are 0. */
static void add_aovs(struct channels *c, uint32_t set, const struct film *film, uint64_t pixels,
                     float *out)
{
    uint32_t plane = FILM_CHANNELS; /* in the film, in the table's order */
    for (enum aov a = 0; a < AOV_COUNT; a++) {
        for (uint32_t i = 0; aov_has(set, a) && i < aov_table[a].channel_count; i++) {
            bool of_film = aov_table[a].kind == AOV_FILM;
            if (film)
                film_aov(film, film_aov_of(a), of_film ? 0 : plane, out);
            plane += !of_film;
            char *name = c->names[c->count - FILM_CHANNELS];
            aov_channel_name(a, i, name);
            c->list[c->count++] = (struct exr_channel){name, out, 1};
            out += pixels;
        }
    }
}

/* Channels of all AOVs of a set. */
static uint32_t aov_channels(uint32_t set)
{
    uint32_t count = 0;
    for (enum aov a = 0; a < AOV_COUNT; a++)
        count += aov_has(set, a) ? aov_table[a].channel_count : 0;
    return count;
}

enum { ATTRIBUTES_MAX = 16 };

static void add_number(struct exr_attribute *list, size_t *count, const char *name,
                       enum exr_attribute_type type, double number)
{
    TL_ASSERT(*count < ATTRIBUTES_MAX);
    list[(*count)++] = (struct exr_attribute){.name = name, .type = type, .number = number};
}

/* What the report says of samples and error; gives how many attributes there are then. */
static size_t add_numbers(const struct picture *w, struct exr_attribute *list, size_t count)
{
    const struct job_stats *s = &w->stats;
    if (w->spec.stop == JOB_STOP_SPP && w->spec.spp <= INT32_MAX)
        add_number(list, &count, "tilery.spp", EXR_INT, (double)w->spec.spp);
    if (w->finished)
        add_number(list, &count, "tilery.sppMean", EXR_FLOAT, s->spp_mean);
    if (!w->finished || !s->error_known)
        return count;
    add_number(list, &count, "tilery.relmse", EXR_FLOAT, s->relmse);
    add_number(list, &count, "tilery.relmseLow", EXR_FLOAT, s->relmse_low);
    add_number(list, &count, "tilery.relmseHigh", EXR_FLOAT, s->relmse_high);
    add_number(list, &count, "tilery.meanLow", EXR_FLOAT, s->mean_low);
    add_number(list, &count, "tilery.meanHigh", EXR_FLOAT, s->mean_high);
    add_number(list, &count, "tilery.effectiveSize", EXR_FLOAT, s->effective);
    add_number(list, &count, "tilery.heavyTail", EXR_INT,
               s->relmse > 0 && s->effective < FILM_EFFECTIVE_MIN);
    return count;
}

static enum err encode_exr(struct picture *w, const struct channels *channels)
{
    const struct job_crop *crop = &w->spec.crop;
    bool half = w->format == PICTURE_EXR_HALF;
    struct exr_attribute attributes[ATTRIBUTES_MAX] = {
        {.name = "software", .type = EXR_TEXT, .text = w->software},
        {.name = "tilery.job", .type = EXR_TEXT, .text = w->job_text},
        {.name = "tilery.name", .type = EXR_TEXT, .text = w->name},
        {.name = "tilery.seed", .type = EXR_TEXT, .text = w->seed},
        {.name = "tilery.sha256", .type = EXR_TEXT, .text = w->image},
    };
    size_t attribute_count = add_numbers(w, attributes, 5);
    struct exr_picture picture = {
        .width = w->spec.width,
        .height = w->spec.height,
        .x = crop->x,
        .y = crop->y,
        .data_width = crop->width,
        .data_height = crop->height,
        .channels = channels->list,
        .channel_count = channels->count,
        .half_count = half ? FILM_CHANNELS : 0,
        .attributes = attributes,
        .attribute_count = attribute_count,
    };
    return exr_write(&picture, &w->file);
}

static enum err draw(struct picture *w, const struct film *film)
{
    uint64_t pixels = (uint64_t)w->spec.crop.width * w->spec.crop.height;
    uint32_t set = w->format == PICTURE_PNG ? 0 : w->spec.aov;
    float *rgb = mem_calloc(pixels, (FILM_CHANNELS + aov_channels(set)) * sizeof(float));
    if (!rgb)
        return ERR_NOMEM;
    if (film)
        film_picture(film, rgb);
    enum err e;
    if (w->format == PICTURE_PNG) {
        e = png_write_rgb(rgb, w->spec.crop.width, w->spec.crop.height, 1.0, &w->file);
    } else {
        if (w->format == PICTURE_EXR_HALF)
            w->clamped = half_clamp(rgb, (size_t)pixels * FILM_CHANNELS);
        struct channels channels = {.list = {{"R", rgb, 3}, {"G", rgb + 1, 3}, {"B", rgb + 2, 3}},
                                    .count = FILM_CHANNELS};
        add_aovs(&channels, set, film, pixels, rgb + FILM_CHANNELS * pixels);
        e = encode_exr(w, &channels);
    }
    mem_free(rgb);
    return e;
}

static void picture_run(uv_work_t *request)
{
    struct picture *w = request->data;
    if (w->film || !w->path) {
        w->result = draw(w, w->film);
        return;
    }
    struct grid grid;
    struct film *film = NULL;
    struct checkpoint at;
    w->result = grid_init(&grid, &w->spec);
    if (w->result != ERR_OK)
        return;
    w->result = checkpoint_read(w->path, w->job, &grid, &w->blocks, &at, &film);
    if (w->result == ERR_OK) {
        w->result = draw(w, film);
        provenance_release(&at.provenance);
    }
    film_free(film);
    grid_release(&grid);
}

/* It is made, or cannot be: whoever asked is told. */
static void end_picture(struct picture *w, enum err e)
{
    struct job *job = farm_job(w->farm, w->job);
    TL_ASSERT(job && job->film_users > 0); /* it kept the job */
    if (w->film)
        film_read_end(job->film);
    job->film_users--;
    job->film_used_at = (uint64_t)farm_now_ms(w->farm);
    w->done(w->ctx, e, &w->file, w->clamped);
    if (!w->farm->stopping)
        job_film_changed(w->farm, job); /* the last unit may have come meanwhile */
    buf_release(&w->file);
    mem_free(w->path);
    mem_free(w);
}

static void picture_after(uv_work_t *request, int status)
{
    struct picture *w = request->data;
    struct farm *f = w->farm;
    f->pictures.running--;
    end_picture(w, status == 0 ? w->result : ERR_CANCELLED);
    job_pictures_start(f);
}

/* Those whose turn has come. A film that holds units back for its readers gets no more of them:
 * they could follow each other without end, and its journal could not be covered meanwhile. */
void job_pictures_start(struct farm *f)
{
    struct picture_queue *q = &f->pictures;
    while (q->first && q->running < PICTURES_AT_ONCE) {
        struct picture *w = q->first;
        struct job *job = farm_job(f, w->job);
        if (job->film && film_holds(job->film) && !f->stopping)
            return;
        q->first = w->next;
        w->film = job->film;
        if (w->film)
            film_read_begin(job->film);
        if (!f->stopping && uv_queue_work(f->loop, &w->request, picture_run, picture_after) == 0)
            q->running++;
        else
            end_picture(w, f->stopping ? ERR_CANCELLED : ERR_NOMEM);
    }
}

enum err job_picture(struct farm *f, struct job *job, enum picture_format format,
                     picture_done *done, void *ctx)
{
    struct picture *w = mem_calloc(1, sizeof *w);
    if (!w)
        return ERR_NOMEM;
    *w = (struct picture){.farm = f,
                          .job = job->rec.id,
                          .spec = job->spec,
                          .stats = job->rec.stats,
                          .finished = job->rec.state == JOB_STATE_DONE,
                          .blocks = job->blocks,
                          .format = format,
                          .done = done,
                          .ctx = ctx};
    w->request.data = w;
    buf_init(&w->file);
    (void)snprintf(w->software, sizeof w->software, "Tilery %s", TILERY_VERSION);
    (void)snprintf(w->job_text, sizeof w->job_text, "j%" PRIu64, job->rec.id);
    (void)snprintf(w->seed, sizeof w->seed, "%" PRIu64, job->spec.seed);
    (void)snprintf(w->name, sizeof w->name, "%s", job->rec.name);
    if (job->rec.has_image)
        digest_to_hex(&job->rec.image, w->image);
    if (!job->film && job->has_stored) {
        w->path = store_film_path(f->store, job->rec.id);
        if (!w->path) {
            mem_free(w);
            return ERR_NOMEM;
        }
    }
    job->film_users++; /* the job stays, and its film if it is in memory */
    struct picture **end = &f->pictures.first;
    while (*end)
        end = &(*end)->next;
    *end = w;
    job_pictures_start(f);
    return ERR_OK;
}
