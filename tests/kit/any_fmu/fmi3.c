/* The models behind FMI 3.0. Event mode, early return and intermediate update must not be asked for.
 *
 * Value references are unique over all types in FMI 3.0: reals from 0, whole numbers from 100, texts from 200.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "models.h"

enum { WHOLE = 100, TEXT = 200, TIME = 300 };

typedef struct {
    Instance m;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Slave;

static void say(Instance *m, enum Status status, const char *category, const char *text) {
    Slave *slave = (Slave *)m;
    slave->log(slave->environment, (fmi3Status)status, category, text);
}

static fmi3Status as3(enum Status status) { return (fmi3Status)status; }

/* ---- life */

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    (void)n, (void)categories;
    ((Instance *)c)->logging = on;
    return fmi3OK;
}

/* what is wrong with the arguments of fmi3InstantiateCoSimulation; NULL if nothing */
static const char *wrong(const char *token, const char *path, int modes, size_t required, const void *update) {
    size_t length = path ? strlen(path) : 0;
    if (named(token) == NOBODY) return "wrong guid";
    if (path && (!strncmp(path, "file:", 5) || !strchr("/\\", path[length - 1]))) return "wrong resource path";
    if (modes || required || update) return "asked for more than a plain slave";
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
                                         const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    const char *why = wrong(token, path, visible || event_mode || early_return, n, update ? &update : NULL);
    (void)required;
    if (why) {
        char text[LENGTH];
        snprintf(text, sizeof text, "%s %.100s", why, token);
        if (logging) log(environment, fmi3Error, "logStatusError", text);
        return NULL;
    }
    Slave *slave = calloc(1, sizeof *slave);
    begin(&slave->m, named(token), name, path);
    slave->environment = environment, slave->log = log, slave->m.say = say, slave->m.logging = logging;
    return slave;
}

void fmi3FreeInstance(fmi3Instance c) {
    instances--;
    farewell(c);
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop) {
    Instance *m = c;
    (void)tolerance_defined, (void)tolerance;
    m->time = start, m->stop_defined = stop_defined, m->stop = stop;
    return as3(move(m, INSTANTIATED, INITIALIZING));
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return as3(move(c, INITIALIZING, READY)); }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return as3(move(c, INSTANTIATED, CONFIGURING)); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return as3(move(c, CONFIGURING, INSTANTIATED)); }
fmi3Status fmi3Terminate(fmi3Instance c) { return as3(move(c, READY, TERMINATED)); }

/* ---- values */

#define EACH(CALL, FIRST, COUNT, BODY)                                                               \
    Instance *m = c;                                                                                 \
    enum Status status = odd(m, CALL);                                                               \
    if (status > WARNED) return as3(status);                                                         \
    if (n != count) return as3(complain(m, FAILED, "values for scalars", (double)count));            \
    for (size_t k = 0; k < n; k++) {                                                                 \
        size_t at = vr[k] - (size_t)FIRST;                                                           \
        if (at >= (size_t)COUNT) return as3(complain(m, FAILED, "no variable of this type", vr[k])); \
        BODY;                                                                                        \
    }                                                                                                \
    return as3(status);

#define GETS(NAME, FIRST, COUNT, FIELD)                                                                         \
    fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##NAME value[],       \
                             size_t count) {                                                                    \
        Instance *asked = c;                                                                                    \
        if (asked->mode < INITIALIZING) return as3(complain(asked, FAILED, "get before initialization", 0));    \
        outputs(asked);                                                                                         \
        EACH(GET, FIRST, COUNT, value[k] = (fmi3##NAME)m->FIELD[at])                                            \
    }

#define SETS(NAME, FIRST, COUNT, FIELD)                                                                         \
    fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##NAME value[], \
                             size_t count) {                                                                    \
        EACH(SET, FIRST, COUNT, m->FIELD[at] = value[k])                                                        \
    }

#define WHOLES(NAME) GETS(NAME, WHOLE, INTEGERS, i) SETS(NAME, WHOLE, INTEGERS, i)

GETS(Float32, 0, REALS, r)
SETS(Float32, 0, REALS, r)
SETS(Float64, 0, REALS, r)
WHOLES(Int8)
WHOLES(UInt8)
WHOLES(Int16)
WHOLES(UInt16)
WHOLES(Int32)
WHOLES(UInt32)
WHOLES(Int64)
WHOLES(Boolean)
GETS(UInt64, WHOLE, INTEGERS, i)
GETS(String, TEXT, STRINGS, s)

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t count) {
    Instance *asked = c;
    if (asked->mode < INITIALIZING) return as3(complain(asked, FAILED, "get before initialization", 0));
    outputs(asked);
    if (n == 1 && vr[0] == TIME) {
        value[0] = asked->time;
        return fmi3OK;
    }
    EACH(GET, 0, REALS, value[k] = m->r[at])
}

fmi3Status fmi3SetUInt64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 value[],
                         size_t count) {
    Instance *asked = c;
    int structural = asked->model == WIDE && n == 1 && vr[0] == WHOLE + W_SIZE;
    if (structural && asked->mode != CONFIGURING)
        return as3(complain(asked, FAILED, "structural parameter in mode", asked->mode));
    EACH(SET, WHOLE, INTEGERS, m->i[at] = (long long)value[k])
}

fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3String value[],
                         size_t count) {
    EACH(SET, TEXT, STRINGS, strncpy(m->s[at], value[k], LENGTH - 1))
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 values[], size_t count) {
    EACH(SLOPE, 0, REALS, if (orders[k] != 1 || !derivative(m, (int)at, &values[k]))
                       return as3(complain(m, FAILED, "derivative of", (double)at)))
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t rows,
                                        const fmi3ValueReference knowns[], size_t columns, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 sensitivity[], size_t sensitivities) {
    if (rows != sensitivities || columns != seeds) return as3(complain(c, FAILED, "values for scalars", 0));
    for (size_t i = 0; i < rows; i++) {
        sensitivity[i] = 0;
        for (size_t j = 0; j < columns; j++) sensitivity[i] += gain(c, (int)unknowns[i], (int)knowns[j]) * seed[j];
    }
    return fmi3OK;
}

/* ---- steps */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no_rollback, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *reached) {
    Instance *m = c;
    enum Failure how = trouble(m, t);
    if (no_rollback) m->final = t;
    enum Status status = advance(m, t, how == EARLY ? h / 2 : h);
    *event = how == EVENT, *terminate = how == ENOUGH, *early = how == EARLY;
    *reached = m->time;
    return as3(status);
}

/* ---- rollback */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) {
    enum Status status = odd(c, SAVE);
    if (status > WARNED) return as3(status);
    if (!*state) *state = malloc(sizeof(Instance)), saved++;
    memcpy(*state, c, sizeof(Instance));
    return as3(status);
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) {
    enum Status status = odd(c, RESTORE);
    if (status > WARNED) return as3(status);
    if ((status = restore(c, state)) > WARNED) return as3(status);
    ((Instance *)c)->say = say; /* the state may come from another process */
    return as3(status);
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) {
    (void)c;
    if (*state) saved--;
    free(*state);
    *state = NULL;
    return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) {
    (void)c, (void)state;
    *size = sizeof(Instance);
    return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
    (void)c;
    memcpy(bytes, state, size);
    return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
    if (size != sizeof(Instance)) return as3(complain(c, FAILED, "state of size", (double)size));
    if (!*state) *state = malloc(size), saved++;
    memcpy(*state, bytes, size);
    return fmi3OK;
}
