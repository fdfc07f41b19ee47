/* common/tags.h: the words by which jobs choose workers: "big", "site-b".
 *
 * A worker has a set of them (tilery-worker --tag), a job asks for a set (--tags): only workers
 * that have all of those render it. Pure; any thread. Tests: test_job_spec, test_tag_table.
 */
#ifndef COMMON_TAGS_H
#define COMMON_TAGS_H

#include <stdbool.h>
#include <stdint.h>

enum {
    TAGS_MAX = 8,                         /* of one worker, or one job */
    TAG_BYTES = 33,                       /* of a word, with its end */
    TAG_LIST_BYTES = TAGS_MAX * TAG_BYTES /* of the list "a,b,c", with its end */
};

/* What tag_valid wants, for people. */
#define TAG_EXPECTED "1 to 32 letters, digits, '-', '_' or '.'"

struct tags {
    char words[TAGS_MAX][TAG_BYTES]; /* distinct */
    uint32_t count;
};

bool tag_valid(const char *word);

/* Reads "big,site-b"; "" is none. False at the first word that is not valid, comes twice or is one
 * too many: then *bad (may be NULL) gets it, cut to its size. */
bool tags_parse(const char *list, struct tags *out, char bad[TAG_BYTES]);

/* In their order, "" for none. */
void tags_list(const struct tags *t, char out[TAG_LIST_BYTES]);

#endif
