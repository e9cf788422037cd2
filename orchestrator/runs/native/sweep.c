/* One communication step as a plan says; see sweep.py and part.py. */

#include <string.h>

#include "run.h"

/* Give the inputs of a component their polynomials from `begin` [s] after the start of the step on. */
static int give(Run *run, Part *p, double begin, double length, int last) {
    static const double factorial[] = {1.0, 2.0, 6.0};
    double *derivative = p->derivatives, c[DEGREE + 1];
    for (int32_t i = 0; i < p->count; i++) {
        const Signal *s = &run->signals[p->first + i];
        if (begin != 0.0) shift(s->c, begin, c);
        else memcpy(c, s->c, sizeof c);
        project(c, s->degree, length);
        if (p->revalued) p->values[i] = c[0];
        for (int32_t k = 0; k < s->degree && k < s->wanted; k++) *derivative++ = factorial[k] * c[k + 1];
        if (begin == 0.0) run->used[s->target] = c[0];
        if (last) run->used[run->reals + s->target] = value_at(c, length);
    }
    return carry_out(run, &p->writers);
}

/* A component's own steps; `clock` is the time now, and then [s]. */
static int advance(Run *run, int k, double h, double *clock) {
    Part *p = &run->parts[k];
    const int32_t many = p->factor;
    for (int32_t j = 0; j < many; j++) {
        const double begin = h * j / many, end = h * (j + 1) / many, now = run->t + begin;
        int verdict = give(run, p, begin, end - begin, j == many - 1);
        if (!verdict) verdict = step_part(run, k, now, run->t + end - now);
        if (verdict) return verdict;
    }
    const double before = *clock;
    *clock = seconds();
    p->busy += *clock - before;
    return CONTINUE;
}

double arrive_all(Run *run, double h, int maker) {
    double change = 0.0;
    for (int32_t i = 0; i < run->signal_count; i++) {
        Signal *s = &run->signals[i];
        if (s->maker == DRIVEN || (maker != EVERYBODY && s->maker != maker)) continue;
        const double value = run->real[s->source] * s->factor + s->offset;
        const double slope = s->slope == NO_SLOPE ? 0.0 : run->slopes[s->slope] * s->factor;
        const double found = arrive(s, value, slope, h, run->length);
        if (found > change) change = found;
    }
    return change;
}

static void shape(Run *run, const Part *p, int n, double h) {
    for (int32_t i = 0; i < p->count; i++) {
        Signal *s = &run->signals[p->first + i];
        if (s->maker == DRIVEN) interpolate(s, 1, h);
        else if (n || run->stepped[s->maker]) interpolate(s, run->degree, h);
        else predict(s, run->order, run->length);
    }
}

/* All components once; `change`: the largest of a signal since the pass before. */
static int pass(Run *run, int n, double h, double *change) {
    double clock = seconds();
    *change = 0.0;
    memset(run->stepped, 0, (size_t)run->part_count);
    for (int32_t i = 0; i < run->part_count; i++) {
        const int k = run->turns[i];
        Part *p = &run->parts[k];
        if (n && !p->count) continue; /* nothing changes what it did */
        shape(run, p, n, h);
        int verdict = n ? restore_part(run, k) : CONTINUE;
        if (!verdict) verdict = carry_out(run, &p->newest);
        if (!verdict) verdict = advance(run, k, h, &clock);
        if (verdict) return verdict;
        if (!run->sequential) continue;
        verdict = carry_out(run, &p->reads);
        if (!verdict) verdict = carry_out(run, &p->tell);
        if (verdict) return verdict;
        const double found = arrive_all(run, h, k);
        if (found > *change) *change = found;
        run->stepped[k] = 1;
    }
    return CONTINUE;
}

int sweep(Run *run, double h) {
    if (run->driver) {
        Driver *d = run->driver;
        look(d, run->t + h);
        for (int32_t i = 0; i < d->count; i++) run->signals[d->signals[i]].value1 = d->coming[i];
    }
    for (int n = 0; n < run->passes; n++) {
        double change;
        const int verdict = pass(run, n, h, &change);
        if (verdict) return verdict;
        run->all_passes++;
        if (n && change <= run->tolerance) break;
    }
    return CONTINUE;
}
