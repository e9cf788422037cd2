/* An input over one communication step, as a cubic polynomial of the time since its beginning:
 *
 *     u(s) = c0 + c1 s + c2 s^2 + c3 s^3,   0 <= s <= h                                   s, h in [s]
 *
 * What a source did is known by value and slope at communication points; here is what follows from that for the step
 * to come (extrapolation) and, once the source has been there, for the step itself (interpolation). An FMU that
 * cannot follow a cubic gets the straight line, or the constant, with the same mean (and, the line, the same first
 * moment) over the step: to what is linear in its input it does the same up to the order h^4 (line) or h^2
 * (constant) of the cubic itself. docs/coupling.md has the derivation and measured orders.
 *
 * length: of the step before this one [s], 0 at the start.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double CORNER = 1e-6; /* of two slopes: what differs by less is the same */

static void cubic(double c[], double c0, double c1, double c2, double c3) {
    c[0] = c0, c[1] = c1, c[2] = c2, c[3] = c3;
}

/* ---- polynomials ----------------------------------------------------------------------------- */

/* The polynomial of degree `order`, 0 to 3, that continues a source. */
static void extrapolated(const CouplingInput *s, int order, double length, double c[]) {
    const double a = s->slope, b = s->slope_before, chord = s->chord_before;
    if (order > s->known) order = s->known;
    if (order == 0) cubic(c, s->value, 0.0, 0.0, 0.0);
    else if (order == 1) cubic(c, s->value, a, 0.0, 0.0);
    else if (order == 2) cubic(c, s->value, a, (a - b) / (2.0 * length), 0.0);
    else cubic(c, s->value, a, (2.0 * a + b - 3.0 * chord) / length, (a + b - 2.0 * chord) / (length * length));
}

/* The polynomial of degree 1, 2 or 3 between values, and slopes, at both ends of the step. */
static void connected(CouplingInput *s, int degree, double h) {
    const double chord = (s->value_end - s->value) / h, a = s->slope, b = s->slope_end;
    if (degree == 1) cubic(s->c, s->value, chord, 0.0, 0.0);
    else if (degree == 2) cubic(s->c, s->value, a, (chord - a) / h, 0.0);
    else cubic(s->c, s->value, a, (3.0 * chord - 2.0 * a - b) / h, (a + b - 2.0 * chord) / (h * h));
}

/* The same polynomial with its time counted from `by`. */
void polynomial_shift(const double c[], double by, double shifted[]) {
    cubic(shifted, c[0] + by * (c[1] + by * (c[2] + by * c[3])), c[1] + by * (2.0 * c[2] + by * (3.0 * c[3])),
          c[2] + by * (3.0 * c[3]), c[3]);
}

double polynomial_mean(const double c[], double h) {
    return c[0] + h * (c[1] / 2.0 + h * (c[2] / 3.0 + h * c[3] / 4.0));
}

/* The nearest polynomial (least squares over the step) of the degree that an FMU can follow: 0, 1 or 3. */
void polynomial_project(double c[], int32_t degree, double h) {
    if (degree == 3) return;
    if (degree == 0) cubic(c, polynomial_mean(c, h), 0.0, 0.0, 0.0);
    else if (c[2] != 0.0 || c[3] != 0.0)
        cubic(c, c[0] - h * h * (c[2] / 6.0 + h * c[3] / 5.0), c[1] + h * (c[2] + 0.9 * h * c[3]), 0.0, 0.0);
}

