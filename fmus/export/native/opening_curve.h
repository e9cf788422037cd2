/* Opening of a metering edge from a table, and its derivative with respect to the command.

   The equations, and the order of the coefficients t, are those of fmus/components/opening_curve.py: ten
   commands; factors of s^2 and s^3 of the first piece; value and factors of s, s^2, s^3 of the others; the
   value after the last point. Only one piece is evaluated. */

#ifndef OPENING_CURVE_H
#define OPENING_CURVE_H

enum { CURVE_POINTS = 10, CURVE_LAST = 44 };

/* The number of the piece that contains a command v > t[0]: 0 to 9. */
static inline int opening_curve_piece(double v, const double *t) {
    int i = 0;
    for (int k = 1; k < CURVE_POINTS; k++) i += v >= t[k];
    return i;
}

static inline double opening_curve(double v, const double *t) {
    if (!(v > t[0])) return 0.0;
    const int i = opening_curve_piece(v, t);
    if (i == CURVE_POINTS - 1) return t[CURVE_LAST];
    const double s = v - t[i], *row = t + 8 + 4 * i;
    const double cubic = s * (row[2] + s * row[3]);
    return i == 0 ? s * cubic : row[0] + s * (row[1] + cubic);
}

static inline double opening_curve_slope(double v, const double *t) {
    if (!(v > t[0])) return 0.0;
    const int i = opening_curve_piece(v, t);
    if (i == CURVE_POINTS - 1) return 0.0;
    const double s = v - t[i], *row = t + 8 + 4 * i;
    return (i == 0 ? 0.0 : row[1]) + s * (2.0 * row[2] + 3.0 * s * row[3]);
}

#endif
