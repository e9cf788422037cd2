/* Linear prediction of all inputs over a step, from the interface Jacobian.
 *
 * Directional derivatives of the FMUs linearise the components at a communication point; their connections join
 * them. From there on, with d the changes of all states and v those of all inputs,
 *
 *     d' = f + A d + B v + drift,     v = C d + D v + w(s),     d(0) = 0
 *
 * where w(s) are the changes of the inputs whose course is known. So  v = K (C d + w),  K = 1 / (1 - D),  and
 *
 *     d' = f + (A + B K C) d + B K w(s) + drift
 *
 * is solved up to h/3, 2h/3 and h by one step each of the L-stable Runge-Kutta method of order 3 whose three stages
 * have the same diagonal element (Alexander 1977, SIAM J. Numer. Anal. 14(6) 1006-1021). All stages share the matrix
 * W = 1 / (1 - gamma h/3 (A + B K C)),  which is kept as long as the linearisation and h.
 *
 * The drift is what an old linearisation misses: its error grew in proportion to its age T, and goes on like that
 * over the step: drift(s) = q (T s + s^2/2).
 *
 * Inputs fall into four kinds, by where they come from:
 *
 *     OPEN         a component with directional derivatives: predicted
 *     BY_SCENARIO  their course over the step is known
 *     LEADING      a component that has stepped already, because its future depends on no other: known
 *     CLOSED       a component without directional derivatives: extrapolated, and taken as known
 *
 * In LinearPrediction: slopes has A, B, C and D one after the other, all matrices column by column. f, x: derivatives
 * and values of the states; w: known inputs, course: their coefficients of s, s^2 and s^3, shape (3, m); felt: K
 * times that, push: B times that; v: changes of all inputs up to h/3, 2h/3 and h. kc: K C; closed: A + B K C;
 * inverse: W. f0, x0, w0: at the communication point before. through: D is not 0. age: steps since the linearisation,
 * since: time since then [s], last: length of the step before [s], length: of the step that W is made for.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double ALIKE = 1e-9;

#define GAMMA 0.43586652150845967
static const double NODES[] = {GAMMA, (1.0 + GAMMA) / 2.0, 1.0};
static const double EARLIER[][2] = {
    {0.0, 0.0},
    {(1.0 - GAMMA) / 2.0, 0.0},
    {-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25},
};

static void zero(double *values, int32_t n) { memset(values, 0, (size_t)n * sizeof *values); }
static void copy(double *to, const double *from, int32_t n) { memcpy(to, from, (size_t)n * sizeof *to); }

/* ---- matrices, stored column by column */

static void add_product(const double *matrix, const double *by, double *to, int32_t columns, int32_t wide) {
    for (int32_t first = 0; first < wide; first += BLOCK) {
        double sum[BLOCK];
        memcpy(sum, to + first, sizeof sum);
        for (int32_t j = 0; j < columns; j++) {
            if (by[j] == 0.0) continue;
            for (int i = 0; i < BLOCK; i++) sum[i] += matrix[j * wide + first + i] * by[j];
        }
        memcpy(to + first, sum, sizeof sum);
    }
}

static void subtract_row(double *restrict to, const double *restrict row, double factor, int32_t wide) {
    for (int32_t first = 0; first < wide; first += BLOCK)
        for (int j = 0; j < BLOCK; j++) to[first + j] -= row[first + j] * factor;
}

static void exchange(double *a, double *b, int32_t n, int32_t apart) {
    for (int32_t j = 0; j < n; j++) {
        const double kept = a[j * apart];
        a[j * apart] = b[j * apart], b[j * apart] = kept;
    }
}

