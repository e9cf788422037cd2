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

/* Number of machines with different times. */
static int times_of(Real t) { return all(t == machine(t, 0)) ? 1 : WIDTH; }

/* Computes the values of the continuous inputs at t [s]. */
void scenario_evaluate(Scenario *d, Real t) {
    if (all(t == d->evaluated_at)) return;
    const int count = times_of(t);
    for (int n = 0; n < count && !d->commands; n++) {
        const double at = machine(t, n);
        const int64_t k = interval_at(d, n, at);
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
        const double *slopes = d->slopes + interval_at(d, n, machine(t, n)) * d->width;
        for (int32_t i = 0; i < d->rate_count; i++) {
            const double slope = d->commands ? 0.0 : slopes[d->rate_columns[i]] * d->rate_factor[i];
            set_machine(&values[d->rates[i]], n, count, slope);
        }
    }
}

/* Sets all driven inputs at t [s]; those that are not continuous have the value of the last sample. */
int scenario_set_inputs(Simulation *sim, Real t) {
    Scenario *d = sim->scenario;
    if (!d) return CONTINUE;
    scenario_set_continuous(d, t, sim->reals);
    const double at = machine(t, 0);
    const int64_t k = interval_at(d, 0, at);
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
    return execute(sim, &d->input_writes);
}
