#include "common/determinism.h"

#include <string.h>

digest determinism_id(const unsigned char self_test[32])
{
    unsigned char text[4 + 32];
    for (int i = 0; i < 4; i++)
        text[i] = (unsigned char)((unsigned)DETERMINISM_NUMBER >> (8 * i));
    memcpy(text + 4, self_test, 32);
    return digest_of(text, sizeof text);
}
