/* Small FMI 2.0 co-simulation models for tests of the orchestrator, all in one library.
 *
 * The GUID tells which model an instance is. Variables of a type are numbered from 0 in the order in
 * which they are listed at each model; conftest.py lists the same variables for modelDescription.xml.
 * A call out of order, a step that does not start at the FMU's own time, and a step beyond the stop time
 * are errors, without any tolerance.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { REALS = 16, INTEGERS = 12, STRINGS = 4, LENGTH = 64, STATES = 2, ORDERS = 3 };
enum Model { NOBODY, MASS_A, MASS_B, SOURCE, GAIN, FAILS, TYPES, SPRING };
enum Mode { INSTANTIATED, INITIALIZING, READY, ERROR, TERMINATED };
enum Failure { NONE, WARNING, DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH };

typedef struct {
    enum Model model;
    enum Mode mode;
    char name[LENGTH];
    fmi2CallbackFunctions call;
    fmi2Boolean logging;
    double time, stop;
    int stop_defined, dirty;
    double r[REALS];
    double slope[REALS][ORDERS]; /* derivatives of inputs, for the next step only */
    int i[INTEGERS];             /* integers, enumerations and booleans */
    char s[STRINGS][LENGTH];
} Instance;

static int instances = 0; /* alive; read through TYPES' integer "alive" */

static fmi2Status complain(Instance *m, fmi2Status status, const char *what, double value) {
    const char *category = status == fmi2Warning ? "logStatusWarning" : "logStatusError";
    if (status >= fmi2Error) m->mode = ERROR;
    if (m->logging) m->call.logger(m->call.componentEnvironment, m->name, status, category, "%s: %g", what, value);
    return status;
}

/* ---- models */

enum { A_X2, A_FORCE, A_X, A_V, A_MASS, A_SPRING, A_COUPLING }; /* MASS_A: x'' = (-k x + F) / m */
enum { B_FORCE, B_X, B_V, B_MASS, B_SPRING };                   /* MASS_B: x'' = (-k x - F) / m */
enum { K_V, K_FORCE, K_STRETCH, K_STIFFNESS };                 /* SPRING: stretch' = v, force = k stretch */
enum { S_Y, S_AMPLITUDE, S_OMEGA, S_OFFSET };                   /* SOURCE: y = offset + amplitude sin(omega t) */
enum { G_U, G_Y, G_FACTOR, G_OFFSET };                          /* GAIN: y = factor u + offset */
enum { F_U, F_Y, F_WHEN };                                      /* FAILS: y' = u, fails once t >= when */
enum { F_HOW };
enum { T_IN, T_OUT, T_GAIN }; /* TYPES: every output follows its input */
enum { T_INT, T_INT_OUT, T_BOOL, T_BOOL_OUT, T_ENUM, T_ENUM_OUT, T_ALIVE };

static void defaults(Instance *m) {
    switch (m->model) {
    case MASS_A: m->r[A_V] = 100, m->r[A_MASS] = 1, m->r[A_SPRING] = 10, m->r[A_COUPLING] = 100; break;
    case MASS_B: m->r[B_V] = -100, m->r[B_MASS] = 1, m->r[B_SPRING] = 1000; break;
    case SPRING: m->r[K_STIFFNESS] = 100; break;
    case SOURCE: m->r[S_AMPLITUDE] = 1, m->r[S_OMEGA] = 1; break;
    case GAIN: m->r[G_FACTOR] = 1; break;
    case FAILS: m->r[F_WHEN] = 1e9; break;
    case TYPES: m->r[T_GAIN] = 1; strcpy(m->s[0], "nobody"); break;
    default: break;
    }
}

