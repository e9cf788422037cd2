/* A scenario: the inputs that it drives, at communication points and in the step to come. */

#include <math.h>

#include "engine.h"

/* The interval that holds t, counted from 0 = before the first sample. */
static int64_t row_of(Scenario *d, double t) {
    int64_t low = 0, high = d->samples;
    if ((d->row == 0 || d->time[d->row - 1] <= t) && (d->row == d->samples || t < d->time[d->row])) return d->row;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (t < d->time[middle]) high = middle;
        else low = middle + 1;
    }
    return d->row = low;
}

/* Finds the values at t [s] of the inputs that move. */
void scenario_look(Scenario *d, double t) {
    if (t == d->when) return;
    const int64_t row = row_of(d, t);
    const double *base = d->base + row * d->width, *slopes = d->slopes + row * d->width;
    for (int32_t i = 0; i < d->count; i++) {
        const int64_t column = d->columns[i];
        d->coming[i] = (base[column] + (t - d->anchor[row]) * slopes[column]) * d->factor[i] + d->offset[i];
    }
    d->when = t;
}

/* Sets all driven inputs to their value at t [s], those that are not continuous to the last sample. */
int scenario_set(Simulation *sim, double t) {
    Scenario *d = sim->scenario;
    if (!d) return CONTINUE;
    scenario_look(d, t);
    for (int32_t i = 0; i < d->count; i++) sim->real[d->targets[i]] = d->coming[i];
    const double *base = d->base + row_of(d, t) * d->width;
    for (int32_t i = 0; i < d->steady_count; i++)
        sim->real[d->steady[i]] = base[d->steady_columns[i]] * d->steady_factor[i] + d->steady_offset[i];
    for (int32_t i = 0; i < d->held_count; i++)
        sim->whole[d->held[i]] = (int32_t)rint(base[d->held_columns[i]]);
    return carry_out(sim, &d->writers);
}
