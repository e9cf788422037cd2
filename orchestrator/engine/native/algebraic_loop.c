/* Newton's method for the inputs of an algebraic loop.
 *
 * The unknowns u are the inputs of a loop. The FMUs compute outputs y from them, and the connections must return the
 * same inputs:
 *
 *     r(u) = u - g(u) = 0,   g_i = factor_i y_k(u) + offset_i                  r_i in the unit of u_i
 *
 * A step d of Newton's method solves  dr/du d = r  and leads from u to u - d. dy/du follows from directional derivatives
 * if the FMU has them, else from differences, one input after the other. The Jacobian is kept as long as the residual
 * decreases fast with it, also to the next communication point. A step that does not reduce the residual is halved.
 *
 * If no FMU declares a loop and none is detected at the start, values are first copied along the connections several
 * times: without a loop they settle exactly. Residuals are relative to the magnitude of the input: its largest value
 * until now, or its nominal value.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double REQUIRED = 1e-10;     /* relative residual: below any coupling error, above rounding */
static const double ACCEPTABLE = 1e-6;    /* relative residual if no step reduces it: an FMU computes in single
                                             precision, or iterates inside */
static const double FAST = 1e-3;          /* ratio of residuals up to which a kept Jacobian is good */
static const double DIFFERENCE = 1e-6;    /* change of an input for a difference, relative to its magnitude: far above
                                             rounding, small enough for the curvature of a function */
static const double DISAGREEMENT = 0.1;   /* of derivative and difference, relative to the largest: a larger one would
                                             spoil the convergence */
enum { MAX_STEPS = 20 };    /* Newton's method doubles the digits with each step, so it has failed long before */
enum { MAX_HALVINGS = 10 }; /* of one step; then its direction is wrong */

static void copy(const AlgebraicLoop *p, double *to, const double *from) {
    memcpy(to, from, (size_t)p->input_count * sizeof *to);
}

/* ---- the components */

static int evaluate_member(Simulation *sim, const LoopMember *m) {
    const int verdict = execute(sim, &m->input_writes);
    return verdict ? verdict : execute(sim, &m->output_reads);
}

static int derivative_by(Simulation *sim, const LoopMember *m, int32_t j) {
    memset(m->derivative.seed, 0, (size_t)m->input_count * sizeof *m->derivative.seed);
    m->derivative.seed[j] = 1.0;
    return directional_derivative(sim, &m->derivative);
}

static int differentiate(Simulation *sim, const AlgebraicLoop *p, const LoopMember *m) {
    for (int32_t j = 0; j < m->input_count; j++) {
        const int verdict = derivative_by(sim, m, j);
        if (verdict) return verdict;
        for (int32_t i = 0; i < m->output_count; i++)
            p->sensitivity[(m->first_output + i) * p->input_count + m->first_input + j] = m->derivative.result[i];
    }
    return CONTINUE;
}

/* Leaves the FMU, and y, with changed inputs, but u unchanged. */
static int difference(Simulation *sim, const AlgebraicLoop *p, const LoopMember *m) {
    double *y = p->y + m->first_output, *y0 = m->derivative.result;
    memcpy(y0, y, (size_t)m->output_count * sizeof *y);
    for (int32_t j = m->first_input; j < m->first_input + m->input_count; j++) {
        const double u = p->u[j];
        p->u[j] = u + copysign(DIFFERENCE * p->jacobian_scale[j], u);
        const double du = p->u[j] - u;
        const int verdict = evaluate_member(sim, m);
        if (verdict) return verdict;
        for (int32_t i = 0; i < m->output_count; i++)
            p->sensitivity[(m->first_output + i) * p->input_count + j] = (y[i] - y0[i]) / du;
        p->u[j] = u;
    }
    return CONTINUE;
}

/* Replaces directional derivatives by differences if they fail or differ from them. */
static int check_derivatives(Simulation *sim, const AlgebraicLoop *p, LoopMember *m) {
    int verdict = difference(sim, p, m);
    if (!verdict) verdict = evaluate_member(sim, m);
    if (verdict) return verdict;
    for (int32_t j = 0; j < m->input_count; j++) {
        verdict = derivative_by(sim, m, j);
        if (verdict == STOP) m->uses_derivative = 0;
        if (verdict) return verdict == STOP ? CONTINUE : verdict;
        for (int32_t i = 0; i < m->output_count; i++) {
            const double *row = p->sensitivity + (m->first_output + i) * p->input_count;
            double largest = 0.0;
            for (int32_t k = m->first_input; k < m->first_input + m->input_count; k++)
                largest = worse(largest, fabs(row[k]) * p->jacobian_scale[k]);
            const int32_t l = m->first_input + j;
            const double error = fabs(m->derivative.result[i] - row[l]) * p->jacobian_scale[l];
            if (!(error <= DISAGREEMENT * largest)) m->uses_derivative = 0;
        }
    }
    return CONTINUE;
}

/* ---- linear equations */

static void exchange(double *a, double *b) {
    const double old = *a;
    *a = *b, *b = old;
}

