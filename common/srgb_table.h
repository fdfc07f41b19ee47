/* common/srgb_table.h: the 256 values of 8-bit sRGB as linear light (IEC 61966-2-1).
 *
 * A table, so that no transcendental function stands in the texel loop. Test: test_surface
 * compares it with dmath_srgb_decode.
 */
#ifndef COMMON_SRGB_TABLE_H
#define COMMON_SRGB_TABLE_H

extern const double srgb_table[256];

#endif
