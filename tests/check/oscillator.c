/* A mass on a spring as an FMU of FMI 2 and FMI 3, both kinds, with one fault of choice for the tests of the probes.

       dx/dt = v      dv/dt = u - stiffness x - damping v      position = x      force = dv/dt

   The solver (Heun) remembers its inner step from call to call, so that results depend on more than x and v.
   Which fault: the text behind "FAULT=" in the binary, "none" as compiled; the tests overwrite it. */

#define _GNU_SOURCE
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#define TOKEN "oscillator"
enum { TIME, U, STIFFNESS, DAMPING, X, V, DER_X, DER_V, POSITION, FORCE, VARIABLES };
enum { NEW, INITIALIZING, RUNNING, ENDED };
enum { GOOD, BAD = 3 };

__attribute__((used)) volatile char marker[24] = "FAULT=none";
static int is(const char *fault) { return strcmp((const char *)marker + 6, fault) == 0; }

typedef struct {
    double time, begin, stop, r[VARIABLES], inner;
    int mode, side; /* 1: co-simulation */
} State;

typedef struct {
    State s;
    double shown[VARIABLES]; /* outputs as of the last step, for a fault */
    int continuous;          /* continuous-time mode was entered, for a fault */
    int upset;               /* something was refused, and the time is from now on */
    void *environment;
    fmi2CallbackLogger say2;
    fmi3LogMessageCallback say3;
    fmi3IntermediateUpdateCallback update;
} Model;

static double shared; /* for faults: what instances must not share */
static int alive, made;
static void *volatile lost;

static void say(Model *m, int status, const char *category, const char *text) {
    if (m->say2) m->say2(m->environment, "oscillator", (fmi2Status)status, category, text);
    if (m->say3) m->say3(m->environment, (fmi3Status)status, category, text);
}

static int no(Model *m, const char *text) {
    say(m, BAD, is("category") ? "logSecret" : "logStatusError", text);
    return BAD;
}

/* ---- equations */

static void rates(const double *r, double x, double v, double *dx, double *dv) {
    *dx = v;
    *dv = r[U] - (is("swings") ? 25 : 1) * r[STIFFNESS] * x - (is("stiff") ? 1e5 : 1) * r[DAMPING] * v;
    if (is("grows")) *dv += 0.1 * tanh(5e5 * v); /* fast from where it begins, and soon no more */
}

static void evaluate(Model *m) {
    double *r = m->s.r;
    rates(r, r[X], r[V], &r[DER_X], &r[DER_V]);
    r[TIME] = m->s.time;
    r[POSITION] = r[X];
    r[FORCE] = r[DER_V] + (is("kink") || is("bent") ? fmax(r[U], 0) : 0);
}

static void integrate(Model *m, double length) {
    double *r = m->s.r, *h = is("shared") ? &shared : &m->s.inner;
    if (*h == 0) *h = 1e-3;
    const int count = (int)ceil(length / *h);
    for (int i = 0; i < count; i++) {
        double a, b, c, d, step = length / count;
        rates(r, r[X], r[V], &a, &b);
        rates(r, r[X] + step * a, r[V] + step * b, &c, &d);
        r[X] += step / 2 * (a + c);
        r[V] += step / 2 * (b + d);
    }
    *h *= fabs(r[V]) > 0.5 ? 0.93 : 1.05;
    if (*h > 4e-3 || *h < 1e-3) *h = 2e-3;
}

/* ---- life */

static Model *make(const char *token, const char *location, int side) {
    if (!is("token") && (!token || strcmp(token, TOKEN) != 0)) return NULL;
    if (is("location") && strchr(location, '%')) return NULL;
    if (is("letters") && location) {
        for (const char *c = location; *c; c++)
            if (*c == ' ') return NULL;
    }
    if (is("refuses") || (is("once") && alive)) return NULL;
    if (is("only") && made++) return NULL;
    if (is("second") && made++) abort();
    if (is("slow")) usleep(20000);
    if (is("place") && location && strchr(location, '%')) abort();
    if (is("leak")) lost = malloc(64);
    if (is("handles") && !fopen("/dev/null", "r")) return NULL;
    if (is("licence") && made++ > 150) return NULL;
    alive++;
    Model *m = calloc(1, sizeof *m);
    m->s.r[STIFFNESS] = 40, m->s.r[DAMPING] = 0.5, m->s.r[X] = 1;
    m->s.side = side;
    m->s.stop = INFINITY;
    return m;
}

