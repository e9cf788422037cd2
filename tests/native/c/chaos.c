/* An FMU of FMI 3.0 that does anything which the types of FMI allow, for test_engine.py: in Co-Simulation with event
 * mode, early return, time events, clocks and arrays, and in Model Exchange with state events.
 *
 * A generator of random numbers chooses each answer; its seed is a parameter. With `wild` calls fail, too, and numbers
 * are NaN, infinite, or times outside of the step. With `fair` a step that is repeated from a saved state has the same
 * answers. Each instance ends the simulation after MOST calls, so that a run ends. It fills all of the memory that it is
 * told to fill: a sanitizer sees a buffer of the engine that is too short.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { SEED = 1, WILD, FAIR, U, Y, N, K, TICK, FIRED, COME, COUNT, TEXT, WORD, X, RATE, Z, LEVEL, REFERENCES };
enum { STATES = 2, WIDTH = 3, MOST = 20000 };
typedef struct {
    uint64_t chaos;
    int wild, fair, calls;
    double time, v[REFERENCES][WIDTH];
    char text[8];
} Chaos;

static uint64_t next_random(Chaos *m) {
    m->chaos ^= m->chaos >> 12, m->chaos ^= m->chaos << 25, m->chaos ^= m->chaos >> 27;
    return m->chaos * 2685821657736338717u;
}
static unsigned below(Chaos *m, unsigned n) { return (unsigned)((next_random(m) >> 33) % n); }
static int one_in(Chaos *m, unsigned n) { return !below(m, n); }
static double between(Chaos *m, double low, double high) { return low + (high - low) * below(m, 1 << 30) / (1 << 30); }
static double odd(Chaos *m) {
    static const double ODD[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 4.9e-324, -0.0, 1e-12};
    return ODD[below(m, sizeof ODD / sizeof *ODD)];
}
static int wild(Chaos *m, unsigned n) { return m->wild && one_in(m, n); }
static double number(Chaos *m, double low, double high) { return wild(m, 300) ? odd(m) : between(m, low, high); }
static fmi3Status answer(void *c) {
    Chaos *m = c;
    m->calls++;
    return wild(m, 400) ? (fmi3Status)below(m, 4) : fmi3OK;
}
static size_t size(fmi3ValueReference r) { return r == U || r == Y || r == K ? WIDTH : r == X || r == RATE || r == Z ? STATES : 1; }

/* ---- life */

static void *made(void) {
    Chaos *m = calloc(1, sizeof *m);
    if (m) m->chaos = 88172645463325252u;
    return m;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean log_on,
                                         fmi3Boolean event_mode, fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    (void)name, (void)token, (void)path, (void)visible, (void)log_on, (void)event_mode, (void)early, (void)required, (void)n;
    return (void)environment, (void)log, (void)update, made();
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean log_on,
                                          fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    return (void)name, (void)token, (void)path, (void)visible, (void)log_on, (void)environment, (void)log, made();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    return (void)a, (void)b, (void)d, (void)e, ((Chaos *)c)->time = t, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return answer(c); }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return answer(c); }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return answer(c); }

/* ---- values */

static int outputs(fmi3ValueReference r) { return r == Y || r == N || r == COUNT || r == RATE || r == Z || r == LEVEL; }
#define VALUES(TYPE, MAKE)                                                                                                      \
    fmi3Status fmi3Get##TYPE(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##TYPE to[], size_t count) {           \
        Chaos *m = c;                                                                                                           \
        for (size_t i = 0, k = 0; i < n && k < count; i++)                                                                      \
            for (size_t j = 0; j < size(r[i]); j++, k++) to[k] = (fmi3##TYPE)(outputs(r[i]) ? (MAKE) : m->v[r[i]][j]);          \
        return answer(c);                                                                                                       \
    }                                                                                                                           \
    fmi3Status fmi3Set##TYPE(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##TYPE from[], size_t count) {   \
        Chaos *m = c;                                                                                                           \
        for (size_t i = 0, k = 0; i < n && k < count; i++)                                                                      \
            for (size_t j = 0; j < size(r[i]); j++, k++) m->v[r[i]][j] = (double)from[k];                                       \
        for (size_t i = 0; i < n; i++) {                                                                                        \
            if (r[i] == SEED) m->chaos ^= ((uint64_t)m->v[SEED][0] + 1) * 2654435769u;                                          \
            m->wild = m->v[WILD][0] > 0, m->fair = m->v[FAIR][0] > 0;                                                           \
        }                                                                                                                       \
        return answer(c);                                                                                                       \
    }
