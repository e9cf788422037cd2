/* One input over a communication step, as a cubic polynomial of the time s since the beginning of the step:
 *
 *     u(s) = c0 + c1 s + c2 s^2 + c3 s^3,   0 <= s <= h                                   s, h in [s]
 *
 * The polynomial follows from value and slope of the source at communication points: by extrapolation before the
 * source has stepped, by interpolation afterwards. An FMU that cannot follow a cubic gets a straight line with the same
 * mean and the same first moment over the step, or a constant with the same mean. A linear FMU then reaches the same
 * state as with the cubic, up to the order h^4 (line) or h^2 (constant). docs/coupling.md has the derivation and
 * measured orders.
 *
 * length: of the previous step [s], 0 at the start of the run.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double SAME_SLOPE = 1e-6; /* largest relative difference of two equal slopes */

static void cubic(Real c[], Real c0, Real c1, Real c2, Real c3) { c[0] = c0, c[1] = c1, c[2] = c2, c[3] = c3; }

/* ---- polynomials ----------------------------------------------------------------------------- */

/* The polynomial of degree `order`, 0 to 3, that continues a source beyond the last communication point. */
static void extrapolate(const CouplingInput *s, int order, Real length, Real c[]) {
    const Real a = s->slope, b = s->slope_before, chord = s->chord_before;
    length = where(length > 0.0, length, 1.0); /* at the start the past is a straight line */
    if (order == 0) cubic(c, s->value, 0.0, 0.0, 0.0);
    else if (order == 1) cubic(c, s->value, a, 0.0, 0.0);
    else if (order == 2) cubic(c, s->value, a, (a - b) / (2.0 * length), 0.0);
    else cubic(c, s->value, a, (2.0 * a + b - 3.0 * chord) / length, (a + b - 2.0 * chord) / (length * length));
}

/* The polynomial of degree 1, 2 or 3 through the values, and the slopes, at both ends of the step. */
static void interpolate(const CouplingInput *s, int degree, Real h, Real c[]) {
    const Real chord = (s->value_end - s->value) / h, a = s->slope, b = s->slope_end;
    if (degree == 1) cubic(c, s->value, chord, 0.0, 0.0);
    else if (degree == 2) cubic(c, s->value, a, (chord - a) / h, 0.0);
    else cubic(c, s->value, a, (3.0 * chord - 2.0 * a - b) / h, (a + b - 2.0 * chord) / (h * h));
}

/* The same polynomial with its time counted from `by` [s]. */
void polynomial_shift(const Real c[], Real by, Real shifted[]) {
    cubic(shifted, c[0] + by * (c[1] + by * (c[2] + by * c[3])), c[1] + by * (2.0 * c[2] + by * (3.0 * c[3])),
          c[2] + by * (3.0 * c[3]), c[3]);
}

Real polynomial_mean(const Real c[], Real h) { return c[0] + h * (c[1] / 2.0 + h * (c[2] / 3.0 + h * c[3] / 4.0)); }

/* The nearest polynomial (least squares over the step) of a degree that an FMU can follow: 0, 1 or 3. */
void polynomial_project(Real c[], int32_t degree, Real h) {
    if (degree == 3) return;
    if (degree == 0) cubic(c, polynomial_mean(c, h), 0.0, 0.0, 0.0);
    else if (any(c[2] != 0.0 || c[3] != 0.0))
        cubic(c, c[0] - h * h * (c[2] / 6.0 + h * c[3] / 5.0), c[1] + h * (c[2] + 0.9 * h * c[3]), 0.0, 0.0);
}

