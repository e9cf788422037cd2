/* Opening of a metering edge, and its derivatives.

   The equations, and the order of the coefficients t, are those of fmus/components/opening_curve.py: ten
   commands; factors of s^2, s^3 and s^4 of the first piece; value and factors of s, s^2, s^3 of the others; the
   value after the last point. Only one piece is evaluated. */

#ifndef OPENING_CURVE_H
#define OPENING_CURVE_H

enum { CURVE_POINTS = 10, CURVE_ROWS = 13, CURVE_LAST = 45 };

/* The number of the piece that contains a command v > t[0]: 0 to 9. */
static inline int opening_curve_piece(double v, const double *t) {
    int i = 0;
    while (i < CURVE_POINTS - 1 && v >= t[i + 1]) i++;
    return i;
}

static inline double opening_curve(double v, const double *t) {
    if (!(v > t[0])) return 0.0;
    const int i = opening_curve_piece(v, t);
    if (i == CURVE_POINTS - 1) return t[CURVE_LAST];
    const double s = v - t[i], *row = t + CURVE_ROWS - 4 + 4 * i, *first = t + CURVE_POINTS;
    if (i == 0) return s * s * (first[0] + s * (first[1] + s * first[2]));
    return row[0] + s * (row[1] + s * (row[2] + s * row[3]));
}

static inline double opening_curve_slope(double v, const double *t) {
    if (!(v > t[0])) return 0.0;
    const int i = opening_curve_piece(v, t);
    if (i == CURVE_POINTS - 1) return 0.0;
    const double s = v - t[i], *row = t + CURVE_ROWS - 4 + 4 * i, *first = t + CURVE_POINTS;
    if (i == 0) return s * (2.0 * first[0] + s * (3.0 * first[1] + s * 4.0 * first[2]));
    return row[1] + s * (2.0 * row[2] + s * 3.0 * row[3]);
}

/* Derivative along a direction of the command, dv, and of the coefficients, dt. */
static inline double opening_curve_along(double v, const double *t, double dv, const double *dt) {
    if (!(v > t[0])) return 0.0;
    const int i = opening_curve_piece(v, t);
    if (i == CURVE_POINTS - 1) return dt[CURVE_LAST];
    const double s = v - t[i], *row = dt + CURVE_ROWS - 4 + 4 * i, *first = dt + CURVE_POINTS;
    const double moved = opening_curve_slope(v, t) * (dv - dt[i]);
    if (i == 0) return moved + s * s * (first[0] + s * (first[1] + s * first[2]));
    return moved + row[0] + s * (row[1] + s * (row[2] + s * row[3]));
}

#endif
