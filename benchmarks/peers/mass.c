/* One mass of the undamped oscillator as an FMU of FMI 2.0 for co-simulation; MASS says which of the two.

       x'' = -stiffness x + gain u        mass 0: u = x2, force = 100 (u - x)        mass 1: u = force

   The input is a polynomial of degree 3 over the step: its value, and the derivatives given for this step. For
   that the solution below is exact, so that all error of a run is that of the coupling. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "sizes.h"

enum { U, X, V, FORCE, VARIABLES };
enum { ORDER = 3 };
static const double coupling = 100, stiffness = MASS == 0 ? 10 + 100 : 1000, gain = MASS == 0 ? 100 : -1;

typedef struct {
    double x, v, u[ORDER + 1]; /* the input and its derivatives at the present time */
    double slope[ORDER];       /* derivatives given for the next step */
} Mass;

/* A particular solution, a polynomial too, and a free oscillation from what is left of the start values. */
static void advance(Mass *m, double h) {
    const double u1 = m->slope[0], u2 = m->slope[1], u3 = m->slope[2], w = sqrt(stiffness);
    const double p3 = gain * u3 / 6 / stiffness, p2 = gain * u2 / 2 / stiffness;
    const double p1 = (gain * u1 - 6 * p3) / stiffness, p0 = (gain * m->u[0] - 2 * p2) / stiffness;
    const double x = m->x - p0, v = (m->v - p1) / w, c = cos(w * h), s = sin(w * h);
    m->x = p0 + h * (p1 + h * (p2 + h * p3)) + x * c + v * s;
    m->v = p1 + h * (2 * p2 + h * 3 * p3) + w * (v * c - x * s);
    m->u[0] += h * (u1 + h / 2 * (u2 + h / 3 * u3));
    m->u[1] = u1 + h * (u2 + h / 2 * u3);
    m->u[2] = u2 + h * u3;
    m->u[3] = u3;
    memset(m->slope, 0, sizeof m->slope);
}

/* Derivative of a variable at the present time, of any order up to ORDER. */
static double derivative(const Mass *m, unsigned reference, int order) {
    double x[ORDER + 2] = {m->x, m->v};
    for (int k = 0; k < ORDER; k++) x[k + 2] = gain * m->u[k] - stiffness * x[k];
    switch (reference) {
    case X: return x[order];
    case V: return x[order + 1];
    case FORCE: return coupling * (m->u[order] - x[order]);
    default: return m->u[order];
    }
}

/* ---- life */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)resources, (void)call, (void)visible, (void)logging;
    Mass *m = type == fmi2CoSimulation && !strcmp(guid, MODEL_GUID) ? calloc(1, sizeof *m) : NULL;
    if (m) m->v = MASS == 0 ? 100 : -100;
    return m;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean ends, fmi2Real stop) {
    return (void)c, (void)given, (void)tolerance, (void)start, (void)ends, (void)stop, fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) {
    const Mass fresh = {.v = MASS == 0 ? 100 : -100};
    *(Mass *)c = fresh;
    return fmi2OK;
}
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) {
    return (void)c, (void)on, (void)n, (void)names, fmi2OK;
}

/* ---- values and steps */

#define REFS const fmi2ValueReference vr[], size_t n

fmi2Status fmi2GetReal(fmi2Component c, REFS, fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES) return fmi2Error;
        value[k] = derivative(c, vr[k], 0);
    }
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, REFS, const fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] != U) return fmi2Error;
        ((Mass *)c)->u[0] = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, REFS, const fmi2Integer order[], const fmi2Real value[]) {
    Mass *m = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] != U || order[k] < 1 || order[k] > ORDER) return fmi2Error;
        m->slope[order[k] - 1] = m->u[order[k]] = value[k];
    }
    return fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, REFS, const fmi2Integer order[], fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES || order[k] < 1 || order[k] > ORDER) return fmi2Error;
        value[k] = derivative(c, vr[k], order[k]);
    }
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference z[], size_t nz, REFS,
                                        const fmi2Real dv[], fmi2Real dz[]) {
    (void)c;
    for (size_t i = 0; i < nz; i++) {
        dz[i] = 0;
        for (size_t k = 0; k < n; k++) dz[i] += z[i] == FORCE && vr[k] == U ? coupling * dv[k] : 0;
    }
    return fmi2OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean final) {
    (void)t, (void)final;
    advance(c, h);
    return fmi2OK;
}

/* ---- rollback */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Mass));
    if (!*state) return fmi2Error;
    memcpy(*state, c, sizeof(Mass));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return memcpy(c, state, sizeof(Mass)), fmi2OK; }
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* ---- what importers look for and this model has nothing of */

#define NOTHING(NAME, ...) \
    fmi2Status fmi2##NAME(fmi2Component c, __VA_ARGS__) { return (void)c, fmi2Error; }
#pragma clang diagnostic ignored "-Wunused-parameter"
NOTHING(GetInteger, REFS, fmi2Integer v[])
NOTHING(GetBoolean, REFS, fmi2Boolean v[])
NOTHING(GetString, REFS, fmi2String v[])
NOTHING(SetInteger, REFS, const fmi2Integer v[])
NOTHING(SetBoolean, REFS, const fmi2Boolean v[])
NOTHING(SetString, REFS, const fmi2String v[])
NOTHING(SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
NOTHING(SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
NOTHING(DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
NOTHING(GetStatus, const fmi2StatusKind k, fmi2Status *v)
NOTHING(GetRealStatus, const fmi2StatusKind k, fmi2Real *v)
NOTHING(GetIntegerStatus, const fmi2StatusKind k, fmi2Integer *v)
NOTHING(GetBooleanStatus, const fmi2StatusKind k, fmi2Boolean *v)
NOTHING(GetStringStatus, const fmi2StatusKind k, fmi2String *v)
fmi2Status fmi2CancelStep(fmi2Component c) { return (void)c, fmi2Error; }
