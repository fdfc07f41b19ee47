#include "master/store_files.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/durable.h"

enum err segments_init(struct segments *s, const char *dir)
{
    *s = (struct segments){.dir = mem_strdup(dir)};
    return s->dir ? ERR_OK : ERR_NOMEM;
}

static void close_segment(struct segment *g)
{
    if (g->job)
        (void)close(g->fd);
    *g = (struct segment){0};
}

void segments_release(struct segments *s)
{
    for (int i = 0; i < SEGMENTS_OPEN_MAX; i++)
        close_segment(&s->open[i]);
    mem_free(s->dir);
}

char *segments_job_path(const char *dir, uint64_t job)
{
    return mem_sprintf("%s/jobs/%" PRIu64, dir, job);
}

char *segments_film_path(const char *dir, uint64_t job)
{
    return mem_sprintf("%s/jobs/%" PRIu64 "/film", dir, job);
}

char *segments_path(const char *dir, uint64_t job, uint64_t number)
{
    return mem_sprintf("%s/jobs/%" PRIu64 "/seg-%" PRIu64, dir, job, number);
}

enum err segments_make_folder(const struct segments *s, uint64_t job)
{
    char *path = segments_job_path(s->dir, job);
    enum err e = path ? durable_make_folder(path) : ERR_NOMEM;
    mem_free(path);
    return e;
}

/* The number in "seg-N", 0 if `name` is no segment's. */
static uint64_t segment_number(const char *name)
{
    uint64_t number = 0;
    int used = 0;
    if (sscanf(name, "seg-%" SCNu64 "%n", &number, &used) != 1 || name[used] != '\0')
        return 0;
    return number;
}

/* The highest number of the job's segments; those below `below` are removed if so asked. */
static uint64_t each_segment(const struct segments *s, uint64_t job, uint64_t below, bool remove)
{
    char *path = segments_job_path(s->dir, job);
    DIR *d = path ? opendir(path) : NULL;
    mem_free(path);
    uint64_t highest = 0;
    if (!d)
        return 0;
    for (struct dirent *entry = readdir(d); entry; entry = readdir(d)) {
        uint64_t number = segment_number(entry->d_name);
        highest = number > highest ? number : highest;
        if (remove && number > 0 && number < below)
            (void)unlinkat(dirfd(d), entry->d_name, 0);
    }
    (void)closedir(d);
    return highest;
}

static struct segment *find(struct segments *s, uint64_t job)
{
    for (int i = 0; i < SEGMENTS_OPEN_MAX; i++)
        if (s->open[i].job == job)
            return &s->open[i];
    return NULL;
}

/* A place for one more: a free one, or the one unused for longest. Where a batch has results of
 * more jobs than there are places, that one is synced before its time; if the batch then fails,
 * what it wrote there stays, and no index knows of it. */
static enum err free_place(struct segments *s, struct segment **out)
{
    struct segment *oldest = s->open;
    for (struct segment *g = s->open; g < s->open + SEGMENTS_OPEN_MAX && oldest->job != 0; g++)
        if (g->job == 0 || g->used_at < oldest->used_at)
            oldest = g;
    if (oldest->job != 0 && oldest->bytes > oldest->bytes_counted)
        TL_TRY(durable_data_sync(oldest->fd));
    close_segment(oldest);
    *out = oldest;
    return ERR_OK;
}

static enum err open_segment(struct segments *s, uint64_t job, struct segment **out)
{
    struct segment *g = find(s, job);
    if (g) {
        *out = g;
        return ERR_OK;
    }
    TL_TRY(segments_make_folder(s, job));
    TL_TRY(free_place(s, &g));
    uint64_t number = each_segment(s, job, 0, false) + 1;
    char *path = segments_path(s->dir, job, number);
    enum err e = path ? ERR_OK : ERR_NOMEM;
    int fd = -1;
    if (e == ERR_OK) {
        fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
        e = fd < 0 ? err_from_errno(errno) : durable_sync_name(path);
    }
    if (e == ERR_OK)
        *g = (struct segment){.job = job, .number = number, .fd = fd};
    else if (fd >= 0)
        (void)close(fd);
    mem_free(path);
    *out = g;
    return e;
}

static enum err write_all(int fd, struct iovec *parts, int count, uint64_t offset)
{
    while (count > 0) {
        ssize_t n = pwritev(fd, parts, count, (off_t)offset);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return err_from_errno(errno);
        if (n == 0)
            return ERR_NOSPACE;
        offset += (uint64_t)n;
        size_t left = (size_t)n;
        while (count > 0 && left >= parts->iov_len) {
            left -= parts->iov_len;
            parts++;
            count--;
        }
        if (count > 0) {
            parts->iov_base = (char *)parts->iov_base + left;
            parts->iov_len -= left;
        }
    }
    return ERR_OK;
}