/* Replaces a by its triangular factors; pivots: the exchanges of rows. Returns 0 if there is no pivot. */
int32_t loop_factorise(double *a, int32_t *pivots, int32_t n) {
    for (int32_t k = 0; k < n; k++) {
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        pivots[k] = best;
        if (best != k)
            for (int32_t j = 0; j < n; j++) exchange(&a[k * n + j], &a[best * n + j]);
        const double pivot = a[k * n + k];
        if (pivot == 0.0 || !(fabs(pivot) < INFINITY)) return 0;
        for (int32_t i = k + 1; i < n; i++) {
            a[i * n + k] /= pivot;
            for (int32_t j = k + 1; j < n; j++) a[i * n + j] -= a[i * n + k] * a[k * n + j];
        }
    }
    return 1;
}

/* Replaces b by the solution. */
void loop_substitute(const double *a, const int32_t *pivots, double *b, int32_t n) {
    for (int32_t k = 0; k < n; k++)
        if (pivots[k] != k) exchange(&b[k], &b[pivots[k]]);
    for (int32_t k = 0; k < n; k++)
        for (int32_t i = k + 1; i < n; i++) b[i] -= a[i * n + k] * b[k];
    for (int32_t k = n - 1; k >= 0; k--) {
        for (int32_t j = k + 1; j < n; j++) b[k] -= a[k * n + j] * b[j];
        b[k] /= a[k * n + k];
    }
}

/* ---- the solution */

static int evaluate(Simulation *sim, const AlgebraicLoop *p) {
    for (int32_t k = 0; k < p->member_count; k++) {
        const int verdict = evaluate_member(sim, &p->members[k]);
        if (verdict) return verdict;
    }
    p->counts[EVALUATIONS]++;
    double scaled = 0.0, relative = 0.0;
    for (int32_t i = 0; i < p->input_count; i++) {
        const double u = p->u[i], g = p->y[p->output[i]] * p->factor[i] + p->offset[i], r = u - g;
        p->g[i] = g, p->residual[i] = r;
        if (!(fabs(r) < INFINITY)) scaled = relative = INFINITY;
        else if (r != 0.0) {
            const double magnitude = larger(larger(p->magnitude[i], fabs(u)), fabs(g));
            if (p->initial_magnitude[i] == 0.0) p->initial_magnitude[i] = magnitude;
            scaled = larger(scaled, fabs(r) / p->initial_magnitude[i]);
            relative = larger(relative, fabs(r) / magnitude);
        }
    }
    p->residual_norms[SCALED] = scaled, p->residual_norms[RELATIVE] = relative;
    return CONTINUE;
}

/* Copy values from outputs to inputs until nothing changes, at most copy_rounds times. */
static int copy_until_settled(Simulation *sim, const AlgebraicLoop *p, int *settled) {
    int verdict;
    for (int32_t n = 0; n < p->copy_rounds; n++) {
        verdict = evaluate(sim, p);
        *settled = p->residual_norms[RELATIVE] == 0.0;
        if (verdict || *settled) return verdict;
        copy(p, p->u, p->g);
    }
    verdict = evaluate(sim, p);
    *settled = p->residual_norms[RELATIVE] <= REQUIRED;
    return verdict;
}

static void set_jacobian_scale(const AlgebraicLoop *p) {
    for (int32_t i = 0; i < p->input_count; i++) {
        const double magnitude = larger(p->magnitude[i], fabs(p->u[i]));
        p->jacobian_scale[i] = magnitude == 0.0 ? 1.0 : magnitude;
    }
}

static int make_jacobian(Simulation *sim, const AlgebraicLoop *p, int *regular) {
    const int32_t n = p->input_count;
    set_jacobian_scale(p);
    for (int32_t k = 0; k < p->member_count; k++) {
        const LoopMember *m = &p->members[k];
        const int verdict = m->uses_derivative ? differentiate(sim, p, m) : difference(sim, p, m);
        if (verdict) return verdict;
    }
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n; j++)
            p->jacobian[i * n + j] = (i == j) - p->factor[i] * p->sensitivity[p->output[i] * n + j] *
                                                    p->jacobian_scale[j] / p->jacobian_scale[i];
    *regular = loop_factorise(p->jacobian, p->pivots, n);
    return CONTINUE;
}

/* Take a step, halved until the residual decreases; with an old Jacobian only the full step is tried. */
static int descend(Simulation *sim, const AlgebraicLoop *p, double norm, int new_jacobian, int *better) {
    for (int32_t i = 0; i < p->input_count; i++) p->step[i] = p->residual[i] / p->jacobian_scale[i];
    loop_substitute(p->jacobian, p->pivots, p->step, p->input_count);
    for (int32_t i = 0; i < p->input_count; i++) p->step[i] *= p->jacobian_scale[i];
    copy(p, p->previous, p->u);
    double fraction = 1.0;
    for (int n = 0; n < (new_jacobian ? MAX_HALVINGS : 1); n++) {
        for (int32_t i = 0; i < p->input_count; i++) p->u[i] = p->previous[i] - fraction * p->step[i];
        const int verdict = evaluate(sim, p);
        *better = p->residual_norms[SCALED] < norm;
        if (verdict || *better) return verdict;
        fraction *= 0.5;
    }
    copy(p, p->u, p->previous);
    return evaluate(sim, p);
}

