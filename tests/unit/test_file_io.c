/* Whole files: written whole or not at all, read only when regular. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"

static char folder[] = P_tmpdir "/tilery-files-XXXXXX";

static int make_folder(void **state)
{
    (void)state;
    return mkdtemp(folder) ? 0 : -1;
}

static int remove_folder(void **state)
{
    (void)state;
    return rmdir(folder);
}

static size_t entry_count(void)
{
    size_t count = 0;
    DIR *dir = opendir(folder);
    assert_non_null(dir);
    for (struct dirent *e = readdir(dir); e; e = readdir(dir))
        count += e->d_name[0] != '.';
    (void)closedir(dir);
    return count;
}

static void a_file_is_replaced_whole(void **state)
{
    (void)state;
    char *path = file_join(folder, "out.bin"), *data;
    size_t bytes;
    struct stat st;
    mode_t mask = umask(0027);
    assert_int_equal(file_write(path, "one", 3), ERR_OK);
    assert_int_equal(file_write(path, "two!", 4), ERR_OK);
    (void)umask(mask);
    assert_int_equal(stat(path, &st), 0);
    assert_int_equal(st.st_mode & 0777, 0640);
    assert_int_equal(entry_count(), 1);
    assert_int_equal(file_read(path, 100, &data, &bytes), ERR_OK);
    assert_int_equal(bytes, 4);
    assert_string_equal(data, "two!");
    mem_free(data);
    assert_int_equal(file_read(path, 3, &data, &bytes), ERR_LIMIT);
    (void)unlink(path);
    mem_free(path);
}

static void failures_leave_nothing(void **state)
{
    (void)state;
    char *missing = file_join(folder, "no/where.bin");
    assert_int_equal(file_write(missing, "x", 1), ERR_NOT_FOUND);
    assert_int_equal(file_write(folder, "x", 1), ERR_IO);
    assert_int_equal(file_write("/dev/full", "x", 1), ERR_NOSPACE);
    assert_int_equal(entry_count(), 0);
    mem_free(missing);
}

static void only_regular_files_are_read(void **state)
{
    (void)state;
    char *fifo = file_join(folder, "fifo"), *data;
    size_t bytes;
    assert_int_equal(mkfifo(fifo, 0600), 0);
    assert_int_equal(file_read(fifo, 100, &data, &bytes), ERR_IO); /* and does not wait */
    assert_int_equal(file_read(folder, 100, &data, &bytes), ERR_IO);
    assert_int_equal(file_read("/dev/zero", 100, &data, &bytes), ERR_IO);
    assert_int_equal(file_read("/nonexistent", 100, &data, &bytes), ERR_NOT_FOUND);
    (void)unlink(fifo);
    mem_free(fifo);
}

static char *hint_of(const char *name)
{
    char path[300];
    (void)snprintf(path, sizeof path, "%s/%s", folder, name);
    return file_missing_hint(path);
}

static void what_is_wrong_is_said(void **state)
{
    (void)state;
    assert_string_equal(file_read_why("/dev/null", ERR_IO), "a device or a pipe, not a file");
    assert_string_equal(file_read_why(folder, ERR_IO), "a folder");
    assert_string_equal(file_read_why("nothing", ERR_NOT_FOUND), "no such file");
    char path[300];
    (void)snprintf(path, sizeof path, "%s/a/b", folder);
    assert_string_equal(file_folder_why(path, ERR_NOT_FOUND),
                        "the folder that it is to be in is not there");
    assert_string_equal(file_folder_why("/dev/null", ERR_IO), "not a folder");
    assert_string_equal(file_folder_why("/dev/null/x", ERR_IO), "not a folder");
    assert_string_equal(file_folder_why(folder, ERR_NOSPACE), "disk full");
    assert_string_equal(file_folder_why(folder, ERR_IO), "input/output error");
    (void)snprintf(path, sizeof path, "%s/Scene.json", folder);
    assert_int_equal(file_write(path, "x", 1), ERR_OK);
    char *other = hint_of("SCENE.JSON"), *near = hint_of("Scnee.json"), *far = hint_of("none.exr");
    assert_non_null(strstr(other, "did you mean ") ? strstr(other, "/Scene.json?") : NULL);
    assert_non_null(strstr(near, "/Scene.json?"));
    assert_null(far);
    char *lost = hint_of("nowhere/a.json"), *here = file_missing_hint("no-such-name-at-all.exr");
    assert_non_null(strstr(lost, "there is no folder"));
    assert_non_null(strstr(here, "paths begin at /"));
    char *hints[] = {other, near, lost, here};
    for (size_t i = 0; i < 4; i++)
        mem_free(hints[i]);
    assert_int_equal(unlink(path), 0);
}

static void names_are_joined(void **state)
{
    (void)state;
    static const struct {
        const char *folder, *path, *joined;
    } cases[] = {{".", "a", "a"}, {"a/b", "c", "a/b/c"}, {"/", "c", "/c"}, {"a", "/c", "/c"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char *joined = file_join(cases[i].folder, cases[i].path);
        assert_string_equal(joined, cases[i].joined);
        mem_free(joined);
    }
    static const char *const folders[][2] = {{"a", "."}, {"/a", "/"}, {"a/b/c", "a/b"}};
    for (size_t i = 0; i < sizeof folders / sizeof *folders; i++) {
        char *of = file_folder(folders[i][0]);
        assert_string_equal(of, folders[i][1]);
        mem_free(of);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_file_is_replaced_whole),
        cmocka_unit_test(failures_leave_nothing),
        cmocka_unit_test(only_regular_files_are_read),
        cmocka_unit_test(what_is_wrong_is_said),
        cmocka_unit_test(names_are_joined),
    };
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
