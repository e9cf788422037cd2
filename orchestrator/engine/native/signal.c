/* Inputs that move inside a step; see signal.py and polynomial.py. */

#include <math.h>
#include <string.h>

#include "run.h"

static const double CORNER = 1e-6;

static void cubic(double c[], double c0, double c1, double c2, double c3) {
    c[0] = c0, c[1] = c1, c[2] = c2, c[3] = c3;
}

/* ---- polynomials ----------------------------------------------------------------------------- */

static void continued(const Signal *s, int order, double step, double c[]) {
    const double a = s->slope0, b = s->before, chord = s->chord;
    if (order > s->known) order = s->known;
    if (order == 0) cubic(c, s->value, 0.0, 0.0, 0.0);
    else if (order == 1) cubic(c, s->value, a, 0.0, 0.0);
    else if (order == 2) cubic(c, s->value, a, (a - b) / (2.0 * step), 0.0);
    else cubic(c, s->value, a, (2.0 * a + b - 3.0 * chord) / step, (a + b - 2.0 * chord) / (step * step));
}

static void connected(Signal *s, int degree, double h) {
    const double chord = (s->value1 - s->value) / h, a = s->slope0, b = s->slope1;
    if (degree == 1) cubic(s->c, s->value, chord, 0.0, 0.0);
    else if (degree == 2) cubic(s->c, s->value, a, (chord - a) / h, 0.0);
    else cubic(s->c, s->value, a, (3.0 * chord - 2.0 * a - b) / h, (a + b - 2.0 * chord) / (h * h));
}

void shift(const double c[], double by, double shifted[]) {
    cubic(shifted, c[0] + by * (c[1] + by * (c[2] + by * c[3])), c[1] + by * (2.0 * c[2] + by * (3.0 * c[3])),
          c[2] + by * (3.0 * c[3]), c[3]);
}

static double mean(const double c[], double h) {
    return c[0] + h * (c[1] / 2.0 + h * (c[2] / 3.0 + h * c[3] / 4.0));
}

void project(double c[], int degree, double h) {
    if (degree == 3) return;
    if (degree == 0) cubic(c, mean(c, h), 0.0, 0.0, 0.0);
    else if (c[2] != 0.0 || c[3] != 0.0)
        cubic(c, c[0] - h * h * (c[2] / 6.0 + h * c[3] / 5.0), c[1] + h * (c[2] + 0.9 * h * c[3]), 0.0, 0.0);
}

double value_at(const double c[], double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
double slope_at(const double c[], double s) { return c[1] + s * (2.0 * c[2] + s * (3.0 * c[3])); }

/* ---- before the component steps ---------------------------------------------------------------- */

void drive(Signal *s, double middle, double value1, double h) {
    s->value1 = value1;
    connected(s, 1, h);
    s->foretold = value1 + (middle - 0.5 * (s->value + value1));
    s->weight = 1.0;
}

void predict(Signal *s, double h, double step) {
    continued(s, s->order, step, s->c);
    s->foretold = value_at(s->c, h);
    s->weight = 1.0;
    s->returned = 0.0;
}

void foresee(Signal *s, double v1, double v2, double v3, double h) {
    cubic(s->c, s->value, (18.0 * v1 - 9.0 * v2 + 2.0 * v3) / (2.0 * h),
          (-45.0 * v1 + 36.0 * v2 - 9.0 * v3) / (2.0 * h * h),
          (27.0 * v1 - 27.0 * v2 + 9.0 * v3) / (2.0 * h * h * h));
    s->foretold = value_at(s->c, h);
    s->weight = 0.25;
    s->returned = 0.0;
}

void hit(Signal *s, double h) { s->c[3] += (s->value1 - value_at(s->c, h)) / (h * h * h); }

static int straight(const Signal *s, double h) {
    if (!s->free) return 0;
    const double chord = (s->value1 - s->value) / h;
    const double room = CORNER * (fabs(chord) + fabs(s->slope0) + fabs(s->slope1));
    return smaller(fabs(chord - s->slope0), fabs(chord - s->slope1)) <= room;
}

void interpolate(Signal *s, int degree, double h, double step) {
    double past[DEGREE + 1];
    const int usable = !s->known || straight(s, h) ? 1 : degree;
    connected(s, usable, h);
    continued(s, usable, step, past);
    s->foretold = value_at(past, h);
    s->weight = 0.25;
    for (int i = 1; i < usable; i++) s->weight *= h / (h + step);
    s->returned = 0.0;
}

void give_back(Signal *s, double h, double step) {
    if (step == 0.0) return;
    double part = h / step;
    for (int i = 0; i < s->order; i++) part *= h / step;
    s->returned = part * s->lost;
    s->c[0] = s->c[0] + s->returned;
}

/* ---- after its source has stepped ---------------------------------------------------------------- */

static double backward(const Signal *s, double h, double step, double older) {
    const double first = (s->value1 - s->value) / h;
    if (step == 0.0) return first;
    const double second = (first - s->chord) / (h + step);
    if (older == 0.0) return first + h * second;
    return first + h * (second + (h + step) * (second - s->bend) / (h + step + older));
}

void arrive(Signal *s, double value, double slope, double h, double step, double older) {
    s->value1 = value;
    s->slope1 = s->slope == NO_SLOPE ? backward(s, h, step, older) : slope;
}

static double true_mean(const Signal *s, double h) {
    return 0.5 * (s->value + s->value1) + h * (s->slope0 - s->slope1) / 12.0;
}

void accept(Signal *s, double h, double step) {
    s->lost = true_mean(s, h) - (mean(s->c, h) - s->returned);
    const double first = (s->value1 - s->value) / h;
    s->bend = step > 0.0 ? (first - s->chord) / (h + step) : 0.0;
    s->chord = first;
    s->before = s->slope0;
    s->slope0 = s->slope1;
    s->value = s->value1;
    s->known += s->known == 1 ? 2 : 1;
    if (s->known > 3) s->known = 3;
    s->scale = larger(s->scale, fabs(s->value));
}

/* ---- how far off the input was ------------------------------------------------------------------- */

double magnitude(const Signal *s) { return larger(s->scale, fabs(s->value1)); }

double share(const Signal *s, double deviation) {
    const double size = magnitude(s);
    return size > 0.0 ? fabs(deviation) / size : 0.0;
}

double miss(const Signal *s, double h) {
    double off = fabs(value_at(s->c, h) - s->value1);
    if (!s->free) off = larger(off, h * fabs(slope_at(s->c, h) - s->slope1));
    return share(s, off);
}

double deviation(const Signal *s, double h, int repeated) {
    double off = s->weight * (s->foretold - s->value1);
    const double beside = value_at(s->c, h) - s->value1;
    if (repeated && fabs(beside) > fabs(off)) off = beside;
    return off;
}

double defect(const Signal *s, double h) { return true_mean(s, h) - mean(s->c, h); }
