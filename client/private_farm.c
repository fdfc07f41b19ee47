#include "client/private_farm.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <ftw.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/prctl.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "client/cli_help.h"
#include "client/signals.h"
#include "common/json_get.h"
#include "common/mem.h"

#define FOLDER_PREFIX "tilery-render-"

/* A worker that is asked to end finishes its units first; asked twice, it drops them. Nothing of a
 * private farm is worth the wait. */
enum { INSIST_MS = 60 };

enum { LINE_BYTES = 512, PATH_BYTES = PATH_MAX, WORKER_ARGUMENTS = 12, MASTER_ARGUMENTS = 12 };
enum { LISTEN_FD = 3 }; /* what the master knows the socket for workers by */

/* A text cut to its buffer: what is too long for a path is refused by the system later. */
TL_PRINTF(3, 4) static void format(char *out, size_t bytes, const char *pattern, ...)
{
    va_list args;
    va_start(args, pattern);
    (void)vsnprintf(out, bytes, pattern, args);
    va_end(args);
}

/* --- The folder --------------------------------------------------------- */

static const char *temporary_root(void)
{
    const char *root = getenv("TMPDIR");
    return root && root[0] == '/' ? root : "/tmp";
}

static int remove_entry(const char *path, const struct stat *info, int kind, struct FTW *ftw)
{
    (void)info, (void)kind, (void)ftw;
    return remove(path) != 0 && errno != ENOENT;
}

