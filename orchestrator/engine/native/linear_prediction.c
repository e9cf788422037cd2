/* Linear prediction of all inputs over a step, from the interface Jacobian.
 *
 * Directional derivatives of the FMUs linearise the components at a communication point; the connections join the
 * linearised components to one system. With the changes d of all states and v of all inputs since that point,
 *
 *     d' = f + A d + B v + drift,     v = C d + D v + w(s),     d(0) = 0
 *
 * where w(s) are the changes of the inputs whose course over the step is given. So  v = K (C d + w),  K = 1 / (1 - D),
 * and
 *
 *     d' = f + (A + B K C) d + B K w(s) + drift
 *
 * is solved up to h/3, 2h/3 and h by one step each of the L-stable Runge-Kutta method of order 3 whose three stages
 * have the same diagonal element (Alexander 1977, SIAM J. Numer. Anal. 14(6) 1006-1021). All stages use the matrix
 * W = 1 / (1 - gamma h/3 (A + B K C)),  which is kept as long as the linearisation and h.
 *
 * The drift is the error of an old linearisation. Until now it has grown in proportion to the age T of the
 * linearisation, and it is assumed to do so over the step: drift(s) = q (T s + s^2/2).
 *
 * There are four kinds of inputs, by their source:
 *
 *     PREDICTED      a component with directional derivatives
 *     BY_SCENARIO    a scenario, so that the course over the step is given
 *     LEADING        a component that has stepped already, because it depends on no other: the course is interpolated
 *     EXTRAPOLATED   a component without directional derivatives: the extrapolated course is taken as given
 *
 * In LinearPrediction: `matrices` contains A, B, C and D, each column by column. f, x: derivatives and values of the
 * states. w: given inputs, course: their coefficients of s, s^2 and s^3, shape (3, m); response: K times course;
 * forcing: B times response. v: changes of all inputs until h/3, 2h/3 and h. kc: K C; closed_loop: A + B K C;
 * inverse: W. f0, x0, w0: values at the previous communication point. has_feedthrough: D is not 0. age: steps since the
 * linearisation, age_seconds: time since then [s]. last_step: length of the previous step [s], inverse_step: of the one
 * that W is made for.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double SAME_STEP = 1e-9; /* largest relative difference of two equal steps */

#define GAMMA 0.43586652150845967
static const double NODES[] = {GAMMA, (1.0 + GAMMA) / 2.0, 1.0};
static const double WEIGHTS[][2] = {
    {0.0, 0.0},
    {(1.0 - GAMMA) / 2.0, 0.0},
    {-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25},
};

static void zero(double *values, int32_t n) { memset(values, 0, (size_t)n * sizeof *values); }
static void copy(double *to, const double *from, int32_t n) { memcpy(to, from, (size_t)n * sizeof *to); }

/* ---- matrices, stored column by column */

static void add_product(const double *matrix, const double *by, double *to, int32_t columns, int32_t n_padded) {
    for (int32_t first = 0; first < n_padded; first += BLOCK) {
        double sum[BLOCK];
        memcpy(sum, to + first, sizeof sum);
        for (int32_t j = 0; j < columns; j++) {
            if (by[j] == 0.0) continue;
            for (int i = 0; i < BLOCK; i++) sum[i] += matrix[j * n_padded + first + i] * by[j];
        }
        memcpy(to + first, sum, sizeof sum);
    }
}

static void subtract_row(double *restrict to, const double *restrict row, double factor, int32_t n_padded) {
    for (int32_t first = 0; first < n_padded; first += BLOCK)
        for (int j = 0; j < BLOCK; j++) to[first + j] -= row[first + j] * factor;
}

static void exchange(double *a, double *b, int32_t n, int32_t stride) {
    for (int32_t j = 0; j < n; j++) {
        const double old = a[j * stride];
        a[j * stride] = b[j * stride], b[j * stride] = old;
    }
}