int32_t prediction_invert(double *a, int32_t *rows, int32_t n, int32_t wide) {
    for (int32_t k = 0; k < n; k++) {
        double *own = a + k * wide;
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * wide + k]) > fabs(a[best * wide + k])) best = i;
        rows[k] = best;
        if (best != k) exchange(own, a + best * wide, n, 1);
        const double pivot = own[k];
        if (pivot == 0.0 || !(fabs(pivot) < INFINITY)) return 0;
        own[k] = 1.0;
        for (int32_t j = 0; j < wide; j++) own[j] /= pivot;
        for (int32_t i = 0; i < n; i++) {
            double *other = a + i * wide;
            const double factor = other[k];
            if (i == k || factor == 0.0) continue;
            other[k] = 0.0;
            subtract_row(other, own, factor, wide);
        }
    }
    for (int32_t k = n - 1; k >= 0; k--)
        if (rows[k] != k) exchange(a + k, a + rows[k], n, wide);
    return 1;
}

/* One minus a share of a matrix. */
static void rest_of(double *a, const double *matrix, double share, int32_t n, int32_t wide) {
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < wide; j++) a[i * wide + j] = (i == j) - share * matrix[i * wide + j];
}

/* ---- the components */

static int linearise(Simulation *sim, const LinearPrediction *p) {
    for (int32_t k = 0; k < p->column_count; k++) {
        const SlopeColumn *one = &p->columns[k];
        const int verdict = directional_derivative(sim, &one->derivative);
        if (verdict) return verdict;
        for (int32_t i = 0; i < one->entries; i++)
            p->slopes[one->to[i]] = one->derivative.into[one->from[i]] * one->factor[i];
    }
    return CONTINUE;
}

/* ---- the linear system */

typedef struct { /* views of the slopes */
    const double *a, *b, *c, *d;
} Blocks;

static Blocks blocks(const LinearPrediction *p) {
    const double *a = p->slopes, *b = a + p->n * p->wide, *c = b + p->m * p->wide, *d = c + p->n * p->broad;
    return (Blocks){a, b, c, d};
}

void prediction_join(LinearPrediction *p) {
    const int32_t n = p->n, m = p->m, wide = p->wide, broad = p->broad;
    const Blocks of = blocks(p);
    p->length = 0.0, p->usable = 1;
    copy(p->kc, of.c, n * broad);
    if (p->through) {
        rest_of(p->k, of.d, 1.0, m, broad);
        p->usable = prediction_invert(p->k, p->rows, m, broad);
        zero(p->kc, n * broad);
        for (int32_t j = 0; j < n; j++) add_product(p->k, of.c + j * broad, p->kc + j * broad, m, broad);
    }
    copy(p->closed, of.a, n * wide);
    for (int32_t j = 0; j < n; j++) add_product(of.b, p->kc + j * broad, p->closed + j * wide, m, wide);
}

/* What known changes are to all inputs. */
static void reach_inputs(const LinearPrediction *p, const double *known, double *felt) {
    if (!p->through) {
        copy(felt, known, p->broad);
        return;
    }
    zero(felt, p->broad);
    add_product(p->k, known, felt, p->m, p->broad);
}

void prediction_find_drift(const LinearPrediction *p) {
    double *moved = p->stages, *felt = p->felt, *before = p->felt + p->broad;
    zero(p->q, p->wide);
    if (p->since == 0.0) return;
    for (int32_t i = 0; i < p->wide; i++) moved[i] = p->x[i] - p->x0[i];
    add_product(p->closed, moved, p->q, p->n, p->wide);
    reach_inputs(p, p->w, felt);
    reach_inputs(p, p->w0, before);
    for (int32_t i = 0; i < p->broad; i++) felt[i] -= before[i];
    add_product(blocks(p).b, felt, p->q, p->m, p->wide);
    const double over = p->last * (p->since - 0.5 * p->last);
    for (int32_t i = 0; i < p->wide; i++) p->q[i] = (p->f[i] - p->f0[i] - p->q[i]) / over;
}

void prediction_prepare(LinearPrediction *p, double h) {
    if (!p->usable || fabs(h - p->length) <= ALIKE * h) return;
    p->length = h;
    rest_of(p->inverse, p->closed, GAMMA * (h / 3.0), p->n, p->wide);
    p->usable = prediction_invert(p->inverse, p->rows, p->n, p->wide);
}

