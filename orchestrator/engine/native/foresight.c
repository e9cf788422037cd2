/* What all inputs will do in a step; see foresight.py and joined.py. */

#include <math.h>
#include <string.h>

#include "run.h"

enum { OPEN, BY_SCENARIO, LEADING, CLOSED };
enum { BLOCK = 8 }; /* so many rows at once; vectors and columns are filled up to a multiple of it */
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

static int inverted(double *a, int32_t *rows, int32_t n, int32_t wide) {
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

typedef struct { /* parts of the slopes */
    const double *a, *b, *c, *d;
} Parts;

static Parts parts(const Foresight *p) {
    const double *a = p->slopes, *b = a + p->n * p->wide, *c = b + p->m * p->wide, *d = c + p->n * p->broad;
    return (Parts){a, b, c, d};
}

static void join(Foresight *p) {
    const int32_t n = p->n, m = p->m, wide = p->wide, broad = p->broad;
    const Parts of = parts(p);
    p->length = 0.0, p->usable = 1;
    copy(p->kc, of.c, n * broad);
    if (p->through) {
        rest_of(p->k, of.d, 1.0, m, broad);
        p->usable = inverted(p->k, p->rows, m, broad);
        zero(p->kc, n * broad);
        for (int32_t j = 0; j < n; j++) add_product(p->k, of.c + j * broad, p->kc + j * broad, m, broad);
    }
    copy(p->closed, of.a, n * wide);
    for (int32_t j = 0; j < n; j++) add_product(of.b, p->kc + j * broad, p->closed + j * wide, m, wide);
}

/* What known changes are to all inputs. */
static void feel(const Foresight *p, const double *known, double *felt) {
    if (!p->through) {
        copy(felt, known, p->broad);
        return;
    }
    zero(felt, p->broad);
    add_product(p->k, known, felt, p->m, p->broad);
}

static void find_drift(const Foresight *p) {
    double *moved = p->stages, *felt = p->felt, *before = p->felt + p->broad;
    zero(p->q, p->wide);
    if (p->since == 0.0) return;
    for (int32_t i = 0; i < p->wide; i++) moved[i] = p->x[i] - p->x0[i];
    add_product(p->closed, moved, p->q, p->n, p->wide);
    feel(p, p->w, felt);
    feel(p, p->w0, before);
    for (int32_t i = 0; i < p->broad; i++) felt[i] -= before[i];
    add_product(parts(p).b, felt, p->q, p->m, p->wide);
    const double over = p->last * (p->since - 0.5 * p->last);
    for (int32_t i = 0; i < p->wide; i++) p->q[i] = (p->f[i] - p->f0[i] - p->q[i]) / over;
}

static void prepare(Foresight *p, double h) {
    if (!p->usable || fabs(h - p->length) <= ALIKE * h) return;
    p->length = h;
    rest_of(p->inverse, p->closed, GAMMA * (h / 3.0), p->n, p->wide);
    p->usable = inverted(p->inverse, p->rows, p->n, p->wide);
}

/* Polynomials of s with the coefficients c of s, s^2 and s^3. */
static double curve(const double *c, int32_t i, int32_t n, double s) {
    return s * (c[i] + s * (c[n + i] + s * c[2 * n + i]));
}

static void solve(const Foresight *p) {
    const int32_t wide = p->wide, broad = p->broad;
    double *d = p->stages, *base = d + wide, *stage = base + wide, *forcing = stage + wide;
    double *rates[] = {forcing + wide, forcing + 2 * wide, forcing + 3 * wide};
    const double delta = p->length / 3.0, share = GAMMA * delta;
    zero(d, wide);
    zero(p->push, 3 * wide);
    for (int k = 0; k < 3; k++) {
        feel(p, p->course + k * broad, p->felt + k * broad);
        add_product(parts(p).b, p->felt + k * broad, p->push + k * wide, p->m, wide);
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

static void know(Run *run, const Foresight *p, int32_t i, double h) {
    Signal *s = &run->signals[p->signals[i]];
    if (p->kinds[i] == LEADING) interpolate(s, DEGREE, h, run->length);
    else if (p->kinds[i] == CLOSED) predict(s, h, run->length);
    p->w[i] = s->value;
    for (int k = 0; k < DEGREE; k++) p->course[k * p->broad + i] = s->c[k + 1];
}

static void give_foretold(Run *run, const Foresight *p, int32_t i, double h) {
    Signal *s = &run->signals[p->signals[i]];
    const double v1 = p->v[i], v2 = p->v[p->broad + i], v3 = p->v[2 * p->broad + i];
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
    copy(p->f0, p->f, p->wide);
    copy(p->x0, p->x, p->wide);
    copy(p->w0, p->w, p->broad);
    p->age++;
    p->since += h;
    p->last = h;
}
