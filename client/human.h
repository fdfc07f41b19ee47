/* client/human.h: numbers as people read them. Pure; any thread. */
#ifndef CLIENT_HUMAN_H
#define CLIENT_HUMAN_H

#include <stddef.h>
#include <stdint.h>

enum { HUMAN_BYTES = 40 };

/* "3 s", "1 min 12 s", "2 h 5 min". */
void human_duration(double seconds, char out[HUMAN_BYTES]);

/* "38-52 s", "2-3 min", "45 s" when both ends read the same; two figures. */
void human_left(double low_s, double high_s, char out[HUMAN_BYTES]);

/* "38-52s", "2-3m": for tables. */
void human_left_short(double low_s, double high_s, char out[HUMAN_BYTES]);

/* "12s", "4m", "3h", "2d". */
void human_age(double seconds, char out[HUMAN_BYTES]);

/* "119 Mray/s". */
void human_rays(double rays_s, char out[HUMAN_BYTES]);

/* "24.9 MB". */
void human_bytes(double bytes, char out[HUMAN_BYTES]);

/* "1,234,567". */
void human_count(double count, char out[HUMAN_BYTES]);

/* "1 mesh", "1,234 meshes". */
void human_things(double count, const char *one, const char *more, char out[HUMAN_BYTES]);

/* An error with three figures: "0.0210", "1.2e-05"; "-" for NaN. */
void human_error(double v, char out[HUMAN_BYTES]);

#endif
