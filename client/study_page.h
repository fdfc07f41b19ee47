/* client/study_page.h: index.html of a study: one file without anything from elsewhere.
 *
 * Recommendations, the plot, a table of all points by knob, thumbnails and maps of where each
 * differs from the reference. Light or dark as the reader's browser is set. One thread.
 */
#ifndef CLIENT_STUDY_PAGE_H
#define CLIENT_STUDY_PAGE_H

#include "client/study.h"
#include "common/buf.h"

/* `svg` is the plot's text. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err study_put_page(const struct study *s, const struct buf *svg, struct buf *out);

#endif