static void outputs(Instance *m) {
    double *r = m->r;
    int *i = m->i;
    switch (m->model) {
    case MASS_A: r[A_FORCE] = r[A_COUPLING] * (r[A_X2] - r[A_X]); break;
    case SPRING: r[K_FORCE] = r[K_STIFFNESS] * r[K_STRETCH]; break;
    case SOURCE: r[S_Y] = r[S_OFFSET] + r[S_AMPLITUDE] * sin(r[S_OMEGA] * m->time); break;
    case GAIN: r[G_Y] = r[G_FACTOR] * r[G_U] + r[G_OFFSET]; break;
    case TYPES:
        r[T_OUT] = r[T_GAIN] * r[T_IN];
        i[T_INT_OUT] = i[T_INT] + 1, i[T_BOOL_OUT] = !i[T_BOOL], i[T_ENUM_OUT] = i[T_ENUM], i[T_ALIVE] = instances;
        snprintf(m->s[1], LENGTH, "hello %.40s", m->s[0]);
        break;
    default: break;
    }
}

/* the input with value reference 0 at time tau after the start of the step */
static double input(const Instance *m, double tau) {
    return m->r[0] + tau * (m->slope[0][0] + tau * (m->slope[0][1] / 2 + tau * m->slope[0][2] / 6));
}

static int first_state(const Instance *m) {
    static const int first[] = {[MASS_A] = A_X, [MASS_B] = B_X, [FAILS] = F_Y, [SPRING] = K_STRETCH};
    return first[m->model];
}

static int states(const Instance *m) {
    static const int count[] = {[MASS_A] = 2, [MASS_B] = 2, [FAILS] = 1, [SPRING] = 1};
    return count[m->model];
}

static void rates(const Instance *m, double tau, const double *x, double *dx) {
    double u = input(m, tau);
    switch (m->model) {
    case MASS_A:
        dx[0] = x[1];
        dx[1] = (-m->r[A_SPRING] * x[0] + m->r[A_COUPLING] * (u - x[0])) / m->r[A_MASS];
        break;
    case MASS_B:
        dx[0] = x[1];
        dx[1] = (-m->r[B_SPRING] * x[0] - u) / m->r[B_MASS];
        break;
    default: dx[0] = u; break;
    }
}

