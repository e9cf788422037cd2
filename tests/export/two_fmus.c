/* Two FMUs in one program, FIRST and SECOND: an output of each goes to an input of the other, in a Jacobi master.

   Arguments: for each FMU its GUID and the value references of input and output; then the reference of another input
   of the first FMU, and its value. Prints both outputs after 100 steps of 1 ms. */

#include <stdio.h>
#include <stdlib.h>

#define JOINED(a, b) a##b
#define JOIN(a, b) JOINED(a, b)

#if VERSION == 2
#include "fmi2FunctionTypes.h"
typedef fmi2Component Handle;

static void ignore(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String text, ...) {
    (void)environment, (void)name, (void)status, (void)category, (void)text;
}

static const fmi2CallbackFunctions callbacks = {ignore, calloc, free, NULL, NULL};

#define FUNCTIONS(f)                                                                                        \
    fmi2InstantiateTYPE JOIN(f, fmi2Instantiate);                                                           \
    fmi2SetupExperimentTYPE JOIN(f, fmi2SetupExperiment);                                                   \
    fmi2EnterInitializationModeTYPE JOIN(f, fmi2EnterInitializationMode);                                   \
    fmi2ExitInitializationModeTYPE JOIN(f, fmi2ExitInitializationMode);                                     \
    fmi2GetRealTYPE JOIN(f, fmi2GetReal);                                                                   \
    fmi2SetRealTYPE JOIN(f, fmi2SetReal);                                                                   \
    fmi2DoStepTYPE JOIN(f, fmi2DoStep);                                                                     \
    fmi2FreeInstanceTYPE JOIN(f, fmi2FreeInstance);                                                         \
    static Handle JOIN(f, begin)(const char *guid) {                                                        \
        Handle c = JOIN(f, fmi2Instantiate)("one", fmi2CoSimulation, guid, "", &callbacks, 0, 0);           \
        return c && !JOIN(f, fmi2SetupExperiment)(c, 0, 0.0, 0.0, 0, 0.0) &&                                \
               !JOIN(f, fmi2EnterInitializationMode)(c) && !JOIN(f, fmi2ExitInitializationMode)(c) ? c : NULL; \
    }                                                                                                       \
    static int JOIN(f, get)(Handle c, unsigned r, double *v) { return JOIN(f, fmi2GetReal)(c, &r, 1, v); }  \
    static int JOIN(f, set)(Handle c, unsigned r, double v) { return JOIN(f, fmi2SetReal)(c, &r, 1, &v); }  \
    static int JOIN(f, step)(Handle c, double t, double h) { return JOIN(f, fmi2DoStep)(c, t, h, 1); }      \
    static void JOIN(f, end)(Handle c) { JOIN(f, fmi2FreeInstance)(c); }
#else
#include "fmi3FunctionTypes.h"
typedef fmi3Instance Handle;

#define FUNCTIONS(f)                                                                                        \
    fmi3InstantiateCoSimulationTYPE JOIN(f, fmi3InstantiateCoSimulation);                                   \
    fmi3EnterInitializationModeTYPE JOIN(f, fmi3EnterInitializationMode);                                   \
    fmi3ExitInitializationModeTYPE JOIN(f, fmi3ExitInitializationMode);                                     \
    fmi3GetFloat64TYPE JOIN(f, fmi3GetFloat64);                                                             \
    fmi3SetFloat64TYPE JOIN(f, fmi3SetFloat64);                                                             \
    fmi3DoStepTYPE JOIN(f, fmi3DoStep);                                                                     \
    fmi3FreeInstanceTYPE JOIN(f, fmi3FreeInstance);                                                         \
    static Handle JOIN(f, begin)(const char *token) {                                                       \
        Handle c = JOIN(f, fmi3InstantiateCoSimulation)("one", token, "", 0, 0, 0, 0, NULL, 0, NULL, NULL,  \
                                                        NULL);                                              \
        return c && !JOIN(f, fmi3EnterInitializationMode)(c, 0, 0.0, 0.0, 0, 0.0) &&                        \
               !JOIN(f, fmi3ExitInitializationMode)(c) ? c : NULL;                                          \
    }                                                                                                       \
    static int JOIN(f, get)(Handle c, unsigned r, double *v) {                                              \
        return JOIN(f, fmi3GetFloat64)(c, &r, 1, v, 1);                                                     \
    }                                                                                                       \
    static int JOIN(f, set)(Handle c, unsigned r, double v) {                                               \
        return JOIN(f, fmi3SetFloat64)(c, &r, 1, &v, 1);                                                    \
    }                                                                                                       \
    static int JOIN(f, step)(Handle c, double t, double h) {                                                \
        fmi3Boolean event, end, early;                                                                      \
        double last;                                                                                        \
        return JOIN(f, fmi3DoStep)(c, t, h, 1, &event, &end, &early, &last);                                \
    }                                                                                                       \
    static void JOIN(f, end)(Handle c) { JOIN(f, fmi3FreeInstance)(c); }
#endif

FUNCTIONS(FIRST)
FUNCTIONS(SECOND)

int main(int count, char **arguments) {
    unsigned reference[9] = {0};
    double a = 0.0, b = 0.0;
    int failed = count != 9;
    if (failed) return 2;
    for (int i = 2; i < 8; i++) reference[i] = (unsigned)strtoul(arguments[i], NULL, 10);
    Handle first = JOIN(FIRST, begin)(arguments[1]), second = JOIN(SECOND, begin)(arguments[4]);
    if (!first || !second) return 3;
    failed = JOIN(FIRST, set)(first, reference[7], strtod(arguments[8], NULL));
    for (int n = 0; n < 100 && !failed; n++) {
        failed |= JOIN(FIRST, get)(first, reference[3], &a) | JOIN(SECOND, get)(second, reference[6], &b);
        failed |= JOIN(FIRST, set)(first, reference[2], b) | JOIN(SECOND, set)(second, reference[5], a);
        failed |= JOIN(FIRST, step)(first, n * 1e-3, 1e-3) | JOIN(SECOND, step)(second, n * 1e-3, 1e-3);
    }
    failed |= JOIN(FIRST, get)(first, reference[3], &a) | JOIN(SECOND, get)(second, reference[6], &b);
    JOIN(FIRST, end)(first), JOIN(SECOND, end)(second);
    printf("%.17g %.17g\n", a, b);
    return failed;
}
