/* client/study_write.h: a study as files: tradeoff.csv, tradeoff.json, presets. docs/TRADEOFF.md
 * describes them. All append to a buf. One thread.
 */
#ifndef CLIENT_STUDY_WRITE_H
#define CLIENT_STUDY_WRITE_H

#include "client/study.h"
#include "common/buf.h"

void study_put_csv(const struct study *s, struct buf *out);
void study_put_json(const struct study *s, struct buf *out);
void study_put_preset(const struct study *s, enum study_level level, struct buf *out);

/* "1.23 (95 %: 1.2 to 1.26)" */
void study_put_interval(struct stats_interval v, struct buf *out);

/* How a preset's error is known: "measured", "expected, ...". */
void study_preset_how(const struct study_preset *p, char *out, size_t bytes);

/* Bias^2 that is surely there: over two standard errors. */
bool study_biased(const struct study_point *p);

#endif
