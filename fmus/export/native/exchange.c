/* Model exchange: states and derivatives for the caller's solver. At a time event nothing changes but rates.

   Some importers set parameters and states between fmi2ExitInitializationMode and continuous-time mode
   (OpenModelica's does), which the standard does not foresee. So the initialisation stays open until the first
   states are set or integrated: until then fixed parameters may be set, and calculated start values follow. They
   follow inputs until the caller has got the states, or has updated the event at the start. */

#include <math.h>
#include <string.h>

#include "instance.h"

/* 1 if the caller's array is one of the model's states. */
/* A state above its nominal value times this has diverged. */
static const double FAR_OFF = 1e4;

static int right_size(Instance *self, const double x[], size_t n) {
    if (n == NX) return given(self, x, n);
    core_message(&self->core, ERROR, "%zu states, expected %d", n, NX);
    return 0;
}

/* No fixed parameter can be set from here on. */
static Status close_initialisation(Instance *self) {
    if (self->core.s.initial && !core_sound(&self->core)) return ERROR;
    self->core.s.initial = 0;
    return OK;
}

/* ---- inputs that are held ----------------------------------------------------------------------

   Some importers hold the inputs over their output interval and change them when it is over, behind the back of
   their solver (FMPy's simulate_fmu does). A multistep method then goes on with the history of another right-hand
   side, and fails where that changes much. It is told to start anew when the inputs are others at the end of a step
   and all derivatives since they changed last were computed with their old values. Inputs that move with the time
   do not look like that in a solver that looks ahead; to Euler's method they do, and an event costs it nothing. */

/* The time derivative of another input: of no use where the caller's solver moves that one. */
static int is_rate(int input) {
    for (int i = 0; i < NU; i++)
        if (model_variables[FIRST_INPUT + i].rate == input) return 1;
    return 0;
}

static int inputs_differ(const Instance *self) {
    for (int i = 0; i < NU; i++)
        if (self->held.at[i] != self->core.s.u[i] && !is_rate(i)) return 1;
    return 0;
}

void exchange_hold(Instance *self) {
    memcpy(self->held.at, self->core.s.u, NU * sizeof(double));
    self->held.evaluated = self->held.moved = self->held.restart = 0;
}

/* Some importers start their solver anew only where states have changed their values (fmusim does). */
int exchange_restarts(Instance *self) {
    const int restart = self->held.restart;
    self->held.restart = 0;
    return restart;
}

void exchange_settle(Instance *self) {
    State *s = &self->core.s;
    if (s->settled || s->phase == INITIALIZATION) return;
    core_start(&self->core);
    s->settled = 1;
}

Status exchange_enter(Instance *self) {
    if (close_initialisation(self) != OK) return ERROR;
    exchange_hold(self);
    return instance_enter(self, CONTINUOUS_TIME);
}

/* Euler's method is what some importers take if nothing is said; its states grow without bounds. */
static void advise(Instance *self) {
    const State *s = &self->core.s;
    for (int i = 0; i < NX && !EXPLICIT_FIRST; i++) {
        if (fabs(s->x[i]) < FAR_OFF * model_variables[FIRST_STATE + i].nominal) continue;
        core_message(&self->core, WARNING,
                     "%s = %.3g at t = %.9g s: if the solver is explicit, take an implicit one such as CVode, "
                     "because the model is stiff",
                     model_variables[FIRST_STATE + i].name, s->x[i], s->time);
        return;
    }
}

Status exchange_completed(Instance *self, int *event) {
    if (!core_sound(&self->core)) {
        advise(self);
        return ERROR;
    }
    *event = 0;
    if (inputs_differ(self)) {
        *event = self->held.evaluated && !self->held.moved;
        exchange_hold(self);
        self->held.restart = *event;
    }
    return OK;
}

/* ---- time, states, derivatives ----------------------------------------------------------------- */

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
    if (close_initialisation(self) != OK) return ERROR;
    if (NX > 0) memcpy(self->core.s.x, x, NX * sizeof *x);
    self->core.dx_valid = self->core.y_valid = 0;
    return OK;
}

Status exchange_states(Instance *self, double x[], size_t n) {
    if (!right_size(self, x, n)) return ERROR;
    for (int i = 0; i < NX; i++)
        if (!core_get(&self->core, (unsigned)(FIRST_STATE + i), &x[i])) return ERROR;
    exchange_settle(self);
    return OK;
}

/* A solver may try states outside the model's range: it is told to try another step. */
Status exchange_derivatives(Instance *self, double dx[], size_t n) {
    Core *core = &self->core;
    if (!right_size(self, dx, n)) return ERROR;
    core_derivatives(core);
    self->held.evaluated = 1;
    self->held.moved |= inputs_differ(self);
    for (int i = 0; i < NX; i++) {
        dx[i] = core->dx[i];
        if (isfinite(dx[i])) continue;
        core_message(core, DISCARD, "the derivative of %s is %g at t = %.9g s",
                     model_variables[FIRST_STATE + i].name, dx[i], core->s.time);
        advise(self);
        return DISCARD;
    }
    return OK;
}

Status exchange_indicators(Instance *self, size_t n) {
    return n == 0 ? OK : refuse(self, "the model has no event indicators");
}

/* For the absolute tolerances of the caller's solver. FMPy and fmusim take tolerance * nominal, others 0.01 of that,
   and their tolerance is 1e-5 or 1e-4 if none is given. With the magnitudes of modelDescription.xml an error of
   100 Pa is free then, which near zero, where the oil is soft, grows to 8 % of the pressures; with 0.001 of them the
   worst output of strokes of 1 to 6 V is within 1 %, for a third more time. */
static const double FOR_TOLERANCES = 0.001;

Status exchange_nominals(Instance *self, double nominal[], size_t n) {
    if (!right_size(self, nominal, n)) return ERROR;
    for (int i = 0; i < NX; i++) nominal[i] = FOR_TOLERANCES * model_variables[FIRST_STATE + i].nominal;
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
