/* Co-simulation: one communication step. */

#include <float.h>
#include <math.h>

#include "instance.h"

/* What times in two ways of counting may differ by. */
static double rounding(double time) { return 2 * DBL_EPSILON * fabs(time); }

/* The first reason why a step from `time` over `length` is impossible, as a message; 0 if there is one. */
static int possible(Core *core, double time, double length) {
    const State *s = &core->s;
    const double end = time + length;
    const double late = 0.01 * length + rounding(time); /* more than that is a mistake of the master */
    if (!(length > 0.0) || !isfinite(end) || end == time)
        core_message(core, ERROR, "the step size is %g s at t = %.15g s, expected one that advances the time",
                     length, time);
    else if (!(fabs(time - s->time) <= late))
        core_message(core, ERROR, "the communication point is %.15g s, expected %.15g s", time, s->time);
    else if (end > s->stop_time + late)
        core_message(core, ERROR, "the step ends at %.15g s, after the stop time %.15g s", end, s->stop_time);
    else return 1;
    return 0;
}

Status do_step(Instance *self, double time, double length) {
    State *s = &self->core.s;
    if (!possible(&self->core, time, length)) return ERROR;
    /* A gap between the master's time and ours becomes part of the step; rounding does not. */
    const double gap = time - s->time;
    if (fabs(gap) > rounding(time)) length += gap;
    else s->time = time;
    if (core_step(&self->core, length)) return OK;
    s->phase = STEP_FAILED;
    return ERROR;
}
