#include "client/signals.h"

#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <unistd.h>

#include "client/term.h"

volatile sig_atomic_t signals_interrupts;

static int pipe_fds[2] = {-1, -1};
static volatile pid_t children[SIGNALS_CHILDREN_MAX];

static void on_signal(int number)
{
    int kept = errno;
    if (number != SIGCHLD) {
        signals_interrupts = signals_interrupts + 1;
        term_cursor_show();
        for (int i = 0; signals_interrupts > 1 && i < SIGNALS_CHILDREN_MAX; i++)
            if (children[i] > 0)
                (void)kill(children[i], SIGKILL);
    }
    ssize_t ignored = write(pipe_fds[1], "", 1);
    (void)ignored;
    errno = kept;
}

enum err signals_install(void)
{
    static const int numbers[] = {SIGINT, SIGTERM, SIGHUP, SIGCHLD};
    if (pipe_fds[0] >= 0)
        return ERR_OK;
    if (pipe2(pipe_fds, O_CLOEXEC | O_NONBLOCK) != 0)
        return ERR_IO;
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (sigaction(numbers[i], &action, NULL) != 0)
            return ERR_IO;
    return ERR_OK;
}

int signals_fd(void)
{
    return pipe_fds[0];
}

void signals_clear(void)
{
    char bytes[64];
    while (read(pipe_fds[0], bytes, sizeof bytes) > 0)
        ;
}

void signals_child_add(pid_t pid)
{
    for (int i = 0; i < SIGNALS_CHILDREN_MAX; i++) {
        if (children[i] == 0) {
            children[i] = pid;
            return;
        }
    }
}

void signals_child_remove(pid_t pid)
{
    for (int i = 0; i < SIGNALS_CHILDREN_MAX; i++)
        if (children[i] == pid)
            children[i] = 0;
}
