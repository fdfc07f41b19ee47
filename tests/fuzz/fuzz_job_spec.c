/* Fuzzes job specs: what is accepted is valid and survives its own text. */
#include <stdint.h>
#include <string.h>

#include "common/job_spec.h"
#include "common/mem.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct job_spec spec, back;
    diag_init(&problems);
    if (job_spec_from_json((const char *)data, bytes, &spec, &problems) == ERR_OK) {
        TL_ASSERT(job_spec_valid(&spec, NULL));
        char *text = job_spec_to_json(&spec);
        TL_ASSERT(text && job_spec_from_json(text, strlen(text), &back, &problems) == ERR_OK);
        char *again = job_spec_to_json(&back);
        TL_ASSERT(again && strcmp(text, again) == 0);
        mem_free(text);
        mem_free(again);
    }
    diag_release(&problems);
    return 0;
}
