/* Plays recorded inputs, linear between samples, into an FMU 2.0 from its start, with some parameters set; records
   outputs at the samples. The functions of the FMU are given: nothing but this loop is added to its own cost. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"

typedef struct {
    fmi2InstantiateTYPE *instantiate;
    fmi2SetupExperimentTYPE *setup;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
    fmi2SetRealTYPE *set;
    fmi2SetRealInputDerivativesTYPE *slope;
    fmi2DoStepTYPE *step;
    fmi2GetRealTYPE *get;
    fmi2FreeInstanceTYPE *release;
} Functions;

static void tell(fmi2ComponentEnvironment owner, fmi2String instance, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void)owner, (void)instance, (void)category;
    if (status > fmi2Warning) fprintf(stderr, "%s\n", message);
}

/* Samples n of time and inputs, (n, nu), to outputs, (n, ny); variables by value reference. 0 if all went well. */
int play(const Functions *f, const char *guid, double tolerance, int n, const double *time, size_t nu,
         const fmi2ValueReference *inputs, const double *u, size_t np, const fmi2ValueReference *parameters,
         const double *p, size_t ny, const fmi2ValueReference *outputs, double *y) {
    const fmi2CallbackFunctions callbacks = {tell, calloc, free, NULL, NULL};
    const fmi2Component c = f->instantiate("play", fmi2CoSimulation, guid, "", &callbacks, 0, 0);
    double *slopes = malloc((nu + 1) * sizeof *slopes);
    fmi2Integer *first = malloc((nu + 1) * sizeof *first);
    if (!c || !slopes || !first) return 1;
    int bad = f->setup(c, tolerance > 0.0, tolerance, time[0], 0, 0.0);
    bad |= f->set(c, parameters, np, p) | f->set(c, inputs, nu, u) | f->enter(c) | f->leave(c);
    bad |= f->get(c, outputs, ny, y);
    for (int i = 0; i + 1 < n && !bad; i++, u += nu) {
        const double h = time[i + 1] - time[i];
        for (size_t j = 0; j < nu; j++) {
            slopes[j] = (u[nu + j] - u[j]) / h;
            first[j] = 1;
        }
        bad |= f->set(c, inputs, nu, u) | f->slope(c, inputs, nu, first, slopes);
        bad |= f->step(c, time[i], h, fmi2True) | f->get(c, outputs, ny, y + (size_t)(i + 1) * ny);
    }
    free(first);
    free(slopes);
    f->release(c);
    return bad;
}
