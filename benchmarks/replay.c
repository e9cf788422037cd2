/* Plays recorded inputs into an FMU 2.0 linked with it: time per communication step of 1 ms, inputs set before
   each, in nanoseconds; the best of five runs.

   argv[1]: int32 k, int32 n, uint32 reference[k], double row[n][k] */

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2Functions.h"
#include "start.h"

enum { RUNS = 5 };
static const double STEP = 1e-3;

static void tell(fmi2ComponentEnvironment owner, fmi2String instance, fmi2Status status, fmi2String category,
                 fmi2String message, ...) {
    (void)owner, (void)instance, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* One run; time per step [s], negative when it failed. */
static double run(const fmi2ValueReference *references, const double *rows, size_t k, int n) {
    const fmi2CallbackFunctions callbacks = {tell, calloc, free, NULL, NULL};
    fmi2Component c = fmi2Instantiate("replay", fmi2CoSimulation, MODEL_GUID, "", &callbacks, 0, 0);
    if (!c) return -1.0;
    int bad = fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0) | fmi2SetReal(c, references, k, rows);
    bad |= fmi2EnterInitializationMode(c) | fmi2ExitInitializationMode(c);
    const double begin = seconds();
    for (int i = 0; i + 1 < n && !bad; i++) {
        bad |= fmi2SetReal(c, references, k, rows + (size_t)i * k);
        bad |= fmi2DoStep(c, i * STEP, STEP, 1);
    }
    const double spent = (seconds() - begin) / (n - 1);
    fmi2FreeInstance(c);
    return bad ? -1.0 : spent;
}

int main(int count, char **arguments) {
    FILE *file = count > 1 ? fopen(arguments[1], "rb") : NULL;
    int32_t size[2];
    if (!file || fread(size, sizeof size, 1, file) != 1) return 2;
    const size_t k = (size_t)size[0], all = k * (size_t)size[1];
    fmi2ValueReference *references = malloc(sizeof *references * (k + 1));
    double *rows = malloc(sizeof *rows * (all + 1)), best = -1.0;
    if (!references || !rows || fread(references, sizeof *references, k, file) != k) return 2;
    if (fread(rows, sizeof *rows, all, file) != all) return 2;
    for (int r = 0; r < RUNS; r++) {
        const double spent = run(references, rows, k, size[1]);
        if (spent < 0.0) return 1;
        if (best < 0.0 || spent < best) best = spent;
    }
    printf("%.1f\n", 1e9 * best);
    fclose(file);
    return 0;
}