VALUES(Float64, r[i] == Z ? sin(9 * m->time + (double)j) : number(m, -1, 1))
VALUES(Int32, one_in(m, 3) ? (int)below(m, 5) : 1)
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3String to[], size_t count) {
    Chaos *m = c;
    for (size_t k = 0; k < 7; k++) m->text[k] = (char)(one_in(m, 3) ? 0 : 32 + below(m, m->wild ? 200 : 90));
    for (size_t k = 0; k < count; k++) to[k] = wild(m, 100) ? NULL : m->text;
    return (void)r, (void)n, answer(c);
}
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3String from[], size_t count) {
    size_t length = 0;
    for (size_t k = 0; k < count; k++) length += strlen(from[k]);
    return (void)r, (void)n, length < (1 << 20) ? answer(c) : fmi3Error;
}

/* ---- clocks and events */

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock on[]) {
    return (void)r, n && on[0] ? answer(c) : fmi3Error;
}
fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock on[]) {
    for (size_t i = 0; i < n; i++) on[i] = one_in(c, 3);
    return (void)r, answer(c);
}
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 t[], fmi3IntervalQualifier q[]) {
    Chaos *m = c;
    for (size_t i = 0; i < n; i++) {
        t[i] = one_in(m, 20) ? 0.0 : number(m, m->wild ? -0.01 : 0.001, 0.3);
        q[i] = (fmi3IntervalQualifier)(wild(m, 50) ? below(m, 9) : one_in(m, 12) ? 0 : 1 + below(m, 2));
    }
    return (void)r, answer(c);
}
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 t[]) {
    for (size_t i = 0; i < n; i++) t[i] = number(c, 0, 0.2);
    return (void)r, answer(c);
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals, fmi3Boolean *values,
                                    fmi3Boolean *defined, fmi3Float64 *next) {
    Chaos *m = c;
    *again = one_in(m, 4), *end = m->calls > MOST || one_in(m, 2000), *nominals = one_in(m, 2), *values = one_in(m, 2);
    *defined = one_in(m, 2);
    *next = wild(m, 40) ? odd(m) : m->time + between(m, wild(m, 40) ? -0.1 : 1e-9, one_in(m, 3) ? 1e-3 : 0.3);
    return answer(c);
}

/* ---- steps */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    Chaos *m = c;
    *end = m->calls > MOST || one_in(m, 2000), *early = one_in(m, 6), *event = *early || one_in(m, 6);
    *last = wild(m, 60) ? odd(m) : *early ? between(m, wild(m, 20) ? t - h : t, t + h) : t + h;
    return (void)keep, m->time = isfinite(*last) ? *last : t + h, answer(c);
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    if (!*s) *s = malloc(sizeof(Chaos));
    return memcpy(*s, c, sizeof(Chaos)), answer(c);
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) {
    Chaos *m = c, before = *m;
    memcpy(m, s, sizeof *m), m->calls = before.calls;
    if (!m->fair) m->chaos = before.chaos;
    return answer(c);
}
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return (void)c, free(*s), *s = NULL, fmi3OK; }

/* ---- Model Exchange */

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { return ((Chaos *)c)->time = t, answer(c); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) ((Chaos *)c)->v[X][i] = x[i];
    return answer(c);
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = ((Chaos *)c)->v[X][i];
    return answer(c);
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = wild(c, 3000) ? odd(c) : -((Chaos *)c)->v[X][i];
    return answer(c);
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) {
    Chaos *m = c;
    for (size_t i = 0; i < n; i++) z[i] = wild(m, 100) ? odd(m) : sin(9 * m->time + (double)i);
    return answer(c);
}
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = number(c, 0, 2);
    return answer(c);
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { return (void)c, *n = STATES, fmi3OK; }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { return (void)c, *n = STATES, fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end) {
    return (void)keep, *event = one_in(c, 5), *end = ((Chaos *)c)->calls > MOST, answer(c);
}