double polynomial_value(const double c[], double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
double polynomial_slope(const double c[], double s) { return c[1] + s * (2.0 * c[2] + s * (3.0 * c[3])); }

/* ---- before the component steps ---------------------------------------------------------------- */

/* Goes straight to the value at the end; what that leaves out shows at the middle. */
void input_drive(CouplingInput *s, double middle, double value_end, double h) {
    s->value_end = value_end;
    connected(s, 1, h);
    s->expected = value_end + (middle - 0.5 * (s->value + value_end));
    s->weight = 1.0;
}

/* Continues the source over the step. */
void input_extrapolate(CouplingInput *s, double h, double length) {
    extrapolated(s, s->order, length, s->c);
    s->expected = polynomial_value(s->c, h);
    s->weight = 1.0;
    s->correction = 0.0;
}

/* Takes the predicted changes up to h/3, 2h/3 and h. What the prediction misses grows with the third power of time
 * or faster: its mean is a quarter of its end. */
void input_take_prediction(CouplingInput *s, double v1, double v2, double v3, double h) {
    cubic(s->c, s->value, (18.0 * v1 - 9.0 * v2 + 2.0 * v3) / (2.0 * h),
          (-45.0 * v1 + 36.0 * v2 - 9.0 * v3) / (2.0 * h * h),
          (27.0 * v1 - 27.0 * v2 + 9.0 * v3) / (2.0 * h * h * h));
    s->expected = polynomial_value(s->c, h);
    s->weight = 0.25;
    s->correction = 0.0;
}

/* Bends a predicted input to where its source has arrived. */
void input_end_at_source(CouplingInput *s, double h) {
    s->c[3] += (s->value_end - polynomial_value(s->c, h)) / (h * h * h);
}

/* An autonomous source with the slope of its chord at one end went straight; the other end is a corner. */
static int went_straight(const CouplingInput *s, double h) {
    if (!s->autonomous) return 0;
    const double chord = (s->value_end - s->value) / h;
    const double room = CORNER * (fabs(chord) + fabs(s->slope) + fabs(s->slope_end));
    return smaller(fabs(chord - s->slope), fabs(chord - s->slope_end)) <= room;
}

/* Connects both ends of the step. The error of a polynomial through both ends is a small part of that of one that
 * continues the past at the same degree: 1/4, about 1/16 and 1/64 at equal steps, by their remainders; the weight
 * has some safety on top, because the ends of a step have errors too. */
void input_interpolate(CouplingInput *s, int32_t degree, double h, double length) {
    double past[DEGREE + 1];
    const int usable = !s->known || went_straight(s, h) ? 1 : degree;
    connected(s, usable, h);
    extrapolated(s, usable, length, past);
    s->expected = polynomial_value(past, h);
    s->weight = 0.25;
    for (int i = 1; i < usable; i++) s->weight *= h / (h + length);
    s->correction = 0.0;
}

/* Corrects the input by what it lost over the step before. What a source continued at order k loses of its mean goes
 * with the length of the step to the power k + 1. That is a correction of the kind of NEPCE (Sadjina and Pedersen
 * 2020, Eng. Comput. 36, doi 10.1007/s00366-019-00783-4), of each signal by itself: with the means of effort and
 * flow right, so is the energy. */
void input_correct(CouplingInput *s, double h, double length) {
    if (length == 0.0) return;
    double part = h / length;
    for (int i = 0; i < s->order; i++) part *= h / length;
    s->correction = part * s->lost;
    s->c[0] = s->c[0] + s->correction;
}

/* ---- after its source has stepped ---------------------------------------------------------------- */

/* Notes the source at the start of the run. */
void input_begin(CouplingInput *s, double value, double slope) {
    s->value = value, s->slope = slope;
    s->scale = larger(s->scale, fabs(value));
    s->known = s->slope_index == NO_SLOPE ? 0 : 1;
    cubic(s->c, value, slope, 0.0, 0.0);
}

/* The slope at the end from the last four values (three, two), by divided differences. */
static double backward_slope(const CouplingInput *s, double h, double length, double before) {
    const double first = (s->value_end - s->value) / h;
    if (length == 0.0) return first;
    const double second = (first - s->chord_before) / (h + length);
    if (before == 0.0) return first + h * second;
    return first + h * (second + (h + length) * (second - s->bend_before) / (h + length + before));
}

/* Notes the source at the end of the step; `before`: length of the step before the last one [s]. */
void input_arrive(CouplingInput *s, double value, double slope, double h, double length, double before) {
    s->value_end = value;
    s->slope_end = s->slope_index == NO_SLOPE ? backward_slope(s, h, length, before) : slope;
}

static double true_mean(const CouplingInput *s, double h) {
    return 0.5 * (s->value + s->value_end) + h * (s->slope - s->slope_end) / 12.0;
}

/* The end of this step is the beginning of the next one. */
void input_accept(CouplingInput *s, double h, double length) {
    s->lost = true_mean(s, h) - (polynomial_mean(s->c, h) - s->correction);
    const double first = (s->value_end - s->value) / h;
    s->bend_before = length > 0.0 ? (first - s->chord_before) / (h + length) : 0.0;
    s->chord_before = first;
    s->slope_before = s->slope;
    s->slope = s->slope_end;
    s->value = s->value_end;
    s->known += s->known == 1 ? 2 : 1;
    if (s->known > 3) s->known = 3;
    s->scale = larger(s->scale, fabs(s->value));
}

/* ---- how far off the input was ------------------------------------------------------------------- */

/* What errors are compared with; 0 only while the signal always was 0. */
double input_magnitude(const CouplingInput *s) { return larger(s->scale, fabs(s->value_end)); }

/* A deviation as a share of the magnitude. */
double input_share(const CouplingInput *s, double deviation) {
    const double size = input_magnitude(s);
    return size > 0.0 ? fabs(deviation) / size : 0.0;
}

/* What another pass could change: how far value and slope of the input end from those of the source. */
double input_mismatch(const CouplingInput *s, double h) {
    double off = fabs(polynomial_value(s->c, h) - s->value_end);
    if (!s->autonomous) off = larger(off, h * fabs(polynomial_slope(s->c, h) - s->slope_end));
    return input_share(s, off);
}

/* How far the input was from the truth, estimated: what was expected less what came; after several passes also where
 * the input ended off its source. */
double input_deviation(const CouplingInput *s, double h, int32_t repeated) {
    double off = s->weight * (s->expected - s->value_end);
    const double at_end = polynomial_value(s->c, h) - s->value_end;
    if (repeated && fabs(at_end) > fabs(off)) off = at_end;
    return off;
}

/* How far the mean of the input was from that of the source. */
double input_mean_error(const CouplingInput *s, double h) { return true_mean(s, h) - polynomial_mean(s->c, h); }
