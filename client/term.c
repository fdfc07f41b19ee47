#include "client/term.h"

#include <errno.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

static volatile sig_atomic_t hidden_fd = -1;

bool term_is_smart(int fd)
{
    const char *term = getenv("TERM");
    return isatty(fd) && term && term[0] && strcmp(term, "dumb") != 0;
}

int term_columns(int fd)
{
    struct winsize size;
    if (ioctl(fd, TIOCGWINSZ, &size) == 0 && size.ws_col > 0)
        return size.ws_col;
    const char *text = getenv("COLUMNS");
    long columns = text ? strtol(text, NULL, 10) : 0;
    return columns > 0 && columns < 10000 ? (int)columns : 80;
}

int term_rows(int fd)
{
    struct winsize size;
    return ioctl(fd, TIOCGWINSZ, &size) == 0 && size.ws_row > 0 ? size.ws_row : 24;
}

void term_write(int fd, const char *text, size_t bytes)
{
    while (bytes > 0) {
        ssize_t written = write(fd, text, bytes);
        if (written < 0 && errno == EINTR)
            continue;
        if (written <= 0)
            return;
        text += written;
        bytes -= (size_t)written;
    }
}

bool term_wants_color(int fd, const char *setting)
{
    if (strcmp(setting, "auto") != 0)
        return strcmp(setting, "always") == 0;
    const char *no_color = getenv("NO_COLOR");
    return term_is_smart(fd) && !(no_color && no_color[0]);
}

bool term_is_utf8(void)
{
    static const char *const names[] = {"LC_ALL", "LC_CTYPE", "LANG"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        const char *value = getenv(names[i]);
        if (value && value[0])
            return strstr(value, "UTF-8") || strstr(value, "utf8") || strstr(value, "utf-8");
    }
    return false;
}

bool term_is_truecolor(void)
{
    const char *value = getenv("COLORTERM");
    return value && (strcmp(value, "truecolor") == 0 || strcmp(value, "24bit") == 0);
}

void term_cursor_show(void)
{
    static const char show[] = "\x1b[?25h";
    int fd = hidden_fd;
    hidden_fd = -1;
    if (fd >= 0) {
        ssize_t ignored = write(fd, show, sizeof show - 1);
        (void)ignored;
    }
}

void term_cursor_hide(int fd)
{
    static const char hide[] = "\x1b[?25l";
    static bool registered;
    if (hidden_fd >= 0)
        return;
    if (!registered)
        registered = atexit(term_cursor_show) == 0;
    hidden_fd = fd;
    ssize_t ignored = write(fd, hide, sizeof hide - 1);
    (void)ignored;
}
