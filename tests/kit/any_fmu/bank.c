/* A bank of n lags with arrays of FMI 3.0, for Co-Simulation and Model Exchange:
 *
 *     x' = -k x + u     y = M x     echo = code     z = x - 1e9, the event indicators
 *
 * n is a structural parameter; k, u, x have the shape (n), M has (2, n). Co-Simulation steps exactly for constant u.
 * Its state can be saved and serialised. A function refuses another number of values than that of its arrays, and reading
 * one before the initialisation mode, which keeps u at its beginning as `begin`.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { TIME, N, K, U, X, RATE, M, Y, CODE, ECHO, Z, BEGIN, MOST = 8 };
typedef struct {
    double time, v[12][2 * MOST];
    int code[3];
    size_t n;
    int configuring, readable;
} Bank;

static size_t size(const Bank *b, unsigned reference) {
    return reference == TIME ? 1 : reference == Y ? 2 : reference == M ? 2 * b->n : b->n;
}

static void calculate(Bank *b) {
    b->v[TIME][0] = b->time, b->v[Y][0] = b->v[Y][1] = 0.0;
    for (size_t i = 0; i < b->n; i++) {
        b->v[RATE][i] = b->v[U][i] - b->v[K][i] * b->v[X][i], b->v[Z][i] = b->v[X][i] - 1e9;
        for (int j = 0; j < 2; j++) b->v[Y][j] += b->v[M][(size_t)j * b->n + i] * b->v[X][i];
    }
}

static Bank *make(void) {
    Bank *b = calloc(1, sizeof *b);
    b->n = 3;
    for (int i = 0; i < 3; i++) b->v[K][i] = i + 1.0, b->v[M][i] = 1.0, b->v[M][3 + i] = i;
    return b;
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String g, fmi3String l, fmi3Boolean v, fmi3Boolean d, fmi3Boolean used,
                                         fmi3Boolean early, const fmi3ValueReference r[], size_t k, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback f, fmi3IntermediateUpdateCallback u) {
    return (void)n, (void)g, (void)l, (void)v, (void)d, (void)used, (void)early, (void)r, (void)k, (void)e, (void)f, (void)u, make();
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String n, fmi3String g, fmi3String l, fmi3Boolean v, fmi3Boolean d,
                                          fmi3InstanceEnvironment e, fmi3LogMessageCallback f) {
    return (void)n, (void)g, (void)l, (void)v, (void)d, (void)e, (void)f, make();
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean b, size_t n, const fmi3String s[]) {
    return (void)c, (void)b, (void)n, (void)s, fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    Bank *k = c;
    memcpy(k->v[BEGIN], k->v[U], sizeof k->v[U]);
    return (void)a, (void)b, (void)d, (void)e, k->time = t, k->readable = 1, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return ((Bank *)c)->configuring++ ? fmi3Error : fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return (void)c, fmi3OK; }

static fmi3Status move(Bank *b, const fmi3ValueReference r[], size_t m, double *to, const double *from, size_t n) {
    size_t k = 0;
    for (size_t i = 0; i < m; i++)
        for (size_t j = 0; j < size(b, r[i]); j++, k++) {
            if (k >= n) return fmi3Error;
            if (from) b->v[r[i]][j] = from[k];
            else to[k] = b->v[r[i]][j];
        }
    return k == n ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t m, fmi3Float64 y[], size_t n) {
    calculate(c);
    return ((Bank *)c)->readable ? move(c, r, m, y, NULL, n) : fmi3Error;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t m, const fmi3Float64 y[], size_t n) {
    return move(c, r, m, NULL, y, n);
}
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t m, fmi3Int32 y[], size_t n) {
    (void)r;
    if (n != 3 * m) return fmi3Error;
    for (size_t k = 0; k < n; k++) y[k] = ((Bank *)c)->code[k % 3];
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t m, const fmi3Int32 y[], size_t n) {
    (void)r;
    if (m != 1 || n != 3) return fmi3Error;
    memcpy(((Bank *)c)->code, y, 3 * sizeof *y);
    return fmi3OK;
}
fmi3Status fmi3GetUInt64(fmi3Instance c, const fmi3ValueReference r[], size_t m, fmi3UInt64 y[], size_t n) {
    return (void)r, (void)m, (void)n, y[0] = ((Bank *)c)->n, fmi3OK;
}
fmi3Status fmi3SetUInt64(fmi3Instance c, const fmi3ValueReference r[], size_t m, const fmi3UInt64 y[], size_t n) {
    Bank *b = c;
    (void)r, (void)m, (void)n;
    if (!b->configuring || y[0] > MOST) return fmi3Error;
    return b->n = (size_t)y[0], fmi3OK;
}
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference y[], size_t m, const fmi3ValueReference x[],
                                        size_t k, const fmi3Float64 seed[], size_t seeds, fmi3Float64 to[], size_t n) {
    Bank d = *(Bank *)c;
    memset(d.v[X], 0, sizeof d.v[X]), memset(d.v[U], 0, sizeof d.v[U]);
    const fmi3Status status = move(&d, x, k, NULL, seed, seeds);
    calculate(&d);
    return status ? status : move(&d, y, m, to, NULL, n);
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    Bank *b = c;
    (void)keep;
    for (size_t i = 0; i < b->n; i++) {
        const double k = b->v[K][i], decay = exp(-k * h);
        b->v[X][i] = decay * b->v[X][i] + (k ? (1.0 - decay) / k : h) * b->v[U][i];
    }
    b->time = *last = t + h, *event = *end = *early = 0;
    return fmi3OK;
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    return *s = *s ? *s : malloc(sizeof(Bank)), memcpy(*s, c, sizeof(Bank)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return memcpy(c, s, sizeof(Bank)), fmi3OK; }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return (void)c, free(*s), *s = NULL, fmi3OK; }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) { return (void)c, (void)s, *n = sizeof(Bank), fmi3OK; }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte to[], size_t n) {
    return (void)c, memcpy(to, s, n), fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte from[], size_t n, fmi3FMUState *s) {
    return (void)c, *s = malloc(n), memcpy(*s, from, n), fmi3OK;
}
/* Model Exchange */
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t) { return ((Bank *)c)->time = t, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d, fmi3Boolean *e, fmi3Boolean *f,
                                    fmi3Float64 *t) {
    return (void)c, (void)t, *a = *b = *d = *e = *f = 0, fmi3OK;
}
static fmi3Status vector(Bank *b, unsigned reference, double *to, const double *from, size_t n) {
    return n == b->n ? move(b, &reference, 1, to, from, n) : fmi3Error;
}
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return vector(c, X, x, NULL, n); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return vector(c, X, NULL, x, n); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 x[], size_t n) {
    return calculate(c), vector(c, RATE, x, NULL, n);
}
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) { return calculate(c), vector(c, Z, z, NULL, n); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) {
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return (void)c, fmi3OK;
}
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { return *n = ((Bank *)c)->n, fmi3OK; }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { return *n = ((Bank *)c)->n, fmi3OK; }
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean b, fmi3Boolean *event, fmi3Boolean *end) {
    return (void)c, (void)b, *event = *end = 0, fmi3OK;
}
