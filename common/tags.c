#include "common/tags.h"

#include <stdio.h>
#include <string.h>

bool tag_valid(const char *word)
{
    static const char allowed[] =
        "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.";
    size_t bytes = strspn(word, allowed);
    return bytes > 0 && bytes < TAG_BYTES && word[bytes] == '\0';
}

static bool add(struct tags *t, const char *word)
{
    if (!tag_valid(word) || t->count == TAGS_MAX)
        return false;
    for (uint32_t i = 0; i < t->count; i++)
        if (strcmp(t->words[i], word) == 0)
            return false;
    memcpy(t->words[t->count++], word, strlen(word) + 1);
    return true;
}

bool tags_parse(const char *list, struct tags *out, char bad[TAG_BYTES])
{
    struct tags t = {.count = 0};
    for (const char *at = list; *list != '\0'; at++) {
        size_t bytes = strcspn(at, ",");
        char word[TAG_BYTES + 1]; /* one more, so that one that is too long stays too long */
        (void)snprintf(word, sizeof word, "%.*s", (int)(bytes < TAG_BYTES ? bytes : TAG_BYTES), at);
        if (!add(&t, word)) {
            if (bad)
                (void)snprintf(bad, TAG_BYTES, "%.*s", TAG_BYTES - 1, word);
            return false;
        }
        at += bytes;
        if (*at == '\0')
            break;
    }
    *out = t;
    return true;
}

void tags_list(const struct tags *t, char out[TAG_LIST_BYTES])
{
    size_t used = 0;
    out[0] = '\0';
    for (uint32_t i = 0; i < t->count; i++)
        used +=
            (size_t)snprintf(out + used, TAG_LIST_BYTES - used, "%s%s", i ? "," : "", t->words[i]);
}
