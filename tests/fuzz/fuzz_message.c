/* Messages: any meta bytes are refused or give a message that can be said again. First byte: the
 * type. */
#include <stdlib.h>
#include <string.h>

#include "proto/message.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes < 1)
        return 0;
    static struct message m, again;
    if (message_decode((enum frame_type)data[0], data + 1, bytes - 1, &m) != ERR_OK)
        return 0;

    unsigned char first[MESSAGE_BYTES_MAX], second[MESSAGE_BYTES_MAX];
    size_t first_bytes, second_bytes;
    if (message_encode(&m, first, &first_bytes) != ERR_OK ||
        message_decode(m.type, first, first_bytes, &again) != ERR_OK ||
        message_encode(&again, second, &second_bytes) != ERR_OK || first_bytes != second_bytes ||
        memcmp(first, second, first_bytes) != 0)
        abort();
    return 0;
}
