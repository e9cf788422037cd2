/* An FMU 2.0 for Model Exchange as functions of its states and inputs, for external functions of Modelica.

   There are two instances: `first` stays in initialization mode and gives the states at the start, `running` is in
   continuous-time mode. A function sets only the inputs that its results depend on; as these are the inputs that
   modelDescription.xml declares for them, each is a function of its arguments alone. */

#ifndef FMU_FOR_MODELICA_H
#define FMU_FOR_MODELICA_H

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "ModelicaUtilities.h"

#ifdef _WIN32
#include <windows.h>
#define FMU_FILE "win64/%s.dll"
#elif defined __APPLE__
#include <dlfcn.h>
#define FMU_FILE "darwin64/%s.dylib"
#else
#include <dlfcn.h>
#define FMU_FILE "linux64/%s.so"
#endif

/* ---- the types of FMI 2.0 that are used here */

typedef struct {
    int new_discrete_states_needed, terminate_simulation, nominals_changed, values_changed, next_time_defined;
    double next_time;
} FmuEventInfo;

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} FmuCallbacks;

typedef struct {
    char *name;
    void *library;
    void *first, *running;
    FmuCallbacks callbacks;
    size_t parameters;
    unsigned *parameter;
    double *value;
    void *(*instantiate)(const char *, int, const char *, const char *, const FmuCallbacks *, int, int);
    void (*free_instance)(void *);
    int (*setup)(void *, int, double, double, int, double);
    int (*enter_initialization)(void *), (*exit_initialization)(void *);
    int (*enter_event)(void *), (*new_discrete_states)(void *, FmuEventInfo *), (*enter_continuous)(void *);
    int (*set_real)(void *, const unsigned *, size_t, const double *);
    int (*get_real)(void *, const unsigned *, size_t, double *);
    int (*set_time)(void *, double);
    int (*set_states)(void *, const double *, size_t);
    int (*get_derivatives)(void *, double *, size_t);
    char *guid, *location;
} Fmu;

/* ---- library and messages */

static void fmu_log(void *environment, const char *name, int status, const char *category, const char *text, ...) {
    char line[1024];
    va_list arguments;
    (void)environment, (void)category;
    va_start(arguments, text);
    vsnprintf(line, sizeof line, text, arguments);
    va_end(arguments);
    if (status > 0) ModelicaFormatMessage("%s: %s\n", name, line);
}

static void *fmu_symbol(Fmu *f, const char *name) {
#ifdef _WIN32
    void *found = (void *)GetProcAddress((HMODULE)f->library, name);
#else
    void *found = dlsym(f->library, name);
#endif
    if (!found) ModelicaFormatError("%s: the library has no function %s", f->name, name);
    return found;
}

static char *fmu_copy(const char *text) {
    char *copy = malloc(strlen(text) + 1);
    if (!copy) ModelicaError("out of memory");
    return strcpy(copy, text);
}

/* fmi2Discard is no failure: the solver tries another step. */
static void fmu_done(Fmu *f, int status, const char *call) {
    if (status > 2) ModelicaFormatError("%s: %s failed, see the messages before", f->name, call);
}

/* The folder of the FMU. Where a tool leaves the URI of a resource as it is, it is found from this file. */
static char *fmu_folder(const char *given) {
    const char *uri = strstr(given, "modelica://"), *here = __FILE__;
    const char *inside = uri ? strstr(uri, "/FMUs/") : NULL;
    if (!inside) return fmu_copy(given);
    size_t length = strlen(here);
    while (length > 0 && here[length - 1] != '/' && here[length - 1] != '\\') length--;
    char *folder = malloc(length + strlen(inside) + 4);
    if (!folder) ModelicaError("out of memory");
    memcpy(folder, here, length);
    strcpy(folder + length, "..");
    return strcat(folder, inside);
}

static void fmu_open_library(Fmu *f, const char *folder) {
    char path[4096], file[512];
    snprintf(file, sizeof file, FMU_FILE, f->name);
    snprintf(path, sizeof path, "%s/binaries/%s", folder, file);
#ifdef _WIN32
    f->library = (void *)LoadLibraryA(path);
#else
    f->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
#endif
    if (!f->library) ModelicaFormatError("%s: no library for this system, expected %s", f->name, path);
}

/* ---- life */

/* An instance in initialization mode, with the parameters set. */
static void *fmu_instance(Fmu *f, double time) {
    void *made = f->instantiate(f->name, 0, f->guid, f->location, &f->callbacks, 0, 0);
    if (!made) ModelicaFormatError("%s: fmi2Instantiate failed, see the messages before", f->name);
    fmu_done(f, f->setup(made, 0, 0.0, time, 0, 0.0), "fmi2SetupExperiment");
    fmu_done(f, f->set_real(made, f->parameter, f->parameters, f->value), "fmi2SetReal");
    fmu_done(f, f->enter_initialization(made), "fmi2EnterInitializationMode");
    return made;
}