static void unmake(Model *m) {
    if (!m) return;
    if (is("twice")) free(m);
    alive--;
    free(m);
}

static int announce(Model *m, double begin, int stop_given, double stop) {
    if (m->s.mode != NEW) return no(m, "not allowed now");
    if (is("stop") && !stop_given) return no(m, "a stop time is needed");
    m->s.time = m->s.begin = is("start") ? 0 : begin;
    if (stop_given) m->s.stop = stop;
    return GOOD;
}

static int move(Model *m, int from, int to) {
    if (is("again") && to == INITIALIZING && m->s.mode == to) return *(volatile int *)8;
    if (m->s.mode != from) return no(m, "not allowed now");
    m->s.mode = to;
    return GOOD;
}

static int start_over(Model *m) {
    State old = m->s;
    memset(&m->s, 0, sizeof m->s);
    m->s.r[STIFFNESS] = 40, m->s.r[DAMPING] = 0.5, m->s.r[X] = is("reset") ? old.r[X] : 1;
    m->s.side = old.side, m->s.stop = INFINITY;
    return GOOD;
}

/* ---- values */

static int get(Model *m, const unsigned *vr, size_t n, double *value) {
    if (is("order") && m->s.mode == NEW) return *(volatile int *)8;
    evaluate(m);
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= VARIABLES && is("reference")) return *(volatile int *)(size_t)vr[i];
        if (vr[i] >= VARIABLES) return no(m, "no such variable");
        value[i] = is("first") && vr[i] >= POSITION ? m->shown[vr[i]] : m->s.r[vr[i]];
        if (is("nan") && m->s.time > 0.3) value[i] = NAN;
        if (is("zero") && vr[i] == POSITION) value[i] = made++ % 2 ? -0.0 : 8e-15; /* rounding is no fault */
    }
    return GOOD;
}

static int set(Model *m, const unsigned *vr, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++) {
        if (vr[i] < U || vr[i] > V) return no(m, "cannot be set");
        const int late = m->s.side == 0 && !(is("parameters") && vr[i] < X); /* importers do that before they step */
        if (m->s.mode == RUNNING && vr[i] != U && is("fixed")) return *(volatile int *)8;
        if (m->s.mode == RUNNING && vr[i] != U && !late) return no(m, "fixed");
        if (m->s.mode == RUNNING && vr[i] == STIFFNESS && is("deaf")) continue;
        if (is("input") && isnan(value[i])) return *(volatile int *)8;
        if (!is("accepts") && !(fabs(value[i]) < 1e9)) return no(m, "out of range");
        m->s.r[vr[i]] = value[i];
    }
    return GOOD;
}

static int directional(Model *m, const unsigned *z, size_t nz, unsigned v, double seed, double *result) {
    const double *r = m->s.r;
    for (size_t i = 0; i < nz; i++) {
        double d = v == z[i];
        if (z[i] == DER_X) d = v == V;
        if (z[i] == POSITION) d = v == X;
        if (z[i] == DER_V || z[i] == FORCE)
            d = v == U ? 1 : v == X ? -r[STIFFNESS] : v == V ? -r[DAMPING] : 0;
        if ((is("kink") || is("bent")) && z[i] == FORCE && v == U) d += r[U] != 0 ? r[U] > 0 : is("kink") ? 0.3 : -0.5;
        result[i] = seed * (is("directional") && z[i] == FORCE ? -d : d);
    }
    return GOOD;
}

static int slopes(Model *m, const unsigned *vr, size_t n, double *value) {
    evaluate(m);
    const double *r = m->s.r;
    for (size_t i = 0; i < n; i++) {
        value[i] = vr[i] == POSITION ? r[V] : -r[STIFFNESS] * r[V] - r[DAMPING] * r[DER_V];
        if (is("slope")) value[i] *= -1;
    }
    return GOOD;
}

