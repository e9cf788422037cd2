/* Small models for Co-Simulation of FMI 3.0 that stop at their events and handle them in event mode.
 *
 * The instantiation token names the model. Value references: reals from 0, whole numbers from 100, time 300.
 *
 *   room    T' = -T + on                                              a discrete input
 *   heater  the same; tells `cold`: T has fallen to 0.4, and has not risen to 0.6 since       state events
 *   relay   on where y falls to low, off where it rises to high; y follows y_rate in a step   events by its input
 *   ball    h' = v, v' = -g; at h = 0 falling: v := -e v; below 0.01 m/s it rests             state events
 *   ticker  count := count + 1 at t = period, 2 period, ...; level = count                    time events
 *   sum     s' = u                                                    a discrete input
 *   copy    y = u, in event mode; `not` turns it round                discrete loops
 *   shy     the same as sum; refuses to be instantiated with event mode
 *
 * `how`: 0 stops at an event; 1 tells it at the end of the step; 2 goes back to the beginning of the step first; what is
 * wrong: 3 stops there for ever; 4 the next event is in the past; 5 discrete states never settle; 6 discards each step
 * after t = 0.55; 7 requests the end at its first event. After t = 0.5 it stops early 8 at NaN, 9 before its step, 10 after it;
 * 11 the next event is at NaN; from 100 on, the seed: at random one of
 * these, 13 an event anywhere in its step, 14 at its end, an update, or nothing;
 * 18 asks at the end of a step for an event that it does not announce, as the end is within 1e-9 s of it or later; 19 asks after each step;
 * 15 the third event is the end; 16 a further event at the time of the second one is, 17 the one of the start.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

typedef enum { ROOM, HEATER, RELAY, BALL, TICKER, SUM, COPY, SHY, MODELS } Model;
enum { T = 0, Y = 1, Y_RATE = 2, LOW = 3, HIGH = 4, H = 5, V_ = 6, E = 7, PERIOD = 8, LEVEL = 9, S = 10, U = 11, FALL = 12, REALS };
enum { ON, COLD, COUNT, HOW, IN, OUT, NOT, INTEGERS };
enum { WHOLE = 100, TIME = 300 };
static const char *const names[MODELS] = {"room", "heater", "relay", "ball", "ticker", "sum", "copy", "shy"};

typedef struct {
    Model model;
    double time, r[REALS];
    int i[INTEGERS];
    int mode; /* 0 before steps, 1 in steps, 2 in event mode */
    int used, early, rests, ends;
    unsigned *random;
} Instance;

#define NAMED(m, n) ((m)->model == (n))

fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String g, fmi3String l, fmi3Boolean v, fmi3Boolean d, fmi3Boolean used,
                                         fmi3Boolean early, const fmi3ValueReference r[], size_t k, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback f, fmi3IntermediateUpdateCallback u) {
    (void)n, (void)l, (void)v, (void)r, (void)k, (void)u;
    if (!strcmp(g, "shy") && used) {
        if (d) f(e, fmi3Error, "logStatusError", "no event mode here");
        return NULL;
    }
    Instance *m = calloc(1, sizeof *m);
    for (int j = 0; j < MODELS; j++)
        if (!strcmp(g, names[j])) m->model = (Model)j;
    m->used = used, m->early = early, m->random = calloc(1, sizeof *m->random);
    m->r[LOW] = 0.4, m->r[HIGH] = 0.6, m->r[H] = 1.0, m->r[E] = 0.7, m->r[PERIOD] = 1.0, m->r[FALL] = 9.81;
    m->i[ON] = NAMED(m, RELAY) || NAMED(m, HEATER), m->i[COLD] = 1;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(((Instance *)c)->random), free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean b, size_t n, const fmi3String s[]) { return (void)c, (void)b, (void)n, (void)s, fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    return (void)a, (void)b, (void)d, (void)e, ((Instance *)c)->time = t, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return ((Instance *)c)->mode = ((Instance *)c)->used ? 2 : 1, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return (void)c, fmi3OK; }

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 y[], size_t k) {
    Instance *m = c;
    for (size_t j = 0; j < n; j++) y[j] = r[j] == TIME ? m->time : m->r[r[j]];
    return (void)k, fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 y[], size_t k) {
    Instance *m = c;
    for (size_t j = 0; j < n; j++) {
        if (r[j] == U && m->used && m->mode == 1) return fmi3Error; /* discrete */
        m->r[r[j]] = y[j];
    }
    return (void)k, fmi3OK;
}
#define WHOLES(NAME)                                                                                                          \
    fmi3Status fmi3Get##NAME(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##NAME y[], size_t k) {              \
        for (size_t j = 0; j < n; j++) y[j] = (fmi3##NAME)((Instance *)c)->i[r[j] - WHOLE];                                   \
        return (void)k, fmi3OK;                                                                                               \
    }                                                                                                                         \
    fmi3Status fmi3Set##NAME(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##NAME y[], size_t k) {        \
        Instance *m = c;                                                                                                      \
        if (m->used && m->mode == 1) return fmi3Error;                                                                        \
        for (size_t j = 0; j < n; j++) m->i[r[j] - WHOLE] = (int)y[j];                                                        \
        return (void)k, fmi3OK;                                                                                               \
    }
