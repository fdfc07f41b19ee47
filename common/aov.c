#include "common/aov.h"

#include <stdio.h>
#include <string.h>

#define AOV_ROW(suffix, name_, components_, kind_)                                                 \
    [AOV_##suffix] = {.name = name_,                                                               \
                      .components = components_,                                                   \
                      .kind = AOV_##kind_,                                                         \
                      .channel_count = sizeof(components_) > 1 ? sizeof(components_) - 1 : 1},
const struct aov_info aov_table[AOV_COUNT] = {AOVS(AOV_ROW)};

#define AOV_WIDTH(suffix, name, components, kind)                                                  \
    +(sizeof(components) > 1 ? sizeof(components) - 1 : 1)
#define AOV_LENGTH(suffix, name, components, kind) +sizeof(name)
_Static_assert(0 AOVS(AOV_WIDTH) == AOV_CHANNELS_MAX, "channels of all");
_Static_assert(0 AOVS(AOV_LENGTH) <= AOV_LIST_BYTES, "the list of all");
_Static_assert(AOV_COUNT <= 32, "a bit each");

static bool find(const char *name, size_t bytes, enum aov *out)
{
    for (enum aov a = 0; a < AOV_COUNT; a++) {
        if (strlen(aov_table[a].name) == bytes && memcmp(aov_table[a].name, name, bytes) == 0) {
            *out = a;
            return true;
        }
    }
    return false;
}

bool aov_parse(const char *list, uint32_t *set, char bad[AOV_LIST_BYTES])
{
    uint32_t found = 0;
    for (const char *at = list;; at++) {
        size_t bytes = strcspn(at, ",");
        enum aov a = AOV_COUNT;
        if (!find(at, bytes, &a) || aov_has(found, a)) {
            if (bad)
                (void)snprintf(bad, AOV_LIST_BYTES, "%.*s",
                               (int)(bytes < AOV_LIST_BYTES ? bytes : AOV_LIST_BYTES), at);
            return false;
        }
        found |= UINT32_C(1) << a;
        at += bytes;
        if (*at == '\0')
            break;
    }
    *set = found;
    return true;
}

void aov_list(uint32_t set, char out[AOV_LIST_BYTES])
{
    size_t used = 0;
    out[0] = '\0';
    for (enum aov a = 0; a < AOV_COUNT; a++)
        if (aov_has(set, a))
            used += (size_t)snprintf(out + used, AOV_LIST_BYTES - used, "%s%s", used ? "," : "",
                                     aov_table[a].name);
}

uint32_t aov_planes(uint32_t set, enum aov_kind kind)
{
    uint32_t planes = 0;
    for (enum aov a = 0; kind != AOV_FILM && a < AOV_COUNT; a++)
        if (aov_has(set, a) && aov_table[a].kind == kind)
            planes += aov_table[a].channel_count;
    return planes;
}

void aov_channel_name(enum aov a, uint32_t component, char out[AOV_CHANNEL_BYTES])
{
    const struct aov_info *info = &aov_table[a];
    if (info->components[0] == '\0')
        (void)snprintf(out, AOV_CHANNEL_BYTES, "%s", info->name);
    else
        (void)snprintf(out, AOV_CHANNEL_BYTES, "%s.%c", info->name, info->components[component]);
}
