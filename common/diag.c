#include "common/diag.h"

#include <stdarg.h>
#include <string.h>

#include "common/mem.h"
#include "common/utf8.h"

enum { WORD_MAX = 64, TEXT_MAX = 1000 };

void diag_init(struct diag_list *list)
{
    *list = (struct diag_list){0};
}

static void item_release(struct diag *d)
{
    mem_free(d->file);
    mem_free(d->path);
    mem_free(d->text);
    mem_free(d->hint);
}

void diag_release(struct diag_list *list)
{
    for (size_t i = 0; i < list->count; i++)
        item_release(&list->items[i]);
    mem_free(list->items);
    diag_init(list);
}

/* Foreign names appear in the texts. */
static char *copy_masked(const char *text)
{
    char *copy = text ? mem_strndup(text, TEXT_MAX) : NULL;
    if (copy)
        utf8_mask(copy);
    return copy;
}

void diag_add(struct diag_list *list, enum diag_severity severity, struct diag_place place,
              const char *id, const char *hint, const char *format, ...)
{
    if (severity == DIAG_ERROR)
        list->error_count++;
    else
        list->warning_count++;
    if (list->count >= DIAG_MAX ||
        !mem_grow((void **)&list->items, list->count, &list->capacity, sizeof *list->items))
        return;

    char text[TEXT_MAX];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    struct diag d = {.severity = severity,
                     .file = copy_masked(place.file),
                     .line = place.line,
                     .path = copy_masked(place.path),
                     .text = copy_masked(text),
                     .hint = copy_masked(hint),
                     .id = id};
    if (!d.text) {
        item_release(&d);
        return;
    }
    list->items[list->count++] = d;
}

void diag_append(struct diag_list *list, struct diag_list *from)
{
    list->error_count += from->error_count;
    list->warning_count += from->warning_count;
    for (size_t i = 0; i < from->count; i++) {
        if (list->count >= DIAG_MAX ||
            !mem_grow((void **)&list->items, list->count, &list->capacity, sizeof *list->items))
            break;
        list->items[list->count++] = from->items[i];
        from->items[i] = (struct diag){0};
    }
    diag_release(from);
}

/* When memory runs out, the problem stays as it was. */
static void move_to_user(struct diag *d, struct diag_place user)
{
    struct diag moved = *d;
    moved.file = copy_masked(user.file);
    moved.path = copy_masked(user.path);
    moved.text = mem_sprintf("%s: %s", d->file, d->text);
    if (moved.path && moved.text && (moved.file || !user.file)) {
        mem_free(d->file);
        mem_free(d->text);
        *d = moved;
        return;
    }
    mem_free(moved.file);
    mem_free(moved.path);
    mem_free(moved.text);
}

static void add_user_to_hint(struct diag *d, struct diag_place user)
{
    char *hint = mem_sprintf("%s%sread for %s%s%s", d->hint ? d->hint : "", d->hint ? "; " : "",
                             user.file ? user.file : "", user.file ? ": " : "", user.path);
    if (!hint)
        return;
    utf8_mask(hint);
    mem_free(d->hint);
    d->hint = hint;
}

void diag_name_user(struct diag_list *list, size_t from, struct diag_place user)
{
    for (size_t i = from; i < list->count; i++) {
        struct diag *d = &list->items[i];
        if (d->file && !d->line && !d->path)
            move_to_user(d, user);
        else
            add_user_to_hint(d, user);
    }
}

void diag_print(const struct diag_list *list, FILE *to)
{
    for (size_t i = 0; i < list->count; i++) {
        const struct diag *d = &list->items[i];
        if (d->file)
            (void)fprintf(to, d->line ? "%s:%llu: " : "%s: ", d->file, (unsigned long long)d->line);
        if (d->path)
            (void)fprintf(to, "%s: ", d->path);
        if (!d->file && !d->path)
            (void)fprintf(to, "tilery: ");
        (void)fprintf(to, "%s%s", d->severity == DIAG_WARNING ? "warning: " : "", d->text);
        (void)fprintf(to, "\n  %s%s[%s]\n", d->hint ? d->hint : "", d->hint ? "  " : "", d->id);
    }
    size_t unseen = list->error_count + list->warning_count - list->count;
    if (unseen)
        (void)fprintf(to, "and %zu more\n", unseen);
}

static char lower(char c)
{
    return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c;
}

/* Letters to insert, leave out, change, or swap with their neighbour (Damerau and Levenshtein, each
 * pair swapped once); capitals count as small ones. Words longer than WORD_MAX are far from
 * everything. */
static size_t edit_distance(const char *a, const char *b)
{
    size_t m = strlen(a), n = strlen(b);
    size_t rows[3][WORD_MAX + 1];
    if (m > WORD_MAX || n > WORD_MAX)
        return WORD_MAX;
    for (size_t j = 0; j <= n; j++)
        rows[0][j] = j;
    for (size_t i = 1; i <= m; i++) {
        size_t *row = rows[i % 3], *above = rows[(i + 2) % 3], *above2 = rows[(i + 1) % 3];
        row[0] = i;
        for (size_t j = 1; j <= n; j++) {
            size_t best = above[j - 1] + (lower(a[i - 1]) != lower(b[j - 1]));
            best = above[j] + 1 < best ? above[j] + 1 : best;
            best = row[j - 1] + 1 < best ? row[j - 1] + 1 : best;
            bool swapped = i > 1 && j > 1 && lower(a[i - 1]) == lower(b[j - 2]) &&
                           lower(a[i - 2]) == lower(b[j - 1]);
            row[j] = swapped && above2[j - 2] + 1 < best ? above2[j - 2] + 1 : best;
        }
    }
    return rows[m % 3][n];
}

/* A slip for every third letter, and one in two; a word of three or more that begins a known one
 * is one slip away from it. */
const char *diag_nearest(const char *word, const char *const *known, size_t known_count)
{
    const char *best = NULL;
    size_t bytes = strlen(word);
    size_t best_distance = (bytes + 1) / 3 + 1;
    for (size_t i = 0; i < known_count; i++) {
        size_t distance = edit_distance(word, known[i]);
        if (bytes >= 3 && distance > 1 && strncmp(word, known[i], bytes) == 0)
            distance = 1;
        if (distance < best_distance) {
            best_distance = distance;
            best = known[i];
        }
    }
    return best;
}
