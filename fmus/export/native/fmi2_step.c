/* FMI 2.0: functions for co-simulation. */

#include <math.h>
#include <string.h>

#include "fmi2.h"

enum { STEPPED = CO_SIMULATION | STEP_MODE | STEP_FAILED | TERMINATED };

/* Sets the derivative of an input of order 1 to 3 for the next step; orders that are not set are zero. */
static void set_input_derivative(State *s, int input, int order, double value) {
    if (!s->has_derivatives[input]) memset(s->input_derivatives[input], 0, sizeof s->input_derivatives[input]);
    s->has_derivatives[input] = 1;
    s->input_derivatives[input][order - 1] = value;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Instance *self = c;
    if (!allowed(self, __func__, CO_SIMULATION | INSTANTIATED | INITIALIZATION | STEP_MODE)) return fmi2Error;
    if (!valid_array(self, vr, nvr) || !valid_array(self, order, nvr)) return fmi2Error;
    if (!valid_array(self, value, nvr)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        const char *name = vr[i] < NUMBER_OF_VARIABLES ? model_variables[vr[i]].name : "value reference";
        const char *problem = NULL;
        if (vr[i] >= NUMBER_OF_VARIABLES || model_variables[vr[i]].kind != INPUT)
            problem = "%s is not an input";
        else if (order[i] < 1 || order[i] > 3) problem = "%s has derivatives of order 1, 2 and 3 only";
        else if (!isfinite(value[i])) problem = "the derivative of %s is not a finite number";
        if (problem) return (fmi2Status)refuse(self, problem, name);
    }
    for (size_t i = 0; i < nvr; i++)
        set_input_derivative(&self->core.s, (int)vr[i] - FIRST_INPUT, order[i], value[i]);
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    CALL(STEPPED, values_output_derivatives(c, vr, nvr, order, value));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint;
    CALL(STEP_MODE, do_step(c, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    CALL(CO_SIMULATION | ANY, refuse(c, "no step is in progress: fmi2DoStep returns when it is done"));
}

/* Reports that this kind of status does not exist; returns DISCARD. */
static Status unknown_status(Instance *self) {
    core_message(&self->core, DISCARD, "there is no such status");
    return DISCARD;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    Instance *self = c;
    if (!allowed(self, __func__, STEPPED) || !valid_array(self, value, 1)) return fmi2Error;
    if (kind != fmi2DoStepStatus) return (fmi2Status)unknown_status(self);
    *value = self->core.s.phase == STEP_FAILED ? fmi2Error : fmi2OK;
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *self = c;
    if (!allowed(self, __func__, STEPPED) || !valid_array(self, value, 1)) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return (fmi2Status)unknown_status(self);
    *value = self->core.s.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    CALL(STEPPED, unknown_status(c));
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!allowed(c, __func__, STEPPED) || !valid_array(c, value, 1)) return fmi2Error;
    if (kind != fmi2Terminated) return (fmi2Status)unknown_status(c);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    if (!allowed(c, __func__, STEPPED) || !valid_array(c, value, 1)) return fmi2Error;
    if (kind != fmi2PendingStatus) return (fmi2Status)unknown_status(c);
    *value = "";
    return fmi2OK;
}
