/* FMI 2.0: creation of instances, state machine, variables, FMU states. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"

/* The logger takes a printf format in which "#" starts a reference: each "%" and "#" is doubled. */
static void write_log(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name,
                      Status kind, const char *text) {
    char format[1024];
    size_t n = 0;
    for (; *text && n < sizeof format - 2; text++) {
        if (*text == '%' || *text == '#') format[n++] = *text;
        format[n++] = *text;
    }
    format[n] = '\0';
    logger(environment, name, (fmi2Status)kind, instance_category(kind), format);
}

static void write2(const Instance *self, Status kind, const char *text) {
    write_log((fmi2CallbackLogger)self->logger, self->environment, self->name, kind, text);
}

/* ---- instances ------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    const fmi2CallbackLogger logger = functions ? functions->logger : NULL;
    const fmi2ComponentEnvironment environment = functions ? functions->componentEnvironment : NULL;
    const int type = fmuType == fmi2CoSimulation ? CO_SIMULATION : MODEL_EXCHANGE;
    char text[PROBLEM];
    (void)visible;
    const char *problem = instance_problem(instanceName, fmuGUID, type, fmuResourceLocation, text);
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation)
        problem = "the type is neither model exchange nor co-simulation";
    Instance *self = problem ? NULL : instance_create(instanceName, type, loggingOn);
    if (!self) {
        if (!problem) problem = "out of memory";
        if (logger) write_log(logger, environment, instanceName ? instanceName : "", ERROR, problem);
        core_reported();
        return NULL;
    }
    self->write = write2;
    self->logger = (void (*)(void))logger;
    self->environment = environment;
    return self;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    CALL(ANY, instance_set_log(c, loggingOn, nCategories, categories));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    CALL(INSTANTIATED, instance_setup(c, toleranceDefined, tolerance, startTime, stopTimeDefined, stopTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { CALL(INSTANTIATED, instance_enter(c, INITIALIZATION)); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { CALL(INITIALIZATION, instance_exit_initialization(c)); }
fmi2Status fmi2Terminate(fmi2Component c) { CALL(SIMULATING | STEP_FAILED, instance_enter(c, TERMINATED)); }
fmi2Status fmi2Reset(fmi2Component c) { CALL(ANY, instance_reset(c)); }

/* ---- values ------------------------------------------------------------------------------------ */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    CALL(ANY, values_get(c, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    CALL(INSTANTIATED | INITIALIZATION | SIMULATING, values_set(c, vr, nvr, value));
}

/* The model has no variable of another type. */
static Status none(Instance *self, size_t nvr) {
    return nvr == 0 ? OK : refuse(self, "the model has Real variables only");
}

#define NO_VARIABLES_OF(type)                                                                                \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,                     \
                             fmi2##type value[]) {                                                           \
        (void)vr, (void)value;                                                                               \
        CALL(ANY, none(c, nvr));                                                                             \
    }                                                                                                        \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,                     \
                             const fmi2##type value[]) {                                                     \
        (void)vr, (void)value;                                                                               \
        CALL(ANY, none(c, nvr));                                                                             \
    }

NO_VARIABLES_OF(Integer)
NO_VARIABLES_OF(Boolean)
NO_VARIABLES_OF(String)

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    CALL(ANY & ~INSTANTIATED,
         values_directional(c, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

/* ---- saved states ------------------------------------------------------------------------------ */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) { CALL(ANY, states_get(c, FMUstate)); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) { CALL(ANY, states_set(c, FMUstate)); }

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) { CALL(ANY, states_free(FMUstate)); }

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)FMUstate;
    CALL(ANY, valid_array(c, size, 1) ? (*size = snapshot_size(), OK) : ERROR);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    CALL(ANY, states_serialize(c, FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    CALL(ANY, states_deserialize(c, serializedState, size, FMUstate));
}

