/* FMI 2.0: functions for co-simulation. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "fmi2_instance.h"

enum { STEPPED = CO_SIMULATION | STEP_COMPLETE | STEP_FAILED | TERMINATED };

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetRealInputDerivatives",
                      CO_SIMULATION | INSTANTIATED | INITIALIZATION | STEP_COMPLETE))
        return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *name = vr[i] < NUMBER_OF_VARIABLES ? model_variables[vr[i]].name : "value reference";
        if (vr[i] >= NUMBER_OF_VARIABLES || model_variables[vr[i]].kind != INPUT)
            return fmi2_refuse(self, "%s is not an input", name);
        if (order[i] < 1 || order[i] > 3)
            return fmi2_refuse(self, "%s has derivatives of order 1, 2 and 3 only", name);
        if (!isfinite(value[i]))
            return fmi2_refuse(self, "the derivative of %s is not a finite number", name);
    }
    for (size_t i = 0; i < nvr; i++)
        core_set_input_derivative(&self->core, (int)vr[i] - FIRST_INPUT, order[i], value[i]);
    return fmi2OK;
}

/* Orders beyond the first are zero, as the standard wants it of those that are not provided. */
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetRealOutputDerivatives", STEPPED)) return fmi2Error;
    Core *core = &self->core;
    core_derivatives(core);
    for (int i = 0; i < NX; i++) core->direction[FIRST_STATE + i] = core->dx[i];
    for (int i = 0; i < NU; i++) core->direction[FIRST_INPUT + i] = core_input_slope(core, i);
    core_forward(core);
    for (size_t i = 0; i < nvr; i++) {
        const Variable *v = vr[i] < NUMBER_OF_VARIABLES ? &model_variables[vr[i]] : NULL;
        const char *name = v ? v->name : "value reference";
        if (!v || (v->kind != OUTPUT && v->kind != STATE && v->kind != CALCULATED_STATE))
            return fmi2_refuse(self, "%s is not an output", name);
        value[i] = core->direction[vr[i]];
        if (order[i] < 1) return fmi2_refuse(self, "the order of the derivative of %s is less than 1", name);
        if (order[i] > 1) value[i] = 0.0;
        if (!isfinite(value[i])) return fmi2_refuse(self, "the derivative of %s is not finite", name);
    }
    return fmi2OK;
}

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

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *self = c;
    double length = communicationStepSize;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!fmi2_allowed(self, "fmi2DoStep", STEP_COMPLETE)) return fmi2Error;
    if (!possible(&self->core, currentCommunicationPoint, length)) return fmi2Error;
    /* A gap between the master's time and ours becomes part of the step; rounding does not. */
    const double gap = currentCommunicationPoint - self->core.s.time;
    if (fabs(gap) > rounding(currentCommunicationPoint)) length += gap;
    else self->core.s.time = currentCommunicationPoint;
    if (core_step(&self->core, length)) return fmi2OK;
    self->core.s.phase = STEP_FAILED;
    return fmi2Error;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2CancelStep", CO_SIMULATION | ANY)) return fmi2Error;
    return fmi2_refuse(self, "no step is in progress: fmi2DoStep returns when it is done%s", "");
}

/* fmi2Discard after a message: this kind of status is of another type. */
static fmi2Status unknown_status(Instance *self) {
    core_message(&self->core, DISCARD, "there is no such status");
    return fmi2Discard;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetStatus", STEPPED)) return fmi2Error;
    if (kind != fmi2DoStepStatus) return unknown_status(self);
    *value = self->core.s.phase == STEP_FAILED ? fmi2Error : fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetRealStatus", STEPPED)) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return unknown_status(self);
    *value = self->core.s.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    Instance *self = c;
    (void)kind, (void)value;
    if (!fmi2_allowed(self, "fmi2GetIntegerStatus", STEPPED)) return fmi2Error;
    return unknown_status(self);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetBooleanStatus", STEPPED)) return fmi2Error;
    if (kind != fmi2Terminated) return unknown_status(self);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetStringStatus", STEPPED)) return fmi2Error;
    if (kind != fmi2PendingStatus) return unknown_status(self);
    *value = "";
    return fmi2OK;
}
