/* shim.c: makes the n-th step of a program fail, or be its last, or sets its clock. For LD_PRELOAD;
 * tests only.
 *
 *   TILERY_SHIM=ACTION:STEP:N[:COUNT]
 *     ACTION  kill     SIGKILL before the step;  killed: after it
 *             torn     writes half of what was to be written, then SIGKILL
 *             ENOSPC, EIO, EMFILE, ENOMEM, EINTR   the step fails with this error
 *             slow     the step takes 20 ms more
 *             count    nothing
 *     STEP    disk     write, pwrite, pwritev, fsync, fdatasync, ftruncate on regular files;
 * rename, mkdir, unlink alloc    malloc, calloc, realloc, aligned_alloc called from the program
 * itself library  the same called from the shared libraries (both: only if built with SHIM_MEMORY)
 *     N       counts from 1; with COUNT, so many steps from N on (0: all)
 *   TILERY_SHIM_COUNT=FILE   the number of steps is written there, at each 64th and at the end
 *   TILERY_SHIM_CLOCK=FILE   so many seconds as FILE holds are added to the time of day
 *
 * Counting is atomic; the order of steps of several threads is theirs, so a run is not repeated
 * exactly: what must hold, holds at any step.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum action { ACT_COUNT, ACT_KILL, ACT_KILLED, ACT_TORN, ACT_ERROR, ACT_SLOW };
enum step { STEP_NONE, STEP_DISK, STEP_ALLOC, STEP_LIBRARY };

static enum action action;
static enum step watched;
static int error_number;
static unsigned long first, last;
static atomic_ulong steps;
static int count_fd = -1, clock_fd = -1;
static uintptr_t program_begin, program_end; /* the executable's own code */

static ssize_t (*real_write)(int, const void *, size_t);
static ssize_t (*real_pwrite)(int, const void *, size_t, off_t);
static ssize_t (*real_pwritev)(int, const struct iovec *, int, off_t);
static int (*real_fsync)(int), (*real_fdatasync)(int);
static int (*real_ftruncate)(int, off_t);
static int (*real_rename)(const char *, const char *), (*real_mkdir)(const char *, mode_t);
static int (*real_unlink)(const char *);
static int (*real_clock_gettime)(clockid_t, struct timespec *);

static int find_program(struct dl_phdr_info *info, size_t bytes, void *ctx)
{
    (void)bytes;
    (void)ctx;
    for (int i = 0; i < info->dlpi_phnum; i++) {
        const ElfW(Phdr) *p = &info->dlpi_phdr[i];
        if (p->p_type == PT_LOAD && (p->p_flags & PF_X)) {
            program_begin = info->dlpi_addr + p->p_vaddr;
            program_end = program_begin + p->p_memsz;
        }
    }
    return 1; /* the first is the program */
}

static void parse(char *text)
{
    static const struct {
        const char *name;
        enum action action;
        int error;
    } actions[] = {{"count", ACT_COUNT, 0},       {"kill", ACT_KILL, 0},
                   {"killed", ACT_KILLED, 0},     {"torn", ACT_TORN, 0},
                   {"slow", ACT_SLOW, 0},         {"ENOSPC", ACT_ERROR, ENOSPC},
                   {"EIO", ACT_ERROR, EIO},       {"EMFILE", ACT_ERROR, EMFILE},
                   {"ENOMEM", ACT_ERROR, ENOMEM}, {"EINTR", ACT_ERROR, EINTR}};
    static const char *const names[] = {"", "disk", "alloc", "library"};
    char what[16], which[16];
    unsigned long n = 0, count = 1;
    if (sscanf(text, "%15[^:]:%15[^:]:%lu:%lu", what, which, &n, &count) < 3)
        return;
    for (size_t i = 0; i < sizeof actions / sizeof *actions; i++)
        if (strcmp(actions[i].name, what) == 0) {
            action = actions[i].action;
            error_number = actions[i].error;
        }
    for (int i = STEP_DISK; i <= STEP_LIBRARY; i++)
        if (strcmp(names[i], which) == 0)
            watched = (enum step)i;
    first = n;
    last = count ? n + count - 1 : ~0UL;
}

static void put_count(void)
{
    char text[24];
    int bytes = snprintf(text, sizeof text, "%lu\n", atomic_load(&steps));
    if (count_fd >= 0)
        (void)!real_pwrite(count_fd, text, (size_t)bytes, 0);
}

#define FIND(name) *(void **)&real_##name = dlsym(RTLD_NEXT, #name)

