/* FMI 3.0: creation of instances, state machine, variables, FMU states. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3.h"

static void write3(const Instance *self, Status kind, const char *text) {
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)self->logger;
    logger(self->environment, (fmi3Status)kind, instance_category(kind), text);
}

/* ---- instances ------------------------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return fmi3Version; }

static Instance *instantiate(const char *name, const char *token, const char *resources, int type, int logging,
                             void *environment, fmi3LogMessageCallback logger) {
    char text[PROBLEM];
    const char *problem = instance_problem(name, token, type, resources, text);
    Instance *self = problem ? NULL : instance_create(name, type, logging);
    if (!self) {
        if (logger) logger(environment, fmi3Error, instance_category(ERROR), problem ? problem : "out of memory");
        core_reported();
        return NULL;
    }
    self->write = write3;
    self->logger = (void (*)(void))logger;
    self->environment = environment;
    self->has_time = 1;
    return self;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    (void)visible;
    return instantiate(instanceName, instantiationToken, resourcePath, MODEL_EXCHANGE, loggingOn,
                       instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)visible;
    (void)requiredIntermediateVariables, (void)nRequiredIntermediateVariables; /* all are available */
    Instance *self = instantiate(instanceName, instantiationToken, resourcePath, CO_SIMULATION, loggingOn,
                                 instanceEnvironment, logMessage);
    if (!self) return NULL;
    self->events = eventModeUsed;
    self->early_return = earlyReturnAllowed;
    self->update = (void (*)(void))intermediateUpdate;
    if (intermediateUpdate) self->core.intermediate_update = intermediate_update;
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

/* An instance cannot be freed inside its own step. Nothing else is logged: the importer's logger may be gone. */
void fmi3FreeInstance(fmi3Instance instance) {
    const Instance *self = instance;
    if (self && self->core.s.phase == INSIDE_STEP) allowed(instance, __func__, OUTSIDE);
    else free(instance);
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    CALL(ANY, instance_set_log(instance, loggingOn, nCategories, categories));
}

static Status initialize(Instance *self, int tolerance_defined, double tolerance, double start,
                         int stop_defined, double stop) {
    const Status status = instance_setup(self, tolerance_defined, tolerance, start, stop_defined, stop);
    return status == OK ? instance_enter(self, INITIALIZATION) : status;
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    CALL(INSTANTIATED,
         initialize(instance, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    CALL(INITIALIZATION, instance_exit_initialization(instance));
}

/* Between steps this is allowed only if the importer announced that it uses event mode. */
static Status enter_event_mode(Instance *self) {
    if (self->core.s.phase == STEP_MODE && !self->events)
        return refuse(self, "the instance was instantiated without event mode");
    return instance_enter(self, EVENT_MODE);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    CALL(EVENT_MODE | CONTINUOUS_TIME | STEP_MODE, enter_event_mode(instance));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    CALL(SIMULATING | STEP_FAILED, instance_enter(instance, TERMINATED));
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
        if (!valid_array(instance, results[i], 1)) return fmi3Error;
    exchange_fix_start(instance);
    *discreteStatesNeedUpdate = *terminateSimulation = fmi3False;
    *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = exchange_restart_needed(instance);
    *nextEventTimeDefined = exchange_next_event(instance, nextEventTime) != 0;
    return fmi3OK;
}

/* ---- values ------------------------------------------------------------------------------------ */

int scalars(Instance *self, size_t n, size_t values) {
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

/* ---- saved states ------------------------------------------------------------------------------ */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    CALL(OUTSIDE, states_get(instance, FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    CALL(OUTSIDE, states_set(instance, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) { CALL(ANY, states_free(FMUState)); }

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    (void)FMUState;
    CALL(ANY, valid_array(instance, size, 1) ? (*size = snapshot_size(), OK) : ERROR);
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size) {
    CALL(ANY, states_serialize(instance, FMUState, (char *)serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState) {
    CALL(ANY, states_deserialize(instance, (const char *)serializedState, size, FMUState));
}
