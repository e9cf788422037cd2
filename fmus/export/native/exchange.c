/* Model exchange: states and derivatives for the solver of the importer. At a time event only derivatives and rates change, not states.

   Some importers, such as OpenModelica, set parameters and states between fmi2ExitInitializationMode and
   continuous-time mode, which the standard does not allow for. So the initialisation stays open until the first
   states are set or integrated. Until then fixed parameters may be set, and calculated start values are computed
   anew. A change of inputs changes these until the importer has read the states or has updated the initial event. */

#include <math.h>
#include <string.h>

#include "instance.h"

/* A state that exceeds this multiple of its nominal value has diverged. */
static const double DIVERGED = 1e4;

/* Inputs that keep their values over this time [s] are held. A shorter one shows nothing: times of one instant differ
   by rounding, and a sine at its peak keeps its value over 1e-8 s. */
static const double HELD = 1e-6;

/* 1 if the importer's array can hold the states; else 0 and a message. */
static int right_size(Instance *self, const double x[], size_t n) {
    if (n == NX) return valid_array(self, x, n);
    core_message(&self->core, ERROR, "%zu states, expected %d", n, NX);
    return 0;
}

/* After this call no fixed parameter can be set. */
static Status end_initialisation(Instance *self) {
    if (self->core.s.initial && !core_check_state(&self->core)) return ERROR;
    self->core.s.initial = 0;
    return OK;
}

/* ---- inputs that are held ----------------------------------------------------------------------

   Some importers, such as FMPy's simulate_fmu, hold the inputs over their output interval and then change them
   without notice to their solver. A multistep method continues with the history of another right-hand side and
   fails if that has changed much. So it is made to restart at the end of a step if the inputs have jumped there:
   derivatives were computed with the old values over some time, and none with the new ones.

   Inputs that vary with time never meet this condition, in whichever order the importer sets the inputs, computes
   derivatives and completes steps, because no two times share their values. The importer itself finds the kinks and
   jumps of its own sources. Between two requests time passes. */

/* 1 if the input is the time derivative of another one, which model exchange does not use. */
static int is_rate_input(int input) {
    for (int i = 0; i < NU; i++)
        if (model_variables[FIRST_INPUT + i].rate == input) return 1;
    return 0;
}

static int inputs_differ(const Instance *self) {
    for (int i = 0; i < NU; i++)
        if (self->held.inputs[i] != self->core.s.u[i] && !is_rate_input(i)) return 1;
    return 0;
}

void exchange_keep_inputs(Instance *self) {
    memcpy(self->held.inputs, self->core.s.u, NU * sizeof(double));
    self->held.since = NAN;
    self->held.long_enough = self->held.restart = 0;
}

/* At each computation of derivatives: were the inputs the same at another time? */
static void watch_inputs(Instance *self) {
    const double time = self->core.s.time;
    if (inputs_differ(self)) exchange_keep_inputs(self);
    if (isnan(self->held.since)) self->held.since = time;
    self->held.long_enough |= fabs(time - self->held.since) > HELD;
}

/* Some importers, such as fmusim, restart their solver only if valuesOfContinuousStatesChanged is set. */
int exchange_restart_needed(Instance *self) {
    const int restart = self->held.restart;
    self->held.restart = 0;
    return restart;
}

void exchange_fix_start(Instance *self) {
    State *s = &self->core.s;
    if (s->start_fixed || s->phase == INITIALIZATION) return;
    core_start(&self->core);
    s->start_fixed = 1;
}

Status exchange_enter(Instance *self) {
    if (end_initialisation(self) != OK) return ERROR;
    exchange_keep_inputs(self);
    return instance_enter(self, CONTINUOUS_TIME);
}

/* Warns of an explicit solver, such as Euler's method, the default of some importers: the states diverge. */
static void recommend_implicit_solver(Instance *self) {
    const State *s = &self->core.s;
    for (int i = 0; i < NX && !EXPLICIT_FIRST; i++) {
        if (fabs(s->x[i]) < DIVERGED * model_variables[FIRST_STATE + i].nominal) continue;
        core_message(&self->core, WARNING,
                     "%s = %.3g at t = %.9g s: if the solver is explicit, take an implicit one such as CVode, "
                     "because the model is stiff",
                     model_variables[FIRST_STATE + i].name, s->x[i], s->time);
        return;
    }
}

Status exchange_completed(Instance *self, int *event) {
    if (!core_check_state(&self->core)) {
        recommend_implicit_solver(self);
        return ERROR;
    }
    *event = 0;
    if (inputs_differ(self)) {
        *event = self->held.long_enough;
        exchange_keep_inputs(self);
        self->held.restart = *event;
    }
    return OK;
}

/* ---- time, states, derivatives ----------------------------------------------------------------- */

/* Times after the stop time are accepted: solvers step beyond it and interpolate. */
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
    if (end_initialisation(self) != OK) return ERROR;
    if (NX > 0) memcpy(self->core.s.x, x, NX * sizeof *x);
    core_invalidate_states(&self->core);
    return OK;
}

Status exchange_states(Instance *self, double x[], size_t n) {
    if (!right_size(self, x, n)) return ERROR;
    for (int i = 0; i < NX; i++)
        if (!core_get(&self->core, (unsigned)(FIRST_STATE + i), &x[i])) return ERROR;
    exchange_fix_start(self);
    return OK;
}

/* A solver may try states outside the range of the model: DISCARD makes it try a smaller step. */
Status exchange_derivatives(Instance *self, double dx[], size_t n) {
    Core *core = &self->core;
    if (!right_size(self, dx, n)) return ERROR;
    core_derivatives(core);
    watch_inputs(self);
    for (int i = 0; i < NX; i++) {
        dx[i] = core->dx[i];
        if (isfinite(dx[i])) continue;
        core_message(core, DISCARD, "the derivative of %s is %g at t = %.9g s",
                     model_variables[FIRST_STATE + i].name, dx[i], core->s.time);
        recommend_implicit_solver(self);
        return DISCARD;
    }
    return OK;
}

Status exchange_indicators(Instance *self, size_t n) {
    return n == 0 ? OK : refuse(self, "the model has no event indicators");
}

/* Importers compute the absolute tolerance of their solver from the nominal values: FMPy and fmusim use tolerance *
   nominal, others 0.01 of that, with a default tolerance of 1e-5 or 1e-4. With the nominal values of
   modelDescription.xml they would tolerate an error of 100 Pa, which near zero, where the oil is soft, grows to 8 %
   of the pressures. With 0.001 of these values the worst output of strokes of 1 to 6 V is within 0.4 to 1.1 % by
   chance, with 0.0001 within 0.8 % at each interval, in the same time: only the relative tolerance is left. */
static const double NOMINAL_FACTOR = 0.0001;

Status exchange_nominals(Instance *self, double nominal[], size_t n) {
    if (!right_size(self, nominal, n)) return ERROR;
    for (int i = 0; i < NX; i++) nominal[i] = NOMINAL_FACTOR * model_variables[FIRST_STATE + i].nominal;
    return OK;
}

/* Co-simulation has no time events: the importer chooses the steps. */
int exchange_next_event(Instance *self, double *time) {
    const State *s = &self->core.s;
    *time = 0.0;
    if (s->type != MODEL_EXCHANGE) return 0;
    const double next = core_next_event(&self->core);
    if (!isfinite(next) || !(next > s->time)) return 0; /* an event at the current time would repeat for ever */
    *time = next;
    return 1;
}
