/* FMI 3.0 behind fmu.h. */

#include "fmu.h"

#include "fmi3Functions.h"
#include "library.h"

#define FUNCTIONS(X)                                                                                         \
    X(InstantiateCoSimulation) X(InstantiateModelExchange) X(FreeInstance) X(EnterInitializationMode)        \
    X(ExitInitializationMode) X(Reset) X(GetFloat64) X(SetFloat64) X(GetDirectionalDerivative)               \
    X(GetFMUState) X(SetFMUState) X(FreeFMUState) X(SerializedFMUStateSize)          \
    X(SerializeFMUState) X(DeserializeFMUState) X(UpdateDiscreteStates) X(EnterContinuousTimeMode)           \
    X(SetTime) X(SetContinuousStates) X(GetContinuousStateDerivatives) X(GetContinuousStates)                \
    X(CompletedIntegratorStep) X(GetOutputDerivatives) X(DoStep)

#define DECLARE(f) static fmi3##f##TYPE *f;
FUNCTIONS(DECLARE)

static void *library;

void fmu_load(const char *path) {
    library = library_open(path);
#define FIND(f) *(void **)&f = function(library, "fmi3" #f);
    FUNCTIONS(FIND)
}

void fmu_unload(void) { library_close(library); }

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                   fmi3String message) {
    (void)environment;
    fprintf(stderr, "status %d, %s: %s\n", (int)status, category, message);
}

void *fmu_make(const char *name, const char *token, int co_simulation) {
    if (!co_simulation) return InstantiateModelExchange(name, token, "", fmi3False, fmi3False, NULL, logger);
    return InstantiateCoSimulation(name, token, "", fmi3False, fmi3False, fmi3False, fmi3False, NULL, 0, NULL,
                                   logger, NULL);
}

int fmu_begin(void *c, double start, double tolerance) {
    return (int)EnterInitializationMode(c, fmi3True, tolerance, start, fmi3False, 0.0);
}

int fmu_end(void *c, int co_simulation) {
    fmi3Boolean flags[5];
    double when;
    int status = (int)ExitInitializationMode(c);
    if (!status && !co_simulation)
        status = (int)UpdateDiscreteStates(c, flags, flags + 1, flags + 2, flags + 3, flags + 4, &when);
    return status || co_simulation ? status : (int)EnterContinuousTimeMode(c);
}

int fmu_reset(void *c) { return (int)Reset(c); }
void fmu_free(void *c) { FreeInstance(c); }
int fmu_set(void *c, unsigned reference, double value) {
    return (int)SetFloat64(c, &reference, 1, &value, 1);
}

int fmu_get(void *c, const unsigned references[], size_t n, double values[]) {
    return (int)GetFloat64(c, references, n, values, n);
}

int fmu_slopes(void *c, const unsigned references[], size_t n, double values[]) {
    int status = 0;
    const fmi3Int32 first = 1;
    for (size_t i = 0; i < n && !status; i++)
        status = (int)GetOutputDerivatives(c, references + i, 1, &first, values + i, 1);
    return status;
}

int fmu_along(void *c, unsigned unknown, unsigned known, double *value) {
    const double seed = 1.0;
    return (int)GetDirectionalDerivative(c, &unknown, 1, &known, 1, &seed, 1, value, 1);
}

int fmu_step(void *c, double time, double length) {
    fmi3Boolean event, terminate, early;
    double reached;
    return (int)DoStep(c, time, length, fmi3True, &event, &terminate, &early, &reached);
}

int fmu_euler(void *c, double time, double length, size_t states) {
    double x[256], dx[256];
    fmi3Boolean event, terminate;
    int status = (int)GetContinuousStates(c, x, states);
    if (!status) status = (int)GetContinuousStateDerivatives(c, dx, states);
    for (size_t i = 0; i < states; i++) x[i] += length * dx[i];
    if (!status) status = (int)SetTime(c, time + length);
    if (!status) status = (int)SetContinuousStates(c, x, states);
    return status ? status : (int)CompletedIntegratorStep(c, fmi3False, &event, &terminate);
}

int fmu_save(void *c, void **state) { return (int)GetFMUState(c, state); }
int fmu_restore(void *c, void *state) { return (int)SetFMUState(c, state); }
int fmu_forget(void *c, void **state) { return (int)FreeFMUState(c, state); }
int fmu_size(void *c, void *state, size_t *size) { return (int)SerializedFMUStateSize(c, state, size); }

int fmu_pack(void *c, void *state, char bytes[], size_t size) {
    return (int)SerializeFMUState(c, state, (fmi3Byte *)bytes, size);
}

int fmu_unpack(void *c, const char bytes[], size_t size, void **state) {
    return (int)DeserializeFMUState(c, (const fmi3Byte *)bytes, size, state);
}
