/* The parent's side of the child process that runs assimp. */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "client/import.h"
#include "client/import_wire.h"

/* A child that answers more than this has gone astray: its own memory is smaller. */
#define MESSAGE_BYTES_MAX (UINT64_C(2) << 30)

/* Processor seconds: enough for any small file, more for large ones. A slow or busy machine may
 * take several times as long by the clock. */
enum { CPU_S_BASE = 4, CPU_S_MAX = 600, CLOCK_FACTOR = 4, READ_STEP_BYTES = 1 << 20 };

/* The child limits its own addresses; builds with a sanitizer cannot, so its memory is looked at
 * too. */
#define RESIDENT_BYTES_MAX (UINT64_C(1) << 30)
enum { LOOK_MS = 50 };
#define BYTES_PER_CPU_S (UINT64_C(1) << 20)

extern char **environ;

struct child {
    pid_t pid;
    int fd; /* its message */
    uint64_t cpu_s;
};

static int64_t now_ms(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000 + t.tv_nsec / 1000000;
}

/* --- Starting ------------------------------------------------------------ */

static bool plan_files(posix_spawn_file_actions_t *files, int message_fd)
{
    return posix_spawn_file_actions_addopen(files, 0, "/dev/null", O_RDONLY, 0) == 0 &&
           posix_spawn_file_actions_addopen(files, 1, "/dev/null", O_WRONLY, 0) == 0 &&
           posix_spawn_file_actions_adddup2(files, message_fd, IMPORT_CHILD_FD) == 0;
}

static enum err spawn(struct child *c, const char *path, const char *uv_sets, int message_fd)
{
    char cpu_s[24];
    posix_spawn_file_actions_t files;
    (void)snprintf(cpu_s, sizeof cpu_s, "%llu", (unsigned long long)c->cpu_s);
    const char *arguments[] = {"tilery", IMPORT_CHILD_ARGUMENT,   path,
                               cpu_s,    uv_sets ? uv_sets : "-", NULL};
    if (posix_spawn_file_actions_init(&files) != 0)
        return ERR_NOMEM;
    int failed = plan_files(&files, message_fd)
                     ? posix_spawn(&c->pid, "/proc/self/exe", &files, NULL,
                                   (char *const *)(uintptr_t)arguments, environ)
                     : ENOMEM;
    (void)posix_spawn_file_actions_destroy(&files);
    return failed ? err_from_errno(failed) : ERR_OK;
}

static enum err start(struct child *c, const char *path, const char *uv_sets, uint64_t bytes)
{
    int ends[2];
    c->cpu_s = CPU_S_BASE + bytes / BYTES_PER_CPU_S;
    if (c->cpu_s > CPU_S_MAX)
        c->cpu_s = CPU_S_MAX;
    if (pipe2(ends, O_CLOEXEC) != 0)
        return err_from_errno(errno);
    enum err e = spawn(c, path, uv_sets, ends[1]);
    (void)close(ends[1]);
    if (e != ERR_OK) {
        (void)close(ends[0]);
        return e;
    }
    c->fd = ends[0];
    return ERR_OK;
}

/* --- Listening ----------------------------------------------------------- */

/* Appends what is there; ERR_CLOSED at the end of the message. */
static enum err read_some(int fd, struct buf *message)
{
    size_t before = message->bytes;
    unsigned char *at = buf_extend(message, READ_STEP_BYTES);
    if (!at)
        return ERR_NOMEM;
    ssize_t got = read(fd, at, READ_STEP_BYTES);
    message->bytes = before + (got > 0 ? (size_t)got : 0);
    if (got < 0)
        return errno == EINTR ? ERR_OK : ERR_IO;
    return got == 0 ? ERR_CLOSED : message->bytes > MESSAGE_BYTES_MAX ? ERR_LIMIT : ERR_OK;
}

/* True if it holds more memory than it may; false when that cannot be told. */
static bool is_too_large(const struct child *c)
{
    char path[40], text[64] = "";
    unsigned long long size, resident;
    (void)snprintf(path, sizeof path, "/proc/%ld/statm", (long)c->pid);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    ssize_t got = fd >= 0 ? read(fd, text, sizeof text - 1) : -1;
    if (fd >= 0)
        (void)close(fd);
    return got > 0 && sscanf(text, "%llu %llu", &size, &resident) == 2 &&
           resident * (uint64_t)sysconf(_SC_PAGESIZE) > RESIDENT_BYTES_MAX;
}

