/* FMI 2.0 behind fmu.h. */

#include "fmu.h"

#include "fmi2Functions.h"
#include "library.h"

#define FUNCTIONS(X)                                                                                         \
    X(Instantiate) X(FreeInstance) X(SetupExperiment) X(EnterInitializationMode) X(ExitInitializationMode)   \
    X(Reset) X(GetReal) X(SetReal) X(GetDirectionalDerivative) X(GetFMUstate) X(SetFMUstate) X(FreeFMUstate) \
    X(SerializedFMUstateSize) X(SerializeFMUstate) X(DeSerializeFMUstate) X(NewDiscreteStates)               \
    X(EnterContinuousTimeMode) X(SetTime) X(SetContinuousStates) X(GetDerivatives) X(GetContinuousStates)    \
    X(CompletedIntegratorStep) X(GetRealOutputDerivatives) X(DoStep)

#define DECLARE(f) static fmi2##f##TYPE *f;
FUNCTIONS(DECLARE)

static void *library;

void fmu_load(const char *path) {
    library = library_open(path);
#define FIND(f) *(void **)&f = function(library, "fmi2" #f);
    FUNCTIONS(FIND)
}

void fmu_unload(void) { library_close(library); }

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment;
    fprintf(stderr, "%s, status %d, %s: %s\n", name, (int)status, category, message);
}

static const fmi2CallbackFunctions CALLBACKS = {logger, calloc, free, NULL, NULL};

void *fmu_make(const char *name, const char *token, int co_simulation) {
    return Instantiate(name, co_simulation ? fmi2CoSimulation : fmi2ModelExchange, token, "file:///",
                       &CALLBACKS, fmi2False, fmi2False);
}

int fmu_begin(void *c, double start, double tolerance) {
    const int status = (int)SetupExperiment(c, fmi2True, tolerance, start, fmi2False, 0.0);
    return status ? status : (int)EnterInitializationMode(c);
}

int fmu_end(void *c, int co_simulation) {
    fmi2EventInfo info;
    int status = (int)ExitInitializationMode(c);
    if (!status && !co_simulation) status = (int)NewDiscreteStates(c, &info);
    return status || co_simulation ? status : (int)EnterContinuousTimeMode(c);
}

int fmu_reset(void *c) { return (int)Reset(c); }
void fmu_free(void *c) { FreeInstance(c); }
int fmu_set(void *c, unsigned reference, double value) { return (int)SetReal(c, &reference, 1, &value); }

int fmu_get(void *c, const unsigned references[], size_t n, double values[]) {
    return (int)GetReal(c, references, n, values);
}

int fmu_slopes(void *c, const unsigned references[], size_t n, double values[]) {
    int status = 0;
    const fmi2Integer first = 1;
    for (size_t i = 0; i < n && !status; i++)
        status = (int)GetRealOutputDerivatives(c, references + i, 1, &first, values + i);
    return status;
}

int fmu_along(void *c, unsigned unknown, unsigned known, double *value) {
    const double seed = 1.0;
    return (int)GetDirectionalDerivative(c, &unknown, 1, &known, 1, &seed, value);
}

int fmu_step(void *c, double time, double length) { return (int)DoStep(c, time, length, fmi2True); }

int fmu_euler(void *c, double time, double length, size_t states) {
    double x[256], dx[256];
    fmi2Boolean event, terminate;
    int status = (int)GetContinuousStates(c, x, states);
    if (!status) status = (int)GetDerivatives(c, dx, states);
    for (size_t i = 0; i < states; i++) x[i] += length * dx[i];
    if (!status) status = (int)SetTime(c, time + length);
    if (!status) status = (int)SetContinuousStates(c, x, states);
    return status ? status : (int)CompletedIntegratorStep(c, fmi2False, &event, &terminate);
}

int fmu_save(void *c, void **state) { return (int)GetFMUstate(c, state); }
int fmu_restore(void *c, void *state) { return (int)SetFMUstate(c, state); }
int fmu_forget(void *c, void **state) { return (int)FreeFMUstate(c, state); }
int fmu_size(void *c, void *state, size_t *size) { return (int)SerializedFMUstateSize(c, state, size); }

int fmu_pack(void *c, void *state, char bytes[], size_t size) {
    return (int)SerializeFMUstate(c, state, bytes, size);
}

int fmu_unpack(void *c, const char bytes[], size_t size, void **state) {
    return (int)DeSerializeFMUstate(c, bytes, size, state);
}
