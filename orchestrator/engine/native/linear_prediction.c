/* Linear prediction of all inputs over a step, from the interface Jacobian.
 *
 * With the changes d of all states and v of all inputs since the linearisation (linear_system.c),
 *
 *     d' = f + (A + B K C) d + B K w(s),     v = K (C d + w(s)),     d(0) = 0
 *
 * where w(s) are the changes of the inputs whose course over the step is given. The system
 * is solved up to h/3, 2h/3 and h by one step each of the L-stable Runge-Kutta method of order 3 whose three stages
 * have the same diagonal element (Alexander 1977, SIAM J. Numer. Anal. 14(6) 1006-1021). All stages use the triangular
 * factors of  1 - gamma h/3 (A + B K C),  which are kept as long as the linearisation and h.
 *
 * There are four kinds of inputs, by their source:
 *
 *     PREDICTED      a component with directional derivatives
 *     BY_SCENARIO    a scenario, so that the course over the step is given
 *     LEADING        a component that has stepped already, because it depends on no other: the course is interpolated
 *     EXTRAPOLATED   a component without directional derivatives: the extrapolated course is taken as given
 *
 * In LinearPrediction: f: derivatives of the states. w: given inputs, course: their coefficients of s, s^2 and s^3,
 * shape (3, m); response: K times course; forcing: B times response. v: changes of all inputs until h/3, 2h/3 and h.
 * factors_step: length of the step that the factors are made for [s].
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double SAME_STEP = 1e-9; /* largest relative difference of two equal steps */

#define GAMMA 0.43586652150845967
static const double NODES[] = {GAMMA, (1.0 + GAMMA) / 2.0, 1.0};
static const double WEIGHTS[][2] = { /* of the earlier stages, for the second and the third one */
    {(1.0 - GAMMA) / 2.0},
    {-1.5 * GAMMA * GAMMA + 4.0 * GAMMA - 0.25, 1.5 * GAMMA * GAMMA - 5.0 * GAMMA + 1.25},
};

void prediction_prepare(LinearPrediction *p, double h) {
    if (!p->system.usable || fabs(h - p->factors_step) <= SAME_STEP * h) return;
    p->factors_step = h;
    matrix_identity_minus(p->factors, p->system.closed_loop, GAMMA * (h / 3.0), p->system.n, p->system.n_padded);
    p->system.usable = matrix_factorise(p->factors, p->system.pivots, p->system.n, p->system.n_padded);
}

/* Value at s of polynomial i with the coefficients c of s, s^2 and s^3. */
static double polynomial_at(const double *c, int32_t i, int32_t n, double s) {
    return s * (c[i] + s * (c[n + i] + s * c[2 * n + i]));
}

void prediction_solve(const LinearPrediction *p) {
    const int32_t n_padded = p->system.n_padded, m_padded = p->system.m_padded;
    double *d = p->stages, *base = d + n_padded, *stage = base + n_padded;
    double *rates[] = {stage + n_padded, stage + 2 * n_padded, stage + 3 * n_padded};
    const double delta = p->factors_step / 3.0, diagonal = GAMMA * delta;
    vector_zero(d, n_padded);
    vector_zero(p->forcing, 3 * n_padded);
    for (int k = 0; k < 3; k++) {
        linear_system_respond(&p->system, p->course + k * m_padded, p->response + k * m_padded);
        matrix_add_product(state_space(&p->system).b, p->response + k * m_padded, p->forcing + k * n_padded,
                           p->system.m, n_padded);
    }
    for (int32_t third = 0; third < 3; third++) {
        for (int k = 0; k < 3; k++) {
            const double s = delta * (third + NODES[k]);
            vector_copy(base, d, n_padded);
            for (int j = 0; j < k; j++) {
                const double weight = delta * WEIGHTS[k - 1][j];
                for (int32_t i = 0; i < n_padded; i++) base[i] += weight * rates[j][i];
            }
            for (int32_t i = 0; i < n_padded; i++)
                stage[i] = base[i] + diagonal * (p->f[i] + polynomial_at(p->forcing, i, n_padded, s));
            matrix_solve(p->factors, p->system.pivots, stage, p->system.n, n_padded);
            for (int32_t i = 0; i < n_padded; i++) rates[k][i] = (stage[i] - base[i]) / diagonal;
        }
        vector_copy(d, stage, n_padded);
        double *v = p->v + third * m_padded;
        for (int32_t i = 0; i < m_padded; i++) v[i] = polynomial_at(p->response, i, m_padded, delta * (third + 1));
        matrix_add_product(p->system.kc, d, v, p->system.n, m_padded);
    }
}

/* ---- one step */

static void set_given_course(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    if (p->kinds[i] == LEADING) input_interpolate(s, DEGREE, h, sim->length);
    else if (p->kinds[i] == EXTRAPOLATED) input_extrapolate(s, h, sim->length);
    p->w[i] = s->value;
    for (int k = 0; k < DEGREE; k++) p->course[k * p->system.m_padded + i] = s->c[k + 1];
}

static void set_predicted_course(Simulation *sim, const LinearPrediction *p, int32_t i, double h) {
    CouplingInput *s = &sim->inputs[p->inputs[i]];
    const double v1 = p->v[i], v2 = p->v[p->system.m_padded + i], v3 = p->v[2 * p->system.m_padded + i];
    if (p->system.usable && fabs(v1) + fabs(v2) + fabs(v3) < INFINITY) input_predict(s, v1, v2, v3, h);
    else input_extrapolate(s, h, sim->length);
}

int predict_inputs(Simulation *sim, double h) {
    LinearPrediction *p = sim->prediction;
    for (int32_t i = 0; i < p->system.m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] != PREDICTED) set_given_course(sim, p, i, h);
    int verdict = execute(sim, &p->rate_reads);
    if (verdict) return verdict;
    if (!p->valid || !p->system.usable) {
        verdict = linear_system_evaluate(sim, &p->system);
        if (verdict) return verdict;
        linear_system_join(&p->system);
        p->factors_step = 0.0, p->valid = 1;
    }
    prediction_prepare(p, h);
    if (p->system.usable) prediction_solve(p);
    for (int32_t i = 0; i < p->system.m; i++)
        if (p->inputs[i] >= 0 && p->kinds[i] == PREDICTED) set_predicted_course(sim, p, i, h);
    return CONTINUE;
}
