/* render_self_test gives the same bits each time, under any floating-point state of the caller. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <string.h>

#include "worker/render/render.h"

static void repeats(void **state)
{
    (void)state;
    struct render_scratch *scratch;
    unsigned char first[32] = {0}, second[32] = {1};
    assert_int_equal(render_scratch_new(&scratch), ERR_OK);
    assert_int_equal(render_self_test(scratch, first), ERR_OK);
    assert_int_equal(render_self_test(scratch, second), ERR_OK);
    assert_memory_equal(first, second, sizeof first);
    render_scratch_free(scratch);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(repeats)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
