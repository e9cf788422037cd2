/* FMI 3.0: functions for model exchange. */

#include "fmi3.h"

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    CALL(MODEL_EXCHANGE | EVENT_MODE, exchange_enter(instance));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
    Instance *self = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, __func__, CONTINUOUS_TIME)) return fmi3Error;
    if (!valid_array(self, enterEventMode, 1) || !valid_array(self, terminateSimulation, 1)) return fmi3Error;
    int event = 0;
    const Status status = exchange_completed(self, &event);
    *enterEventMode = event;
    *terminateSimulation = fmi3False;
    return (fmi3Status)status;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    CALL(MODEL_EXCHANGE | EVENT_MODE | CONTINUOUS_TIME, exchange_set_time(instance, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    CALL(MODEL_EXCHANGE | EVENT_MODE | CONTINUOUS_TIME,
         exchange_set_states(instance, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates) {
    CALL(READABLE, exchange_derivatives(instance, derivatives, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[],
                                  size_t nEventIndicators) {
    (void)eventIndicators;
    CALL(READABLE, exchange_indicators(instance, nEventIndicators));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    CALL(READABLE, exchange_states(instance, continuousStates, nContinuousStates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[],
                                             size_t nContinuousStates) {
    CALL(READABLE | INSTANTIATED, exchange_nominals(instance, nominals, nContinuousStates));
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
    CALL(READABLE | INSTANTIATED,
         valid_array(instance, nEventIndicators, 1) ? (*nEventIndicators = 0, OK) : ERROR);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
    CALL(READABLE | INSTANTIATED,
         valid_array(instance, nContinuousStates, 1) ? (*nContinuousStates = NX, OK) : ERROR);
}
