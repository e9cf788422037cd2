/* Small models with events and algebraic loops for Model Exchange, FMI 2.0 or 3.0 (-DFMI=2, -DFMI=3).
 *
 * The instantiation token names the model. Value references: 0 time, then as in hybrid.py.
 *
 *   ball      h' = v, v' = -g; at h = 0 falling: v := -e v; below 0.01 m/s it rests      state events
 *   counter   count := count + 1 at t = 1, 2, 3 ...; ends after `last`                   time events
 *   thermo    on where y falls to low, off where it rises to high                                       state events
 *   room      T' = -T + power if on                                                       discrete input
 *   gain      y = a u + b u^3                                                             loops
 *   swing     x' = v, v' = mu (1 - x^2) v - x                                             none: not linear
 *   lag       x' = a u - x, y = x + b u; x := 0 after a step to x > limit, or the end if `last`  step events
 *
 * At the end of the function that the environment variable HYBRID_WHERE names (all: of each) it changes the floating-point
 * environment as HYBRID_HOW says: round, flush, or trap.
 */
#include <fenv.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef enum { BALL, COUNTER, THERMO, ROOM, GAIN, SWING, LAG, MODELS } Model;
typedef struct {
    Model model;
    double time, r[9]; /* variables of type Real by value reference */
    int i[8];          /* Integer and Boolean variables by value reference */
    int events;        /* in event mode */
} Instance;

static const char *const names[MODELS] = {"ball", "counter", "thermo", "room", "gain", "swing", "lag"};

static void change(const char *function) {
    const char *where = getenv("HYBRID_WHERE"), *how = getenv("HYBRID_HOW");
    if (!where || !how || (strcmp(where, "all") && strcmp(where, function))) return;
    if (!strcmp(how, "round")) fesetround(FE_UPWARD);
#ifdef __x86_64__
    if (!strcmp(how, "flush")) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040);
    if (!strcmp(how, "trap")) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() & ~0x1F80u);
#endif
}

static Instance *make(const char *token) {
    Instance *m = calloc(1, sizeof *m);
    change("instantiate");
    for (int k = 0; m && k < MODELS; k++)
        if (!strcmp(token, names[k])) m->model = (Model)k;
    if (!m) return m;
    if (m->model == BALL) m->r[1] = 1.0, m->r[5] = 0.7; /* h v h' v' e */
    if (m->model == COUNTER) m->i[1] = 0, m->i[2] = 1000;
    if (m->model == THERMO) m->r[2] = 0.4, m->r[3] = 0.6; /* y low high */
    if (m->model == ROOM) m->r[3] = 1.0;                  /* T T' power */
    if (m->model == GAIN) m->r[3] = 0.5;                  /* u y a b */
    if (m->model == SWING) m->r[1] = 2.0, m->r[5] = 1.0;  /* x v x' v' mu */
    if (m->model == LAG) m->r[5] = 1.0, m->r[7] = 1e9; /* x x' u y a b limit last */
    return m;
}

static int count(const Instance *m) { return m->model == BALL || m->model == SWING ? 2 : m->model == ROOM || m->model == LAG; }

static double indicator(const Instance *m) {
    double y = m->r[1];
    if (m->model == BALL) return y <= 0.0 && m->r[2] == 0.0 ? 1.0 : y;
    return m->i[4] ? m->r[3] - y : y - m->r[2]; /* the next threshold */
}

static int indicators(const Instance *m) { return m->model == BALL || m->model == THERMO; }

static void calculate(Instance *m) {
    double *r = m->r;
    if (indicators(m)) r[6] = indicator(m);
    if (m->model == BALL) {
        int rests = r[1] <= 0.0 && r[2] == 0.0;
        r[3] = r[2];
        r[4] = rests ? 0.0 : -9.81;
    }
    if (m->model == COUNTER) r[3] = m->i[1];
    if (m->model == ROOM) r[2] = -r[1] + (m->i[5] ? r[3] : 0.0);
    if (m->model == GAIN) r[2] = r[3] * r[1] + r[4] * r[1] * r[1] * r[1];
    if (m->model == LAG) r[2] = r[5] * r[3] - r[1], r[4] = r[1] + r[6] * r[3];
    if (m->model == SWING) r[3] = r[2], r[4] = r[5] * (1.0 - r[1] * r[1]) * r[2] - r[1];
    change("calculate");
}

