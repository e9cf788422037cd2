/* One communication step as a plan says; see sweep.py and part.py. */

#include <math.h>
#include <string.h>

#include "run.h"

/* Give the inputs of a component their polynomials from `begin` [s] after the start of the step on. */
static int give(Run *run, Part *p, double begin, double length, int last) {
    static const double factorial[] = {1.0, 2.0, 6.0};
    double *value = p->values, *derivative = p->derivatives, c[DEGREE + 1];
    for (int32_t i = 0; i < p->count; i++) {
        const Signal *s = &run->signals[p->first + i];
        if (begin != 0.0) shift(s->c, begin, c);
        else memcpy(c, s->c, sizeof c);
        project(c, s->degree, length);
        if (p->revalued && s->wanted) *value++ = c[0];
        for (int32_t k = 0; k < s->degree && k < s->wanted; k++) *derivative++ = factorial[k] * c[k + 1];
        if (begin == 0.0 && s->wanted) run->used[s->target] = c[0];
        if (last && s->wanted) run->used[run->reals + s->target] = value_at(c, length);
    }
    return carry_out(run, &p->writers);
}

/* A component's own steps; `clock` is the time now, and then [s]. */
int advance_part(Run *run, int k, double h, double *clock) {
    Part *p = &run->parts[k];
    const int32_t many = p->factor;
    for (int32_t j = 0; j < many; j++) {
        const double begin = h * j / many, end = j == many - 1 ? h : h * (j + 1) / many, now = run->t + begin;
        int verdict = give(run, p, begin, end - begin, j == many - 1);
        if (!verdict) verdict = step_part(run, k, now, p->even != 0.0 ? p->even : run->t + end - now);
        if (verdict) return verdict;
    }
    const double before = *clock;
    *clock = seconds();
    p->busy += *clock - before;
    return CONTINUE;
}

/* Let inputs that could only be followed roughly end as they should, before outputs are read. */
static int end_inputs(Run *run, const Part *p, double h) {
    if (!p->rough) return CONTINUE;
    double *value = p->values, *derivative = p->derivatives;
    for (int32_t i = 0; i < p->count; i++) {
        const Signal *s = &run->signals[p->first + i];
        if (s->wanted) *value++ = value_at(s->c, h);
        for (int32_t k = 0; k < s->degree && k < s->wanted; k++) *derivative++ = k == 0 ? slope_at(s->c, h) : 0.0;
    }
    return carry_out(run, &p->writers);
}

static void arrive_one(Run *run, Signal *s, double h) {
    const double value = run->real[s->source] * s->factor + s->offset;
    const double slope = s->slope == NO_SLOPE ? 0.0 : run->slopes[s->slope] * s->factor;
    arrive(s, value, slope, h, run->length, run->older);
}

void arrive_all(Run *run, double h, int maker) {
    for (int32_t i = 0; i < run->signal_count; i++) {
        Signal *s = &run->signals[i];
        if (s->maker == DRIVEN || (maker != EVERYBODY && (s->maker != maker || s->tied))) continue;
        arrive_one(run, s, h);
    }
}

static void shape(Run *run, const Part *p, int n, double h) {
    for (int32_t i = 0; i < p->count; i++) {
        Signal *s = &run->signals[p->first + i];
        if (s->maker == DRIVEN) continue;
        if (s->foreseen) {
            if (!n && run->stepped[s->maker] && !s->tied) hit(s, h);
            continue;
        }
        if (s->wanted && (n || (run->stepped[s->maker] && !s->tied))) {
            interpolate(s, run->degree, h, run->length);
            continue;
        }
        predict(s, h, run->length);
        if (run->corrected && s->wanted) give_back(s, h, run->length);
    }
}

/* All components once. */
static int pass(Run *run, int n, double h) {
    double clock = seconds();
    memset(run->stepped, 0, (size_t)run->part_count);
    if (run->pool) {
        for (int32_t k = 0; k < run->part_count; k++) shape(run, &run->parts[k], n, h);
        return pool_step(run->pool, h);
    }
    for (int32_t i = 0; i < run->part_count; i++) {
        const int k = run->turns[i];
        Part *p = &run->parts[k];
        const int looks = run->foresight && i == run->foresight->leads;
        int verdict = looks ? foretell(run, h) : CONTINUE;
        if (verdict) return verdict;
        if (looks) clock = seconds();
        if (n && !p->repeated) continue; /* nothing changes what it did */
        shape(run, p, n, h);
        if (n) verdict = restore_part(run, k);
        if (!verdict) verdict = carry_out(run, &p->newest);
        if (!verdict) verdict = advance_part(run, k, h, &clock);
        if (verdict) return verdict;
        if (!run->sequential) continue;
        verdict = end_inputs(run, p, h);
        if (!verdict) verdict = carry_out(run, &p->reads);
        if (!verdict) verdict = carry_out(run, &p->tell);
        if (verdict) return verdict;
        arrive_all(run, h, k);
        run->stepped[k] = 1;
    }
    return CONTINUE;
}

/* Solve the algebraic loops at the end of a step that may be computed again. */
static int untie(Run *run, double h) {
    const int verdict = carry_out(run, &run->tied);
    if (verdict) return verdict;
    for (int32_t i = 0; i < run->signal_count; i++)
        if (run->signals[i].tied) arrive_one(run, &run->signals[i], h);
    return CONTINUE;
}

/* What another pass could change, at most. */
static double largest_miss(const Run *run, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < run->signal_count; i++)
        if (run->signals[i].maker != DRIVEN) worst = worse(worst, miss(&run->signals[i], h));
    return worst;
}

static void ahead(Run *run, double h) {
    Driver *d = run->driver;
    if (!d) return;
    look(d, run->t + 0.5 * h);
    memcpy(d->middle, d->coming, (size_t)d->count * sizeof *d->middle);
    look(d, run->t + h);
    for (int32_t i = 0; i < d->count; i++)
        drive(&run->signals[d->signals[i]], d->middle[i], d->coming[i], h);
}

int sweep(Run *run, double h, int *passes) {
    ahead(run, h);
    for (int n = 0; n < run->passes; n++) {
        int verdict = pass(run, n, h);
        *passes = n + 1;
        if (!verdict && run->passes > 1) verdict = untie(run, h);
        if (verdict) return verdict;
        if (run->passes > 1 && !(largest_miss(run, h) > run->tolerance)) break;
    }
    if (run->sequential) return CONTINUE;
    for (int32_t k = 0; k < run->part_count; k++) {
        if (!run->parts[k].tell.count) continue;
        const int verdict = end_inputs(run, &run->parts[k], h); /* slopes of outputs may follow from theirs */
        if (verdict) return verdict;
    }
    return CONTINUE;
}

double step_error(const Run *run, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < run->signal_count; i++) {
        const Signal *s = &run->signals[i];
        const int by_mean = run->corrected && s->maker != DRIVEN;
        const double off = by_mean ? defect(s, h) : deviation(s, h, run->passes > 1);
        worst = worse(worst, share(s, off));
    }
    return worst;
}

double power_error(const Run *run, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < run->bond_count; i++) {
        const Signal *effort = &run->signals[run->bonds[2 * i]], *flow = &run->signals[run->bonds[2 * i + 1]];
        const int repeated = run->passes > 1;
        const double power =
            effort->value1 * deviation(flow, h, repeated) - flow->value1 * deviation(effort, h, repeated);
        const double size = magnitude(effort) * magnitude(flow);
        worst = worse(worst, size > 0.0 ? fabs(power) / size : 0.0);
    }
    return worst;
}