/* ---- steps */

static int advance(Model *m, double t, double h, double *reached) {
    const double close = is("drift") || is("strict") ? 0 : 1e-6 * h;
    *reached = m->s.time;
    if (is("order") && m->s.mode == NEW) return *(volatile int *)8;
    if (m->s.mode != RUNNING) return no(m, "not allowed now");
    if (!(h > 0) || (!is("start") && fabs(t - m->s.time) > close)) return no(m, "this is not the time");
    if (t + h > m->s.stop + (is("exact") ? 0 : 1e-6 * h)) return no(m, "beyond the stop time");
    if (m->s.time > 0.3) {
        if (is("crash")) return *(volatile int *)8;
        if (is("hang")) for (;;) usleep(1000);
        if (is("exit")) exit(3);
        if (is("signal")) raise(36);
        if (is("eats"))
            for (;;) lost = memset(malloc(1 << 20), 1, 1 << 20);
        if (is("error")) return no(m, "no more");
        if (is("runaway")) m->s.r[X] = m->s.r[V] = 1e120;
    }
    if (is("threads")) {
        shared = m->s.r[U];
        usleep(20);
        m->s.r[U] = shared;
    }
    if (is("start") || (is("leap") && t == 1000)) h = 50;
    if (m->update) {
        fmi3Boolean asked = fmi3False;
        double at = 0, half = t + h / 2;
        m->update(m->environment, is("update") ? t + 2 * h : half, fmi3False, fmi3True, fmi3True, fmi3True, &asked, &at);
        if (asked) h /= 2;
        *reached = is("early") && asked ? t - h : t + h;
    } else {
        *reached = is("late") ? 0 : t + h;
    }
    integrate(m, is("clock") && t > 500 ? h / 2 : h);
    if (is("leap") && h == 50) h = 0.01;
    m->s.time = is("drift") ? rint((t + h) / h) * h : t + h;
    evaluate(m);
    memcpy(m->shown, m->s.r, sizeof m->shown);
    say(m, GOOD, "logEvents", "a step");
    return GOOD;
}

/* ---- saved states */

static int save(Model *m, void **state) {
    if (!*state) *state = calloc(1, sizeof(State));
    memcpy(*state, &m->s, sizeof(State));
    return GOOD;
}

static int restore(Model *m, void *state) {
    const double inner = m->s.inner;
    m->s = *(State *)state;
    if (is("solver")) m->s.inner = inner;
    return GOOD;
}

static int forget(void **state) {
    free(*state);
    *state = NULL;
    return GOOD;
}

static int pack(void *state, void *bytes, size_t size) {
    if (is("pointer")) memcpy(bytes, &state, sizeof state);
    else memcpy(bytes, state, sizeof(State));
    if (is("beyond")) ((char *)bytes)[size] = 1;
    return GOOD;
}

static int unpack(const void *bytes, void **state) {
    const void *from = bytes;
    if (is("pointer")) memcpy(&from, bytes, sizeof from);
    if (!*state) *state = calloc(1, sizeof(State));
    memcpy(*state, from, sizeof(State));
    return GOOD;
}

/* ---- FMI 2 */

