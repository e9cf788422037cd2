/* FMI 3.0: names and types of the standard around instance.h. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "instance.h"

static void write3(const Instance *self, Status kind, const char *text) {
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)self->logger;
    logger(self->environment, (fmi3Status)kind, instance_category(kind), text);
}

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi3Status)(allowed(instance, __func__, mask) ? (body) : ERROR)

enum { OUTSIDE = ANY & ~INSIDE_STEP }; /* everywhere but inside a step */

/* ---- life of an instance ----------------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return fmi3Version; }

static Instance *instantiate(const char *name, const char *token, int type, int logging, void *environment,
                             fmi3LogMessageCallback logger) {
    const char *problem = instance_problem(name, token);
    Instance *self = problem ? NULL : instance_create(name, type, logging);
    if (!self) {
        if (logger) logger(environment, fmi3Error, instance_category(ERROR), problem ? problem : "out of memory");
        return NULL;
    }
    self->write = write3;
    self->logger = (void (*)(void))logger;
    self->environment = environment;
    self->time = NUMBER_OF_VARIABLES;
    return self;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    (void)resourcePath, (void)visible;
    return instantiate(instanceName, instantiationToken, MODEL_EXCHANGE, loggingOn, instanceEnvironment,
                       logMessage);
}

/* Inside a step: the caller reads values, sets inputs and may end the step. */
static double update(void *owner, double end) {
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

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)resourcePath, (void)visible;
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables; /* all are available */
    Instance *self = instantiate(instanceName, instantiationToken, CO_SIMULATION, loggingOn,
                                 instanceEnvironment, logMessage);
    if (!self) return NULL;
    self->events = eventModeUsed;
    self->early_return = earlyReturnAllowed;
    self->update = (void (*)(void))intermediateUpdate;
    if (intermediateUpdate) self->core.pause = update;
    return self;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption) {
    (void)instanceName, (void)instantiationToken, (void)resourcePath, (void)visible, (void)loggingOn;
    (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    if (logMessage)
        logMessage(instanceEnvironment, fmi3Error, instance_category(ERROR),
                   "the model has no scheduled execution, expected model exchange or co-simulation");
    return NULL;
}

/* Inside its own step an instance is still needed. Else no word: the caller's log may be gone already. */
void fmi3FreeInstance(fmi3Instance instance) {
    const Instance *self = instance;
    if (self && self->core.s.phase == INSIDE_STEP) allowed(instance, __func__, OUTSIDE);
    else free(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    CALL(ANY, instance_set_log(instance, loggingOn, nCategories, categories));
}

/* To another state of the state machine. */
static Status enter(Instance *self, int phase) {
    self->core.s.phase = phase;
    return OK;
}

static Status initialize(Instance *self, int tolerance_defined, double tolerance, double start,
                         int stop_defined, double stop) {
    const Status status = instance_setup(self, tolerance_defined, tolerance, start, stop_defined, stop);
    return status == OK ? enter(self, INITIALIZATION) : status;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    CALL(INSTANTIATED,
         initialize(instance, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    CALL(INITIALIZATION, instance_initialized(instance));
}

/* Between steps only where the caller said that it would use event mode. */
static Status enter_event_mode(Instance *self) {
    if (self->core.s.phase == STEP_MODE && !self->events)
        return refuse(self, "the instance was made without event mode");
    return enter(self, EVENT_MODE);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    CALL(EVENT_MODE | CONTINUOUS_TIME | STEP_MODE, enter_event_mode(instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    CALL(SIMULATING | STEP_FAILED, enter(instance, TERMINATED));
}

fmi3Status fmi3Reset(fmi3Instance instance) { CALL(OUTSIDE, instance_reset(instance)); }

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) { CALL(INITIALIZATION | EVENT_MODE, OK); }

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime) {
    const void *const results[] = {discreteStatesNeedUpdate,         terminateSimulation,
                                   nominalsOfContinuousStatesChanged, valuesOfContinuousStatesChanged,
                                   nextEventTimeDefined,              nextEventTime};
    if (!allowed(instance, __func__, EVENT_MODE)) return fmi3Error;
    for (int i = 0; i < 6; i++)
        if (!given(instance, results[i], 1)) return fmi3Error;
    *discreteStatesNeedUpdate = *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = *valuesOfContinuousStatesChanged = fmi3False;
    *nextEventTimeDefined = exchange_next_event(instance, nextEventTime) != 0;
    return fmi3OK;
}

/* ---- values ------------------------------------------------------------------------------------ */

/* All variables are scalars: as many values as references. */
static int scalars(Instance *self, size_t n, size_t values) {
    if (n == values) return 1;
    core_message(&self->core, ERROR, "%zu values for %zu scalar variables", values, n);
    return 0;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    CALL(ANY, scalars(instance, nValueReferences, nValues)
                  ? values_get(instance, valueReferences, nValueReferences, values)
                  : ERROR);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    CALL(INSTANTIATED | INITIALIZATION | SIMULATING | INSIDE_STEP,
         scalars(instance, nValueReferences, nValues)
             ? values_set(instance, valueReferences, nValueReferences, values)
             : ERROR);
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                        const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                        size_t nSensitivity) {
    CALL(ANY & ~INSTANTIATED,
         scalars(instance, nKnowns, nSeed) && scalars(instance, nUnknowns, nSensitivity)
             ? values_directional(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity)
             : ERROR);
}

/* From weights of the unknowns those of the knowns, in core->direction. */
static void reverse(Core *core) {
    const State *s = &core->s;
    double *w = core->direction, *wdx = w + FIRST_DERIVATIVE, *wy = w + FIRST_OUTPUT;
    double wx[ROOM(NX)], wu[ROOM(NU)];
    core_start(core);
    if (s->initial) {
        double wp[ROOM(NP)];
        model_start_reverse(s->x, s->u, s->p, core->c, w + FIRST_STATE, wdx, wy, wx, wu, wp);
        memcpy(w + FIRST_PARAMETER, wp, NP * sizeof *wp);
    } else {
        model_reverse(s->x, s->u, s->p, core->c, wdx, wy, wx, wu);
        for (int i = 0; i < NX; i++) wx[i] += w[FIRST_STATE + i];
    }
    memcpy(w + FIRST_STATE, wx, NX * sizeof *wx);
    memcpy(w + FIRST_INPUT, wu, NU * sizeof *wu);
}

static Status adjoint(Instance *self, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                      size_t n_known, const double seed[], double result[]) {
    Core *core = &self->core;
    if (!given(self, unknown, n_unknown) || !given(self, seed, n_unknown)) return ERROR;
    if (!given(self, known, n_known) || !given(self, result, n_known)) return ERROR;
    memset(core->direction, 0, sizeof core->direction);
    for (size_t i = 0; i < n_unknown; i++) {
        if (!is_unknown(self, unknown[i])) return ERROR;
        core->direction[unknown[i]] += seed[i];
    }
    reverse(core);
    for (size_t i = 0; i < n_known; i++) {
        result[i] = 0.0;
        if (known[i] == self->time) continue; /* nothing depends on it */
        if (!is_known(self, known[i])) return ERROR;
        result[i] = core->direction[known[i]];
        if (!isfinite(result[i])) return refuse(self, "the adjoint derivative is not finite");
    }
    return OK;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity) {
    CALL(ANY & ~INSTANTIATED,
         scalars(instance, nUnknowns, nSeed) && scalars(instance, nKnowns, nSensitivity)
             ? adjoint(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity)
             : ERROR);
}

/* ---- saved states ------------------------------------------------------------------------------ */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    CALL(OUTSIDE, states_get(instance, FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    CALL(OUTSIDE, states_set(instance, FMUState));
}

static Status forget(fmi3FMUState *state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
    return OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) { CALL(ANY, forget(FMUState)); }

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    (void)FMUState;
    CALL(ANY, given(instance, size, 1) ? (*size = snapshot_size(), OK) : ERROR);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size) {
    CALL(ANY, states_serialize(instance, FMUState, (char *)serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState) {
    CALL(ANY, states_deserialize(instance, (const char *)serializedState, size, FMUState));
}

/* ---- model exchange ---------------------------------------------------------------------------- */

enum { READABLE = MODEL_EXCHANGE | INITIALIZATION | EVENT_MODE | CONTINUOUS_TIME | TERMINATED };

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    CALL(MODEL_EXCHANGE | EVENT_MODE, enter(instance, CONTINUOUS_TIME));
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
    Instance *self = instance;
    (void)noSetFMUStatePriorToCurrentPoint;
    if (!allowed(self, __func__, CONTINUOUS_TIME)) return fmi3Error;
    if (!given(self, enterEventMode, 1) || !given(self, terminateSimulation, 1)) return fmi3Error;
    *enterEventMode = *terminateSimulation = fmi3False;
    return core_sound(&self->core) ? fmi3OK : fmi3Error;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) {
    CALL(MODEL_EXCHANGE | EVENT_MODE | CONTINUOUS_TIME, exchange_set_time(instance, time));
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    CALL(CONTINUOUS_TIME, exchange_set_states(instance, continuousStates, nContinuousStates));
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
    CALL(READABLE | INSTANTIATED, given(instance, nEventIndicators, 1) ? (*nEventIndicators = 0, OK) : ERROR);
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
    CALL(READABLE | INSTANTIATED, given(instance, nContinuousStates, 1) ? (*nContinuousStates = NX, OK) : ERROR);
}

/* ---- co-simulation ----------------------------------------------------------------------------- */

fmi3Status fmi3EnterStepMode(fmi3Instance instance) {
    CALL(CO_SIMULATION | EVENT_MODE, enter(instance, STEP_MODE));
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
    if (!given(self, eventHandlingNeeded, 1) || !given(self, terminateSimulation, 1)) return fmi3Error;
    if (!given(self, earlyReturn, 1) || !given(self, lastSuccessfulTime, 1)) return fmi3Error;
    const Status status = do_step(self, currentCommunicationPoint, communicationStepSize);
    const double reached = self->core.s.time, end = currentCommunicationPoint + communicationStepSize;
    *eventHandlingNeeded = *terminateSimulation = fmi3False;
    *earlyReturn = status == OK && self->early_return && end - reached > 1e-9 * communicationStepSize;
    *lastSuccessfulTime = reached;
    return (fmi3Status)status;
}
