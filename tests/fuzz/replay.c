/* Runs a fuzz target over every file of a corpus, as a plain test.
 *
 * usage: TARGET FILE-OR-FOLDER...; prints how many inputs ran; 1 if there was none.
 * Also over every prefix of small inputs, which is what a cut connection or disk gives.
 */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/file_io.h"
#include "common/mem.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

enum { PREFIX_BYTES_MAX = 4096, INPUT_BYTES_MAX = 64 << 20 };

static size_t input_count;

/* Each input gets memory of exactly its size, so that a read past its end is seen by ASan. */
static void run_copy(const char *data, size_t bytes)
{
    uint8_t *copy = mem_alloc(bytes);
    if (!copy)
        abort();
    memcpy(copy, data, bytes);
    (void)LLVMFuzzerTestOneInput(copy, bytes);
    mem_free(copy);
}

static bool run_file(const char *path)
{
    char *data;
    size_t bytes;
    if (file_read(path, INPUT_BYTES_MAX, &data, &bytes) != ERR_OK) {
        (void)fprintf(stderr, "%s: cannot be read\n", path);
        return false;
    }
    run_copy(data, bytes);
    size_t step = bytes <= PREFIX_BYTES_MAX ? 1 : bytes;
    for (size_t cut = 0; cut < bytes; cut += step)
        run_copy(data, cut);
    mem_free(data);
    input_count++;
    return true;
}

static bool run_folder(const char *path)
{
    DIR *dir = opendir(path);
    bool good = dir != NULL;
    for (struct dirent *entry = dir ? readdir(dir) : NULL; entry && good; entry = readdir(dir)) {
        if (entry->d_name[0] == '.')
            continue;
        char *file = file_join(path, entry->d_name);
        good = file && run_file(file);
        mem_free(file);
    }
    if (dir)
        (void)closedir(dir);
    return good;
}

int main(int argc, char **argv)
{
    bool good = argc > 1;
    for (int i = 1; i < argc && good; i++) {
        struct stat st;
        good = stat(argv[i], &st) == 0 && (S_ISDIR(st.st_mode) ? run_folder : run_file)(argv[i]);
    }
    printf("%zu inputs replayed\n", input_count);
    return good && input_count > 0 ? 0 : 1;
}