#define M ((Model *)c)
#define REFS const fmi2ValueReference vr[], size_t n

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return is("version") ? "1.0" : "2.0"; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String token, fmi2String location,
                              const fmi2CallbackFunctions *f, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m = make(token, location, type == fmi2CoSimulation);
    (void)name, (void)visible, (void)logging;
    if (m) m->say2 = f->logger, m->environment = f->componentEnvironment;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { unmake(c); }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real begin,
                               fmi2Boolean stop_given, fmi2Real stop) {
    (void)given, (void)tolerance;
    return announce(c, begin, stop_given, stop);
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return move(c, NEW, INITIALIZING); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return move(c, INITIALIZING, RUNNING); }
fmi2Status fmi2Terminate(fmi2Component c) { return move(c, RUNNING, ENDED); }
fmi2Status fmi2Reset(fmi2Component c) { return start_over(c); }
fmi2Status fmi2GetReal(fmi2Component c, REFS, fmi2Real value[]) { return get(c, vr, n, value); }
fmi2Status fmi2SetReal(fmi2Component c, REFS, const fmi2Real value[]) { return set(c, vr, n, value); }
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *s) { return save(c, s); }
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate s) { return restore(c, s); }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *s) { return (void)c, forget(s); }
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate s, size_t *n) {
    (void)c, (void)s;
    *n = sizeof(State);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate s, fmi2Byte b[], size_t n) { return (void)c, pack(s, b, n); }
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte b[], size_t n, fmi2FMUstate *s) {
    return (void)c, (void)n, unpack(b, s);
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference z[], size_t nz,
                                        const fmi2ValueReference v[], size_t nv, const fmi2Real dv[], fmi2Real dz[]) {
    return (void)nv, directional(c, z, nz, v[0], dv[0], dz);
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, REFS, const fmi2Integer order[], fmi2Real value[]) {
    return (void)order, slopes(c, vr, n, value);
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean last) {
    double reached;
    const fmi2Status status = (fmi2Status)advance(c, t, h, &reached);
    return (void)last, is("late") && t > 0.305 ? fmi2Discard : status;
}
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    (void)c;
    *value = is("late") ? 0 : NAN; /* it may be asked after fmi2Discard only */
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    (void)c;
    *value = is("late") && kind == fmi2Terminated;
    return fmi2OK;
}

static void event(int *flags, double *next) {
    for (int i = 0; i < 5; i++) flags[i] = 0;
    flags[0] = is("event"); /* new discrete states are needed */
    *next = 0;
}
static int put_states(Model *m, const double *x) {
    if (is("states") && !m->continuous) {
        m->upset = 1;
        return no(m, "not in event mode");
    }
    memcpy(&m->s.r[X], x, 2 * sizeof *x);
    return GOOD;
}
static int get_states(Model *m, double *x) {
    memcpy(x, &m->s.r[X], 2 * sizeof *x);
    return GOOD;
}
static int get_rates(Model *m, double *dx) {
    evaluate(m);
    memcpy(dx, &m->s.r[DER_X], 2 * sizeof *dx);
    return GOOD;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) {
    if ((is("soon") && !M->continuous) || M->upset) return no(M, "not in event mode");
    return M->s.time = t, fmi2OK;
}
fmi2Status fmi2EnterEventMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return M->continuous = 1, fmi2OK; }
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *i) {
    (void)c;
    event(&i->newDiscreteStatesNeeded, &i->nextEventTime);
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean last, fmi2Boolean *event, fmi2Boolean *end) {
    (void)c, (void)last;
    return *event = *end = 0, fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) { return (void)n, put_states(c, x); }
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) { return (void)n, get_states(c, x); }
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) { return (void)n, get_rates(c, dx); }
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    (void)c, (void)n;
    return x[0] = 1, x[1] = is("nominal") ? 0 : 1, fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) { return (void)c, (void)z, (void)n, fmi2OK; }

/* ---- FMI 2: what the model does not need and importers look for */

#define EMPTY(NAME, ...) \
    fmi2Status fmi2##NAME(fmi2Component c, __VA_ARGS__) { return no(c, "there is nothing of this kind"); }
