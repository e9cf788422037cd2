/* Co-simulation: a communication step, with checks of its time and length. */

#include <float.h>
#include <math.h>

#include "instance.h"

/* Rounding error by which two computations of the same time may differ. */
static double rounding(double time) { return 2 * DBL_EPSILON * fabs(time); }

/* 1 if a step from `time` over `length` is possible, else 0 and a message. */
static int step_allowed(Core *core, double time, double length) {
    const State *s = &core->s;
    const double end = time + length;
    const double largest_gap = 0.01 * length + rounding(time); /* a larger one is an error of the master */
    if (!(length > 0.0) || !isfinite(end) || end == time)
        core_message(core, ERROR, "the step size is %g s at t = %.15g s, expected one that advances the time",
                     length, time);
    else if (!(fabs(time - s->time) <= largest_gap))
        core_message(core, ERROR, "the communication point is %.15g s, expected %.15g s", time, s->time);
    else if (end > s->stop_time + largest_gap)
        core_message(core, ERROR, "the step ends at %.15g s, after the stop time %.15g s", end, s->stop_time);
    else return 1;
    return 0;
}

Status do_step(Instance *self, double time, double length) {
    State *s = &self->core.s;
    if (!step_allowed(&self->core, time, length)) return ERROR;
    /* If the master's time differs from ours by more than rounding, the step covers the gap; else we take over
       the master's time. */
    const double gap = time - s->time;
    if (fabs(gap) > rounding(time)) length += gap;
    else s->time = time;
    if (core_step(&self->core, length)) return OK;
    s->phase = STEP_FAILED;
    return ERROR;
}
