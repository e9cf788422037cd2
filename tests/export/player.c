/* Runs a shared library of an FMU for co-simulation and prints numbers; for machines without Python.

       player LIBRARY TOKEN FIRST LAST STEP COUNT REFERENCE=VALUE...

   The values are set before the start; after each step the variables with value references FIRST to LAST are
   printed on a line. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
#define FULL(name) fmi2##name
typedef fmi2Component Handle;
typedef fmi2Status Status;
#else
#include "fmi3Functions.h"
#define FULL(name) fmi3##name
typedef fmi3Instance Handle;
typedef fmi3Status Status;
#endif

#ifdef _WIN32
#include <windows.h>
typedef HMODULE Library;
static Library open_library(const char *path) { return LoadLibraryA(path); }
static void (*find(Library library, const char *name))(void) {
    return (void (*)(void))GetProcAddress(library, name);
}
#else
#include <dlfcn.h>
typedef void *Library;
static Library open_library(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void (*find(Library library, const char *name))(void) {
    void (*function)(void);
    *(void **)&function = dlsym(library, name);
    return function;
}
#endif

#define WORD(name) #name
#define NAME(name) WORD(name)

static void must(int good, const char *what) {
    if (good) return;
    fprintf(stderr, "player: %s\n", what);
    exit(1);
}

/* A function of the library, with its type in the standard: FIND(Terminate)(handle) */
#define FIND(function) ((FULL(function##TYPE) *)need(library, NAME(FULL(function))))

static void (*need(Library library, const char *name))(void) {
    void (*function)(void) = find(library, name);
    must(function != NULL, name);
    return function;
}

#if FMI == 2
static void logger(void *environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)environment, (void)instance, (void)category;
    fprintf(stderr, "%d %s\n", (int)status, message);
}

static Handle start(Library library, const char *token) {
    static fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    Handle handle = FIND(Instantiate)("player", fmi2CoSimulation, token, "", &callbacks, fmi2False, fmi2False);
    must(handle != NULL, "no instance");
    must(FIND(SetupExperiment)(handle, fmi2False, 0, 0, fmi2False, 0) == fmi2OK, "setup");
    must(FIND(EnterInitializationMode)(handle) == fmi2OK, "initialisation");
    return handle;
}

static Status set(Library library, Handle handle, unsigned reference, double value) {
    return FIND(SetReal)(handle, &reference, 1, &value);
}

static Status get(Library library, Handle handle, unsigned reference, double *value) {
    return FIND(GetReal)(handle, &reference, 1, value);
}

static Status step(Library library, Handle handle, double time, double length) {
    return FIND(DoStep)(handle, time, length, fmi2True);
}
#else
static void logger(void *environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment, (void)category;
    fprintf(stderr, "%d %s\n", (int)status, message);
}

static Handle start(Library library, const char *token) {
    Handle handle = FIND(InstantiateCoSimulation)("player", token, NULL, fmi3False, fmi3False, fmi3False,
                                                  fmi3False, NULL, 0, NULL, logger, NULL);
    must(handle != NULL, "no instance");
    must(FIND(EnterInitializationMode)(handle, fmi3False, 0, 0, fmi3False, 0) == fmi3OK, "initialisation");
    return handle;
}

static Status set(Library library, Handle handle, unsigned reference, double value) {
    return FIND(SetFloat64)(handle, &reference, 1, &value, 1);
}

static Status get(Library library, Handle handle, unsigned reference, double *value) {
    return FIND(GetFloat64)(handle, &reference, 1, value, 1);
}

static Status step(Library library, Handle handle, double time, double length) {
    fmi3Boolean event, terminate, early;
    fmi3Float64 last;
    return FIND(DoStep)(handle, time, length, fmi3True, &event, &terminate, &early, &last);
}
#endif

int main(int count, char **words) {
    must(count >= 7, "expected LIBRARY TOKEN FIRST LAST STEP COUNT REFERENCE=VALUE...");
    Library library = open_library(words[1]);
    must(library != NULL, "the library does not load");
    Handle handle = start(library, words[2]);
    const unsigned first = (unsigned)atoi(words[3]), last = (unsigned)atoi(words[4]);
    const double length = atof(words[5]);
    for (int i = 7; i < count; i++)
        must(set(library, handle, (unsigned)atoi(words[i]), atof(strchr(words[i], '=') + 1)) == 0, words[i]);
    must(FIND(ExitInitializationMode)(handle) == 0, "end of the initialisation");
    for (int k = 0; k <= atoi(words[6]); k++) {
        if (k) must(step(library, handle, (k - 1) * length, length) == 0, "step");
        for (unsigned r = first; r <= last; r++) {
            double value;
            must(get(library, handle, r, &value) == 0, "get");
            printf(r < last ? "%.17g " : "%.17g\n", value);
        }
    }
    FIND(Terminate)(handle);
    FIND(FreeInstance)(handle);
    return 0;
}