static void integrate(Instance *m, double length) {
    int n = states(m), count = (int)ceil(length / 2.5e-4 - 1e-9);
    double *x = m->r + first_state(m), k[4][STATES], y[STATES], h = length / count;
    for (int step = 0; n && step < count; step++) {
        double tau = step * h;
        rates(m, tau, x, k[0]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h / 2 * k[0][j];
        rates(m, tau + h / 2, y, k[1]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h / 2 * k[1][j];
        rates(m, tau + h / 2, y, k[2]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h * k[2][j];
        rates(m, tau + h, y, k[3]);
        for (int j = 0; j < n; j++) x[j] += h / 6 * (k[0][j] + 2 * k[1][j] + 2 * k[2][j] + k[3][j]);
    }
}

static fmi2Status misbehave(Instance *m) {
    if (m->model != FAILS || m->time < m->r[F_WHEN]) return fmi2OK;
    switch (m->i[F_HOW]) {
    case WARNING: return complain(m, fmi2Warning, "the oil is warm at", m->r[F_Y]);
    case DISCARD: case ENOUGH: return fmi2Discard;
    case FAULT: return complain(m, fmi2Error, "the pump broke, y is", m->r[F_Y]);
    case FATAL: return complain(m, fmi2Fatal, "the house burnt down, y is", m->r[F_Y]);
    case NOT_A_NUMBER: m->r[F_Y] = NAN; return fmi2OK;
    default: return fmi2OK;
    }
}

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
    static const char *guids[] = {"nobody", "mass_a", "mass_b", "source", "gain", "fails", "types", "spring"};
    (void)visible, (void)resources;
    for (int model = MASS_A; model <= SPRING; model++) {
        if (type != fmi2CoSimulation || strcmp(guid, guids[model])) continue;
        Instance *m = call->allocateMemory(1, sizeof *m);
        m->model = model, m->call = *call, m->logging = logging;
        strncpy(m->name, name, LENGTH - 1);
        defaults(m);
        instances++;
        return m;
    }
    if (logging)
        call->logger(call->componentEnvironment, name, fmi2Error, "logStatusError", "wrong guid %s", guid);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *m = c;
    instances--;
    m->call.freeMemory(m);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *m = c;
    (void)tolerance_defined, (void)tolerance;
    if (m->mode != INSTANTIATED) return complain(m, fmi2Error, "fmi2SetupExperiment in mode", m->mode);
    m->time = start, m->stop_defined = stop_defined, m->stop = stop;
    return fmi2OK;
}

static fmi2Status move(Instance *m, enum Mode from, enum Mode to) {
    if (m->mode != from) return complain(m, fmi2Error, "call out of order in mode", m->mode);
    m->mode = to;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return move(c, INSTANTIATED, INITIALIZING); }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return move(c, INITIALIZING, READY); }
fmi2Status fmi2Terminate(fmi2Component c) { return move(c, READY, TERMINATED); }
fmi2Status fmi2Reset(fmi2Component c) { return complain(c, fmi2Error, "no reset", 0); }

/* ---- values */

#define GET(TYPE, FIELD, COUNT)                                                                             \
    Instance *m = c;                                                                                        \
    if (m->mode == INSTANTIATED) return complain(m, fmi2Error, "get before initialization, mode", m->mode); \
    outputs(m);                                                                                             \
    for (size_t k = 0; k < n; k++) {                                                                        \
        if (vr[k] >= COUNT) return complain(m, fmi2Error, "no variable", vr[k]);                            \
        value[k] = m->FIELD[vr[k]];                                                                         \
    }                                                                                                       \
    return fmi2OK;

#define SET(FIELD, COUNT)                                                        \
    Instance *m = c;                                                             \
    for (size_t k = 0; k < n; k++) {                                             \
        if (vr[k] >= COUNT) return complain(m, fmi2Error, "no variable", vr[k]); \
        m->FIELD[vr[k]] = value[k];                                              \
    }                                                                            \
    return fmi2OK;

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    GET(fmi2Real, r, REALS)
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) {
    GET(fmi2Integer, i, INTEGERS)
}
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) {
    GET(fmi2Boolean, i, INTEGERS)
}
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
    GET(fmi2String, s, STRINGS)
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    SET(r, REALS)
}
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) {
    SET(i, INTEGERS)
}
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) {
    SET(i, INTEGERS)
}
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
    Instance *m = c;
    for (size_t k = 0; k < n; k++) strncpy(m->s[vr[k]], value[k], LENGTH - 1);
    return fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    Instance *m = c;
    for (size_t k = 0; k < n; k++) {
        if (order[k] < 1 || order[k] > ORDERS) return complain(m, fmi2Error, "derivative of order", order[k]);
        m->slope[vr[k]][order[k] - 1] = value[k];
    }
    return fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Instance *m = c;
    double dx[STATES] = {0};
    rates(m, 0, m->r + first_state(m), dx);
    for (size_t k = 0; k < n; k++) {
        int state = (int)vr[k] - first_state(m);
        if (order[k] != 1 || state < 0 || state >= states(m)) return complain(m, fmi2Error, "derivative of", vr[k]);
        value[k] = dx[state];
    }
    return fmi2OK;
}

/* ---- steps */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_rollback) {
    Instance *m = c;
    (void)no_rollback;
    if (m->mode != READY) return complain(m, fmi2Error, "step in mode", m->mode);
    if (t != m->time) return complain(m, fmi2Error, "the step does not start at the FMU's time", m->time);
    if (m->stop_defined && t + h > m->stop) return complain(m, fmi2Error, "step beyond the stop time", m->stop);
    fmi2Status status = misbehave(m);
    if (status > fmi2Warning) return status;
    integrate(m, h);
    m->r[0] = m->model == SOURCE ? m->r[0] : input(m, h);
    memset(m->slope, 0, sizeof m->slope);
    m->time = t + h;
    return status;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return complain(c, fmi2Error, "no cancel", 0); }

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->time;
    return fmi2OK;
}
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = ((Instance *)c)->i[F_HOW] == ENOUGH;
    return fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind k, fmi2Status *v) { (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind k, fmi2Integer *v) { (void)c, (void)k, (void)v; return fmi2Discard; }
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind k, fmi2String *v) { (void)c, (void)k, (void)v; return fmi2Discard; }

/* ---- rollback (serialisation and directional derivatives are left out on purpose: they are optional) */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Instance));
    memcpy(*state, c, sizeof(Instance));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(Instance));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}
