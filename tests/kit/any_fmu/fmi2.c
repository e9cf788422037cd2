/* The models behind FMI 2.0. fmi2CancelStep is left out on purpose: there has to be an FMU that lacks something. */
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "models.h"

typedef struct {
    Instance m;
    fmi2CallbackFunctions call;
} Slave;

static void say(Instance *m, enum Status status, const char *category, const char *text) {
    const fmi2CallbackFunctions *call = &((Slave *)m)->call;
    call->logger(call->componentEnvironment, m->name, (fmi2Status)status, category, "%s", text);
}

static fmi2Status as2(enum Status status) { return (fmi2Status)status; }

/* ---- life */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)n, (void)categories;
    ((Instance *)c)->logging = on;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging) {
    enum Model model = named(guid);
    (void)visible;
    if (type != fmi2CoSimulation || model == NOBODY) {
        if (logging)
            call->logger(call->componentEnvironment, name, fmi2Error, "logStatusError", "wrong guid %s", guid);
        return NULL;
    }
    Slave *slave = call->allocateMemory(1, sizeof *slave);
    begin(&slave->m, model, name, resources);
    slave->call = *call, slave->m.say = say, slave->m.logging = logging;
    return slave;
}

void fmi2FreeInstance(fmi2Component c) {
    instances--;
    farewell(c);
    ((Slave *)c)->call.freeMemory(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *m = c;
    (void)tolerance_defined, (void)tolerance;
    if (m->mode != INSTANTIATED) return as2(complain(m, FAILED, "fmi2SetupExperiment in mode", m->mode));
    m->time = start, m->stop_defined = stop_defined, m->stop = stop;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return as2(move(c, INSTANTIATED, INITIALIZING)); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return as2(move(c, INITIALIZING, READY)); }
fmi2Status fmi2Terminate(fmi2Component c) { return as2(move(c, READY, TERMINATED)); }
fmi2Status fmi2Reset(fmi2Component c) { return as2(complain(c, FAILED, "no reset", 0)); }

/* ---- values */

#define GETS(FIELD, COUNT, AS)                                                                          \
    Instance *m = c;                                                                                   \
    if (m->mode == INSTANTIATED) return as2(complain(m, FAILED, "get before initialization", m->mode)); \
    outputs(m);                                                                                        \
    if (m->model == QUIRK && m->i[Q_STRICT] && m->touched) return as2(complain(m, FAILED, "get after set", 0)); \
    enum Status status = odd(m, GET);                                                                  \
    if (status > WARNED) return as2(status);                                                           \
    for (size_t k = 0; k < n; k++) {                                                                   \
        if (vr[k] >= COUNT) return as2(complain(m, FAILED, "no variable", vr[k]));                     \
        value[k] = AS m->FIELD[vr[k]];                                                                 \
    }                                                                                                  \
    return as2(status);

#define SETS(FIELD, COUNT)                                                          \
    Instance *m = c;                                                               \
    enum Status status = odd(m, SET);                                              \
    m->touched = m->mode == READY;                                                 \
    if (status > WARNED) return as2(status);                                       \
    for (size_t k = 0; k < n; k++) {                                               \
        if (vr[k] >= COUNT) return as2(complain(m, FAILED, "no variable", vr[k])); \
        m->FIELD[vr[k]] = value[k];                                                \
    }                                                                              \
    return as2(status);

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    GETS(r, REALS, )
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    GETS(i, INTEGERS, (fmi2Integer))
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    GETS(i, INTEGERS, (fmi2Boolean))
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    GETS(s, STRINGS, )
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    SETS(r, REALS)
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    SETS(i, INTEGERS)
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    SETS(i, INTEGERS)
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    Instance *m = c;
    for (size_t k = 0; k < n; k++) strncpy(m->s[vr[k]], value[k], LENGTH - 1);
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Instance *m = c;
    int mass = m->model == MASS_A || m->model == MASS_B;
    int highest = m->model == QUIRK ? (int)m->i[Q_HIGHEST] : mass ? (int)m->i[M_HIGHEST] : ORDERS;
    enum Status status = odd(m, CURVE);
    if (status > WARNED) return as2(status);
    for (size_t k = 0; k < n; k++) {
        if (order[k] < 1 || order[k] > highest) return as2(complain(m, FAILED, "derivative of order", order[k]));
        m->slope[vr[k]][order[k] - 1] = value[k];
    }
    return as2(status);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    enum Status status = odd(c, SLOPE);
    if (status > WARNED) return as2(status);
    for (size_t k = 0; k < n; k++)
        if (order[k] != 1 || !derivative(c, (int)vr[k], &value[k]))
            return as2(complain(c, FAILED, "derivative of", vr[k]));
    return as2(status);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t rows,
                                        const fmi2ValueReference knowns[], size_t columns, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    for (size_t i = 0; i < rows; i++) {
        sensitivity[i] = 0;
        for (size_t j = 0; j < columns; j++) sensitivity[i] += gain(c, (int)unknowns[i], (int)knowns[j]) * seed[j];
    }
    return fmi2OK;
}

/* ---- steps */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_rollback) {
    Instance *m = c;
    if (no_rollback) m->final = t;
    if (trouble(m, t) == ENOUGH) return fmi2Discard;
    return as2(advance(m, t, h));
}


fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->time;
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = trouble(c, ((Instance *)c)->time) == ENOUGH;
    return fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v) { (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v) { (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v) { (void)c, (void)k, (void)v; return fmi2Discard; }

/* ---- rollback */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    enum Status status = odd(c, SAVE);
    if (status > WARNED) return as2(status);
    if (!*state) *state = malloc(sizeof(Instance)), saved++;
    memcpy(*state, c, sizeof(Instance));
    return as2(status);
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    enum Status status = odd(c, RESTORE);
    if (status > WARNED) return as2(status);
    if ((status = restore(c, state)) > WARNED) return as2(status);
    ((Instance *)c)->say = say; /* the state may come from another process */
    return as2(status);
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    if (*state) saved--;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c, (void)state;
    *size = sizeof(Instance);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    (void)c;
    memcpy(bytes, state, size);
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    if (size != sizeof(Instance)) return as2(complain(c, FAILED, "state of size", (double)size));
    if (!*state) *state = malloc(size), saved++;
    memcpy(*state, bytes, size);
    return fmi2OK;
}
