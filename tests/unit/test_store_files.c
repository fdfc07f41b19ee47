/* Segment files: of any number of jobs at a time, taken back whole, and deleted with all that a
 * kill left beside them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/store_files.h"

enum { JOBS = SEGMENTS_OPEN_MAX + 9, ROUNDS = 3, BODY_BYTES = 40 };

static char folder[64];
static struct segments segments;
static struct segment_place places[ROUNDS][JOBS + 1];

static int set_up(void **state)
{
    (void)state;
    char jobs[80];
    (void)snprintf(folder, sizeof folder, "/tmp/test_store_files.XXXXXX");
    assert_non_null(mkdtemp(folder));
    (void)snprintf(jobs, sizeof jobs, "%s/jobs", folder);
    assert_int_equal(mkdir(jobs, 0700), 0);
    assert_int_equal(segments_init(&segments, folder), ERR_OK);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    char command[128];
    segments_release(&segments);
    (void)snprintf(command, sizeof command, "rm -rf '%s'", folder);
    return system(command);
}

/* One record of each job, told by its epoch. */
static void append_round(int round)
{
    for (uint64_t job = 1; job <= JOBS; job++) {
        unsigned char body[BODY_BYTES];
        struct journal_result r = {.job = job,
                                   .sequence = (uint64_t)round + 1,
                                   .unit = {0, 1, 0},
                                   .epoch = (uint64_t)round * 1000 + job,
                                   .raw_bytes = BODY_BYTES,
                                   .body_bytes = BODY_BYTES};
        memset(body, (int)(r.epoch % 251), sizeof body);
        assert_int_equal(segments_append(&segments, &r, body, &places[round][job]), ERR_OK);
    }
}

static void check_round(int round)
{
    for (uint64_t job = 1; job <= JOBS; job++) {
        unsigned char *data = NULL;
        const unsigned char *body;
        struct journal_result r;
        assert_int_equal(segment_read(folder, job, &places[round][job], &data, &r, &body), ERR_OK);
        assert_int_equal(r.epoch, (uint64_t)round * 1000 + job);
        assert_int_equal(body[BODY_BYTES - 1], r.epoch % 251);
        mem_free(data);
    }
}

/* Such a batch once failed whole for want of another open file, and paused every job in it. */
static void test_batches_of_many_jobs(void **state)
{
    (void)state;
    for (int round = 0; round < ROUNDS; round++) {
        append_round(round);
        assert_int_equal(segments_sync(&segments), ERR_OK);
        segments_commit(&segments);
    }
    for (int round = 0; round < ROUNDS; round++)
        check_round(round);
}

static void test_batch_that_fails(void **state)
{
    (void)state;
    append_round(0);
    assert_int_equal(segments_sync(&segments), ERR_OK);
    segments_commit(&segments);
    append_round(1);
    segments_rollback(&segments);
    append_round(2);
    assert_int_equal(segments_sync(&segments), ERR_OK);
    segments_commit(&segments);
    check_round(0);
    check_round(2);
}

/* A checkpoint half-written by a kill once kept the folder for ever. */
static void test_deletion(void **state)
{
    (void)state;
    char *path = segments_job_path(folder, 1), *film = segments_film_path(folder, 1);
    assert_non_null(path);
    assert_non_null(film);
    append_round(0);
    segments_commit(&segments);
    char *const left[] = {film, mem_sprintf("%s.new", film)};
    for (int i = 0; i < 2; i++) {
        int fd = open(left[i], O_WRONLY | O_CREAT, 0600);
        assert_true(fd >= 0);
        (void)close(fd);
    }
    segments_delete_job(&segments, 1);
    assert_int_not_equal(access(path, F_OK), 0);
    segments_delete_job(&segments, 1); /* it is gone: nothing happens */
    mem_free(left[1]);
    mem_free(film);
    mem_free(path);
}

int main(void)
{
    log_set_level(LOG_ERROR);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_batches_of_many_jobs, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_batch_that_fails, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_deletion, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