int32_t prediction_invert(double *a, int32_t *pivots, int32_t n, int32_t n_padded) {
    for (int32_t k = 0; k < n; k++) {
        double *column = a + k * n_padded;
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * n_padded + k]) > fabs(a[best * n_padded + k])) best = i;
        pivots[k] = best;
        if (best != k) exchange(column, a + best * n_padded, n, 1);
        const double pivot = column[k];
        if (pivot == 0.0 || !(fabs(pivot) < INFINITY)) return 0;
        column[k] = 1.0;
        for (int32_t j = 0; j < n_padded; j++) column[j] /= pivot;
        for (int32_t i = 0; i < n; i++) {
            double *other = a + i * n_padded;
            const double factor = other[k];
            if (i == k || factor == 0.0) continue;
            other[k] = 0.0;
            subtract_row(other, column, factor, n_padded);
        }
    }
    for (int32_t k = n - 1; k >= 0; k--)
        if (pivots[k] != k) exchange(a + k, a + pivots[k], n, n_padded);
    return 1;
}

/* The identity matrix minus `factor` times a matrix. */
static void identity_minus(double *a, const double *matrix, double factor, int32_t n, int32_t n_padded) {
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n_padded; j++) a[i * n_padded + j] = (i == j) - factor * matrix[i * n_padded + j];
}

/* ---- the linear system */

typedef struct { /* views of `matrices` */
    const double *a, *b, *c, *d;
} StateSpace;

static StateSpace state_space(const LinearPrediction *p) {
    const double *a = p->matrices, *b = a + p->n * p->n_padded;
    const double *c = b + p->m * p->n_padded, *d = c + p->n * p->m_padded;
    return (StateSpace){a, b, c, d};
}

void prediction_join(LinearPrediction *p) {
    const int32_t n = p->n, m = p->m, n_padded = p->n_padded, m_padded = p->m_padded;
    const StateSpace system = state_space(p);
    p->inverse_step = 0.0, p->usable = 1;
    copy(p->kc, system.c, n * m_padded);
    if (p->has_feedthrough) {
        identity_minus(p->k, system.d, 1.0, m, m_padded);
        p->usable = prediction_invert(p->k, p->pivots, m, m_padded);
        zero(p->kc, n * m_padded);
        for (int32_t j = 0; j < n; j++) add_product(p->k, system.c + j * m_padded, p->kc + j * m_padded, m, m_padded);
    }
    copy(p->closed_loop, system.a, n * n_padded);
    for (int32_t j = 0; j < n; j++)
        add_product(system.b, p->kc + j * m_padded, p->closed_loop + j * n_padded, m, n_padded);
}

/* The response of all inputs to the given ones: K times the change. */
static void respond(const LinearPrediction *p, const double *change, double *response) {
    if (!p->has_feedthrough) {
        copy(response, change, p->m_padded);
        return;
    }
    zero(response, p->m_padded);
    add_product(p->k, change, response, p->m, p->m_padded);
}

void prediction_find_drift(const LinearPrediction *p) {
    double *dx = p->stages, *response = p->response, *before = p->response + p->m_padded;
    zero(p->q, p->n_padded);
    if (p->age_seconds == 0.0) return;
    for (int32_t i = 0; i < p->n_padded; i++) dx[i] = p->x[i] - p->x0[i];
    add_product(p->closed_loop, dx, p->q, p->n, p->n_padded);
    respond(p, p->w, response);
    respond(p, p->w0, before);
    for (int32_t i = 0; i < p->m_padded; i++) response[i] -= before[i];
    add_product(state_space(p).b, response, p->q, p->m, p->n_padded);
    const double divisor = p->last_step * (p->age_seconds - 0.5 * p->last_step);
    for (int32_t i = 0; i < p->n_padded; i++) p->q[i] = (p->f[i] - p->f0[i] - p->q[i]) / divisor;
}

void prediction_prepare(LinearPrediction *p, double h) {
    if (!p->usable || fabs(h - p->inverse_step) <= SAME_STEP * h) return;
    p->inverse_step = h;
    identity_minus(p->inverse, p->closed_loop, GAMMA * (h / 3.0), p->n, p->n_padded);
    p->usable = prediction_invert(p->inverse, p->pivots, p->n, p->n_padded);
}