WHOLES(Int32)
WHOLES(Boolean)

/* ---- events */

/* Not of a state: a step that is repeated has another one. */
static unsigned chance(const Instance *m) {
    *m->random = (*m->random ? *m->random : (unsigned)m->i[HOW]) * 1103515245u + 12345u;
    return *m->random >> 16;
}

/* The misuse that is due. */
static int misuse(const Instance *m) {
    if (m->i[HOW] < 100) return m->time > 0.5 && m->i[HOW] < 12 ? m->i[HOW] : 0;
    const unsigned k = chance(m) % 1024;
    return k < 4 ? (int[]){8, 9, 10, 4}[k] : k < 6 ? 11 : k < 150 ? 13 : k < 250 ? 14 : k < 400 ? 5 : 0;
}

static double following(const Instance *m) { return m->r[PERIOD] * (m->i[COUNT] + 1); }
static int on(const Instance *m, double y, int before) { return before ? y < m->r[HIGH] - 1e-12 : y <= m->r[LOW] + 1e-12; }

/* One event iteration; does another have to follow? */
static int update(Instance *m) {
    if (NAMED(m, HEATER)) m->i[COLD] = on(m, m->r[T], m->i[COLD]);
    if (NAMED(m, RELAY)) m->i[ON] = on(m, m->r[Y], m->i[ON]);
    if (NAMED(m, BALL) && m->r[H] <= 1e-12 && m->r[V_] < 0.0) {
        m->r[H] = 0.0;
        m->rests = m->r[V_] > -0.01;
        m->r[V_] = m->rests ? 0.0 : -m->r[E] * m->r[V_];
    }
    if (NAMED(m, TICKER) && m->mode == 2 && m->time >= following(m) - 1e-9) m->i[COUNT]++;
    m->r[LEVEL] = m->i[COUNT];
    if (NAMED(m, COPY)) m->i[OUT] = m->i[NOT] ? !m->i[IN] : m->i[IN];
    return misuse(m) == 5;
}

/* The time of the first event in a step, for the inputs that it has; infinite without one. */
static double stops(const Instance *m, double t, double h) {
    double target = m->i[ON] ? 1.0 : 0.0, temperature = m->r[T];
    if (m->i[HOW] == 3 && t > 0.5) return t;
    if (NAMED(m, HEATER)) {
        double level = m->i[COLD] ? m->r[HIGH] : m->r[LOW], ratio = (level - target) / (temperature - target);
        if (on(m, temperature, m->i[COLD]) != m->i[COLD]) return t;
        return ratio > 0.0 && ratio < 1.0 ? t - log(ratio) : INFINITY;
    }
    if (NAMED(m, RELAY)) {
        double level = m->i[ON] ? m->r[HIGH] : m->r[LOW], y = m->r[Y], when = (level - y) / m->r[Y_RATE];
        if (on(m, y, m->i[ON]) != m->i[ON]) return t;
        return m->r[Y_RATE] != 0.0 && when > 0.0 ? t + when : INFINITY;
    }
    if (NAMED(m, BALL) && !m->rests) {
        double g = m->r[FALL], v = m->r[V_], fall = (v + sqrt(v * v + 2.0 * g * m->r[H])) / g;
        return t + fall;
    }
    if (NAMED(m, TICKER)) return following(m) <= t + h + 1e-9 * (m->i[HOW] == 18) ? fmax(following(m), t) : INFINITY;
    return INFINITY;
}

