/* FMI 3.0: functions for co-simulation. */

#include "fmi3.h"

double intermediate_update(void *owner, double end) {
    Instance *self = owner;
    State *s = &self->core.s;
    const fmi3IntermediateUpdateCallback callback = (fmi3IntermediateUpdateCallback)self->update;
    const char *call = self->core.call;
    fmi3Boolean stop = fmi3False;
    fmi3Float64 when = s->time;
    s->phase = INSIDE_STEP;
    callback(self->environment, s->time, fmi3True, fmi3True, fmi3True, self->early_return && s->time < end,
             &stop, &when);
    s->phase = STEP_MODE;
    self->core.call = call;
    return stop && self->early_return ? when : end;
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    CALL(CO_SIMULATION | EVENT_MODE, instance_enter(instance, STEP_MODE));
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues) {
    CALL(CO_SIMULATION | EVENT_MODE | STEP_MODE | INSIDE_STEP | STEP_FAILED | TERMINATED,
         scalars(instance, nValueReferences, nValues)
             ? values_output_derivatives(instance, valueReferences, nValueReferences, orders, values)
             : ERROR);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    Instance *self = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, __func__, STEP_MODE)) return fmi3Error;
    if (!valid_array(self, eventHandlingNeeded, 1) || !valid_array(self, terminateSimulation, 1)) return fmi3Error;
    if (!valid_array(self, earlyReturn, 1) || !valid_array(self, lastSuccessfulTime, 1)) return fmi3Error;
    const Status status = do_step(self, currentCommunicationPoint, communicationStepSize);
    const double reached = self->core.s.time, end = currentCommunicationPoint + communicationStepSize;
    *eventHandlingNeeded = *terminateSimulation = fmi3False;
    *earlyReturn = status == OK && self->early_return && end - reached > 1e-9 * communicationStepSize;
    *lastSuccessfulTime = reached;
    return (fmi3Status)status;
}