static void remove_tree(const char *path)
{
    (void)nftw(path, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

/* True if nobody holds the lock in that folder, which is ours: its owner was killed. */
static bool folder_is_stale(const char *path)
{
    char lock[PATH_BYTES];
    struct stat info;
    if (lstat(path, &info) != 0 || !S_ISDIR(info.st_mode) || info.st_uid != geteuid())
        return false;
    format(lock, sizeof lock, "%s/lock", path);
    int fd = open(lock, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0)
        return false;
    bool stale = flock(fd, LOCK_EX | LOCK_NB) == 0;
    (void)close(fd);
    return stale;
}

static void sweep_stale(const char *root)
{
    DIR *folder = opendir(root);
    const struct dirent *entry;
    while (folder && (entry = readdir(folder))) {
        char path[PATH_BYTES];
        if (strncmp(entry->d_name, FOLDER_PREFIX, strlen(FOLDER_PREFIX)) != 0)
            continue;
        int bytes = snprintf(path, sizeof path, "%s/%s", root, entry->d_name);
        if (bytes > 0 && (size_t)bytes < sizeof path && folder_is_stale(path))
            remove_tree(path);
    }
    if (folder)
        (void)closedir(folder);
}

static enum err failed(struct private_farm *f, const char *what)
{
    format(f->failure, sizeof f->failure, "%s: %s", what, strerror(errno));
    return err_from_errno(errno) == ERR_NOSPACE ? ERR_NOSPACE : ERR_IO;
}

static enum err make_token(struct private_farm *f)
{
    static const char digits[] = "0123456789abcdef";
    unsigned char bytes[(PRIVATE_TOKEN_BYTES - 1) / 2];
    if (getrandom(bytes, sizeof bytes, 0) != (ssize_t)sizeof bytes)
        return failed(f, "no random numbers");
    for (size_t i = 0; i < sizeof bytes; i++) {
        f->token[2 * i] = digits[bytes[i] >> 4];
        f->token[2 * i + 1] = digits[bytes[i] & 15];
    }
    char path[PATH_BYTES];
    format(path, sizeof path, "%s/token", f->folder);
    int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    ssize_t size = (ssize_t)(sizeof f->token - 1);
    bool ok = fd >= 0 && write(fd, f->token, (size_t)size) == size && write(fd, "\n", 1) == 1;
    enum err e = ok ? ERR_OK : failed(f, path);
    if (fd >= 0)
        (void)close(fd);
    return e;
}

static enum err make_folder(struct private_farm *f)
{
    const char *root = temporary_root();
    char lock[PATH_BYTES], fresh[PATH_BYTES];
    sweep_stale(root);
    int bytes = snprintf(f->folder, sizeof f->folder, "%s/" FOLDER_PREFIX "XXXXXX", root);
    if (bytes < 0 || (size_t)bytes >= sizeof f->folder || !mkdtemp(f->folder)) {
        f->folder[0] = '\0';
        return failed(f, root);
    }
    /* Locked before it has its name: a sweeper never sees it free. */
    format(fresh, sizeof fresh, "%s/lock.new", f->folder);
    format(lock, sizeof lock, "%s/lock", f->folder);
    f->lock_fd = open(fresh, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (f->lock_fd < 0 || flock(f->lock_fd, LOCK_EX | LOCK_NB) != 0 || rename(fresh, lock) != 0)
        return failed(f, lock);
    return make_token(f);
}

/* Bound and listening before anybody runs, so that nobody waits for a port to be known. */
static enum err make_socket(struct private_farm *f)
{
    struct sockaddr_in at = {.sin_family = AF_INET, .sin_addr = {htonl(INADDR_LOOPBACK)}};
    socklen_t bytes = sizeof at;
    f->listen_fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (f->listen_fd < 0 || bind(f->listen_fd, (struct sockaddr *)&at, sizeof at) != 0 ||
        listen(f->listen_fd, PRIVATE_WORKERS_MAX) != 0 ||
        getsockname(f->listen_fd, (struct sockaddr *)&at, &bytes) != 0)
        return failed(f, "no socket for workers");
    format(f->listen, sizeof f->listen, "127.0.0.1:%u", ntohs(at.sin_port));
    return ERR_OK;
}

/* --- Children ----------------------------------------------------------- */

static enum err find_programs(struct private_farm *f)
{
    ssize_t bytes = readlink("/proc/self/exe", f->bin, sizeof f->bin - 1);
    if (bytes <= 0)
        return failed(f, "/proc/self/exe");
    f->bin[bytes] = '\0';
    *strrchr(f->bin, '/') = '\0';
    return ERR_OK;
}

/* In the child: connects the descriptors, ties its life to the parent's, runs the program. */
TL_NORETURN static void child_run(const struct private_farm *f, const struct private_child *child,
                                  pid_t parent, int out_fd, char *const *arguments)
{
    char path[PATH_BYTES], log[PATH_BYTES];
    static const int reset[] = {SIGINT, SIGTERM, SIGHUP, SIGCHLD, SIGPIPE};
    for (size_t i = 0; i < sizeof reset / sizeof *reset; i++)
        (void)signal(reset[i], i == 0 ? SIG_IGN : SIG_DFL); /* Ctrl-C is for the parent alone */
    if (prctl(PR_SET_PDEATHSIG, SIGKILL) != 0 || getppid() != parent)
        _exit(127); /* the parent died before the tie held */
    format(path, sizeof path, "%s/%s", f->bin, arguments[0]);
    format(log, sizeof log, "%s/%s.log", f->folder, child->name);
    int log_fd = open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    int null_fd = open("/dev/null", O_RDONLY | O_CLOEXEC);
    if (log_fd < 0 || null_fd < 0 || dup2(null_fd, 0) < 0 || dup2(out_fd, 1) < 0 ||
        dup2(log_fd, 2) < 0)
        _exit(126);
    /* The copy outlives exec; where it is the same already, dup2 would keep it from that. */
    if (child == &f->master && (f->listen_fd == LISTEN_FD ? fcntl(LISTEN_FD, F_SETFD, 0)
                                                          : dup2(f->listen_fd, LISTEN_FD)) < 0)
        _exit(126);
    (void)setpgid(0, 0);
    (void)setenv("TILERY_TOKEN", f->token, 1);
    (void)execv(path, arguments);
    (void)dprintf(2, "cannot run %s: %s\n", path, strerror(errno));
    _exit(127);
}

static enum err child_start(struct private_farm *f, struct private_child *child,
                            char *const *arguments)
{
    int fds[2];
    if (pipe2(fds, O_CLOEXEC) != 0)
        return failed(f, "pipe");
    pid_t parent = getpid();
    pid_t pid = fork();
    if (pid == 0)
        child_run(f, child, parent, fds[1], arguments);
    (void)close(fds[1]);
    if (pid < 0) {
        (void)close(fds[0]);
        return failed(f, "fork");
    }
    (void)fcntl(fds[0], F_SETFL, O_NONBLOCK);
    if (child->out_fd > 0)
        (void)close(child->out_fd);
    child->pid = pid;
    child->out_fd = fds[0];
    signals_child_add(pid);
    return ERR_OK;
}

static enum err master_start(struct private_farm *f)
{
    char data[PATH_BYTES], token[PATH_BYTES], listen_fd[8];
    format(data, sizeof data, "%s/master", f->folder);
    format(token, sizeof token, "%s/token", f->folder);
    format(listen_fd, sizeof listen_fd, "%d", LISTEN_FD);
    const char *arguments[MASTER_ARGUMENTS] = {"tilery-master",
                                               "--listen-socket",
                                               listen_fd,
                                               "--http",
                                               f->http[0] ? f->http : "127.0.0.1:0",
                                               "--data",
                                               data,
                                               "--token-file",
                                               token,
                                               "--no-sync",
                                               NULL};
    return child_start(f, &f->master, (char *const *)arguments);
}

/* Chunks stay in memory: what ends with us needs no disk. A tree that is large is built by one
 * worker, on everybody's cores, while the others wait for it. */
static enum err worker_start(struct private_farm *f, struct private_child *child)
{
    char threads[16], build_threads[16];
    format(threads, sizeof threads, "%u", f->threads);
    format(build_threads, sizeof build_threads, "%u", f->build_threads);
    const char *arguments[WORKER_ARGUMENTS] = {
        "tilery-worker", "--master", f->listen, "--threads", threads, "--name", child->name,
    };
    const char *const shared[] = {"--build-threads", build_threads, "--trees", f->folder};
    if (f->worker_count > 1)
        memcpy(arguments + 7, shared, sizeof shared);
    return child_start(f, child, (char *const *)arguments);
}

/* What all workers together may use, and this process can. */
static uint32_t build_threads(uint32_t worker_count, uint32_t threads)
{
    uint64_t all = (uint64_t)worker_count * threads;
    uint32_t cores = cli_default_threads(1);
    if (all <= cores)
        return (uint32_t)all;
    return cores > threads ? cores : threads;
}

enum err private_farm_start(struct private_farm *f, uint32_t worker_count, uint32_t threads)
{
    *f = (struct private_farm){.worker_count = worker_count,
                               .threads = threads,
                               .build_threads = build_threads(worker_count, threads),
                               .listen_fd = -1,
                               .lock_fd = -1};
    f->workers = mem_calloc(worker_count, sizeof *f->workers);
    format(f->master.name, sizeof f->master.name, "master");
    for (uint32_t i = 0; f->workers && i < worker_count; i++)
        format(f->workers[i].name, sizeof f->workers[i].name, "worker-%u", i + 1);
    enum err e = f->workers ? find_programs(f) : ERR_NOMEM;
    if (e == ERR_OK)
        e = make_folder(f);
    if (e == ERR_OK)
        e = make_socket(f);
    if (e == ERR_OK)
        e = master_start(f);
    for (uint32_t i = 0; e == ERR_OK && i < f->worker_count; i++)
        e = worker_start(f, &f->workers[i]);
    if (e != ERR_OK)
        private_farm_end(f, 0);
    return e;
}

int private_farm_fd(const struct private_farm *f)
{
    return f->master.out_fd;
}

/* The last line of level error, or simply the last. `text` is cut into lines. */
static const char *telling_line(char *text)
{
    const char *last = "", *error = NULL;
    for (char *rest = text, *line; (line = strsep(&rest, "\n"));) {
        last = line;
        if (strncmp(line, "error ", 6) == 0)
            error = line;
    }
    return error ? error : last;
}

/* Appended to `failure`. */
static void add_words(struct private_farm *f, const char *before, const char *words)
{
    size_t used = strlen(f->failure);
    format(f->failure + used, sizeof f->failure - used, "; %s%s", before, words);
}

/* What a child's log says of its end; on a full disk the log has no words either. */
static void quote_log(struct private_farm *f, const struct private_child *child)
{
    char path[PATH_BYTES], text[2048];
    format(path, sizeof path, "%s/%s.log", f->folder, child->name);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0)
        return;
    off_t end = lseek(fd, 0, SEEK_END);
    (void)lseek(fd, end > (off_t)sizeof text - 1 ? end - (off_t)sizeof text + 1 : 0, SEEK_SET);
    ssize_t bytes = read(fd, text, sizeof text - 1);
    (void)close(fd);
    while (bytes > 0 && text[bytes - 1] == '\n')
        bytes--;
    struct statvfs disk;
    if (bytes <= 0 && statvfs(f->folder, &disk) == 0 && disk.f_bavail == 0)
        add_words(f, "disk full: ", f->folder);
    if (bytes <= 0)
        return;
    text[bytes] = '\0';
    add_words(f, "its last words: ", telling_line(text));
}

static void say_end(struct private_farm *f, const struct private_child *child, int status)
{
    if (WIFSIGNALED(status))
        format(f->failure, sizeof f->failure, "%s was killed by signal %d (%s)", child->name,
               WTERMSIG(status), strsignal(WTERMSIG(status)));
    else
        format(f->failure, sizeof f->failure, "%s ended with status %d", child->name,
               WEXITSTATUS(status));
    quote_log(f, child);
}

/* {"listen": "ADDR:PORT", "http": "ADDR:PORT"}, of which the first is known. */
static bool read_addresses(struct private_farm *f, const char *line, size_t bytes)
{
    struct json_get g;
    struct diag_list problems;
    const char *http_text = NULL;
    diag_init(&problems);
    if (json_get_open(&g, line, bytes, "master", &problems) == ERR_OK) {
        if (json_get_text(&g, g.root, "http", &http_text) && http_text)
            format(f->http, sizeof f->http, "%s", http_text);
        json_get_close(&g);
    }
    diag_release(&problems);
    return http_text != NULL;
}

/* True if the child has just ended; then it is collected. By its own id: this process has other
 * children, too. */
static bool child_ended(struct private_child *child, int options, int *status)
{
    pid_t ended;
    if (child->pid <= 0)
        return false;
    do
        ended = waitpid(child->pid, status, options);
    while (ended < 0 && errno == EINTR); /* by another child's end */
    if (ended != child->pid)
        return false;
    signals_child_remove(child->pid);
    child->pid = 0;
    return true;
}

/* The first line of the master: ERR_AGAIN until it is whole. */
static enum err read_handshake(struct private_farm *f)
{
    char line[LINE_BYTES];
    ssize_t bytes = read(f->master.out_fd, line, sizeof line - 1);
    if (bytes < 0 && (errno == EAGAIN || errno == EINTR))
        return ERR_AGAIN;
    if (bytes > 0) {
        /* A line of this size is written at once (PIPE_BUF), so it comes whole. */
        line[bytes] = '\0';
        size_t length = strcspn(line, "\n");
        if (read_addresses(f, line, length))
            return ERR_OK;
        format(f->failure, sizeof f->failure, "master said something else than its ports");
        return ERR_IO;
    }
    /* Its output is closed: it ends or has ended; if it only closed it, it is of no use. */
    int status = 0;
    (void)kill(f->master.pid, SIGKILL);
    if (child_ended(&f->master, 0, &status))
        say_end(f, &f->master, status);
    return ERR_IO;
}

enum err private_farm_connect(struct private_farm *f)
{
    return read_handshake(f);
}

static enum err child_restart(struct private_farm *f, struct private_child *child)
{
    if (++child->restarts > PRIVATE_RESTARTS_MAX)
        return ERR_IO;
    return child == &f->master ? master_start(f) : worker_start(f, child);
}

static enum err child_look(struct private_farm *f, struct private_child *child, uint32_t *restarted)
{
    int status = 0;
    if (!child_ended(child, WNOHANG, &status))
        return ERR_OK;
    say_end(f, child, status);
    TL_TRY(child_restart(f, child));
    if (restarted)
        ++*restarted;
    return ERR_OK;
}

enum err private_farm_reap(struct private_farm *f, uint32_t *restarted)
{
    TL_TRY(child_look(f, &f->master, restarted));
    for (uint32_t i = 0; i < f->worker_count; i++)
        TL_TRY(child_look(f, &f->workers[i], restarted));
    return ERR_OK;
}

static void signal_all(struct private_farm *f, int number)
{
    for (uint32_t i = 0; i < f->worker_count; i++)
        if (f->workers[i].pid > 0)
            (void)kill(f->workers[i].pid, number);
    if (f->master.pid > 0)
        (void)kill(f->master.pid, number);
}

void private_farm_ask_end(struct private_farm *f)
{
    signal_all(f, SIGTERM);
}

static bool any_running(const struct private_farm *f)
{
    bool running = f->master.pid > 0;
    for (uint32_t i = 0; i < f->worker_count; i++)
        running |= f->workers[i].pid > 0;
    return running;
}

static void collect(struct private_farm *f, int options)
{
    int status;
    (void)child_ended(&f->master, options, &status);
    for (uint32_t i = 0; i < f->worker_count; i++)
        (void)child_ended(&f->workers[i], options, &status);
}

void private_farm_end(struct private_farm *f, int grace_ms)
{
    static const struct timespec step = {.tv_nsec = 2000000};
    if (!f->workers)
        f->worker_count = 0;
    collect(f, WNOHANG);
    for (int waited = 0; any_running(f) && waited < grace_ms; waited += 2) {
        (void)nanosleep(&step, NULL);
        collect(f, WNOHANG);
        if (waited == INSIST_MS)
            signal_all(f, SIGTERM);
    }
    signal_all(f, SIGKILL);
    collect(f, 0);
    for (uint32_t i = 0; i < f->worker_count; i++)
        if (f->workers[i].out_fd > 0)
            (void)close(f->workers[i].out_fd);
    if (f->master.out_fd > 0)
        (void)close(f->master.out_fd);
    if (f->folder[0])
        remove_tree(f->folder);
    if (f->lock_fd >= 0)
        (void)close(f->lock_fd);
    if (f->listen_fd >= 0)
        (void)close(f->listen_fd);
    mem_free(f->workers);
    f->workers = NULL;
    f->worker_count = 0;
    f->folder[0] = '\0';
    f->lock_fd = f->listen_fd = -1;
    f->master = (struct private_child){0};
    explicit_bzero(f->token, sizeof f->token);
}
