/* Looks at outputs inside of steps: pulses between two communication points, and jumps.
 *
 * They are at outputs that others do not know between two points (dependencies.py). Before a step the component saves its
 * state, steps to a time inside the step with the inputs that it has, and goes back. Each time it is another part of the
 * step: by multiples of the golden ratio, which no period of pulses hides from. Looks are in each step at first, then
 * rarer and rarer. A component that cannot go back is compared at the points only.
 */

#include <math.h>

#include "engine.h"

static const double GOLDEN = 0.6180339887498949, ENDS = 0.05; /* ENDS: part of a step at each end without looks */
static const double OUTSIDE = 0.1;   /* of its range, by which a resolved output may leave two values around it */
static const double AROUND = 10.0;   /* change of an output that jumps, over that of the steps around it */
static const double FADING = 1.0 / 256.0; /* growth of the number of steps between two looks */

/* Looks at a component inside the step of length h [s] that begins. */
static int look(Simulation *sim, Looks *p, double h) {
    p->phase += GOLDEN, p->phase -= floor(p->phase);
    int verdict = component_save(sim, p->component);
    if (verdict) return verdict;
    verdict = component_try(sim, p->component, h * (ENDS + (1.0 - 2.0 * ENDS) * p->phase));
    if (!verdict) verdict = execute(sim, &p->reads);
    p->looked = !verdict, p->goes_back = !verdict; /* what it does not do here it tells in the step itself */
    if (verdict && verdict != DISCARDED) return verdict;
    verdict = component_restore(sim, p->component, EVERY_MACHINE);
    return verdict ? verdict : sim->check_status(0, 0, WITHDRAWN);
}

int looks_take(Simulation *sim, double h) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->look_count && !verdict; k++) {
        Looks *p = &sim->looks[k];
        p->looked = 0;
        if (p->goes_back && sim->steps >= p->next) verdict = look(sim, p, h);
    }
    return verdict;
}

/* By how much a value is outside of two others, and of a part of the range around them. */
static double outside(const LookedAt *o, double value, double a, double b) {
    const double beyond = larger(value - larger(a, b), smaller(a, b) - value);
    return larger(beyond - OUTSIDE * (o->highest - o->lowest), 0.0);
}

/* The output at the end of an accepted step of length h [s]. */
static void compare(LookedAt *o, double end, double h, double length) {
    const double change = end - o->value, before = fabs(o->change), rate = fabs(change) / h;
    o->lowest = smaller(o->lowest, end), o->highest = larger(o->highest, end);
    const int jumps = before > AROUND * length * larger(o->rate, rate);
    if (jumps || outside(o, o->value, o->value - o->change, end) > 0.0)
        o->jump = larger(o->jump, before), o->late += before * length;
    o->rate = length > 0.0 ? before / length : 0.0, o->change = change, o->value = end;
}

/* Compares the outputs at both ends of an accepted step, and inside of it. */
void looks_compare(Simulation *sim, double h) {
    for (int32_t k = 0; k < sim->look_count; k++) {
        Looks *p = &sim->looks[k];
        if (p->looked) p->next = sim->steps + 1 + (int64_t)(FADING * (double)++p->count);
        for (int32_t i = 0; i < p->outputs; i++) {
            LookedAt *o = &p->at[i];
            const double end = sim->reals[o->index], start = o->value;
            compare(o, end, h, sim->length);
            if (!p->looked) continue;
            o->lowest = smaller(o->lowest, p->inside[i]), o->highest = larger(o->highest, p->inside[i]);
            o->hidden += outside(o, p->inside[i], start, end);
        }
    }
}

/* At the start of the run, and where values jump at a communication point. */
void looks_begin(Simulation *sim) {
    for (int32_t k = 0; k < sim->look_count; k++)
        for (int32_t i = 0; i < sim->looks[k].outputs; i++) {
            LookedAt *o = &sim->looks[k].at[i];
            o->value = sim->reals[o->index], o->change = o->rate = 0.0;
            o->lowest = smaller(o->lowest, o->value), o->highest = larger(o->highest, o->value);
        }
}
