/* A first-order lag, der(x) = rate (u - x), y = x, as a complete FMU of FMI 2 or FMI 3.
 *
 * Compile with -DFMI=2 or -DFMI=3. Every function of the standard is there; those for what the FMU cannot do
 * return an error. With -DLACKING one of these is left out. Value references: 0 time, 1 u, 2 rate, 3 x, 4 der_x, 5 y.
 * The instantiation token begins with TOKEN. A file that includes this one may define PHASE, which is called at
 * instantiation and before the end of initialisation, each step and the release of an instance, and LOGGER.
 */
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
#define TOKEN "{31f3d6a2-6f0c-4b57-9d7e-0c1f6a5e9b42}"
#else
#include "fmi3Functions.h"
#define TOKEN "{9a0c6f5e-2a31-4f0e-8f57-6d1b7b6b3c55}"
#endif

#ifdef FREESTANDING /* without a C library */
static void *fill(void *to, int byte, size_t n) {
    for (char *c = to; n--;) *c++ = (char)byte;
    return to;
}
static void *copy(void *to, const void *from, size_t n) {
    char *c = to;
    for (const char *d = from; n--;) *c++ = *d++;
    return to;
}
static int differ(const char *a, const char *b, size_t n) {
    while (n && *a && *a == *b) a++, b++, n--;
    return n && *a != *b;
}
static void *take(size_t n) { /* nobody runs these libraries: no memory needs to be given back */
    static double pool[1000];
    static size_t used;
    size_t first = used;
    used += (n + sizeof *pool - 1) / sizeof *pool;
    return used <= sizeof pool / sizeof *pool ? &pool[first] : NULL;
}
#ifdef _WIN32
int DllMainCRTStartup(void *library, unsigned reason, void *reserved) {
    (void)library, (void)reason, (void)reserved;
    return 1;
}
#endif
#undef memset
#undef memcpy
#define memset fill
#define memcpy copy
#define strncmp differ
#define strlen(text) (sizeof text - 1)
#define malloc take
#define calloc(n, size) take((n) * (size))
#define free(memory) (void)(memory)
#endif

#ifndef PHASE
#define PHASE(phase, lag, t, token)
#endif
#ifndef LOGGER
#define LOGGER(environment, function)
#endif

enum { TIME, U, RATE, X, DER_X, Y, COUNT };
typedef struct {
    double v[COUNT];
} Lag;

static Lag *new_lag(const char *token) {
    Lag *lag = strncmp(token, TOKEN, strlen(TOKEN)) ? NULL : calloc(1, sizeof *lag);
    if (!lag) return NULL;
    lag->v[RATE] = 2;
    PHASE("instantiate", lag->v, 0, token);
    return lag;
}

static void free_lag(Lag *lag) {
    if (!lag) return;
    PHASE("free", lag->v, lag->v[TIME], NULL);
    free(lag);
}

static int initialised(Lag *lag) {
    PHASE("initialise", lag->v, lag->v[TIME], NULL);
    (void)lag;
    return 0;
}

static void update(Lag *lag) {
    lag->v[DER_X] = lag->v[RATE] * (lag->v[U] - lag->v[X]);
    lag->v[Y] = lag->v[X];
}

static int get(void *instance, const unsigned *refs, size_t n, double *values) {
    update(instance);
    for (size_t i = 0; i < n; i++) {
        if (refs[i] >= COUNT) return 3;
        values[i] = ((Lag *)instance)->v[refs[i]];
    }
    return 0;
}

static int set(void *instance, const unsigned *refs, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) {
        if (refs[i] != U && refs[i] != RATE && refs[i] != X) return 3;
        ((Lag *)instance)->v[refs[i]] = values[i];
    }
    return 0;
}

static void advance(Lag *lag, double t, double h) {
    PHASE("step", lag->v, t, NULL);
    for (int i = 0; i < 100; i++) {
        update(lag);
        lag->v[X] += h / 100 * lag->v[DER_X];
    }
    lag->v[TIME] = t + h;
}