/* Polynomials of s with the coefficients c of s, s^2 and s^3. */
static double curve(const double *c, int32_t i, int32_t n, double s) {
    return s * (c[i] + s * (c[n + i] + s * c[2 * n + i]));
}

void prediction_solve(const LinearPrediction *p) {
    const int32_t wide = p->wide, broad = p->broad;
    double *d = p->stages, *base = d + wide, *stage = base + wide, *forcing = stage + wide;
    double *rates[] = {forcing + wide, forcing + 2 * wide, forcing + 3 * wide};
    const double delta = p->length / 3.0, share = GAMMA * delta;
    zero(d, wide);
    zero(p->push, 3 * wide);
    for (int k = 0; k < 3; k++) {
        reach_inputs(p, p->course + k * broad, p->felt + k * broad);
        add_product(blocks(p).b, p->felt + k * broad, p->push + k * wide, p->m, wide);
    }
    for (int32_t third = 0; third < 3; third++) {
        for (int k = 0; k < 3; k++) {
            const double s = delta * (third + NODES[k]), grown = p->since * s + 0.5 * s * s;
            copy(base, d, wide);
            for (int j = 0; j < k; j++) {
                const double weight = delta * EARLIER[k][j];
                for (int32_t i = 0; i < wide; i++) base[i] += weight * rates[j][i];
            }
            for (int32_t i = 0; i < wide; i++)
                forcing[i] = base[i] + share * (p->f[i] + grown * p->q[i] + curve(p->push, i, wide, s));
            zero(stage, wide);
            add_product(p->inverse, forcing, stage, p->n, wide);
            for (int32_t i = 0; i < wide; i++) rates[k][i] = (stage[i] - base[i]) / share;
        }
        copy(d, stage, wide);
        double *v = p->v + third * broad;
        for (int32_t i = 0; i < broad; i++) v[i] = curve(p->felt, i, broad, delta * (third + 1));
        add_product(p->kc, d, v, p->n, broad);
    }
}

/* ---- at every step */

static void take_known(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    if (p->kinds[i] == LEADING) input_interpolate(s, DEGREE, h, sim->length);
    else if (p->kinds[i] == CLOSED) input_extrapolate(s, h, sim->length);
    p->w[i] = s->value;
    for (int k = 0; k < DEGREE; k++) p->course[k * p->broad + i] = s->c[k + 1];
}

static void give_predicted(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    const double v1 = p->v[i], v2 = p->v[p->broad + i], v3 = p->v[2 * p->broad + i];
    if (p->usable && fabs(v1) + fabs(v2) + fabs(v3) < INFINITY) input_take_prediction(s, v1, v2, v3, h);
    else input_extrapolate(s, h, sim->length);
}

int predict_inputs(Simulation *sim, double h) {
    LinearPrediction *p = sim->prediction;
    for (int32_t i = 0; i < p->m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] != OPEN) take_known(sim, p, i, h);
    int verdict = carry_out(sim, &p->rates);
    if (!verdict && p->lag > 1) verdict = carry_out(sim, &p->values);
    if (verdict) return verdict;
    if (p->age >= p->lag || !p->usable) {
        verdict = linearise(sim, p);
        if (verdict) return verdict;
        prediction_join(p);
        p->age = 0, p->since = 0.0;
    }
    if (p->lag > 1) prediction_find_drift(p);
    prediction_prepare(p, h);
    if (p->usable) prediction_solve(p);
    for (int32_t i = 0; i < p->m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] == OPEN) give_predicted(sim, p, i, h);
    return CONTINUE;
}

void prediction_accept(LinearPrediction *p, double h) {
    copy(p->f0, p->f, p->wide);
    copy(p->x0, p->x, p->wide);
    copy(p->w0, p->w, p->broad);
    p->age++;
    p->since += h;
    p->last = h;
}
