/* client/report_text.h: a job's report as the block of lines that ends a render. Pure. */
#ifndef CLIENT_REPORT_TEXT_H
#define CLIENT_REPORT_TEXT_H

#include "client/farm_api.h"

/* `report` is the object of GET /jobs/ID; `title` the file's or the job's name. Fields that are
 * null are left out. */
void report_text(const struct json *report, const char *title, struct buf *out);

#endif
