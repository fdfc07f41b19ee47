/* Tags: what is one, lists of them, and the bits of those that jobs ask for. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <stdio.h>
#include <string.h>

#include "master/tag_table.h"

static struct tags words(const char *list)
{
    struct tags t;
    assert_true(tags_parse(list, &t, NULL));
    return t;
}

static void test_lists(void **state)
{
    (void)state;
    static const char longest[] = "abcdefghijklmnopqrstuvwxyz-_.012";
    struct tags t;
    char bad[TAG_BYTES], list[TAG_LIST_BYTES];
    assert_true(tags_parse("", &t, bad) && t.count == 0);
    assert_true(tags_parse(longest, &t, bad) && t.count == 1);
    assert_true(tags_parse("big,site-b,Q_4.1", &t, bad) && t.count == 3);
    tags_list(&t, list);
    assert_string_equal(list, "big,site-b,Q_4.1");
    assert_true(tags_parse("a,b,c,d,e,f,g,h", &t, bad) && t.count == TAGS_MAX);
    static const struct {
        const char *list, *bad;
    } wrong[] = {
        {"a,b,c,d,e,f,g,h,i", "i"},
        {"big,small,big", "big"},
        {",", ""},
        {"a,,b", ""},
        {"a,", ""},
        {"a b", "a b"},
        {"caf\xc3\xa9", "caf\xc3\xa9"},
        {"a,abcdefghijklmnopqrstuvwxyz-_.0123", "abcdefghijklmnopqrstuvwxyz-_.012"},
    };
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        t.count = 77;
        assert_false(tags_parse(wrong[i].list, &t, bad));
        assert_string_equal(bad, wrong[i].bad);
        assert_int_equal(t.count, 77);
    }
}

static void test_bits_of_words(void **state)
{
    (void)state;
    struct tag_table t = {0};
    const struct tags big_b = words("big,site-b"), big = words("big"), all = words("x,big,site-b");
    uint64_t first, second;
    bool moved;
    assert_int_equal(tag_table_bits(&t, &all), 0);
    assert_true(tag_table_take(&t, &big_b, &first, &moved) && moved);
    assert_true(first != 0 && tag_table_bits(&t, &all) == first);
    assert_true(tag_table_take(&t, &big, &second, &moved) && !moved);
    assert_true((first & second) == second && first != second);
    tag_table_give(&t, first);
    /* `big` is still asked for: its bit stays where it is. */
    assert_true(tag_table_take(&t, &big_b, &first, &moved));
    assert_true((first & second) == second);
    const struct tags none = {.count = 0};
    assert_true(tag_table_take(&t, &none, &first, &moved) && first == 0 && !moved);
}

/* The 65th word must wait, and leaves no trace; a job that ends makes room. */
static void test_no_room(void **state)
{
    (void)state;
    struct tag_table t = {0};
    uint64_t bits[TAG_TABLE_WORDS], more;
    bool moved;
    for (int i = 0; i < TAG_TABLE_WORDS; i++) {
        char word[TAG_BYTES];
        (void)snprintf(word, sizeof word, "w%d", i);
        const struct tags one = words(word);
        assert_true(tag_table_take(&t, &one, &bits[i], &moved));
        for (int k = 0; k < i; k++)
            assert_true(bits[k] != bits[i]);
    }
    const struct tags two = words("w3,new"), fresh = words("new");
    assert_false(tag_table_take(&t, &two, &more, &moved));
    tag_table_give(&t, bits[3]); /* the failed try did not count for w3 */
    assert_true(tag_table_take(&t, &fresh, &more, &moved) && moved);
    assert_true(more == bits[3]);
    const struct tags old = words("w3");
    assert_int_equal(tag_table_bits(&t, &old), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_lists),
        cmocka_unit_test(test_bits_of_words),
        cmocka_unit_test(test_no_room),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
