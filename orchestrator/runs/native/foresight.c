/* What all inputs will do in a step; see foresight.py and joined.py. */

#include <math.h>
#include <string.h>

#include "run.h"

enum { OPEN, BY_SCENARIO, LEADING, CLOSED };
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

static void add_column(double *restrict to, const double *restrict column, double factor, int32_t rows) {
    for (int32_t i = 0; i < rows; i++) to[i] += column[i] * factor;
}

static void subtract_row(double *restrict to, const double *restrict row, double factor, int32_t n) {
    for (int32_t j = 0; j < n; j++) to[j] -= row[j] * factor;
}

static void add_product(const double *matrix, const double *by, double *to, int32_t columns, int32_t rows) {
    for (int32_t j = 0; j < columns; j++)
        if (by[j] != 0.0) add_column(to, matrix + (size_t)j * (size_t)rows, by[j], rows);
}

static void exchange(double *a, double *b, int32_t n, int32_t apart) {
    for (int32_t j = 0; j < n; j++) {
        const double kept = a[j * apart];
        a[j * apart] = b[j * apart], b[j * apart] = kept;
    }
}

static int inverted(double *a, int32_t *rows, int32_t n) {
    for (int32_t k = 0; k < n; k++) {
        int32_t best = k;
        for (int32_t i = k + 1; i < n; i++)
            if (fabs(a[i * n + k]) > fabs(a[best * n + k])) best = i;
        rows[k] = best;
        if (best != k) exchange(a + k * n, a + best * n, n, 1);
        const double pivot = a[k * n + k];
        if (pivot == 0.0 || !(fabs(pivot) < INFINITY)) return 0;
        a[k * n + k] = 1.0;
        for (int32_t j = 0; j < n; j++) a[k * n + j] /= pivot;
        for (int32_t i = 0; i < n; i++) {
            const double factor = a[i * n + k];
            if (i == k || factor == 0.0) continue;
            a[i * n + k] = 0.0;
            subtract_row(a + i * n, a + k * n, factor, n);
        }
    }
    for (int32_t k = n - 1; k >= 0; k--)
        if (rows[k] != k) exchange(a + k, a + rows[k], n, n);
    return 1;
}

/* ---- the components */

static int tell(Run *run, const Foresight *p) {
    for (int32_t k = 0; k < p->telling_count; k++) {
        const Telling *one = &p->tellings[k];
        const int status = derivative_along(one->derivative, one->component, one->fmi, one->of,
                                            (size_t)one->outputs, one->by, (size_t)one->count, one->seed,
                                            one->into);
        const int verdict = status ? run->judge(one, 0, status) : CONTINUE;
        if (verdict) return verdict;
        for (int32_t i = 0; i < one->entries; i++)
            p->slopes[one->to[i]] = one->into[one->from[i]] * one->factor[i];
    }
    return CONTINUE;
}

/* ---- the linear system */

/* The four parts of the slopes. */
static const double *part(const Foresight *p, int of_input, int to_input) {
    const int32_t n = p->n, m = p->m;
    if (!to_input) return p->slopes + (of_input ? n * n : 0);
    return p->slopes + n * n + n * m + (of_input ? n * m : 0);
}

static void join(Foresight *p) {
    const int32_t n = p->n, m = p->m;
    const double *a = part(p, 0, 0), *b = part(p, 1, 0), *c = part(p, 0, 1), *d = part(p, 1, 1);
    p->length = 0.0, p->usable = 1;
    copy(p->kc, c, n * m);
    if (p->through) {
        for (int32_t i = 0; i < m; i++)
            for (int32_t j = 0; j < m; j++) p->k[i * m + j] = (i == j) - d[i * m + j];
        p->usable = inverted(p->k, p->rows, m);
        zero(p->kc, n * m);
        for (int32_t j = 0; j < n; j++) add_product(p->k, c + j * m, p->kc + j * m, m, m);
    }
    copy(p->closed, a, n * n);
    for (int32_t j = 0; j < n; j++) add_product(b, p->kc + j * m, p->closed + j * n, m, n);
}

/* What the known changes are to all inputs. */
static void feel(const Foresight *p) {
    copy(p->felt, p->known, p->m);
    if (!p->through) return;
    zero(p->felt, p->m);
    add_product(p->k, p->known, p->felt, p->m, p->m);
}

static void find_drift(const Foresight *p) {
    const int32_t n = p->n;
    double *moved = p->stages;
    zero(p->q, n);
    if (p->since == 0.0) return;
    for (int32_t i = 0; i < n; i++) moved[i] = p->x[i] - p->x0[i];
    add_product(p->closed, moved, p->q, n, n);
    for (int32_t i = 0; i < p->m; i++) p->known[i] = p->w[i] - p->w0[i];
    feel(p);
    add_product(part(p, 1, 0), p->felt, p->q, p->m, n);
    const double over = p->last * (p->since - 0.5 * p->last);
    for (int32_t i = 0; i < n; i++) p->q[i] = (p->f[i] - p->f0[i] - p->q[i]) / over;
}

