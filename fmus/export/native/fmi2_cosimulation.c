/* FMI 2.0: functions for co-simulation. */

#include <math.h>
#include <string.h>

#include "fmi2_instance.h"

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetRealInputDerivatives", INSTANTIATED | INITIALIZATION | STEP_COMPLETE))
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

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetRealOutputDerivatives", STEP_COMPLETE | STEP_FAILED | TERMINATED))
        return fmi2Error;
    Core *core = &self->core;
    core_derivatives(core);
    memcpy(core->vx, core->dx, sizeof core->vx);
    for (int i = 0; i < NU; i++) core->vu[i] = core_input_slope(core, i);
    core_forward(core);
    for (size_t i = 0; i < nvr; i++) {
        const int known = vr[i] < NUMBER_OF_VARIABLES;
        const char *name = known ? model_variables[vr[i]].name : "value reference";
        if (known && vr[i] >= FIRST_OUTPUT) value[i] = core->vy[vr[i] - FIRST_OUTPUT];
        else if (known && vr[i] >= FIRST_STATE && vr[i] < FIRST_DERIVATIVE)
            value[i] = core->vx[vr[i] - FIRST_STATE];
        else return fmi2_refuse(self, "%s is not an output", name);
        if (order[i] != 1) return fmi2_refuse(self, "%s has a derivative of order 1 only", name);
        if (!isfinite(value[i])) return fmi2_refuse(self, "the derivative of %s is not finite", name);
    }
    return fmi2OK;
}

/* The first reason why a step from `time` over `length` is impossible, as a message; 0 if there is one. */
static int possible(Core *core, double time, double length) {
    const State *s = &core->s;
    const double end = time + length;
    if (!(length > 0.0) || !isfinite(end) || end == time)
        core_message(core, ERROR, "the step size is %g s at t = %.9g s, expected > 0", length, time);
    /* Masters add up step sizes or count steps: one per cent of a step is rounding, more is a mistake. */
    else if (!(fabs(time - s->time) <= 0.01 * length))
        core_message(core, ERROR, "the communication point is %.9g s, expected %.9g s", time, s->time);
    else if (end > s->stop_time + 0.01 * length)
        core_message(core, ERROR, "the step ends at %.9g s, after the stop time %.9g s", end, s->stop_time);
    else return 1;
    return 0;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    Instance *self = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!fmi2_allowed(self, "fmi2DoStep", STEP_COMPLETE)) return fmi2Error;
    if (!possible(&self->core, currentCommunicationPoint, communicationStepSize)) return fmi2Error;
    self->core.s.time = currentCommunicationPoint;
    if (core_step(&self->core, communicationStepSize)) return fmi2OK;
    self->core.s.phase = STEP_FAILED;
    return fmi2Error;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2CancelStep", ANY)) return fmi2Error;
    return fmi2_refuse(self, "no step is in progress: fmi2DoStep returns when it is done%s", "");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetStatus", STEP_COMPLETE | STEP_FAILED | TERMINATED)) return fmi2Error;
    if (kind != fmi2DoStepStatus) return fmi2Discard;
    *value = self->core.s.phase == STEP_FAILED ? fmi2Error : fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetRealStatus", STEP_COMPLETE | STEP_FAILED | TERMINATED)) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = self->core.s.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    Instance *self = c;
    (void)kind, (void)value;
    if (!fmi2_allowed(self, "fmi2GetIntegerStatus", STEP_COMPLETE | STEP_FAILED | TERMINATED))
        return fmi2Error;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetBooleanStatus", STEP_COMPLETE | STEP_FAILED | TERMINATED))
        return fmi2Error;
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetStringStatus", STEP_COMPLETE | STEP_FAILED | TERMINATED)) return fmi2Error;
    if (kind != fmi2PendingStatus) return fmi2Discard;
    *value = "";
    return fmi2OK;
}