static void *fmu_new(const char *given, const char *name, const char *guid, const int *parameter, size_t n,
                     const double *value) {
    Fmu *f = calloc(1, sizeof *f);
    if (!f) ModelicaError("out of memory");
    char *folder = fmu_folder(given);
    f->name = fmu_copy(name);
    f->guid = fmu_copy(guid);
    f->location = malloc(strlen(folder) + 32);
    f->parameter = malloc((n + 1) * sizeof *f->parameter);
    f->value = malloc((n + 1) * sizeof *f->value);
    if (!f->location || !f->parameter || !f->value) ModelicaError("out of memory");
    sprintf(f->location, folder[0] == '/' ? "file://%s/resources" : "file:///%s/resources", folder);
    f->parameters = n;
    for (size_t i = 0; i < n; i++) {
        f->parameter[i] = (unsigned)parameter[i];
        f->value[i] = value[i];
    }
    f->callbacks.logger = fmu_log;
    f->callbacks.allocate = calloc;
    f->callbacks.release = free;
    fmu_open_library(f, folder);
    free(folder);
    *(void **)&f->instantiate = fmu_symbol(f, "fmi2Instantiate");
    *(void **)&f->free_instance = fmu_symbol(f, "fmi2FreeInstance");
    *(void **)&f->setup = fmu_symbol(f, "fmi2SetupExperiment");
    *(void **)&f->enter_initialization = fmu_symbol(f, "fmi2EnterInitializationMode");
    *(void **)&f->exit_initialization = fmu_symbol(f, "fmi2ExitInitializationMode");
    *(void **)&f->enter_event = fmu_symbol(f, "fmi2EnterEventMode");
    *(void **)&f->new_discrete_states = fmu_symbol(f, "fmi2NewDiscreteStates");
    *(void **)&f->enter_continuous = fmu_symbol(f, "fmi2EnterContinuousTimeMode");
    *(void **)&f->set_real = fmu_symbol(f, "fmi2SetReal");
    *(void **)&f->get_real = fmu_symbol(f, "fmi2GetReal");
    *(void **)&f->set_time = fmu_symbol(f, "fmi2SetTime");
    *(void **)&f->set_states = fmu_symbol(f, "fmi2SetContinuousStates");
    *(void **)&f->get_derivatives = fmu_symbol(f, "fmi2GetDerivatives");
    return f;
}

static void fmu_free(void *object) {
    Fmu *f = object;
    if (!f) return;
    if (f->first) f->free_instance(f->first);
    if (f->running) f->free_instance(f->running);
    free(f->name), free(f->guid), free(f->location), free(f->parameter), free(f->value), free(f);
}

/* ---- values */

static void fmu_set(Fmu *f, void *instance, const int *reference, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++) {
        const unsigned r = (unsigned)reference[i];
        fmu_done(f, f->set_real(instance, &r, 1, &value[i]), "fmi2SetReal");
    }
}

static void fmu_get(Fmu *f, void *instance, const int *reference, size_t n, double *value) {
    for (size_t i = 0; i < n; i++) {
        const unsigned r = (unsigned)reference[i];
        fmu_done(f, f->get_real(instance, &r, 1, &value[i]), "fmi2GetReal");
    }
}

/* States at the start. */
static void fmu_start(void *object, double time, const int *input, size_t nu, const double *u, const int *state,
                      size_t nx, double *x) {
    Fmu *f = object;
    if (!f->first) f->first = fmu_instance(f, time);
    fmu_set(f, f->first, input, nu, u);
    fmu_get(f, f->first, state, nx, x);
}

static double fmu_next_time(Fmu *f) {
    FmuEventInfo info;
    memset(&info, 0, sizeof info);
    do fmu_done(f, f->new_discrete_states(f->running, &info), "fmi2NewDiscreteStates");
    while (info.new_discrete_states_needed && !info.terminate_simulation);
    if (info.values_changed) ModelicaFormatError("%s: states that jump at an event are not supported", f->name);
    fmu_done(f, f->enter_continuous(f->running), "fmi2EnterContinuousTimeMode");
    return info.next_time_defined ? info.next_time : 1e60;
}

static void fmu_at(Fmu *f, double time, const double *x, size_t nx, const int *input, size_t nu, const double *u) {
    if (!f->running) {
        f->running = fmu_instance(f, time);
        fmu_done(f, f->exit_initialization(f->running), "fmi2ExitInitializationMode");
        fmu_next_time(f);
    }
    fmu_done(f, f->set_time(f->running, time), "fmi2SetTime");
    fmu_set(f, f->running, input, nu, u);
    if (nx > 0) fmu_done(f, f->set_states(f->running, x, nx), "fmi2SetContinuousStates");
}

static void fmu_derivatives(void *object, double time, const double *x, size_t nx, const int *input, size_t nu,
                            const double *u, double *dx) {
    Fmu *f = object;
    fmu_at(f, time, x, nx, input, nu, u);
    fmu_done(f, f->get_derivatives(f->running, dx, nx), "fmi2GetDerivatives");
}

static void fmu_outputs(void *object, double time, const double *x, size_t nx, const int *input, size_t nu,
                        const double *u, const int *output, size_t ny, double *y) {
    Fmu *f = object;
    fmu_at(f, time, x, nx, input, nu, u);
    fmu_get(f, f->running, output, ny, y);
}

/* The next time at which a derivative jumps, 1e60 where none is known. */
static double fmu_event(void *object, double time, const double *x, size_t nx) {
    Fmu *f = object;
    fmu_at(f, time, x, nx, NULL, 0, NULL);
    fmu_done(f, f->enter_event(f->running), "fmi2EnterEventMode");
    return fmu_next_time(f);
}

#endif
