#include "client/frames.h"

#include <stdio.h>
#include <string.h>

#include "client/cli_option.h"

bool frames_parse(const char *text, struct frames *out)
{
    char first[16];
    const char *dash = strchr(text, '-');
    size_t bytes = dash ? (size_t)(dash - text) : strlen(text);
    uint64_t low, high;
    if (bytes >= sizeof first)
        return false;
    memcpy(first, text, bytes);
    first[bytes] = '\0';
    if (!cli_parse_count(first, UINT32_MAX, &low) ||
        !cli_parse_count(dash ? dash + 1 : first, UINT32_MAX, &high) || low > high ||
        high - low >= FRAMES_MAX)
        return false;
    *out = (struct frames){(uint32_t)low, (uint32_t)high};
    return true;
}

bool frames_marked(const char *path)
{
    return strchr(path, '#') != NULL;
}

bool frames_path(const char *path, uint32_t frame, char *out, size_t bytes)
{
    const char *end = strrchr(path, '#'), *begin = end;
    int written;
    while (begin && begin > path && begin[-1] == '#')
        begin--;
    if (end)
        written = snprintf(out, bytes, "%.*s%0*u%s", (int)(begin - path), path,
                           (int)(end - begin) + 1, frame, end + 1);
    else
        written = snprintf(out, bytes, "%s", path);
    return written >= 0 && (size_t)written < bytes;
}
