/* Pictures appear whole or not at all. */
#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <dirent.h>

#include <cmocka.h>

#include "client/out_file.h"

static char folder[64], path[100];

static int make_folder(void **state)
{
    (void)state;
    (void)snprintf(folder, sizeof folder, "/tmp/test_cli_files_XXXXXX");
    if (!mkdtemp(folder))
        return -1;
    (void)snprintf(path, sizeof path, "%s/out.exr", folder);
    return 0;
}

static int remove_folder(void **state)
{
    (void)state;
    (void)unlink(path);
    return rmdir(folder); /* fails if anything was left beside */
}

static size_t entries(void)
{
    DIR *d = opendir(folder);
    size_t count = 0;
    assert_non_null(d);
    while (readdir(d))
        count++;
    (void)closedir(d);
    return count - 2;
}

static void content_is(const char *expected)
{
    char text[64] = "";
    int fd = open(path, O_RDONLY);
    assert_true(fd >= 0);
    ssize_t bytes = read(fd, text, sizeof text - 1);
    assert_true(bytes >= 0);
    assert_string_equal(text, expected);
    (void)close(fd);
}

static void write_file(const char *text)
{
    struct out_file f;
    assert_int_equal(out_file_begin(&f, path), ERR_OK);
    assert_int_equal(write(f.fd, text, strlen(text)), (int)strlen(text));
    assert_int_equal(out_file_commit(&f), ERR_OK);
}

static void test_commit(void **state)
{
    (void)state;
    write_file("one");
    content_is("one");
    write_file("two");
    content_is("two");
    assert_int_equal(entries(), 1);
}

static void test_abort(void **state)
{
    struct out_file f;
    (void)state;
    write_file("before");
    assert_int_equal(out_file_begin(&f, path), ERR_OK);
    assert_int_equal(write(f.fd, "half", 4), 4);
    content_is("before");
    out_file_abort(&f);
    out_file_abort(&f); /* harmless */
    content_is("before");
    assert_int_equal(entries(), 1);
}

/* The file behind a link is replaced, not the link; the longest names work. */
static void test_links_and_long_names(void **state)
{
    char link[100];
    struct stat found;
    (void)state;
    (void)snprintf(link, sizeof link, "%s/link.exr", folder);
    write_file("one");
    assert_int_equal(symlink(path, link), 0);
    struct out_file f;
    assert_int_equal(out_file_begin(&f, link), ERR_OK);
    assert_int_equal(write(f.fd, "two", 3), 3);
    assert_int_equal(out_file_commit(&f), ERR_OK);
    content_is("two");
    assert_int_equal(lstat(link, &found), 0);
    assert_true(S_ISLNK(found.st_mode));
    assert_int_equal(unlink(link), 0);

    char name[256], longest[400];
    /* 248 bytes: some overlay file systems keep a few of the 255 for themselves. */
    memset(name, 'n', 244);
    (void)snprintf(name + 244, sizeof name - 244, ".exr");
    (void)snprintf(longest, sizeof longest, "%s/%s", folder, name);
    assert_int_equal(out_file_begin(&f, longest), ERR_OK);
    assert_int_equal(out_file_commit(&f), ERR_OK);
    assert_int_equal(unlink(longest), 0);
}

static void test_check(void **state)
{
    (void)state;
    assert_int_equal(out_file_check(path, 1000), ERR_OK);
    assert_int_equal(entries(), 0);
    assert_int_equal(out_file_check(path, UINT64_C(1) << 60), ERR_NOSPACE);
    assert_int_equal(out_file_check(folder, 0), ERR_IO);
    assert_int_equal(errno, EISDIR);
    char deeper[200];
    (void)snprintf(deeper, sizeof deeper, "%s/none/out.exr", folder);
    assert_int_equal(out_file_check(deeper, 0), ERR_NOT_FOUND);
    assert_int_equal(out_file_check("/dev/null", 0), ERR_IO);
    assert_int_equal(entries(), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_commit, make_folder, remove_folder),
        cmocka_unit_test_setup_teardown(test_abort, make_folder, remove_folder),
        cmocka_unit_test_setup_teardown(test_links_and_long_names, make_folder, remove_folder),
        cmocka_unit_test_setup_teardown(test_check, make_folder, remove_folder),
    };
    return cmocka_run_group_tests_name("cli_files", tests, NULL, NULL);
}
