/* Inputs that move inside a step; see signal.py and polynomial.py. */

#include <math.h>
#include <string.h>

#include "run.h"

static void cubic(double c[], double c0, double c1, double c2, double c3) {
    c[0] = c0, c[1] = c1, c[2] = c2, c[3] = c3;
}

void predict(Signal *s, int order, double step) {
    if (order > s->known) order = s->known;
    if (order == 0) cubic(s->c, s->value, 0.0, 0.0, 0.0);
    else if (order == 1 || step == 0.0) cubic(s->c, s->value, s->slope0, 0.0, 0.0);
    else cubic(s->c, s->value, s->slope0, (s->slope0 - s->before) / (2.0 * step), 0.0);
}

void interpolate(Signal *s, int degree, double h) {
    const double chord = (s->value1 - s->value) / h, a = s->slope0, b = s->slope1;
    if (!s->known || degree == 1) cubic(s->c, s->value, chord, 0.0, 0.0);
    else if (degree == 2) cubic(s->c, s->value, a, (chord - a) / h, 0.0);
    else cubic(s->c, s->value, a, (3.0 * chord - 2.0 * a - b) / h, (a + b - 2.0 * chord) / (h * h));
}

/* The slope at the end of a step of length h from values alone, of second order. */
static double backward(double value, double value1, double h, double chord, double step) {
    const double latest = (value1 - value) / h;
    return step == 0.0 ? latest : latest + (latest - chord) * h / (h + step);
}

double arrive(Signal *s, double value, double slope, double h, double step) {
    const double change = fabs(value - s->value1) / s->scale;
    s->value1 = value;
    s->slope1 = s->slope == NO_SLOPE ? backward(s->value, value, h, s->chord, step) : slope;
    return change;
}

void accept(Signal *s, double h) {
    s->chord = (s->value1 - s->value) / h;
    s->before = s->slope0;
    s->slope0 = s->slope1;
    s->value = s->value1;
    if (s->known < 2) s->known++;
}

void shift(const double c[], double by, double shifted[]) {
    cubic(shifted, c[0] + by * (c[1] + by * (c[2] + by * c[3])), c[1] + by * (2.0 * c[2] + by * (3.0 * c[3])),
          c[2] + by * (3.0 * c[3]), c[3]);
}

void project(double c[], int degree, double h) {
    if (degree == 3) return;
    if (degree == 0)
        cubic(c, c[0] + h * (c[1] / 2.0 + h * (c[2] / 3.0 + h * c[3] / 4.0)), 0.0, 0.0, 0.0);
    else if (c[2] != 0.0 || c[3] != 0.0)
        cubic(c, c[0] - h * h * (c[2] / 6.0 + h * c[3] / 5.0), c[1] + h * (c[2] + 0.9 * h * c[3]), 0.0, 0.0);
}

double value_at(const double c[], double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