static void prepare(Foresight *p, double h) {
    const int32_t n = p->n;
    if (!p->usable || fabs(h - p->length) <= ALIKE * h) return;
    const double share = GAMMA * (h / 3.0);
    p->length = h;
    for (int32_t i = 0; i < n; i++)
        for (int32_t j = 0; j < n; j++) p->inverse[i * n + j] = (i == j) - share * p->closed[i * n + j];
    p->usable = inverted(p->inverse, p->rows, n);
}

/* All that does not depend on the states. */
static void force(const Foresight *p, double s, double *forcing) {
    const int32_t n = p->n, m = p->m;
    const double *c1 = p->course, *c2 = c1 + m, *c3 = c2 + m;
    for (int32_t i = 0; i < m; i++) p->known[i] = s * (c1[i] + s * (c2[i] + s * c3[i]));
    feel(p);
    const double grown = p->since * s + 0.5 * s * s;
    for (int32_t i = 0; i < n; i++) forcing[i] = p->f[i] + grown * p->q[i];
    add_product(part(p, 1, 0), p->felt, forcing, m, n);
}

static void solve(const Foresight *p) {
    const int32_t n = p->n, m = p->m;
    double *d = p->stages, *base = d + n, *stage = base + n, *forcing = stage + n;
    double *rates[] = {forcing + n, forcing + 2 * n, forcing + 3 * n};
    const double delta = p->length / 3.0, share = GAMMA * delta;
    zero(d, n);
    for (int32_t third = 0; third < 3; third++) {
        for (int k = 0; k < 3; k++) {
            copy(base, d, n);
            for (int j = 0; j < k; j++) {
                const double weight = delta * EARLIER[k][j];
                for (int32_t i = 0; i < n; i++) base[i] += weight * rates[j][i];
            }
            force(p, delta * (third + NODES[k]), forcing);
            for (int32_t i = 0; i < n; i++) forcing[i] = base[i] + share * forcing[i];
            zero(stage, n);
            add_product(p->inverse, forcing, stage, n, n);
            for (int32_t i = 0; i < n; i++) rates[k][i] = (stage[i] - base[i]) / share;
        }
        copy(d, stage, n);
        double *v = p->v + third * m;
        if (p->through) copy(v, p->felt, m);
        else zero(v, m);
        add_product(p->kc, d, v, n, m);
    }
}

/* ---- at every step */

static void know(Run *run, const Foresight *p, int32_t i, double h) {
    Signal *s = &run->signals[p->signals[i]];
    if (p->kinds[i] == LEADING) interpolate(s, DEGREE, h, run->length);
    else if (p->kinds[i] == CLOSED) predict(s, h, run->length);
    p->w[i] = s->value;
    for (int k = 0; k < DEGREE; k++) p->course[k * p->m + i] = s->c[k + 1];
}

static void give_foretold(Run *run, const Foresight *p, int32_t i, double h) {
    Signal *s = &run->signals[p->signals[i]];
    const double v1 = p->v[i], v2 = p->v[p->m + i], v3 = p->v[2 * p->m + i];
    if (p->usable && fabs(v1) + fabs(v2) + fabs(v3) < INFINITY) foresee(s, v1, v2, v3, h);
    else predict(s, h, run->length);
}

int foretell(Run *run, double h) {
    Foresight *p = run->foresight;
    for (int32_t i = 0; i < p->m; i++)
        if (p->signals[i] >= 0 && p->kinds[i] != OPEN) know(run, p, i, h);
    int verdict = carry_out(run, &p->rates);
    if (!verdict && p->lag > 1) verdict = carry_out(run, &p->values);
    if (verdict) return verdict;
    if (p->age >= p->lag || !p->usable) {
        verdict = tell(run, p);
        if (verdict) return verdict;
        join(p);
        p->age = 0, p->since = 0.0;
    }
    if (p->lag > 1) find_drift(p);
    prepare(p, h);
    if (p->usable) solve(p);
    for (int32_t i = 0; i < p->m; i++)
        if (p->signals[i] >= 0 && p->kinds[i] == OPEN) give_foretold(run, p, i, h);
    return CONTINUE;
}

void foresight_accept(Foresight *p, double h) {
    copy(p->f0, p->f, p->n);
    copy(p->x0, p->x, p->n);
    copy(p->w0, p->w, p->m);
    p->age++;
    p->since += h;
    p->last = h;
}
