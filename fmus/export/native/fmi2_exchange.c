/* FMI 2.0: functions for model exchange. */

#include <string.h>

#include "fmi2.h"

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    CALL(MODEL_EXCHANGE | CONTINUOUS_TIME | EVENT_MODE, instance_enter(c, EVENT_MODE));
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo) {
    if (!allowed(c, __func__, EVENT_MODE) || !valid_array(c, eventInfo, 1)) return fmi2Error;
    memset(eventInfo, 0, sizeof *eventInfo);
    exchange_fix_start(c);
    eventInfo->nextEventTimeDefined = exchange_next_event(c, &eventInfo->nextEventTime);
    eventInfo->valuesOfContinuousStatesChanged = exchange_restart_needed(c);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { CALL(EVENT_MODE, exchange_enter(c)); }

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    Instance *self = c;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, __func__, CONTINUOUS_TIME)) return fmi2Error;
    if (!valid_array(self, enterEventMode, 1) || !valid_array(self, terminateSimulation, 1)) return fmi2Error;
    int event = 0;
    const Status status = exchange_completed(self, &event);
    *enterEventMode = event;
    *terminateSimulation = fmi2False;
    return (fmi2Status)status;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    CALL(MODEL_EXCHANGE | EVENT_MODE | CONTINUOUS_TIME, exchange_set_time(c, time));
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    CALL(MODEL_EXCHANGE | EVENT_MODE | CONTINUOUS_TIME, exchange_set_states(c, x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    CALL(READABLE, exchange_derivatives(c, derivatives, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    (void)eventIndicators;
    CALL(READABLE, exchange_indicators(c, ni));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    CALL(READABLE, exchange_states(c, x, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    CALL(READABLE | INSTANTIATED, exchange_nominals(c, x_nominal, nx));
}
