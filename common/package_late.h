/* common/package_late.h: which pictures of a package may come after the first unit.
 *
 * A worker builds a scene without its late pictures and fetches each when a path of light first
 * meets a surface that shows it. That pays where there are many and large ones, of which the
 * camera may see few; elsewhere all is fetched before the first unit. What building reads is never
 * late: the sky, textures of what emits, and textures whose opacity decides which rays go on.
 * Pictures in pieces (package.h) are there to be late: of them, base and pieces come each when they
 * are met.
 *
 * Pure; any thread. Test: test_package_late.
 */
#ifndef COMMON_PACKAGE_LATE_H
#define COMMON_PACKAGE_LATE_H

#include "common/package.h"

/* A picture of fewer plain bytes costs about as much to ask for as to send; and fewer pictures, or
 * fewer bytes of them in all, are not worth a unit's second run. Of pictures that are whole. */
enum {
    PACKAGE_LATE_BYTES_MIN = 256 << 10,
    PACKAGE_LATE_COUNT_MIN = 8,
    PACKAGE_LATE_SUM_MIN = 16 << 20,
};

/* Sets may[i] for each image of a scene (or its tables): nothing that building reads shows it. */
void package_late_may(const struct scene *tables, bool *may);

/* Sets late[i] for each entry i of the index, and gives how many pictures are late. Both are of one
 * package_tables_read. */
size_t package_late_choose(const struct scene *tables, const struct package_index *index,
                           bool *late);

#endif
