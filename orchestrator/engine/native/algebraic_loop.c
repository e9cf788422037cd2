/* Newton's method for the inputs of an algebraic loop.
 *
 * The unknowns u are the inputs of a loop. The FMUs make outputs y of them, and the connections should make the same
 * inputs of those:
 *
 *     r(u) = u - g(u) = 0,   g_i = factor_i y_k(u) + offset_i                  r_i in the unit of u_i
 *
 * A step d of Newton's method solves  dr/du d = r  and goes from u to u - d. dy/du comes from directional derivatives
 * where an FMU has them, else from differences, one input after the other. The Jacobian is kept, to the next
 * communication point, too, as long as the residual falls fast with it. A step that does not make the residual
 * smaller is halved.
 *
 * Where nobody declared a loop and none is seen at the start, values are first carried round: without one they
 * settle, exactly. Residuals are shares of the magnitude of the input: its largest value until now, or its nominal
 * value.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double NEAR = 1e-10;  /* wanted: below the error of any coupling, above rounding in double precision */
static const double ENOUGH = 1e-6; /* accepted where no step makes it smaller: single precision, or an FMU that
                                      iterates inside */
static const double FAST = 1e-3;   /* a kept Jacobian is good while each step takes three digits off the residual */
static const double SHIFT = 1e-6;  /* of the magnitude: far above rounding, below what bends a function */
static const double ALIKE = 0.1;   /* derivatives further from differences than this share of the largest would
                                      spoil convergence */
enum { LIMIT = 20 };    /* steps; Newton's method doubles the digits with each, so this is long after it failed */
enum { HALVINGS = 10 }; /* of a step; then its direction is wrong */

static void copy(const AlgebraicLoop *p, double *to, const double *from) {
    memcpy(to, from, (size_t)p->count * sizeof *to);
}

/* ---- the components */

static int set_and_read(Simulation *sim, const LoopMember *m) {
    const int verdict = carry_out(sim, &m->writers);
    return verdict ? verdict : carry_out(sim, &m->readers);
}

static int derivative_by(Simulation *sim, const LoopMember *m, int32_t j) {
    memset(m->derivative.seed, 0, (size_t)m->count * sizeof *m->derivative.seed);
    m->derivative.seed[j] = 1.0;
    return directional_derivative(sim, &m->derivative);
}

static int slopes_by_derivatives(Simulation *sim, const AlgebraicLoop *p, const LoopMember *m) {
    for (int32_t j = 0; j < m->count; j++) {
        const int verdict = derivative_by(sim, m, j);
        if (verdict) return verdict;
        for (int32_t i = 0; i < m->outputs; i++)
            p->slopes[(m->first_output + i) * p->count + m->first + j] = m->derivative.into[i];
    }
    return CONTINUE;
}

/* The FMU is left at moved inputs; u and y are what they were. */
static int slopes_by_differences(Simulation *sim, const AlgebraicLoop *p, const LoopMember *m) {
    double *y = p->y + m->first_output, *kept = m->derivative.into;
    memcpy(kept, y, (size_t)m->outputs * sizeof *y);
    for (int32_t j = m->first; j < m->first + m->count; j++) {
        const double u = p->u[j];
        p->u[j] = u + copysign(SHIFT * p->unit[j], u);
        const double moved = p->u[j] - u;
        const int verdict = set_and_read(sim, m);
        if (verdict) return verdict;
        for (int32_t i = 0; i < m->outputs; i++)
            p->slopes[(m->first_output + i) * p->count + j] = (y[i] - kept[i]) / moved;
        p->u[j] = u;
    }
    memcpy(y, kept, (size_t)m->outputs * sizeof *y);
    return CONTINUE;
}

/* Does without derivatives that fail, or that are not what the outputs do. */
static int check_derivatives(Simulation *sim, const AlgebraicLoop *p, LoopMember *m) {
    int verdict = slopes_by_differences(sim, p, m);
    if (!verdict) verdict = set_and_read(sim, m);
    if (verdict) return verdict;
    for (int32_t j = 0; j < m->count; j++) {
        verdict = derivative_by(sim, m, j);
        if (verdict == STOP) m->trusted = 0;
        if (verdict) return verdict == STOP ? CONTINUE : verdict;
        for (int32_t i = 0; i < m->outputs; i++) {
            const double *row = p->slopes + (m->first_output + i) * p->count;
            double largest = 0.0;
            for (int32_t l = m->first; l < m->first + m->count; l++)
                largest = worse(largest, fabs(row[l]) * p->unit[l]);
            const double off = fabs(m->derivative.into[i] - row[m->first + j]) * p->unit[m->first + j];
            if (!(off <= ALIKE * largest)) m->trusted = 0;
        }
    }
    return CONTINUE;
}

