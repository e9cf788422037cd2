/* FMI 2.0: functions for model exchange. The model has no events of its own. */

#include <math.h>
#include <string.h>

#include "fmi2_instance.h"

enum { READABLE = MODEL_EXCHANGE | INITIALIZATION | EVENT_MODE | CONTINUOUS_TIME | TERMINATED };

/* 1 if the caller's number of states is the model's. */
static int right_size(Instance *self, size_t n) {
    if (n == NX) return 1;
    core_message(&self->core, ERROR, "%zu states, expected %d", n, NX);
    return 0;
}

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2EnterEventMode", CONTINUOUS_TIME | EVENT_MODE)) return fmi2Error;
    self->core.s.phase = EVENT_MODE;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2NewDiscreteStates", EVENT_MODE)) return fmi2Error;
    memset(eventInfo, 0, sizeof *eventInfo);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2EnterContinuousTimeMode", EVENT_MODE)) return fmi2Error;
    self->core.s.phase = CONTINUOUS_TIME;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    Instance *self = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!fmi2_allowed(self, "fmi2CompletedIntegratorStep", CONTINUOUS_TIME)) return fmi2Error;
    *enterEventMode = *terminateSimulation = fmi2False;
    return core_sound(&self->core) ? fmi2OK : fmi2Error;
}

/* Times after the stop time are accepted: solvers step over it and interpolate. */
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetTime", EVENT_MODE | CONTINUOUS_TIME)) return fmi2Error;
    if (!isfinite(time)) return fmi2_refuse(self, "the time is not finite%s", "");
    self->core.s.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetContinuousStates", CONTINUOUS_TIME)) return fmi2Error;
    if (!right_size(self, nx)) return fmi2Error;
    for (int i = 0; i < NX; i++)
        if (!isfinite(x[i]))
            return fmi2_refuse(self, "%s is not a finite number", model_variables[FIRST_STATE + i].name);
    for (int i = 0; i < NX; i++) self->core.s.x[i] = x[i];
    self->core.dx_valid = self->core.y_valid = 0;
    return fmi2OK;
}

/* A solver may try states outside the model's range: it is told to try another step. */
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetDerivatives", READABLE)) return fmi2Error;
    if (!right_size(self, nx)) return fmi2Error;
    core_derivatives(&self->core);
    for (int i = 0; i < NX; i++) {
        derivatives[i] = self->core.dx[i];
        if (!isfinite(derivatives[i])) {
            core_message(&self->core, DISCARD, "the derivative of %s is %g at t = %.9g s",
                         model_variables[FIRST_STATE + i].name, derivatives[i], self->core.s.time);
            return fmi2Discard;
        }
    }
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    Instance *self = c;
    (void)eventIndicators;
    if (!fmi2_allowed(self, "fmi2GetEventIndicators", READABLE)) return fmi2Error;
    return ni == 0 ? fmi2OK : fmi2_refuse(self, "the model has no event indicators%s", "");
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetContinuousStates", READABLE)) return fmi2Error;
    if (!right_size(self, nx)) return fmi2Error;
    for (int i = 0; i < NX; i++)
        if (!core_get(&self->core, (unsigned)(FIRST_STATE + i), &x[i])) return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetNominalsOfContinuousStates", READABLE | INSTANTIATED)) return fmi2Error;
    if (!right_size(self, nx)) return fmi2Error;
    for (int i = 0; i < NX; i++) x_nominal[i] = model_variables[FIRST_STATE + i].nominal;
    return fmi2OK;
}
