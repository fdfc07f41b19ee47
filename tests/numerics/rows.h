/* tests/numerics/rows.h: one test case a row of the matrix of extremes.
 *
 * docs/NUMERICS.md has the matrix. A row's case is named test_tNN_..., so that
 * `ctest -L numerics -N` lists them; numerics.cmake registers each as a test of its own. A
 * program of rows runs all its cases, or those that its arguments say:
 *
 *   PROGRAM [--long] [CASE | --but-rows]
 *
 * --but-rows leaves out the rows of the matrix, which ctest runs one by one. A CASE that does not
 * exist is a failure. --long: the matrix's full counts instead of some seconds' worth.
 */
#ifndef TESTS_NUMERICS_ROWS_H
#define TESTS_NUMERICS_ROWS_H

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <stdio.h>
#include <string.h>

static bool rows_long;

static inline bool rows_is_row(const char *name)
{
    return strncmp(name, "test_t", 6) == 0 && name[6] >= '0' && name[6] <= '9';
}

static inline int rows_run(int argc, char **argv, const struct CMUnitTest *tests, size_t count)
{
    const char *only = NULL;
    struct CMUnitTest chosen[64];
    size_t chosen_count = 0;
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--long") == 0)
            rows_long = true;
        else
            only = argv[i];
    }
    for (size_t i = 0; i < count && chosen_count < sizeof chosen / sizeof *chosen; i++) {
        bool but_rows = only && strcmp(only, "--but-rows") == 0;
        if (!only || (but_rows ? !rows_is_row(tests[i].name) : strcmp(only, tests[i].name) == 0))
            chosen[chosen_count++] = tests[i];
    }
    if (chosen_count == 0 && only && strcmp(only, "--but-rows") == 0) {
        printf("every case is a row: ctest runs each by itself\n");
        return 0;
    }
    if (chosen_count == 0) {
        (void)fprintf(stderr, "no case \"%s\" in %s\n", only ? only : "", argv[0]);
        return 1;
    }
    return _cmocka_run_group_tests("rows", chosen, chosen_count, NULL, NULL);
}

#define ROWS_RUN(argc, argv, tests)                                                                \
    rows_run((argc), (argv), (tests), sizeof(tests) / sizeof *(tests))

#endif