/* ---- linear equations */

static void exchange(double *a, double *b) {
    const double kept = *a;
    *a = *b, *b = kept;
}

/* Puts the triangular factors in the place of a, the exchanges of rows into `rows`; 0 where there is no pivot. */
int32_t loop_factorise(double *a, int32_t *rows, int32_t n) {
    for (int32_t k = 0; k < n; k++) {
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        rows[k] = best;
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

/* Puts the solution into b. */
void loop_substitute(const double *a, const int32_t *rows, double *b, int32_t n) {
    for (int32_t k = 0; k < n; k++)
        if (rows[k] != k) exchange(&b[k], &b[rows[k]]);
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
        const int verdict = set_and_read(sim, &p->members[k]);
        if (verdict) return verdict;
    }
    p->counts[EVALUATIONS]++;
    double norm = 0.0, share = 0.0;
    for (int32_t i = 0; i < p->count; i++) {
        const double u = p->u[i], g = p->y[p->source[i]] * p->factor[i] + p->offset[i], r = u - g;
        p->g[i] = g, p->residual[i] = r;
        if (!(fabs(r) < INFINITY)) norm = share = INFINITY;
        else if (r != 0.0) {
            const double size = larger(larger(p->seen[i], fabs(u)), fabs(g));
            if (p->scale[i] == 0.0) p->scale[i] = size;
            norm = larger(norm, fabs(r) / p->scale[i]);
            share = larger(share, fabs(r) / size);
        }
    }
    p->shares[NORM] = norm, p->shares[SHARE] = share;
    return CONTINUE;
}

/* Set the inputs to what the outputs make of them, until that changes nothing. */
static int carry_round(Simulation *sim, const AlgebraicLoop *p, int *settled) {
    int verdict;
    for (int32_t n = 0; n < p->rounds; n++) {
        verdict = evaluate(sim, p);
        *settled = p->shares[SHARE] == 0.0;
        if (verdict || *settled) return verdict;
        copy(p, p->u, p->g);
    }
    verdict = evaluate(sim, p);
    *settled = p->shares[SHARE] <= NEAR;
    return verdict;
}

static void measure_units(const AlgebraicLoop *p) {
    for (int32_t i = 0; i < p->count; i++) {
        const double size = larger(p->seen[i], fabs(p->u[i]));
        p->unit[i] = size == 0.0 ? 1.0 : size;
    }
}

static int linearise(Simulation *sim, const AlgebraicLoop *p, int *found) {
    const int32_t n = p->count;
    measure_units(p);
    for (int32_t k = 0; k < p->member_count; k++) {
        const LoopMember *m = &p->members[k];
        const int verdict = m->trusted ? slopes_by_derivatives(sim, p, m) : slopes_by_differences(sim, p, m);
        if (verdict) return verdict;
    }
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n; j++)
            p->matrix[i * n + j] =
                (i == j) - p->factor[i] * p->slopes[p->source[i] * n + j] * p->unit[j] / p->unit[i];
    *found = loop_factorise(p->matrix, p->rows, n);
    return CONTINUE;
}

/* Take a step, at most so long that the residual becomes smaller; with an old Jacobian try it once. */
static int descend(Simulation *sim, const AlgebraicLoop *p, double norm, int fresh, int *better) {
    for (int32_t i = 0; i < p->count; i++) p->step[i] = p->residual[i] / p->unit[i];
    loop_substitute(p->matrix, p->rows, p->step, p->count);
    for (int32_t i = 0; i < p->count; i++) p->step[i] *= p->unit[i];
    copy(p, p->before, p->u);
    double size = 1.0;
    for (int n = 0; n < (fresh ? HALVINGS : 1); n++) {
        for (int32_t i = 0; i < p->count; i++) p->u[i] = p->before[i] - size * p->step[i];
        const int verdict = evaluate(sim, p);
        *better = p->shares[NORM] < norm;
        if (verdict || *better) return verdict;
        size *= 0.5;
    }
    copy(p, p->u, p->before);
    return evaluate(sim, p);
}