Real polynomial_value(const Real c[], Real s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
Real polynomial_slope(const Real c[], Real s) { return c[1] + s * (2.0 * c[2] + s * (3.0 * c[3])); }

/* ---- the polynomial of a step ---------------------------------------------------------------- */

/* An input driven by a scenario: a straight line to the value at the end; the value at the middle gives its error. */
void input_drive(CouplingInput *s, Real middle, Real value_end, Real h) {
    s->value_end = value_end;
    interpolate(s, 1, h, s->c);
    s->expected = value_end + (middle - 0.5 * (s->value + value_end));
    s->weight = 1.0;
}

/* Extrapolates the source over the step. */
void input_extrapolate(CouplingInput *s, Real h, Real length) {
    extrapolate(s, s->order, length, s->c);
    s->expected = polynomial_value(s->c, h);
    s->weight = 1.0;
}

/* The cubic through the predicted changes at h/3, 2h/3 and h. The error of the prediction grows with the third power of
 * time or faster, so its mean is a quarter of its value at the end. */
void input_predict(CouplingInput *s, Real v1, Real v2, Real v3, Real h) {
    cubic(s->c, s->value, (18.0 * v1 - 9.0 * v2 + 2.0 * v3) / (2.0 * h),
          (-45.0 * v1 + 36.0 * v2 - 9.0 * v3) / (2.0 * h * h),
          (27.0 * v1 - 27.0 * v2 + 9.0 * v3) / (2.0 * h * h * h));
    s->expected = polynomial_value(s->c, h);
    s->weight = 0.25;
}

/* Moves the end of a predicted input to the value that its source has reached. */
void input_end_at_source(CouplingInput *s, Real h) {
    s->c[3] += (s->value_end - polynomial_value(s->c, h)) / (h * h * h);
}

/* An autonomous source with the slope of its chord at one end is a straight line; its slope jumps at the other end. */
static Mask is_straight(const CouplingInput *s, Real h) {
    if (!s->autonomous) return NO_MACHINE;
    const Real chord = (s->value_end - s->value) / h;
    const Real tolerance = SAME_SLOPE * (fabs(chord) + fabs(s->slope) + fabs(s->slope_end));
    return smaller(fabs(chord - s->slope), fabs(chord - s->slope_end)) <= tolerance;
}

/* By the remainders, the error of this polynomial is 1/4, about 1/16 and 1/64 (degree 1, 2, 3; equal steps) of the
 * error of one that extrapolates at the same degree. The weight is somewhat larger, because the ends of a step have
 * errors too. */
static void interpolate_all(CouplingInput *s, int degree, Real h, Real length) {
    Real past[DEGREE + 1];
    interpolate(s, degree, h, s->c);
    extrapolate(s, degree, length, past);
    s->expected = polynomial_value(past, h);
    s->weight = 0.25;
    for (int i = 1; i < degree; i++) s->weight *= h / (h + length);
}

/* Interpolates between both ends of the step, along a straight line where the source is one. */
void input_interpolate(CouplingInput *s, int32_t degree, Real h, Real length) {
    if (degree == 1 || !s->slopes_known) {
        interpolate_all(s, 1, h, length);
        return;
    }
    const Mask straight = is_straight(s, h);
    if (!any(straight)) {
        interpolate_all(s, degree, h, length);
        return;
    }
    interpolate_all(s, 1, h, length);
    if (all(straight)) return;
    Real line[POLYNOMIAL];
    memcpy((void *)line, s->c, sizeof line);
    interpolate_all(s, degree, h, length);
    input_replace_polynomial(s, line, straight);
}

/* ---- the source at communication points ---------------------------------------------------------------- */

/* Sets the value and the slope of the source at the start of the run. Some FMUs give NaN for slopes before their first
 * step. */
void input_begin(CouplingInput *s, Real value, Real slope) {
    s->slopes_known = s->source_slope && any(is_finite(slope));
    s->value = value, s->slope = s->slopes_known ? where(is_finite(slope), slope, 0.0) : 0.0;
    s->slope_before = s->chord_before = s->slope;
    s->scale = larger(s->scale, fabs(value));
    cubic(s->c, value, s->slope, 0.0, 0.0);
}

/* The slope at the end of the step, by divided differences of the last four values (at the start three or two). */
static Real backward_slope(const CouplingInput *s, Real h, Real length, Real before) {
    const Real first = (s->value_end - s->value) / h;
    const Real second = (first - s->chord_before) / (h + length);
    const Real second_before = (s->chord_before - s->chord_earlier) / (length + before);
    const Real third = where(before > 0.0, (h + length) * (second - second_before) / (h + length + before), 0.0);
    return where(length > 0.0, first + h * (second + third), first);
}

/* Sets the source at the end of the step; `before`: length of the step before the previous one [s]. */
void input_set_end(CouplingInput *s, Real value, Real slope, Real h, Real length, Real before) {
    const int given = s->source_slope && all(is_finite(slope));
    s->value_end = value;
    s->slope_end = given ? slope : backward_slope(s, h, length, before);
    if (s->source_slope && !given) s->slope_end = where(is_finite(slope), slope, s->slope_end);
}

/* The source over the step, along the computed solution: the cubic through both ends. */
void input_true_course(const CouplingInput *s, Real h, Real c[]) {
    interpolate(s, any(is_straight(s, h)) ? 1 : DEGREE, h, c);
}

/* The end of this step is the beginning of the next one. If the slope at its beginning was not known, the past becomes
 * a straight line. */
void input_accept(CouplingInput *s, Real h) {
    s->chord_earlier = s->chord_before;
    s->chord_before = s->slopes_known ? (s->value_end - s->value) / h : s->slope_end;
    s->slope_before = s->slopes_known ? s->slope : s->slope_end;
    s->slope = s->slope_end;
    s->value = s->value_end;
    s->slopes_known = s->slopes_known ? 2 : 1;
    s->scale = larger(s->scale, fabs(s->value));
}

static void replace_some(Real *to, const Real *from, size_t count, Mask machines) {
    for (size_t i = 0; i < count; i++) to[i] = where(machines, from[i], to[i]);
}

/* Takes the polynomial and what is expected of it from an earlier one, for some machines. */
void input_replace_polynomial(CouplingInput *s, const Real by[], Mask machines) {
    replace_some(s->c, by, POLYNOMIAL, machines);
}

/* Takes all numbers of an input from another one, for some machines. */
void input_replace(CouplingInput *s, const CouplingInput *by, Mask machines) {
    replace_some(&s->value, &by->value, offsetof(CouplingInput, source_slope) / sizeof(Real), machines);
}

/* ---- the error of the input ------------------------------------------------------------------- */

/* The magnitude to which errors are relative; 0 only as long as the signal has always been 0. */
Real input_magnitude(const CouplingInput *s) { return larger(s->scale, fabs(s->value_end)); }

/* A deviation relative to the magnitude. */
Real input_relative(const CouplingInput *s, Real deviation) {
    const Real magnitude = input_magnitude(s);
    return where(magnitude > 0.0, fabs(deviation) / magnitude, 0.0);
}

/* The relative change that a further pass could make: from value and slope at the end of the input to those of the
 * source. */
Real input_mismatch(const CouplingInput *s, Real h) {
    Real deviation = fabs(polynomial_value(s->c, h) - s->value_end);
    if (!s->autonomous) deviation = larger(deviation, h * fabs(polynomial_slope(s->c, h) - s->slope_end));
    return input_relative(s, deviation);
}

/* Estimated deviation of the input from the truth: expected less actual value at the end; after several passes also the
 * distance of the end of the input from its source. */
Real input_deviation(const CouplingInput *s, Real h, int32_t repeated) {
    const Real deviation = s->weight * (s->expected - s->value_end);
    if (!repeated) return deviation;
    const Real at_end = polynomial_value(s->c, h) - s->value_end;
    return where(fabs(at_end) > fabs(deviation), at_end, deviation);
}
