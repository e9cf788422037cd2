/* The C sources of an FMU, compiled with -finstrument-functions: when the library is unloaded, the number of calls of some
   of its functions is written to the file PART in the folder $COUNTS. Calls of inlined functions count, too. */

#include MODEL /* <part>_fmu.c */

#include <stdio.h>
#include <stdlib.h>

/* Hidden, or those of the C library, which do nothing, would be called in place of these. */
#define QUIET __attribute__((no_instrument_function, visibility("hidden")))
#define NAMED(function) {(void *)function, #function, 0}

static struct {
    void *function;
    const char *name;
    long calls;
} counted[] = {
    NAMED(rodas), NAMED(rodas3), NAMED(kutta), NAMED(cash_karp), NAMED(model_jacobian), NAMED(model_factorise),
    NAMED(model_solve), NAMED(model_dynamics), NAMED(model_derivatives), NAMED(fmi2DoStep),
};
enum { COUNTED = sizeof counted / sizeof *counted };

QUIET void __cyg_profile_func_enter(void *function, void *caller) {
    (void)caller;
    for (int i = 0; i < COUNTED; i++) counted[i].calls += counted[i].function == function;
}

QUIET void __cyg_profile_func_exit(void *function, void *caller) { (void)function, (void)caller; }

QUIET __attribute__((destructor)) static void tell(void) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", getenv("COUNTS"), PART);
    FILE *file = fopen(path, "w");
    for (int i = 0; file && i < COUNTED; i++) fprintf(file, "%s %ld\n", counted[i].name, counted[i].calls);
    if (file) fclose(file);
}
