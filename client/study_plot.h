/* client/study_plot.h: core-seconds against relMSE, on logarithmic axes.
 *
 * 95 % bars, the Pareto front as steps, and diagonals of equal efficiency: along one of them, ten
 * times the work buys a tenth of the error. One thread.
 */
#ifndef CLIENT_STUDY_PLOT_H
#define CLIENT_STUDY_PLOT_H

#include "client/canvas.h"
#include "client/study.h"

enum { STUDY_PLOT_WIDTH = 1100, STUDY_PLOT_HEIGHT = 700 };

/* Draws onto a canvas of that size. */
void study_plot(const struct study *s, struct canvas *c);

/* Colour and shape that stand for a knob, in plot and page. */
enum canvas_ink study_ink(enum study_knob knob);
enum canvas_shape study_shape(enum study_knob knob);

#endif
