/* Values of the inputs that a scenario drives, at any time. */

#include <math.h>

#include "engine.h"

/* Index of the interval that contains t, for machine i; interval 0 is before the first sample. */
static int64_t interval_at(Scenario *d, int i, double t) {
    int64_t low = 0, high = d->samples;
    const int64_t last = d->interval[i];
    if ((last == 0 || d->time[last - 1] <= t) && (last == d->samples || t < d->time[last])) return last;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (t < d->time[middle]) high = middle;
        else low = middle + 1;
    }
    return d->interval[i] = low;
}

/* The interval that ends at t, where the scenario jumps at t; else the one that contains t. */
static int64_t interval_before(Scenario *d, int i, double t) {
    const int64_t after = interval_at(d, i, t);
    int64_t k = after;
    while (k > 0 && d->time[k - 1] == t) k--;
    return after - k > 1 ? k : after;
}

static int64_t interval(Scenario *d, int i, double t) {
    return t > machine(d->since, i) ? interval_before(d, i, t) : interval_at(d, i, t);
}

/* Number of machines with different times. */
static int times_of(Real t) { return all(t == machine(t, 0)) ? 1 : WIDTH; }

/* Those of some machines whose inputs jump at t [s]; commands jump where they are not those of the last step. */
Mask scenario_jumps(Scenario *d, Real t, Mask machines) {
    if (!d->commands) {
        const int count = times_of(t);
        for (int i = 0; i < count; i++) {
            const double at = machine(t, i);
            if (interval_before(d, i, at) != interval_at(d, i, at)) continue;
            if (count == 1) return NO_MACHINE;
            remove_machine(&machines, i);
        }
        return machines;
    }
    Mask jumps = NO_MACHINE;
    for (int32_t i = 0; i < d->count; i++)
        jumps = jumps || d->commands[d->columns[i]] * d->factor[i] + d->offset[i] != d->at_end[i];
    return jumps && machines;
}

/* Computes the values of the continuous inputs at t [s]. */
void scenario_evaluate(Scenario *d, Real t) {
    if (all(t == d->evaluated_at)) return;
    const int count = times_of(t);
    for (int n = 0; n < count && !d->commands; n++) {
        const double at = machine(t, n);
        const int64_t k = interval(d, n, at);
        const double *base = d->base + k * d->width, *slopes = d->slopes + k * d->width;
        for (int32_t i = 0; i < d->count; i++) {
            const int64_t column = d->columns[i];
            const double value = base[column] + (at - d->anchor[k]) * slopes[column];
            set_machine(&d->at_end[i], n, count, value * d->factor[i] + d->offset[i]);
        }
    }
    for (int32_t i = 0; i < d->count && d->commands; i++)
        d->at_end[i] = d->commands[d->columns[i]] * d->factor[i] + d->offset[i];
    d->evaluated_at = t;
}

/* Sets continuous inputs at t [s], and their rate inputs to the slopes just after t. */
void scenario_set_continuous(Scenario *d, Real t, Real *values) {
    scenario_evaluate(d, t);
    for (int32_t i = 0; i < d->count; i++) values[d->targets[i]] = d->at_end[i];
    const int count = d->rate_count ? times_of(t) : 0;
    for (int n = 0; n < count; n++) {
        const double *slopes = d->slopes + interval(d, n, machine(t, n)) * d->width;
        for (int32_t i = 0; i < d->rate_count; i++) {
            const double slope = d->commands ? 0.0 : slopes[d->rate_columns[i]] * d->rate_factor[i];
            set_machine(&values[d->rates[i]], n, count, slope);
        }
    }
}

/* Computes the values of all driven inputs at t [s]; those that are not continuous have that of the last sample. */
static void compute_inputs(Simulation *sim, Real t) {
    Scenario *d = sim->scenario;
    scenario_set_continuous(d, t, sim->reals);
    const double at = machine(t, 0);
    const int64_t k = interval(d, 0, at);
    const double *base = d->base + k * d->width, *slopes = d->slopes + k * d->width;
    for (int32_t i = 0; i < d->passed_count; i++) {
        const int64_t column = d->passed_columns[i];
        sim->reals[d->passed[i]] = base[column] + (at - d->anchor[k]) * slopes[column];
    }
    for (int32_t i = 0; i < d->discrete_count; i++)
        sim->reals[d->discrete[i]] = base[d->discrete_columns[i]] * d->discrete_factor[i] + d->discrete_offset[i];
    for (int32_t i = 0; i < d->integer_count; i++) {
        const int64_t value = (int64_t)rint(base[d->integer_columns[i]]);
        sim->integers[d->integers[i]] = value * d->integer_factor[i] + d->integer_offset[i];
    }
    for (int32_t i = 0; d->table && i < d->table->count; i++)
        if ((int64_t)rint(base[d->table->source[i]]) == d->table->from[i]) sim->integers[d->table->target[i]] = d->table->to[i];
}

/* Sets all driven inputs at t [s]. */
int scenario_set_inputs(Simulation *sim, Real t) {
    if (!sim->scenario) return CONTINUE;
    compute_inputs(sim, t);
    return execute(sim, &sim->scenario->input_writes);
}

#if WIDTH == 1
/* In a run that goes on from a saved one: have inputs of its scenario other values now than the saved ones? */
int scenario_differs(Simulation *sim) {
    if (!sim->scenario) return 0;
    sim->scenario->since = sim->t, sim->scenario->evaluated_at = NAN;
    values_save(sim);
    compute_inputs(sim, sim->t);
    return memcmp(sim->reals, sim->saved_reals, (size_t)sim->real_count * sizeof *sim->reals)
        || memcmp(sim->integers, sim->saved_integers, (size_t)sim->integer_count * sizeof *sim->integers);
}
#endif
