/* Values of the inputs that a scenario drives, at any time. */

#include <math.h>

#include "engine.h"

/* Index of the interval that contains t; interval 0 is before the first sample. */
static int64_t interval_at(Scenario *d, double t) {
    int64_t low = 0, high = d->samples;
    const int64_t last = d->interval;
    if ((last == 0 || d->time[last - 1] <= t) && (last == d->samples || t < d->time[last])) return last;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (t < d->time[middle]) high = middle;
        else low = middle + 1;
    }
    return d->interval = low;
}

/* Computes the values of the continuous inputs at t [s]. */
void scenario_evaluate(Scenario *d, double t) {
    if (t == d->evaluated_at) return;
    const int64_t k = interval_at(d, t);
    const double *base = d->base + k * d->width, *slopes = d->slopes + k * d->width;
    for (int32_t i = 0; i < d->count; i++) {
        const int64_t column = d->columns[i];
        d->at_end[i] = (base[column] + (t - d->anchor[k]) * slopes[column]) * d->factor[i] + d->offset[i];
    }
    d->evaluated_at = t;
}

/* Sets all driven inputs at t [s]: continuous ones are interpolated, their rate inputs have the slope just after t, the
 * others have the value of the last sample. */
int scenario_set_inputs(Simulation *sim, double t) {
    Scenario *d = sim->scenario;
    if (!d) return CONTINUE;
    scenario_evaluate(d, t);
    for (int32_t i = 0; i < d->count; i++) sim->reals[d->targets[i]] = d->at_end[i];
    const double *base = d->base + interval_at(d, t) * d->width;
    const double *slopes = d->slopes + interval_at(d, t) * d->width;
    for (int32_t i = 0; i < d->rate_count; i++) sim->reals[d->rates[i]] = slopes[d->rate_columns[i]] * d->rate_factor[i];
    for (int32_t i = 0; i < d->discrete_count; i++)
        sim->reals[d->discrete[i]] = base[d->discrete_columns[i]] * d->discrete_factor[i] + d->discrete_offset[i];
    for (int32_t i = 0; i < d->integer_count; i++)
        sim->integers[d->integers[i]] = (int32_t)rint(base[d->integer_columns[i]]);
    return execute(sim, &d->input_writes);
}