enum err segments_append(struct segments *s, const struct journal_result *r, const void *body,
                         struct segment_place *out)
{
    struct segment *g;
    TL_TRY(open_segment(s, r->job, &g));
    g->used_at = ++s->clock;
    unsigned char header[JOURNAL_HEADER_BYTES];
    digest record = journal_header(r, body, header);
    struct iovec parts[2] = {{header, sizeof header}, {(void *)(uintptr_t)body, r->body_bytes}};
    enum err e = write_all(g->fd, parts, r->body_bytes ? 2 : 1, g->bytes);
    if (e != ERR_OK) {
        /* What was written of it lies beyond `bytes` and is written over, or cut at restart. */
        (void)!ftruncate(g->fd, (off_t)g->bytes);
        return e;
    }
    *out = (struct segment_place){.segment = g->number,
                                  .offset = g->bytes,
                                  .bytes = JOURNAL_HEADER_BYTES + (uint64_t)r->body_bytes,
                                  .record = record};
    g->bytes += out->bytes;
    return ERR_OK;
}

enum err segments_sync(struct segments *s)
{
    enum err first = ERR_OK;
    for (int i = 0; i < SEGMENTS_OPEN_MAX; i++) {
        struct segment *g = &s->open[i];
        enum err e = g->job && g->bytes > g->bytes_counted ? durable_data_sync(g->fd) : ERR_OK;
        if (first == ERR_OK)
            first = e;
    }
    return first;
}

void segments_commit(struct segments *s)
{
    for (int i = 0; i < SEGMENTS_OPEN_MAX; i++)
        s->open[i].bytes_counted = s->open[i].bytes;
}

void segments_rollback(struct segments *s)
{
    for (int i = 0; i < SEGMENTS_OPEN_MAX; i++) {
        struct segment *g = &s->open[i];
        if (!g->job || g->bytes == g->bytes_counted)
            continue;
        /* After a failed sync nobody knows what the file holds: go on in a new one. */
        (void)!ftruncate(g->fd, (off_t)g->bytes_counted);
        close_segment(g);
    }
}

void segments_roll(struct segments *s, uint64_t job, uint64_t keep_from)
{
    struct segment *g = find(s, job);
    if (g) {
        TL_ASSERT(g->bytes == g->bytes_counted);
        close_segment(g);
    }
    (void)each_segment(s, job, keep_from, true);
}

void segments_delete_job(struct segments *s, uint64_t job)
{
    struct segment *g = find(s, job);
    if (g)
        close_segment(g);
    char *folder = segments_job_path(s->dir, job);
    DIR *d = folder ? opendir(folder) : NULL;
    /* All of it: a kill may have left a checkpoint half-written. */
    for (struct dirent *entry = d ? readdir(d) : NULL; entry; entry = readdir(d))
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0)
            (void)unlinkat(dirfd(d), entry->d_name, 0);
    if (d)
        (void)closedir(d);
    if (folder && rmdir(folder) != 0 && errno != ENOENT)
        log_warn("store", "cannot remove folder=%s error=\"%s\"", folder, strerror(errno));
    mem_free(folder);
}

void segments_truncate(const char *dir, uint64_t job, uint64_t number, uint64_t bytes)
{
    char *path = segments_path(dir, job, number);
    struct stat st;
    if (path && stat(path, &st) == 0 && (uint64_t)st.st_size > bytes) {
        log_info("store", "torn tail cut file=%s bytes=%" PRIu64, path,
                 (uint64_t)st.st_size - bytes);
        if (truncate(path, (off_t)bytes) != 0)
            log_warn("store", "cannot cut file=%s error=\"%s\"", path, strerror(errno));
    }
    mem_free(path);
}

static enum err read_all(int fd, unsigned char *data, uint64_t bytes, uint64_t offset)
{
    while (bytes > 0) {
        ssize_t n = pread(fd, data, bytes, (off_t)offset);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return err_from_errno(errno);
        if (n == 0)
            return ERR_CORRUPT;
        data += n;
        bytes -= (uint64_t)n;
        offset += (uint64_t)n;
    }
    return ERR_OK;
}

enum err segment_read(const char *dir, uint64_t job, const struct segment_place *place,
                      unsigned char **data, struct journal_result *out, const unsigned char **body)
{
    if (place->bytes < JOURNAL_HEADER_BYTES ||
        place->bytes > (uint64_t)JOURNAL_BODY_BYTES_MAX + JOURNAL_HEADER_BYTES)
        return ERR_CORRUPT;
    char *path = segments_path(dir, job, place->segment);
    unsigned char *bytes = mem_alloc(place->bytes);
    enum err e = path && bytes ? ERR_OK : ERR_NOMEM;
    int fd = -1;
    if (e == ERR_OK) {
        fd = open(path, O_RDONLY | O_CLOEXEC);
        e = fd < 0 ? err_from_errno(errno) : read_all(fd, bytes, place->bytes, place->offset);
    }
    if (fd >= 0)
        (void)close(fd);
    digest found;
    if (e == ERR_OK)
        e = journal_read(bytes, place->bytes, out, &found, body);
    if (e == ERR_OK && (!digest_equal(&found, &place->record) || out->job != job))
        e = ERR_CORRUPT;
    mem_free(path);
    if (e == ERR_OK)
        *data = bytes;
    else
        mem_free(bytes);
    return e;
}