/* Value at s of polynomial i with the coefficients c of s, s^2 and s^3. */
static double polynomial_at(const double *c, int32_t i, int32_t n, double s) {
    return s * (c[i] + s * (c[n + i] + s * c[2 * n + i]));
}

void prediction_solve(const LinearPrediction *p) {
    const int32_t n_padded = p->n_padded, m_padded = p->m_padded;
    double *d = p->stages, *base = d + n_padded, *stage = base + n_padded, *rhs = stage + n_padded;
    double *rates[] = {rhs + n_padded, rhs + 2 * n_padded, rhs + 3 * n_padded};
    const double delta = p->inverse_step / 3.0, diagonal = GAMMA * delta;
    zero(d, n_padded);
    zero(p->forcing, 3 * n_padded);
    for (int k = 0; k < 3; k++) {
        respond(p, p->course + k * m_padded, p->response + k * m_padded);
        add_product(state_space(p).b, p->response + k * m_padded, p->forcing + k * n_padded, p->m, n_padded);
    }
    for (int32_t third = 0; third < 3; third++) {
        for (int k = 0; k < 3; k++) {
            const double s = delta * (third + NODES[k]), drift = p->age_seconds * s + 0.5 * s * s;
            copy(base, d, n_padded);
            for (int j = 0; j < k; j++) {
                const double weight = delta * WEIGHTS[k][j];
                for (int32_t i = 0; i < n_padded; i++) base[i] += weight * rates[j][i];
            }
            for (int32_t i = 0; i < n_padded; i++)
                rhs[i] = base[i] + diagonal * (p->f[i] + drift * p->q[i] + polynomial_at(p->forcing, i, n_padded, s));
            zero(stage, n_padded);
            add_product(p->inverse, rhs, stage, p->n, n_padded);
            for (int32_t i = 0; i < n_padded; i++) rates[k][i] = (stage[i] - base[i]) / diagonal;
        }
        copy(d, stage, n_padded);
        double *v = p->v + third * m_padded;
        for (int32_t i = 0; i < m_padded; i++) v[i] = polynomial_at(p->response, i, m_padded, delta * (third + 1));
        add_product(p->kc, d, v, p->n, m_padded);
    }
}

/* ---- one step */

static void set_given_course(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    if (p->kinds[i] == LEADING) input_interpolate(s, DEGREE, h, sim->length);
    else if (p->kinds[i] == EXTRAPOLATED) input_extrapolate(s, h, sim->length);
    p->w[i] = s->value;
    for (int k = 0; k < DEGREE; k++) p->course[k * p->m_padded + i] = s->c[k + 1];
}

static void set_predicted_course(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    const double v1 = p->v[i], v2 = p->v[p->m_padded + i], v3 = p->v[2 * p->m_padded + i];
    if (p->usable && fabs(v1) + fabs(v2) + fabs(v3) < INFINITY) input_predict(s, v1, v2, v3, h);
    else input_extrapolate(s, h, sim->length);
}

int predict_inputs(Simulation *sim, double h) {
    LinearPrediction *p = sim->prediction;
    for (int32_t i = 0; i < p->m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] != PREDICTED) set_given_course(sim, p, i, h);
    int verdict = execute(sim, &p->rate_reads);
    if (!verdict && p->lag > 1) verdict = execute(sim, &p->state_reads);
    if (verdict) return verdict;
    if (p->age >= p->lag || !p->usable) {
        verdict = linearise(sim, p->columns, p->column_count, p->matrices);
        if (verdict) return verdict;
        prediction_join(p);
        p->age = 0, p->age_seconds = 0.0;
    }
    if (p->lag > 1) prediction_find_drift(p);
    prediction_prepare(p, h);
    if (p->usable) prediction_solve(p);
    for (int32_t i = 0; i < p->m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] == PREDICTED) set_predicted_course(sim, p, i, h);
    return CONTINUE;
}

void prediction_accept(LinearPrediction *p, double h) {
    copy(p->f0, p->f, p->n_padded);
    copy(p->x0, p->x, p->n_padded);
    copy(p->w0, p->w, p->m_padded);
    p->age++;
    p->age_seconds += h;
    p->last_step = h;
}