static int newton(Simulation *sim, AlgebraicLoop *p, int *outcome) {
    int new_jacobian = 0;
    for (int n = 0; n < MAX_STEPS; n++) {
        *outcome = SOLVED;
        if (p->residual_norms[RELATIVE] <= REQUIRED) return CONTINUE;
        if (!p->flags[JACOBIAN_VALID]) {
            int regular = 0;
            const int verdict = make_jacobian(sim, p, &regular);
            *outcome = SINGULAR;
            if (verdict || !regular) return verdict;
            new_jacobian = 1;
        }
        const double norm = p->residual_norms[SCALED];
        int better = 0;
        const int verdict = descend(sim, p, norm, new_jacobian, &better);
        *outcome = NOT_CONVERGED;
        if (verdict || (new_jacobian && !better)) return verdict;
        p->flags[JACOBIAN_VALID] = better && p->residual_norms[SCALED] <= FAST * norm;
        new_jacobian = 0;
    }
    *outcome = p->residual_norms[RELATIVE] <= REQUIRED ? SOLVED : NOT_CONVERGED;
    return CONTINUE;
}

static int solve(Simulation *sim, AlgebraicLoop *p, int *outcome) {
    *outcome = SOLVED;
    memset(p->initial_magnitude, 0, (size_t)p->input_count * sizeof *p->initial_magnitude);
    p->counts[SOLVES]++;
    if (p->copy_rounds && !p->flags[CIRCULAR]) {
        int settled = 0;
        copy(p, p->initial, p->u);
        const int verdict = copy_until_settled(sim, p, &settled);
        if (verdict || settled) return verdict;
        p->flags[CIRCULAR] = 1;
        copy(p, p->u, p->initial);
    }
    int verdict = evaluate(sim, p);
    if (!verdict) verdict = newton(sim, p, outcome);
    if (p->residual_norms[RELATIVE] <= ACCEPTABLE && *outcome != SINGULAR) *outcome = SOLVED;
    return verdict;
}

/* Whether inputs depend on themselves: those that depend on no remaining one are removed until nothing changes. */
static int is_circular(const AlgebraicLoop *p) {
    int32_t *remaining = p->pivots, count = p->input_count, removed = 1;
    for (int32_t i = 0; i < p->input_count; i++) remaining[i] = 1;
    while (removed) {
        removed = 0;
        for (int32_t i = 0; i < p->input_count; i++) {
            int dependent = !remaining[i];
            for (int32_t j = 0; j < p->input_count && !dependent; j++)
                dependent = remaining[j] && p->sensitivity[p->output[i] * p->input_count + j] != 0.0;
            if (!dependent) remaining[i] = 0, count--, removed = 1;
        }
    }
    return count > 0;
}

/* Starts with the present inputs of the FMUs; checks their derivatives, or detects whether there is a loop. */
static int initialise(Simulation *sim, AlgebraicLoop *p) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < p->member_count && !verdict; k++) verdict = execute(sim, &p->members[k].input_reads);
    if (!verdict) verdict = evaluate(sim, p);
    set_jacobian_scale(p);
    for (int32_t k = 0; k < p->member_count && !verdict; k++) {
        LoopMember *m = &p->members[k];
        if (!p->declared) m->uses_derivative = 0;
        if (!p->declared) verdict = difference(sim, p, m);
        else if (m->uses_derivative) verdict = check_derivatives(sim, p, m);
    }
    p->flags[INITIALISED] = 1;
    p->flags[CIRCULAR] = !p->declared && !verdict && is_circular(p);
    p->counts[SOLVES] = p->counts[EVALUATIONS] = 0;
    return verdict;
}

int32_t loop_solve(Simulation *sim, AlgebraicLoop *p) {
    int outcome = SOLVED, verdict = CONTINUE;
    if (!p->flags[INITIALISED]) verdict = initialise(sim, p);
    else
        for (int32_t i = 0; i < p->input_count; i++) p->u[i] = sim->reals[p->input_indices[i]];
    if (!verdict) verdict = solve(sim, p, &outcome);
    if (verdict) return verdict;
    if (outcome != SOLVED) return sim->check_status(p, 0, outcome);
    for (int32_t i = 0; i < p->input_count; i++) p->magnitude[i] = larger(p->magnitude[i], fabs(p->u[i]));
    p->residual_norms[WORST] = larger(p->residual_norms[WORST], p->residual_norms[RELATIVE]);
    for (int32_t i = 0; i < p->input_count; i++) sim->reals[p->input_indices[i]] = p->u[i];
    for (int32_t i = 0; i < p->output_count; i++) sim->reals[p->output_indices[i]] = p->y[i];
    return CONTINUE;
}