/* One event iteration; the time of the next time event, or infinity. */
static double update(Instance *m, int *ends) {
    if (m->model == BALL && m->r[1] <= 0.0 && m->r[2] < 0.0) {
        m->r[1] = 0.0;
        m->r[2] = m->r[2] > -0.01 ? 0.0 : -m->r[5] * m->r[2];
    }
    if (m->model == COUNTER) {
        m->i[1] = (int)floor(m->time + 1e-9);
        *ends = m->i[1] >= m->i[2];
        return m->i[1] + 1.0;
    }
    if (m->model == LAG && m->r[1] > m->r[7]) m->r[1] = 0.0;
    if (m->model == THERMO) m->i[4] = m->i[4] ? m->r[1] < m->r[3] - 1e-9 : m->r[1] < m->r[2] + 1e-9;
    change("update");
    return INFINITY;
}

/* After a step: does it ask for an event, or for the end? */
static void completed(const Instance *m, int *event, int *end) {
    const int beyond = m->model == LAG && m->r[1] > m->r[7];
    *event = beyond && m->r[8] == 0.0, *end = beyond && m->r[8] != 0.0;
    change("completed");
}

#if FMI == 2
#include "fmi2Functions.h"
typedef fmi2Status S;
typedef fmi2Component C;
#define REF const fmi2ValueReference
#define OK fmi2OK
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String l, const fmi2CallbackFunctions *f,
                              fmi2Boolean v, fmi2Boolean d) {
    return (void)n, (void)t, (void)l, (void)f, (void)v, (void)d, make(g);
}
void fmi2FreeInstance(C c) { free(c); }
const char *fmi2GetVersion(void) { return "2.0"; }
const char *fmi2GetTypesPlatform(void) { return "default"; }
S fmi2SetDebugLogging(C c, fmi2Boolean b, size_t n, const fmi2String s[]) { return (void)c, (void)b, (void)n, (void)s, OK; }
S fmi2SetupExperiment(C c, fmi2Boolean a, fmi2Real b, fmi2Real t, fmi2Boolean d, fmi2Real e) {
    return (void)a, (void)b, (void)d, (void)e, ((Instance *)c)->time = t, OK;
}
S fmi2EnterInitializationMode(C c) { return (void)c, OK; }
S fmi2ExitInitializationMode(C c) { return ((Instance *)c)->events = 1, change("initialise"), OK; }
S fmi2Terminate(C c) { return (void)c, change("terminate"), OK; }
S fmi2Reset(C c) { return (void)c, OK; }
S fmi2GetReal(C c, REF r[], size_t n, fmi2Real y[]) {
    calculate(c);
    for (size_t k = 0; k < n; k++) y[k] = ((Instance *)c)->r[r[k]];
    return OK;
}
S fmi2SetReal(C c, REF r[], size_t n, const fmi2Real y[]) {
    for (size_t k = 0; k < n; k++) ((Instance *)c)->r[r[k]] = y[k];
    change("set");
    return OK;
}
S fmi2GetInteger(C c, REF r[], size_t n, fmi2Integer y[]) {
    for (size_t k = 0; k < n; k++) y[k] = ((Instance *)c)->i[r[k]];
    return OK;
}
S fmi2SetInteger(C c, REF r[], size_t n, const fmi2Integer y[]) {
    for (size_t k = 0; k < n; k++) ((Instance *)c)->i[r[k]] = y[k];
    return OK;
}
S fmi2GetBoolean(C c, REF r[], size_t n, fmi2Boolean y[]) { return fmi2GetInteger(c, r, n, y); }
S fmi2SetBoolean(C c, REF r[], size_t n, const fmi2Boolean y[]) {
    return ((Instance *)c)->events || ((Instance *)c)->time == 0.0 ? fmi2SetInteger(c, r, n, y) : fmi2Error;
}
S fmi2GetFMUstate(C c, fmi2FMUstate *s) { return *s = *s ? *s : malloc(sizeof(Instance)), memcpy(*s, c, sizeof(Instance)), OK; }
S fmi2SetFMUstate(C c, fmi2FMUstate s) { return memcpy(c, s, sizeof(Instance)), OK; }
S fmi2FreeFMUstate(C c, fmi2FMUstate *s) { return (void)c, free(*s), *s = NULL, OK; }
S fmi2EnterEventMode(C c) { return ((Instance *)c)->events = 1, change("events"), OK; }
S fmi2NewDiscreteStates(C c, fmi2EventInfo *e) {
    int ends = 0;
    double next = update(c, &ends);
    memset(e, 0, sizeof *e);
    e->terminateSimulation = ends;
    e->nextEventTimeDefined = isfinite(next);
    e->nextEventTime = next;
    return ((Instance *)c)->events ? OK : fmi2Error;
}
S fmi2EnterContinuousTimeMode(C c) { return ((Instance *)c)->events = 0, OK; }
S fmi2CompletedIntegratorStep(C c, fmi2Boolean p, fmi2Boolean *e, fmi2Boolean *t) { return (void)p, completed(c, e, t), OK; }
S fmi2SetTime(C c, fmi2Real t) { return ((Instance *)c)->time = ((Instance *)c)->r[0] = t, change("time"), OK; }
S fmi2SetContinuousStates(C c, const fmi2Real x[], size_t n) {
    memcpy(((Instance *)c)->r + 1, x, n * sizeof *x);
    return ((Instance *)c)->events || !n ? fmi2Error : OK; /* strict: not without states */
}
S fmi2GetContinuousStates(C c, fmi2Real x[], size_t n) { return memcpy(x, ((Instance *)c)->r + 1, n * sizeof *x), OK; }
S fmi2GetNominalsOfContinuousStates(C c, fmi2Real x[], size_t n) {
    for (size_t k = 0; k < n; k++) x[k] = 1.0;
    return (void)c, change("nominals"), OK;
}
S fmi2GetDerivatives(C c, fmi2Real x[], size_t n) {
    calculate(c);
    return memcpy(x, ((Instance *)c)->r + 1 + count(c), n * sizeof *x), OK;
}
S fmi2GetEventIndicators(C c, fmi2Real z[], size_t n) {
    for (size_t k = 0; k < n && indicators(c); k++) z[k] = indicator(c);
    return n ? OK : fmi2Error;
}
#else
#include "fmi3Functions.h"
typedef fmi3Status S;
typedef fmi3Instance C;
#define REF const fmi3ValueReference
#define OK fmi3OK
C fmi3InstantiateModelExchange(fmi3String n, fmi3String g, fmi3String l, fmi3Boolean v, fmi3Boolean d,
                               fmi3InstanceEnvironment e, fmi3LogMessageCallback f) {
    return (void)n, (void)l, (void)v, (void)d, (void)e, (void)f, make(g);
}
void fmi3FreeInstance(C c) { free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }
S fmi3SetDebugLogging(C c, fmi3Boolean b, size_t n, const fmi3String s[]) { return (void)c, (void)b, (void)n, (void)s, OK; }
S fmi3EnterInitializationMode(C c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    return (void)a, (void)b, (void)d, (void)e, ((Instance *)c)->time = t, OK;
}
S fmi3ExitInitializationMode(C c) { return ((Instance *)c)->events = 1, OK; }
S fmi3Terminate(C c) { return (void)c, OK; }
S fmi3Reset(C c) { return (void)c, OK; }
S fmi3GetFloat64(C c, REF r[], size_t n, fmi3Float64 y[], size_t m) {
    calculate(c);
    for (size_t k = 0; k < n; k++) y[k] = ((Instance *)c)->r[r[k]];
    return (void)m, OK;
}
S fmi3SetFloat64(C c, REF r[], size_t n, const fmi3Float64 y[], size_t m) {
    for (size_t k = 0; k < n; k++) ((Instance *)c)->r[r[k]] = y[k];
    return (void)m, OK;
}
S fmi3GetInt32(C c, REF r[], size_t n, fmi3Int32 y[], size_t m) {
    for (size_t k = 0; k < n; k++) y[k] = ((Instance *)c)->i[r[k]];
    return (void)m, OK;
}
S fmi3SetInt32(C c, REF r[], size_t n, const fmi3Int32 y[], size_t m) {
    for (size_t k = 0; k < n; k++) ((Instance *)c)->i[r[k]] = y[k];
    return (void)m, OK;
}
S fmi3GetBoolean(C c, REF r[], size_t n, fmi3Boolean y[], size_t m) {
    for (size_t k = 0; k < n; k++) y[k] = ((Instance *)c)->i[r[k]] != 0;
    return (void)m, OK;
}
S fmi3SetBoolean(C c, REF r[], size_t n, const fmi3Boolean y[], size_t m) {
    for (size_t k = 0; k < n; k++) ((Instance *)c)->i[r[k]] = y[k];
    return (void)m, ((Instance *)c)->events || ((Instance *)c)->time == 0.0 ? OK : fmi3Error;
}
S fmi3GetFMUState(C c, fmi3FMUState *s) { return *s = *s ? *s : malloc(sizeof(Instance)), memcpy(*s, c, sizeof(Instance)), OK; }
S fmi3SetFMUState(C c, fmi3FMUState s) { return memcpy(c, s, sizeof(Instance)), OK; }
S fmi3FreeFMUState(C c, fmi3FMUState *s) { return (void)c, free(*s), *s = NULL, OK; }
S fmi3EnterEventMode(C c) { return ((Instance *)c)->events = 1, OK; }
S fmi3UpdateDiscreteStates(C c, fmi3Boolean *a, fmi3Boolean *t, fmi3Boolean *n, fmi3Boolean *v, fmi3Boolean *d,
                           fmi3Float64 *e) {
    int ends = 0;
    *e = update(c, &ends);
    *a = *n = *v = fmi3False;
    *t = ends != 0;
    *d = isfinite(*e);
    return ((Instance *)c)->events ? OK : fmi3Error;
}
S fmi3EnterContinuousTimeMode(C c) { return ((Instance *)c)->events = 0, OK; }
S fmi3CompletedIntegratorStep(C c, fmi3Boolean p, fmi3Boolean *e, fmi3Boolean *t) {
    int event, end;
    completed(c, &event, &end);
    return (void)p, *e = event != 0, *t = end != 0, OK;
}
S fmi3SetTime(C c, fmi3Float64 t) { return ((Instance *)c)->time = ((Instance *)c)->r[0] = t, OK; }
S fmi3SetContinuousStates(C c, const fmi3Float64 x[], size_t n) {
    memcpy(((Instance *)c)->r + 1, x, n * sizeof *x);
    return ((Instance *)c)->events || !n ? fmi3Error : OK;
}
S fmi3GetContinuousStates(C c, fmi3Float64 x[], size_t n) { return memcpy(x, ((Instance *)c)->r + 1, n * sizeof *x), OK; }
S fmi3GetNominalsOfContinuousStates(C c, fmi3Float64 x[], size_t n) {
    for (size_t k = 0; k < n; k++) x[k] = 1.0;
    return (void)c, OK;
}
S fmi3GetContinuousStateDerivatives(C c, fmi3Float64 x[], size_t n) {
    calculate(c);
    return memcpy(x, ((Instance *)c)->r + 1 + count(c), n * sizeof *x), OK;
}
S fmi3GetEventIndicators(C c, fmi3Float64 z[], size_t n) {
    for (size_t k = 0; k < n && indicators(c); k++) z[k] = indicator(c);
    return n ? OK : fmi3Error;
}
#endif