#pragma clang diagnostic ignored "-Wunused-parameter"
EMPTY(GetInteger, REFS, fmi2Integer v[])
EMPTY(GetBoolean, REFS, fmi2Boolean v[])
EMPTY(GetString, REFS, fmi2String v[])
EMPTY(SetInteger, REFS, const fmi2Integer v[])
EMPTY(SetBoolean, REFS, const fmi2Boolean v[])
EMPTY(SetString, REFS, const fmi2String v[])
EMPTY(SetRealInputDerivatives, REFS, const fmi2Integer o[], const fmi2Real v[])
EMPTY(GetStatus, const fmi2StatusKind k, fmi2Status *v)
EMPTY(GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
EMPTY(GetStringStatus, const fmi2StatusKind k, fmi2String *v)
fmi2Status fmi2CancelStep(fmi2Component c) { return no(c, "nothing to cancel"); }

/* ---- FMI 3 */

#undef REFS
#define REFS const fmi3ValueReference vr[], size_t n
#define FORWARD(NAME) \
    fmi3Status fmi3##NAME(fmi3Instance c) { return (fmi3Status)fmi2##NAME(c); }

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String location, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference inner[], size_t n, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Model *m = make(token, location, 1);
    (void)name, (void)visible, (void)logging, (void)events, (void)early, (void)inner, (void)n;
    if (m) m->say3 = log, m->environment = environment, m->update = update;
    return m;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String location, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log) {
    Model *m = make(token, location, 0);
    (void)name, (void)visible, (void)logging;
    if (m) m->say3 = log, m->environment = environment;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { unmake(c); }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String names[]) {
    (void)c, (void)on, (void)n, (void)names;
    return fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean given, fmi3Float64 tolerance, fmi3Float64 begin,
                                       fmi3Boolean stop_given, fmi3Float64 stop) {
    (void)given, (void)tolerance;
    const int status = announce(c, begin, stop_given, stop);
    return (fmi3Status)(status ? status : move(c, NEW, INITIALIZING));
}
FORWARD(ExitInitializationMode)
FORWARD(Terminate)
FORWARD(Reset)
FORWARD(EnterEventMode)
FORWARD(EnterContinuousTimeMode)
fmi3Status fmi3GetFloat64(fmi3Instance c, REFS, fmi3Float64 value[], size_t k) { return (void)k, get(c, vr, n, value); }
fmi3Status fmi3SetFloat64(fmi3Instance c, REFS, const fmi3Float64 value[], size_t k) { return (void)k, set(c, vr, n, value); }
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) { return save(c, s); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return restore(c, s); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return (void)c, forget(s); }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) {
    return (fmi3Status)fmi2SerializedFMUstateSize(c, s, n);
}
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte b[], size_t n) { return (void)c, pack(s, b, n); }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte b[], size_t n, fmi3FMUState *s) {
    return (void)c, (void)n, unpack(b, s);
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference z[], size_t nz,
                                        const fmi3ValueReference v[], size_t nv, const fmi3Float64 dv[], size_t ndv,
                                        fmi3Float64 dz[], size_t ndz) {
    return (void)nv, (void)ndv, (void)ndz, directional(c, z, nz, v[0], dv[0], dz);
}
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference z[], size_t nz,
                                    const fmi3ValueReference v[], size_t nv, const fmi3Float64 dz[], size_t ndz,
                                    fmi3Float64 dv[], size_t ndv) {
    (void)nz, (void)ndz, (void)ndv;
    for (size_t i = 0; i < nv; i++) directional(c, z, 1, v[i], is("adjoint") ? 0 : dz[0], &dv[i]);
    return fmi3OK;
}
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, REFS, const fmi3Int32 order[], fmi3Float64 value[], size_t k) {
    return (void)order, (void)k, slopes(c, vr, n, value);
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean last, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *reached) {
    (void)last;
    const int status = advance(c, t, h, reached);
    *event = *end = fmi3False;
    *early = *reached < t + h - 1e-9 * h && !is("late");
    return (fmi3Status)status;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { return (fmi3Status)fmi2SetTime(c, t); }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *needed, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *defined, fmi3Float64 *next) {
    int flags[5];
    (void)c;
    event(flags, next);
    *needed = flags[0];
    *end = *nominals = *values = *defined = fmi3False;
    return fmi3OK;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean last, fmi3Boolean *event, fmi3Boolean *end) {
    (void)c, (void)last;
    return *event = *end = fmi3False, fmi3OK;
}
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return (void)n, put_states(c, x); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return (void)n, get_states(c, x); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) { return (void)n, get_rates(c, x); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return (fmi3Status)fmi2GetNominalsOfContinuousStates(c, x, n);
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) { return (void)c, (void)z, (void)n, fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { return (void)c, *n = 2, fmi3OK; }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { return (void)c, *n = 0, fmi3OK; }