static void move(Instance *m, double t, double h) {
    double target = m->i[ON] ? 1.0 : 0.0, g = m->r[FALL];
    if (NAMED(m, ROOM) || NAMED(m, HEATER)) m->r[T] = target + (m->r[T] - target) * exp(-h);
    if (NAMED(m, RELAY)) m->r[Y] += m->r[Y_RATE] * h;
    if (NAMED(m, BALL) && !m->rests) m->r[H] += m->r[V_] * h - 0.5 * g * h * h, m->r[V_] -= g * h;
    if (NAMED(m, SUM) || NAMED(m, SHY)) m->r[S] += m->r[U] * h;
    m->time = t + h;
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean p, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *reached) {
    Instance *m = c;
    double when = stops(m, t, h);
    int inside = when < t + h, stop = inside && m->i[HOW] != 1 && m->i[HOW] < 18 && m->early && m->used;
    *event = *end = *early = fmi3False, *reached = t, (void)p;
    if (m->mode != 1 || !(h > 0.0)) return fmi3Error;
    if (m->i[HOW] == 6 && t + h > 0.55) return fmi3Discard;
    if (m->i[HOW] == 16 && m->i[COUNT] == 2 && m->early) return *event = *early = fmi3True, m->time = t, m->ends = 1, fmi3OK;
    if (stop && m->i[HOW] == 2) when = t;
    move(m, t, stop ? when - t : h);
    *event = m->used && (when <= t + h + 1e-9 * (m->i[HOW] == 18) || m->i[HOW] == 19), *early = stop, *reached = m->time;
    *end = *event && m->i[HOW] == 7;
    const int wrong = misuse(m);
    if (wrong >= 8 && wrong <= 10) *event = *early = fmi3True, *reached = wrong == 8 ? NAN : wrong == 9 ? t - 1.0 : t + 3.0 * h;
    if (wrong == 13) *event = *early = fmi3True, *reached = t + (double)(chance(m) % 9) / 8.0 * h;
    if (wrong == 14) *event = fmi3True;
    while (!m->used && inside) { /* without event mode it handles its events itself, if late */
        m->mode = 2, inside = update(m), m->mode = 1;
        if (NAMED(m, TICKER)) inside = following(m) <= t + h;
    }
    return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance c) { return ((Instance *)c)->mode == 1 && ((Instance *)c)->used ? ((Instance *)c)->mode = 2, fmi3OK : fmi3Error; }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return ((Instance *)c)->mode == 2 ? ((Instance *)c)->mode = 1, fmi3OK : fmi3Error; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *t, fmi3Boolean *n, fmi3Boolean *v, fmi3Boolean *d,
                                    fmi3Float64 *e) {
    Instance *m = c;
    *a = update(m) != 0;
    *n = *v = fmi3False, *t = (m->i[HOW] == 15 && m->i[COUNT] == 3) || m->ends || (m->i[HOW] == 17 && m->time == 0.0);
    if (*t && m->i[HOW] > 15) m->r[LEVEL] = 99.0;
    const int wrong = misuse(m);
    *d = (NAMED(m, TICKER) && m->i[HOW] < 18) || wrong == 4 || wrong == 11;
    *e = wrong == 4 ? m->time - 0.1 : wrong == 11 ? NAN : following(m);
    return m->mode == 2 ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    if (!*s) *s = malloc(sizeof(Instance));
    return memcpy(*s, c, sizeof(Instance)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return memcpy(c, s, sizeof(Instance)), fmi3OK; }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return (void)c, free(*s), *s = NULL, fmi3OK; }
