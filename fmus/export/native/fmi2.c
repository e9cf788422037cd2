/* FMI 2.0: functions common to model exchange and co-simulation. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2_instance.h"

/* ---- messages -------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    unsigned mask;
} Category;

static const Category CATEGORIES[] = {
    {"logEvents", 1u << EVENT},          {"logStatusWarning", 1u << WARNING},
    {"logStatusDiscard", 1u << DISCARD}, {"logStatusError", 1u << ERROR},
    {"logAll", ~0u},
};
enum { NUMBER_OF_CATEGORIES = sizeof CATEGORIES / sizeof *CATEGORIES };

/* Logged without debug logging, too: what goes with fmi2Warning and fmi2Error has to reach the user. */
enum { ALWAYS = 1u << WARNING | 1u << ERROR };

/* The logger takes a printf format in which "#" starts a reference: each "%" and "#" is doubled. */
static void write_log(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name,
                      Severity severity, const char *text) {
    static const fmi2Status STATUS[] = {fmi2OK, fmi2Warning, fmi2Discard, fmi2Error};
    char format[1024];
    size_t n = 0;
    for (; *text && n < sizeof format - 2; text++) {
        if (*text == '%' || *text == '#') format[n++] = *text;
        format[n++] = *text;
    }
    format[n] = '\0';
    logger(environment, name, STATUS[severity], CATEGORIES[severity].name, format);
}

static void report(void *owner, Severity severity, const char *text) {
    Instance *self = owner;
    if (self->logger && (self->log & 1u << severity))
        write_log(self->logger, self->environment, self->name, severity, text);
}

fmi2Status fmi2_refuse(Instance *self, const char *format, const char *detail) {
    core_message(&self->core, ERROR, format, detail);
    return fmi2Error;
}

static const char *phase_name(int phase) {
    switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZATION: return "initialization mode";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME: return "continuous-time mode";
    case STEP_COMPLETE: return "step complete";
    case STEP_FAILED: return "failed";
    default: return "terminated";
    }
}

const char *fmi2_type_name(int type) {
    return type == fmi2CoSimulation ? "co-simulation" : "model exchange";
}

int fmi2_allowed(Instance *self, const char *function, int mask) {
    if (!self) return 0;
    const int type = self->core.s.type;
    self->core.call = function;
    if (mask & (type == fmi2CoSimulation ? MODEL_EXCHANGE : CO_SIMULATION)) {
        fmi2_refuse(self, "not allowed in an instance for %s", fmi2_type_name(type));
        return 0;
    }
    if (!(self->core.s.phase & mask)) {
        fmi2_refuse(self, "not allowed in state \"%s\"", phase_name(self->core.s.phase));
        return 0;
    }
    if (self->log & 1u << EVENT) core_message(&self->core, EVENT, "t = %.9g s", self->core.s.time);
    return 1;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetDebugLogging", ANY)) return fmi2Error;
    /* Without names everything is meant; warnings and errors can be silenced only by name. */
    unsigned mask = nCategories == 0 ? (loggingOn ? ~0u : ~(unsigned)ALWAYS) : 0u;
    for (size_t i = 0; i < nCategories; i++) {
        int known = 0;
        for (int k = 0; k < NUMBER_OF_CATEGORIES; k++)
            if (strcmp(categories[i], CATEGORIES[k].name) == 0) {
                mask |= CATEGORIES[k].mask;
                known = 1;
            }
        if (!known) return fmi2_refuse(self, "log category \"%s\" is unknown", categories[i]);
    }
    self->log = loggingOn ? self->log | mask : self->log & ~mask;
    return fmi2OK;
}

