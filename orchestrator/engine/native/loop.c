/* Algebraic loops; see loop.py, newton.py, member.py and linear.py. */

#include <math.h>
#include <string.h>

#include "run.h"

enum { SOLVED = 0, SINGULAR = -1, STUCK = -2 };
enum { USABLE, CIRCULAR };        /* flags */
enum { SOLVES, EVALUATIONS };     /* counts */
enum { NORM, SHARE, WORST };      /* shares */
enum { LIMIT = 20, HALVINGS = 10 };
static const double NEAR = 1e-10, ENOUGH = 1e-6, FAST = 1e-3, SHIFT = 1e-6;

static void copy(const Loop *p, double *to, const double *from) {
    memcpy(to, from, (size_t)p->count * sizeof *to);
}

/* ---- the components */

static int set_and_read(Run *run, const Member *m) {
    const int verdict = carry_out(run, &m->writers);
    return verdict ? verdict : carry_out(run, &m->readers);
}

static int told(Run *run, const Loop *p, const Member *m) {
    const size_t n = (size_t)m->count, outputs = (size_t)m->outputs;
    for (int32_t j = 0; j < m->count; j++) {
        memset(m->seed, 0, n * sizeof *m->seed);
        m->seed[j] = 1.0;
        const int status =
            derivative_along(m->derivative, m->component, m->fmi, m->of, outputs, m->by, n, m->seed, m->into);
        if (status) {
            const int verdict = run->judge(m, 0, status);
            if (verdict) return verdict;
        }
        for (int32_t i = 0; i < m->outputs; i++)
            p->slopes[(m->first_output + i) * p->count + m->first + j] = m->into[i];
    }
    return CONTINUE;
}

/* By differences. */
static int measured(Run *run, const Loop *p, const Member *m) {
    double *y = p->y + m->first_output, *kept = m->into;
    memcpy(kept, y, (size_t)m->outputs * sizeof *y);
    for (int32_t j = m->first; j < m->first + m->count; j++) {
        const double u = p->u[j];
        p->u[j] = u + copysign(SHIFT * p->unit[j], u);
        const double moved = p->u[j] - u;
        const int verdict = set_and_read(run, m);
        if (verdict) return verdict;
        for (int32_t i = 0; i < m->outputs; i++)
            p->slopes[(m->first_output + i) * p->count + j] = (y[i] - kept[i]) / moved;
        p->u[j] = u;
    }
    memcpy(y, kept, (size_t)m->outputs * sizeof *y);
    return CONTINUE;
}

/* ---- linear equations */

static void exchange(double *a, double *b) {
    const double kept = *a;
    *a = *b, *b = kept;
}

static int factorised(double *a, int32_t *rows, int32_t n) {
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

static void solve(const double *a, const int32_t *rows, double *b, int32_t n) {
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

static int evaluate(Run *run, const Loop *p) {
    for (int32_t k = 0; k < p->member_count; k++) {
        const int verdict = set_and_read(run, &p->members[k]);
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
static int carry_round(Run *run, const Loop *p, int *settled) {
    int verdict;
    for (int32_t n = 0; n < p->sweeps; n++) {
        verdict = evaluate(run, p);
        *settled = p->shares[SHARE] == 0.0;
        if (verdict || *settled) return verdict;
        copy(p, p->u, p->g);
    }
    verdict = evaluate(run, p);
    *settled = p->shares[SHARE] <= NEAR;
    return verdict;
}

static int linearise(Run *run, const Loop *p, int *found) {
    const int32_t n = p->count;
    for (int32_t i = 0; i < n; i++) {
        const double size = larger(p->seen[i], fabs(p->u[i]));
        p->unit[i] = size == 0.0 ? 1.0 : size;
    }
    for (int32_t k = 0; k < p->member_count; k++) {
        const Member *m = &p->members[k];
        const int verdict = *m->trusted ? told(run, p, m) : measured(run, p, m);
        if (verdict) return verdict;
    }
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n; j++)
            p->matrix[i * n + j] =
                (i == j) - p->factor[i] * p->slopes[p->source[i] * n + j] * p->unit[j] / p->unit[i];
    *found = factorised(p->matrix, p->rows, n);
    return CONTINUE;
}

/* Take a step, at most so long that the residual becomes smaller; with an old Jacobian try it once. */
static int descend(Run *run, const Loop *p, double norm, int fresh, int *better) {
    for (int32_t i = 0; i < p->count; i++) p->step[i] = p->residual[i] / p->unit[i];
    solve(p->matrix, p->rows, p->step, p->count);
    for (int32_t i = 0; i < p->count; i++) p->step[i] *= p->unit[i];
    copy(p, p->before, p->u);
    double size = 1.0;
    for (int n = 0; n < (fresh ? HALVINGS : 1); n++) {
        for (int32_t i = 0; i < p->count; i++) p->u[i] = p->before[i] - size * p->step[i];
        const int verdict = evaluate(run, p);
        *better = p->shares[NORM] < norm;
        if (verdict || *better) return verdict;
        size *= 0.5;
    }
    copy(p, p->u, p->before);
    return evaluate(run, p);
}

static int newton(Run *run, const Loop *p, int *how) {
    int fresh = 0;
    for (int n = 0; n < LIMIT; n++) {
        *how = SOLVED;
        if (p->shares[SHARE] <= NEAR) return CONTINUE;
        if (!p->flags[USABLE]) {
            int found = 0;
            const int verdict = linearise(run, p, &found);
            *how = SINGULAR;
            if (verdict || !found) return verdict;
            fresh = 1;
        }
        const double norm = p->shares[NORM];
        int better = 0;
        const int verdict = descend(run, p, norm, fresh, &better);
        *how = STUCK;
        if (verdict || (fresh && !better)) return verdict;
        p->flags[USABLE] = better && p->shares[NORM] <= FAST * norm;
        fresh = 0;
    }
    *how = p->shares[SHARE] <= NEAR ? SOLVED : STUCK;
    return CONTINUE;
}

static int find(Run *run, const Loop *p, int *how) {
    *how = SOLVED;
    memset(p->scale, 0, (size_t)p->count * sizeof *p->scale);
    p->counts[SOLVES]++;
    if (p->sweeps && !p->flags[CIRCULAR]) {
        int settled = 0;
        copy(p, p->start, p->u);
        const int verdict = carry_round(run, p, &settled);
        if (verdict || settled) return verdict;
        p->flags[CIRCULAR] = 1;
        copy(p, p->u, p->start);
    }
    int verdict = evaluate(run, p);
    if (!verdict) verdict = newton(run, p, how);
    if (p->shares[SHARE] <= ENOUGH && *how != SINGULAR) *how = SOLVED;
    return verdict;
}

int solve_loop(Run *run, const Loop *p) {
    int how;
    for (int32_t i = 0; i < p->count; i++) p->u[i] = run->real[p->targets[i]];
    const int verdict = find(run, p, &how);
    if (verdict) return verdict;
    if (how != SOLVED) return run->judge(p, 0, how);
    for (int32_t i = 0; i < p->count; i++) p->seen[i] = larger(p->seen[i], fabs(p->u[i]));
    p->shares[WORST] = larger(p->shares[WORST], p->shares[SHARE]);
    for (int32_t i = 0; i < p->count; i++) run->real[p->targets[i]] = p->u[i];
    for (int32_t i = 0; i < p->outputs; i++) run->real[p->sources[i]] = p->y[i];
    return CONTINUE;
}
