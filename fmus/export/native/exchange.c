/* Model exchange: states and derivatives for the caller's solver. At a time event nothing changes but rates. */

#include <math.h>
#include <string.h>

#include "instance.h"

/* 1 if the caller's array is one of the model's states. */
static int right_size(Instance *self, const double x[], size_t n) {
    if (n == NX) return given(self, x, n);
    core_message(&self->core, ERROR, "%zu states, expected %d", n, NX);
    return 0;
}

/* Times after the stop time are accepted: solvers step over it and interpolate. */
Status exchange_set_time(Instance *self, double time) {
    if (!isfinite(time)) return refuse(self, "the time is not finite");
    self->core.s.time = time;
    return OK;
}

Status exchange_set_states(Instance *self, const double x[], size_t n) {
    if (!right_size(self, x, n)) return ERROR;
    for (int i = 0; i < NX; i++)
        if (!isfinite(x[i]))
            return refuse(self, "%s is not a finite number", model_variables[FIRST_STATE + i].name);
    if (NX > 0) memcpy(self->core.s.x, x, NX * sizeof *x);
    self->core.dx_valid = self->core.y_valid = 0;
    return OK;
}

Status exchange_states(Instance *self, double x[], size_t n) {
    if (!right_size(self, x, n)) return ERROR;
    for (int i = 0; i < NX; i++)
        if (!core_get(&self->core, (unsigned)(FIRST_STATE + i), &x[i])) return ERROR;
    return OK;
}

/* A solver may try states outside the model's range: it is told to try another step. */
Status exchange_derivatives(Instance *self, double dx[], size_t n) {
    Core *core = &self->core;
    if (!right_size(self, dx, n)) return ERROR;
    core_derivatives(core);
    for (int i = 0; i < NX; i++) {
        dx[i] = core->dx[i];
        if (isfinite(dx[i])) continue;
        core_message(core, DISCARD, "the derivative of %s is %g at t = %.9g s",
                     model_variables[FIRST_STATE + i].name, dx[i], core->s.time);
        return DISCARD;
    }
    return OK;
}

Status exchange_indicators(Instance *self, size_t n) {
    return n == 0 ? OK : refuse(self, "the model has no event indicators");
}

Status exchange_nominals(Instance *self, double nominal[], size_t n) {
    if (!right_size(self, nominal, n)) return ERROR;
    for (int i = 0; i < NX; i++) nominal[i] = model_variables[FIRST_STATE + i].nominal;
    return OK;
}

/* In co-simulation no events are needed: the caller chooses the steps. */
int exchange_next_event(Instance *self, double *time) {
    const State *s = &self->core.s;
    double wait;
    *time = 0.0;
    if (s->type != MODEL_EXCHANGE) return 0;
    core_start(&self->core);
    model_corner(s->x, s->u, s->p, self->core.c, &wait);
    const double next = s->time + wait;
    if (!isfinite(next) || !(next > s->time)) return 0; /* an event that is already here would never end */
    *time = next;
    return 1;
}