static enum err listen_to(const struct child *c, struct buf *message)
{
    int64_t end_ms = now_ms() + (int64_t)c->cpu_s * 1000 * CLOCK_FACTOR;
    enum err e = ERR_OK;
    while (e == ERR_OK) {
        int64_t left_ms = end_ms - now_ms();
        struct pollfd p = {.fd = c->fd, .events = POLLIN};
        if (left_ms <= 0)
            return ERR_TIMEOUT;
        if (is_too_large(c))
            return ERR_LIMIT;
        int ready = poll(&p, 1, LOOK_MS);
        if (ready < 0 && errno != EINTR)
            return ERR_IO;
        if (ready > 0)
            e = read_some(c->fd, message);
    }
    return e == ERR_CLOSED ? ERR_OK : e;
}

/* Ends it if it still runs; its wait status. */
static int finish(const struct child *c, bool kill_it)
{
    int status = 0;
    if (kill_it)
        (void)kill(c->pid, SIGKILL);
    (void)close(c->fd);
    while (waitpid(c->pid, &status, 0) < 0 && errno == EINTR)
        continue;
    return status;
}

static enum err tell_death(struct import *im, enum err heard, int status)
{
    static const char hint[] = "open and save the model in another program, or convert it";
    bool killed =
        WIFSIGNALED(status) && (WTERMSIG(status) == SIGXCPU || WTERMSIG(status) == SIGKILL);
    if (heard == ERR_NOMEM)
        return heard;
    if (heard == ERR_LIMIT)
        return import_fail(im, "import-limit", hint, "reading it needs more than 1 GiB of memory");
    if (heard == ERR_TIMEOUT || killed)
        return import_fail(im, "import-limit", hint, "reading it took too long and was ended");
    if (WIFSIGNALED(status))
        return import_fail(im, "import-crash", hint,
                           "the reader of this format crashed on it (signal %d)", WTERMSIG(status));
    if (WIFEXITED(status) && WEXITSTATUS(status) == IMPORT_CHILD_NOMEM)
        return import_fail(im, "import-limit", hint, "reading it needs more than 1 GiB of memory");
    return import_fail(im, "import-crash", hint, "the reader of this format failed on it");
}

/* White in the place of a picture that cannot be had is no colour, but it tilts normals, and glows:
 * what only the picture could tell is left out. */
static void do_without(struct scene *s, uint32_t texture)
{
    for (size_t i = 0; i < s->material_count; i++) {
        struct scene_material *m = &s->materials[i];
        if (m->normal_texture == texture)
            m->normal_texture = SCENE_NONE;
        if (m->bump_texture == texture)
            m->bump_texture = SCENE_NONE;
        if (m->emission_texture != texture)
            continue;
        m->emission_texture = SCENE_NONE;
        m->emission[0] = m->emission[1] = m->emission[2] = 0;
    }
}

/* Replaces the constant textures that stand for pictures. */
static enum err load_pictures(struct import *im, const struct import_message *m)
{
    for (size_t i = 0; i < m->count; i++) {
        const struct import_picture *p = &m->pictures[i];
        struct scene_texture *t = NULL;
        for (size_t j = 0; j < im->scene.texture_count && !t; j++)
            if (strcmp(im->scene.textures[j].name, p->texture) == 0)
                t = &im->scene.textures[j];
        if (!t)
            continue;
        uint32_t image;
        TL_TRY(p->path ? import_image_file(im, p->path, p->use, &image)
                       : import_image_bytes(im, p->texture, p->data, p->bytes, p->use, &image));
        if (image != SCENE_NONE) {
            t->type = SCENE_TEXTURE_IMAGE;
            t->image = image;
        } else {
            do_without(&im->scene, (uint32_t)(t - im->scene.textures));
        }
    }
    return ERR_OK;
}

enum err import_child_run(struct import *im, const char *uv_sets, uint64_t bytes)
{
    struct child c;
    struct buf message;
    struct import_message m = {0};
    TL_TRY(start(&c, im->path, uv_sets, bytes));
    buf_init(&message);
    enum err heard = listen_to(&c, &message);
    int status = finish(&c, heard != ERR_OK);
    bool whole = heard == ERR_OK && WIFEXITED(status) && WEXITSTATUS(status) == 0;
    enum err e = whole ? import_wire_get(message.data, message.bytes, im, &m)
                       : tell_death(im, heard, status);
    if (e == ERR_OK)
        e = load_pictures(im, &m);
    if (e == ERR_CORRUPT)
        e = import_fail(im, "import-crash", NULL, "the reader of this format answered nonsense");
    import_message_release(&m);
    buf_release(&message);
    return e;
}