/* ---- life of an instance ----------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    const char *name = instanceName ? instanceName : "";
    const fmi2CallbackLogger logger = functions ? functions->logger : NULL;
    const fmi2ComponentEnvironment environment = functions ? functions->componentEnvironment : NULL;
    const char *problem = NULL;
    (void)fmuResourceLocation;
    (void)visible;
    if (fmuType != fmi2ModelExchange && fmuType != fmi2CoSimulation)
        problem = "fmi2Instantiate: the type is neither model exchange nor co-simulation";
    if (strspn(name, " \t\r\n") == strlen(name)) problem = "fmi2Instantiate: the instance name is empty";
    if (!fmuGUID || strcmp(fmuGUID, MODEL_GUID) != 0)
        problem = "fmi2Instantiate: the GUID differs, expected \"" MODEL_GUID
                  "\" (modelDescription.xml and binary are of different builds)";
    Instance *self = problem ? NULL : calloc(1, sizeof *self + strlen(name) + 1);
    if (!problem && !self) problem = "fmi2Instantiate: out of memory";
    if (problem) {
        if (logger) write_log(logger, environment, name, ERROR, problem);
        return NULL;
    }
    strcpy(self->name, name);
    self->logger = logger;
    self->environment = environment;
    self->log = loggingOn ? ~0u : ALWAYS;
    self->core.report = report;
    self->core.owner = self;
    core_reset(&self->core);
    self->core.s.type = (int)fmuType;
    self->core.s.phase = INSTANTIATED;
    return self;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetupExperiment", INSTANTIATED)) return fmi2Error;
    State *s = &self->core.s;
    if (!isfinite(startTime)) return fmi2_refuse(self, "the start time is not finite%s", "");
    if (stopTimeDefined && !(stopTime >= startTime))
        return fmi2_refuse(self, "the stop time is before the start time%s", "");
    if (toleranceDefined && !(tolerance > 0.0 && tolerance < 1.0))
        return fmi2_refuse(self, "the tolerance is out of range, expected > 0 and < 1%s", "");
    s->time = s->start_time = startTime;
    s->stop_time = stopTimeDefined ? stopTime : HUGE_VAL;
    s->tolerance = toleranceDefined ? fmin(tolerance, LOOSEST_TOLERANCE) : DEFAULT_TOLERANCE;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2EnterInitializationMode", INSTANTIATED)) return fmi2Error;
    self->core.s.phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2ExitInitializationMode", INITIALIZATION)) return fmi2Error;
    if (!core_sound(&self->core)) return fmi2Error;
    self->core.s.initial = 0;
    self->core.s.phase = self->core.s.type == fmi2CoSimulation ? STEP_COMPLETE : EVENT_MODE;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2Terminate", SIMULATING | STEP_FAILED)) return fmi2Error;
    self->core.s.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2Reset", ANY)) return fmi2Error;
    const int type = self->core.s.type;
    core_reset(&self->core);
    self->core.s.type = type;
    self->core.s.phase = INSTANTIATED;
    return fmi2OK;
}

/* ---- values ------------------------------------------------------------------------------------ */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetReal", ANY)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++)
        if (!core_get(&self->core, vr[i], &value[i])) return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SetReal", INSTANTIATED | INITIALIZATION | SIMULATING)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (!core_check(&self->core, vr[i], value[i])) return fmi2Error;
        if (self->core.s.phase == CONTINUOUS_TIME && model_variables[vr[i]].kind != INPUT)
            return fmi2_refuse(self, "%s cannot be set in continuous-time mode", model_variables[vr[i]].name);
    }
    for (size_t i = 0; i < nvr; i++) core_set(&self->core, vr[i], value[i]);
    return fmi2OK;
}

/* The model has no variable of another type. */
static fmi2Status none(Instance *self, const char *function, size_t nvr) {
    if (!fmi2_allowed(self, function, ANY)) return fmi2Error;
    return nvr == 0 ? fmi2OK : fmi2_refuse(self, "the model has Real variables only%s", "");
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2GetInteger", nvr);
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2GetBoolean", nvr);
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2GetString", nvr);
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2SetInteger", nvr);
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2SetBoolean", nvr);
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    (void)vr, (void)value;
    return none(c, "fmi2SetString", nvr);
}