__attribute__((constructor)) static void start(void)
{
    FIND(write), FIND(pwrite), FIND(pwritev), FIND(fsync), FIND(fdatasync), FIND(ftruncate);
    FIND(rename), FIND(mkdir), FIND(unlink), FIND(clock_gettime);
    (void)dl_iterate_phdr(find_program, NULL);
    char *text = getenv("TILERY_SHIM"), *count = getenv("TILERY_SHIM_COUNT");
    char *clock = getenv("TILERY_SHIM_CLOCK");
    if (clock)
        clock_fd = open(clock, O_RDONLY | O_CLOEXEC);
    if (count)
        count_fd = open(count, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (text)
        parse(text);
}

__attribute__((destructor)) static void stop(void)
{
    put_count();
}

/* True: the step fails with errno set. */
static bool step(enum step kind, bool *after)
{
    *after = false;
    if (kind != watched)
        return false;
    unsigned long n = atomic_fetch_add(&steps, 1) + 1;
    if (n % 64 == 0)
        put_count();
    if (n < first || n > last || action == ACT_COUNT)
        return false;
    if (action == ACT_KILL)
        (void)raise(SIGKILL);
    if (action == ACT_SLOW)
        (void)usleep(20000);
    *after = action == ACT_KILLED || action == ACT_TORN;
    if (action != ACT_ERROR)
        return false;
    errno = error_number;
    return true;
}

static void step_done(bool after)
{
    if (after)
        (void)raise(SIGKILL);
}

static bool regular(int fd)
{
    struct stat st;
    int before = errno;
    bool is = fd != count_fd && fstat(fd, &st) == 0 && S_ISREG(st.st_mode);
    errno = before;
    return is;
}

#define DISK_STEP(fd, size, call)                                                                  \
    do {                                                                                           \
        bool after = false;                                                                        \
        if (regular(fd)) {                                                                         \
            if (step(STEP_DISK, &after))                                                           \
                return -1;                                                                         \
            if (after && action == ACT_TORN)                                                       \
                (size) /= 2;                                                                       \
        }                                                                                          \
        ssize_t result = (call);                                                                   \
        step_done(after);                                                                          \
        return result;                                                                             \
    } while (0)

ssize_t write(int fd, const void *data, size_t bytes)
{
    DISK_STEP(fd, bytes, real_write(fd, data, bytes));
}

ssize_t pwrite(int fd, const void *data, size_t bytes, off_t at)
{
    DISK_STEP(fd, bytes, real_pwrite(fd, data, bytes, at));
}

ssize_t pwrite64(int fd, const void *data, size_t bytes, off_t at)
{
    DISK_STEP(fd, bytes, real_pwrite(fd, data, bytes, at));
}

ssize_t pwritev(int fd, const struct iovec *parts, int count, off_t at)
{
    DISK_STEP(fd, count, real_pwritev(fd, parts, count, at));
}

ssize_t pwritev64(int fd, const struct iovec *parts, int count, off_t at)
{
    DISK_STEP(fd, count, real_pwritev(fd, parts, count, at));
}

#define PLAIN_STEP(call)                                                                           \
    do {                                                                                           \
        bool after = false;                                                                        \
        if (step(STEP_DISK, &after))                                                               \
            return -1;                                                                             \
        int result = (call);                                                                       \
        step_done(after);                                                                          \
        return result;                                                                             \
    } while (0)

int fsync(int fd)
{
    PLAIN_STEP(real_fsync(fd));
}

int fdatasync(int fd)
{
    PLAIN_STEP(real_fdatasync(fd));
}

int ftruncate(int fd, off_t bytes)
{
    PLAIN_STEP(real_ftruncate(fd, bytes));
}

int ftruncate64(int fd, off_t bytes)
{
    PLAIN_STEP(real_ftruncate(fd, bytes));
}

int rename(const char *from, const char *to)
{
    PLAIN_STEP(real_rename(from, to));
}

int mkdir(const char *path, mode_t mode)
{
    PLAIN_STEP(real_mkdir(path, mode));
}

int unlink(const char *path)
{
    PLAIN_STEP(real_unlink(path));
}

/* --- Time ----------------------------------------------------------------------
 * Somebody sets the clock of this machine. */

int clock_gettime(clockid_t clock, struct timespec *out)
{
    if (!real_clock_gettime)
        FIND(clock_gettime); /* called before start() */
    int result = real_clock_gettime(clock, out);
    char text[24];
    ssize_t bytes = 0;
    if (result == 0 && clock == CLOCK_REALTIME && clock_fd >= 0)
        bytes = pread(clock_fd, text, sizeof text - 1, 0);
    if (bytes > 0) {
        text[bytes] = '\0';
        out->tv_sec += atol(text);
    }
    return result;
}

#ifdef SHIM_MEMORY
/* --- Memory ------------------------------------------------------------------
 * Through glibc's own names: dlsym itself allocates. Not under a sanitizer. */

extern void *__libc_malloc(size_t bytes);
extern void *__libc_calloc(size_t count, size_t bytes);
extern void *__libc_realloc(void *old, size_t bytes);
extern void *__libc_memalign(size_t alignment, size_t bytes);

static bool alloc_fails(const void *caller)
{
    bool after;
    uintptr_t at = (uintptr_t)caller;
    bool own = at >= program_begin && at < program_end;
    return step(own ? STEP_ALLOC : STEP_LIBRARY, &after);
}

void *malloc(size_t bytes)
{
    return alloc_fails(__builtin_return_address(0)) ? NULL : __libc_malloc(bytes);
}

void *calloc(size_t count, size_t bytes)
{
    return alloc_fails(__builtin_return_address(0)) ? NULL : __libc_calloc(count, bytes);
}

void *realloc(void *old, size_t bytes)
{
    return alloc_fails(__builtin_return_address(0)) ? NULL : __libc_realloc(old, bytes);
}

void *aligned_alloc(size_t alignment, size_t bytes)
{
    return alloc_fails(__builtin_return_address(0)) ? NULL : __libc_memalign(alignment, bytes);
}

int posix_memalign(void **out, size_t alignment, size_t bytes)
{
    if (alloc_fails(__builtin_return_address(0)))
        return ENOMEM;
    *out = __libc_memalign(alignment, bytes);
    return *out ? 0 : ENOMEM;
}
#endif