static int newton(Simulation *sim, AlgebraicLoop *p, int *how) {
    int fresh = 0;
    for (int n = 0; n < LIMIT; n++) {
        *how = SOLVED;
        if (p->shares[SHARE] <= NEAR) return CONTINUE;
        if (!p->flags[USABLE]) {
            int found = 0;
            const int verdict = linearise(sim, p, &found);
            *how = SINGULAR;
            if (verdict || !found) return verdict;
            fresh = 1;
        }
        const double norm = p->shares[NORM];
        int better = 0;
        const int verdict = descend(sim, p, norm, fresh, &better);
        *how = STUCK;
        if (verdict || (fresh && !better)) return verdict;
        p->flags[USABLE] = better && p->shares[NORM] <= FAST * norm;
        fresh = 0;
    }
    *how = p->shares[SHARE] <= NEAR ? SOLVED : STUCK;
    return CONTINUE;
}

static int find(Simulation *sim, AlgebraicLoop *p, int *how) {
    *how = SOLVED;
    memset(p->scale, 0, (size_t)p->count * sizeof *p->scale);
    p->counts[SOLVES]++;
    if (p->rounds && !p->flags[CIRCULAR]) {
        int settled = 0;
        copy(p, p->start, p->u);
        const int verdict = carry_round(sim, p, &settled);
        if (verdict || settled) return verdict;
        p->flags[CIRCULAR] = 1;
        copy(p, p->u, p->start);
    }
    int verdict = evaluate(sim, p);
    if (!verdict) verdict = newton(sim, p, how);
    if (p->shares[SHARE] <= ENOUGH && *how != SINGULAR) *how = SOLVED;
    return verdict;
}

/* Do inputs change themselves? Those that no other changes are taken away until none is left. */
static int is_circular(const AlgebraicLoop *p) {
    int32_t *left = p->rows, count = p->count, found = 1;
    for (int32_t i = 0; i < p->count; i++) left[i] = 1;
    while (found) {
        found = 0;
        for (int32_t i = 0; i < p->count; i++) {
            int changed = !left[i];
            for (int32_t j = 0; j < p->count && !changed; j++)
                changed = left[j] && p->slopes[p->source[i] * p->count + j] != 0.0;
            if (!changed) left[i] = 0, count--, found = 1;
        }
    }
    return count > 0;
}

/* Starts at what the inputs of the FMUs are, and tries what their outputs do. */
static int begin(Simulation *sim, AlgebraicLoop *p) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < p->member_count && !verdict; k++) verdict = carry_out(sim, &p->members[k].starters);
    if (!verdict) verdict = evaluate(sim, p);
    measure_units(p);
    for (int32_t k = 0; k < p->member_count && !verdict; k++) {
        LoopMember *m = &p->members[k];
        if (!p->declared) m->trusted = 0;
        if (!p->declared) verdict = slopes_by_differences(sim, p, m);
        else if (m->trusted) verdict = check_derivatives(sim, p, m);
    }
    p->flags[BEGUN] = 1;
    p->flags[CIRCULAR] = !p->declared && !verdict && is_circular(p);
    p->counts[SOLVES] = p->counts[EVALUATIONS] = 0;
    return verdict;
}

int32_t loop_solve(Simulation *sim, AlgebraicLoop *p) {
    int how = SOLVED, verdict = CONTINUE;
    if (!p->flags[BEGUN]) verdict = begin(sim, p);
    else
        for (int32_t i = 0; i < p->count; i++) p->u[i] = sim->real[p->targets[i]];
    if (!verdict) verdict = find(sim, p, &how);
    if (verdict) return verdict;
    if (how != SOLVED) return sim->check_status(p, 0, how);
    for (int32_t i = 0; i < p->count; i++) p->seen[i] = larger(p->seen[i], fabs(p->u[i]));
    p->shares[WORST] = larger(p->shares[WORST], p->shares[SHARE]);
    for (int32_t i = 0; i < p->count; i++) sim->real[p->targets[i]] = p->u[i];
    for (int32_t i = 0; i < p->outputs; i++) sim->real[p->sources[i]] = p->y[i];
    return CONTINUE;
}