static int save(const void *instance, void **state) {
    if (!*state) *state = malloc(sizeof(Lag));
    memcpy(*state, instance, sizeof(Lag));
    return 0;
}

#define IGNORE(x) (void)(x)
#if FMI == 2

#define STUB(name, ...) \
    fmi2Status fmi2##name(fmi2Component c, __VA_ARGS__) { return IGNORE(c), fmi2Error; }
typedef fmi2Component C;
typedef const fmi2ValueReference *R;
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging) {
    IGNORE(name), IGNORE(type), IGNORE(resources), IGNORE(call), IGNORE(visible), IGNORE(logging);
    LOGGER(call->componentEnvironment, call->logger);
    return new_lag(guid);
}
void fmi2FreeInstance(C c) { free_lag(c); }
fmi2Status fmi2SetDebugLogging(C c, fmi2Boolean on, size_t n, const fmi2String s[]) {
    return IGNORE(c), IGNORE(on), IGNORE(n), IGNORE(s), fmi2OK;
}
fmi2Status fmi2SetupExperiment(C c, fmi2Boolean td, fmi2Real tol, fmi2Real t, fmi2Boolean sd, fmi2Real stop) {
    IGNORE(td), IGNORE(tol), IGNORE(sd), IGNORE(stop);
    ((Lag *)c)->v[TIME] = t;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(C c) { return IGNORE(c), fmi2OK; }
fmi2Status fmi2ExitInitializationMode(C c) { return (fmi2Status)initialised(c); }
fmi2Status fmi2Terminate(C c) { return IGNORE(c), fmi2OK; }
fmi2Status fmi2Reset(C c) {
    memset(c, 0, sizeof(Lag));
    ((Lag *)c)->v[RATE] = 2;
    return fmi2OK;
}
fmi2Status fmi2GetReal(C c, R r, size_t n, fmi2Real v[]) { return get(c, r, n, v); }
fmi2Status fmi2SetReal(C c, R r, size_t n, const fmi2Real v[]) { return set(c, r, n, v); }
STUB(GetInteger, R r, size_t n, fmi2Integer v[])
STUB(GetBoolean, R r, size_t n, fmi2Boolean v[])
STUB(GetString, R r, size_t n, fmi2String v[])
STUB(SetInteger, R r, size_t n, const fmi2Integer v[])
STUB(SetBoolean, R r, size_t n, const fmi2Boolean v[])
STUB(SetString, R r, size_t n, const fmi2String v[])
fmi2Status fmi2GetFMUstate(C c, fmi2FMUstate *s) { return save(c, s); }
fmi2Status fmi2SetFMUstate(C c, fmi2FMUstate s) { return memcpy(c, s, sizeof(Lag)), fmi2OK; }
fmi2Status fmi2FreeFMUstate(C c, fmi2FMUstate *s) { return IGNORE(c), free(*s), *s = NULL, fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(C c, fmi2FMUstate s, size_t *n) {
    return IGNORE(c), IGNORE(s), *n = sizeof(Lag), fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(C c, fmi2FMUstate s, fmi2Byte b[], size_t n) {
    return IGNORE(c), n < sizeof(Lag) ? fmi2Error : (memcpy(b, s, sizeof(Lag)), fmi2OK);
}
fmi2Status fmi2DeSerializeFMUstate(C c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
    return IGNORE(c), n < sizeof(Lag) ? fmi2Error : (fmi2Status)save(b, s);
}
#ifndef LACKING
STUB(GetDirectionalDerivative, R z, size_t nz, R v, size_t nv, const fmi2Real dv[], fmi2Real dz[])
#endif
fmi2Status fmi2SetRealInputDerivatives(C c, R r, size_t n, const fmi2Integer o[], const fmi2Real v[]) {
    return IGNORE(c), IGNORE(r), IGNORE(n), IGNORE(o), IGNORE(v), fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(C c, R r, size_t n, const fmi2Integer o[], fmi2Real v[]) {
    IGNORE(o), IGNORE(r);
    update(c);
    for (size_t i = 0; i < n; i++) v[i] = ((Lag *)c)->v[DER_X];
    return fmi2OK;
}
fmi2Status fmi2DoStep(C c, fmi2Real t, fmi2Real h, fmi2Boolean keep) { return IGNORE(keep), advance(c, t, h), fmi2OK; }
fmi2Status fmi2CancelStep(C c) { return IGNORE(c), fmi2Error; }
STUB(GetStatus, const fmi2StatusKind k, fmi2Status *v)
STUB(GetRealStatus, const fmi2StatusKind k, fmi2Real *v)
STUB(GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
STUB(GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *v)
STUB(GetStringStatus, const fmi2StatusKind k, fmi2String *v)
fmi2Status fmi2EnterEventMode(C c) { return IGNORE(c), fmi2OK; }
fmi2Status fmi2NewDiscreteStates(C c, fmi2EventInfo *e) { return IGNORE(c), memset(e, 0, sizeof *e), fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(C c) { return IGNORE(c), fmi2OK; }
fmi2Status fmi2CompletedIntegratorStep(C c, fmi2Boolean k, fmi2Boolean *e, fmi2Boolean *t) {
    return IGNORE(c), IGNORE(k), *e = *t = fmi2False, fmi2OK;
}
fmi2Status fmi2SetTime(C c, fmi2Real t) { return ((Lag *)c)->v[TIME] = t, fmi2OK; }
fmi2Status fmi2SetContinuousStates(C c, const fmi2Real x[], size_t n) {
    return n == 1 ? (((Lag *)c)->v[X] = x[0], fmi2OK) : fmi2Error;
}
fmi2Status fmi2GetDerivatives(C c, fmi2Real d[], size_t n) {
    return update(c), n == 1 ? (d[0] = ((Lag *)c)->v[DER_X], fmi2OK) : fmi2Error;
}
fmi2Status fmi2GetEventIndicators(C c, fmi2Real z[], size_t n) {
    return IGNORE(c), IGNORE(z), n ? fmi2Error : fmi2OK;
}
fmi2Status fmi2GetContinuousStates(C c, fmi2Real x[], size_t n) {
    return n == 1 ? (x[0] = ((Lag *)c)->v[X], fmi2OK) : fmi2Error;
}
fmi2Status fmi2GetNominalsOfContinuousStates(C c, fmi2Real x[], size_t n) {
    return IGNORE(c), n == 1 ? (x[0] = 1, fmi2OK) : fmi2Error;
}

#else

typedef fmi3Instance C;
typedef const fmi3ValueReference *R;
#define STUB(name, ...) \
    fmi3Status fmi3##name(C c, __VA_ARGS__) { return IGNORE(c), fmi3Error; }
#define ACCESS(type)                                                               \
    STUB(Get##type, R r, size_t n, fmi3##type v[], size_t nv)                      \
    STUB(Set##type, R r, size_t n, const fmi3##type v[], size_t nv)
const char *fmi3GetVersion(void) { return fmi3Version; }
fmi3Status fmi3SetDebugLogging(C c, fmi3Boolean on, size_t n, const fmi3String s[]) {
    return IGNORE(c), IGNORE(on), IGNORE(n), IGNORE(s), fmi3OK;
}
C fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                               fmi3Boolean logging, fmi3InstanceEnvironment e, fmi3LogMessageCallback log) {
    IGNORE(name), IGNORE(path), IGNORE(visible), IGNORE(logging), IGNORE(e), IGNORE(log);
    LOGGER(e, log);
    return new_lag(token);
}
C fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                              fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[],
                              size_t n, fmi3InstanceEnvironment e, fmi3LogMessageCallback log,
                              fmi3IntermediateUpdateCallback update_) {
    IGNORE(name), IGNORE(path), IGNORE(visible), IGNORE(logging), IGNORE(events), IGNORE(early);
    IGNORE(r), IGNORE(n), IGNORE(e), IGNORE(log), IGNORE(update_);
    LOGGER(e, log);
    return new_lag(token);
}
#ifndef LACKING
C fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                    fmi3Boolean logging, fmi3InstanceEnvironment e, fmi3LogMessageCallback log,
                                    fmi3ClockUpdateCallback tick, fmi3LockPreemptionCallback lock,
                                    fmi3UnlockPreemptionCallback unlock) {
    IGNORE(name), IGNORE(token), IGNORE(path), IGNORE(visible), IGNORE(logging), IGNORE(e), IGNORE(log);
    IGNORE(tick), IGNORE(lock), IGNORE(unlock);
    return NULL;
}
#endif
void fmi3FreeInstance(C c) { free_lag(c); }
fmi3Status fmi3EnterInitializationMode(C c, fmi3Boolean td, fmi3Float64 tol, fmi3Float64 t, fmi3Boolean sd,
                                       fmi3Float64 stop) {
    IGNORE(td), IGNORE(tol), IGNORE(sd), IGNORE(stop);
    return ((Lag *)c)->v[TIME] = t, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(C c) { return (fmi3Status)initialised(c); }
fmi3Status fmi3EnterEventMode(C c) { return IGNORE(c), fmi3OK; }
fmi3Status fmi3Terminate(C c) { return IGNORE(c), fmi3OK; }
fmi3Status fmi3Reset(C c) { return memset(c, 0, sizeof(Lag)), ((Lag *)c)->v[RATE] = 2, fmi3OK; }
fmi3Status fmi3GetFloat64(C c, R r, size_t n, fmi3Float64 v[], size_t nv) { return IGNORE(nv), get(c, r, n, v); }
fmi3Status fmi3SetFloat64(C c, R r, size_t n, const fmi3Float64 v[], size_t nv) {
    return IGNORE(nv), set(c, r, n, v);
}
ACCESS(Float32)
ACCESS(Int8)
ACCESS(UInt8)
ACCESS(Int16)
ACCESS(UInt16)
ACCESS(Int32)
ACCESS(UInt32)
ACCESS(Int64)
ACCESS(UInt64)
ACCESS(Boolean)
ACCESS(String)
STUB(GetBinary, R r, size_t n, size_t s[], fmi3Binary v[], size_t nv)
STUB(SetBinary, R r, size_t n, const size_t s[], const fmi3Binary v[], size_t nv)
STUB(GetClock, R r, size_t n, fmi3Clock v[])
STUB(SetClock, R r, size_t n, const fmi3Clock v[])
STUB(GetNumberOfVariableDependencies, fmi3ValueReference r, size_t *n)
STUB(GetVariableDependencies, fmi3ValueReference r, size_t d[], fmi3ValueReference i[], size_t e[],
     fmi3DependencyKind k[], size_t n)
fmi3Status fmi3GetFMUState(C c, fmi3FMUState *s) { return save(c, s); }
fmi3Status fmi3SetFMUState(C c, fmi3FMUState s) { return memcpy(c, s, sizeof(Lag)), fmi3OK; }
fmi3Status fmi3FreeFMUState(C c, fmi3FMUState *s) { return IGNORE(c), free(*s), *s = NULL, fmi3OK; }
fmi3Status fmi3SerializedFMUStateSize(C c, fmi3FMUState s, size_t *n) {
    return IGNORE(c), IGNORE(s), *n = sizeof(Lag), fmi3OK;
}
fmi3Status fmi3SerializeFMUState(C c, fmi3FMUState s, fmi3Byte b[], size_t n) {
    return IGNORE(c), n < sizeof(Lag) ? fmi3Error : (memcpy(b, s, sizeof(Lag)), fmi3OK);
}
fmi3Status fmi3DeserializeFMUState(C c, const fmi3Byte b[], size_t n, fmi3FMUState *s) {
    return IGNORE(c), n < sizeof(Lag) ? fmi3Error : (fmi3Status)save(b, s);
}
STUB(GetDirectionalDerivative, R z, size_t nz, R v, size_t nv, const fmi3Float64 s[], size_t ns, fmi3Float64 d[],
     size_t nd)
STUB(GetAdjointDerivative, R z, size_t nz, R v, size_t nv, const fmi3Float64 s[], size_t ns, fmi3Float64 d[],
     size_t nd)
fmi3Status fmi3EnterConfigurationMode(C c) { return IGNORE(c), fmi3Error; }
fmi3Status fmi3ExitConfigurationMode(C c) { return IGNORE(c), fmi3Error; }
STUB(GetIntervalDecimal, R r, size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[])
STUB(GetIntervalFraction, R r, size_t n, fmi3UInt64 v[], fmi3UInt64 w[], fmi3IntervalQualifier q[])
STUB(GetShiftDecimal, R r, size_t n, fmi3Float64 v[])
STUB(GetShiftFraction, R r, size_t n, fmi3UInt64 v[], fmi3UInt64 w[])
STUB(SetIntervalDecimal, R r, size_t n, const fmi3Float64 v[])
STUB(SetIntervalFraction, R r, size_t n, const fmi3UInt64 v[], const fmi3UInt64 w[])
STUB(SetShiftDecimal, R r, size_t n, const fmi3Float64 v[])
STUB(SetShiftFraction, R r, size_t n, const fmi3UInt64 v[], const fmi3UInt64 w[])
fmi3Status fmi3EvaluateDiscreteStates(C c) { return IGNORE(c), fmi3Error; }
fmi3Status fmi3UpdateDiscreteStates(C c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d, fmi3Boolean *e,
                                    fmi3Boolean *f, fmi3Float64 *t) {
    return IGNORE(c), *a = *b = *d = *e = *f = fmi3False, *t = 0, fmi3OK;
}
fmi3Status fmi3EnterContinuousTimeMode(C c) { return IGNORE(c), fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(C c, fmi3Boolean k, fmi3Boolean *e, fmi3Boolean *t) {
    return IGNORE(c), IGNORE(k), *e = *t = fmi3False, fmi3OK;
}
fmi3Status fmi3SetTime(C c, fmi3Float64 t) { return ((Lag *)c)->v[TIME] = t, fmi3OK; }
fmi3Status fmi3SetContinuousStates(C c, const fmi3Float64 x[], size_t n) {
    return n == 1 ? (((Lag *)c)->v[X] = x[0], fmi3OK) : fmi3Error;
}
fmi3Status fmi3GetContinuousStateDerivatives(C c, fmi3Float64 d[], size_t n) {
    return update(c), n == 1 ? (d[0] = ((Lag *)c)->v[DER_X], fmi3OK) : fmi3Error;
}
fmi3Status fmi3GetEventIndicators(C c, fmi3Float64 z[], size_t n) {
    return IGNORE(c), IGNORE(z), n ? fmi3Error : fmi3OK;
}
fmi3Status fmi3GetContinuousStates(C c, fmi3Float64 x[], size_t n) {
    return n == 1 ? (x[0] = ((Lag *)c)->v[X], fmi3OK) : fmi3Error;
}
fmi3Status fmi3GetNominalsOfContinuousStates(C c, fmi3Float64 x[], size_t n) {
    return IGNORE(c), n == 1 ? (x[0] = 1, fmi3OK) : fmi3Error;
}
fmi3Status fmi3GetNumberOfEventIndicators(C c, size_t *n) { return IGNORE(c), *n = 0, fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(C c, size_t *n) { return IGNORE(c), *n = 1, fmi3OK; }
fmi3Status fmi3EnterStepMode(C c) { return IGNORE(c), fmi3OK; }
fmi3Status fmi3GetOutputDerivatives(C c, R r, size_t n, const fmi3Int32 o[], fmi3Float64 v[], size_t nv) {
    IGNORE(o), IGNORE(r), IGNORE(nv);
    update(c);
    for (size_t i = 0; i < n; i++) v[i] = ((Lag *)c)->v[DER_X];
    return fmi3OK;
}
fmi3Status fmi3DoStep(C c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    IGNORE(keep);
    advance(c, t, h);
    return *event = *end = *early = fmi3False, *last = t + h, fmi3OK;
}
fmi3Status fmi3ActivateModelPartition(C c, fmi3ValueReference r, fmi3Float64 t) {
    return IGNORE(c), IGNORE(r), IGNORE(t), fmi3Error;
}
#endif
