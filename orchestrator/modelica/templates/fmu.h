/* External functions of Modelica that evaluate an FMU 2.0 for Model Exchange at given time, states and inputs.

   There are two instances. `initializing` remains in initialization mode and computes the initial states, `running` is
   in continuous-time mode. A function sets only the inputs on which its results depend by modelDescription.xml, so
   the results are functions of the arguments only.

   All names get the name of the package as a prefix, because a model can use two packages. */

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

/* ---- types of FMI 2.0 */

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

/* Parameter values of one type. */
typedef struct {
    size_t n;
    unsigned *reference;
    void *value;
} FmuValues;

/* An instance; `ready` after its mode was reached without an error. */
typedef struct {
    void *fmu;
    int ready;
} FmuInstance;

typedef struct {
    char *name, *identifier, *guid, *location;
    void *library;
    int has_failed; /* fmi2Fatal: nothing may be called any more */
    FmuInstance initializing, running;
    FmuCallbacks callbacks;
    FmuValues reals, integers, booleans, strings;
    void *(*instantiate)(const char *, int, const char *, const char *, const FmuCallbacks *, int, int);
    void (*free_instance)(void *);
    int (*setup)(void *, int, double, double, int, double);
    int (*enter_initialization)(void *), (*exit_initialization)(void *);
    int (*enter_event)(void *), (*new_discrete_states)(void *, FmuEventInfo *), (*enter_continuous)(void *);
    int (*set_real)(void *, const unsigned *, size_t, const double *);
    int (*set_integer)(void *, const unsigned *, size_t, const int *);
    int (*set_boolean)(void *, const unsigned *, size_t, const int *);
    int (*set_string)(void *, const unsigned *, size_t, const char **);
    int (*get_real)(void *, const unsigned *, size_t, double *);
    int (*set_time)(void *, double);
    int (*set_states)(void *, const double *, size_t);
    int (*get_derivatives)(void *, double *, size_t);
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
    void *symbol = (void *)GetProcAddress((HMODULE)f->library, name);
#else
    void *symbol = dlsym(f->library, name);
#endif
    if (!symbol) ModelicaFormatError("%s: the library has no function %s", f->name, name);
    return symbol;
}

static void *fmu_memory(size_t size) {
    void *memory = calloc(1, size + 1);
    if (!memory) ModelicaError("out of memory");
    return memory;
}

static char *fmu_copy(const char *text) {
    return strcpy(fmu_memory(strlen(text)), text);
}

/* Also fmi2Discard is an error: a Modelica tool then tries another step. */
static void fmu_check(Fmu *f, int status, const char *call) {
    if (status < 2) return;
    f->has_failed |= status == 4;
    ModelicaFormatError("%s: %s %s, see the messages before", f->name, call, status == 2 ? "was discarded" : "failed");
}

/* The folder of the FMU. If a tool does not resolve the URI of the resource, the folder relative to this file. */
static char *fmu_folder(const char *location) {
    const char *uri = strstr(location, "modelica://"), *header = __FILE__;
    const char *inside = uri ? strstr(uri, "/FMUs/") : NULL;
    if (!inside) return fmu_copy(location);
    size_t length = strlen(header);
    while (length > 0 && header[length - 1] != '/' && header[length - 1] != '\\') length--;
    char *folder = fmu_memory(length + strlen(inside) + 4);
    memcpy(folder, header, length);
    strcpy(folder + length, "..");
    return strcat(folder, inside);
}

/* The URI of the resources; bytes that are not allowed in a URI are written as %XX. */
static char *fmu_location(const char *folder) {
    static const char allowed[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~/:";
    char *uri = fmu_memory(3 * strlen(folder) + 32);
    size_t length = (size_t)sprintf(uri, folder[0] == '/' ? "file://" : "file:///");
    for (const char *c = folder; *c; c++) {
        const char byte = *c == '\\' ? '/' : *c;
        length += (size_t)sprintf(uri + length, strchr(allowed, byte) ? "%c" : "%%%02X", (unsigned char)byte);
    }
    strcpy(uri + length, "/resources");
    return uri;
}

static void fmu_open_library(Fmu *f, const char *folder) {
    char path[4096], file[512];
    snprintf(file, sizeof file, FMU_FILE, f->identifier);
    snprintf(path, sizeof path, "%s/binaries/%s", folder, file);
#ifdef _WIN32
    wchar_t wide[4096];
    char reason[64];
    MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 4096);
    f->library = (void *)LoadLibraryW(wide);
    snprintf(reason, sizeof reason, "error %lu", (unsigned long)GetLastError());
#else
    f->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    const char *reason = f->library ? "" : dlerror();
#endif
    if (!f->library) ModelicaFormatError("%s: cannot load %s: %s", f->name, path, reason);
}

/* ---- instances */

/* A copy of values of one type. */
static FmuValues fmu_values(const int *reference, size_t n, const void *value, size_t size) {
    FmuValues values = {n, fmu_memory(n * sizeof(unsigned)), fmu_memory(n * size)};
    for (size_t i = 0; i < n; i++) values.reference[i] = (unsigned)reference[i];
    if (n) memcpy(values.value, value, n * size);
    return values;
}

static void fmu_find_functions(Fmu *f) {
    *(void **)&f->instantiate = fmu_symbol(f, "fmi2Instantiate");
    *(void **)&f->free_instance = fmu_symbol(f, "fmi2FreeInstance");
    *(void **)&f->setup = fmu_symbol(f, "fmi2SetupExperiment");
    *(void **)&f->enter_initialization = fmu_symbol(f, "fmi2EnterInitializationMode");
    *(void **)&f->exit_initialization = fmu_symbol(f, "fmi2ExitInitializationMode");
    *(void **)&f->enter_event = fmu_symbol(f, "fmi2EnterEventMode");
    *(void **)&f->new_discrete_states = fmu_symbol(f, "fmi2NewDiscreteStates");
    *(void **)&f->enter_continuous = fmu_symbol(f, "fmi2EnterContinuousTimeMode");
    *(void **)&f->set_real = fmu_symbol(f, "fmi2SetReal");
    *(void **)&f->set_integer = fmu_symbol(f, "fmi2SetInteger");
    *(void **)&f->set_boolean = fmu_symbol(f, "fmi2SetBoolean");
    *(void **)&f->set_string = fmu_symbol(f, "fmi2SetString");
    *(void **)&f->get_real = fmu_symbol(f, "fmi2GetReal");
    *(void **)&f->set_time = fmu_symbol(f, "fmi2SetTime");
    *(void **)&f->set_states = fmu_symbol(f, "fmi2SetContinuousStates");
    *(void **)&f->get_derivatives = fmu_symbol(f, "fmi2GetDerivatives");
}

/* name: of the block in the model, for messages */
static void *fmu_new(const char *name, const char *location, const char *identifier, const char *guid,
                     const int *real, size_t reals, const double *real_value,
                     const int *integer, size_t integers, const int *integer_value,
                     const int *boolean, size_t booleans, const int *boolean_value,
                     const int *string, size_t strings, const char **string_value) {
    Fmu *f = fmu_memory(sizeof *f);
    char *folder = fmu_folder(location);
    f->name = fmu_copy(name);
    f->identifier = fmu_copy(identifier);
    f->guid = fmu_copy(guid);
    f->location = fmu_location(folder);
    f->reals = fmu_values(real, reals, real_value, sizeof *real_value);
    f->integers = fmu_values(integer, integers, integer_value, sizeof *integer_value);
    f->booleans = fmu_values(boolean, booleans, boolean_value, sizeof *boolean_value);
    f->strings = fmu_values(string, strings, string_value, sizeof *string_value);
    for (size_t i = 0; i < strings; i++) ((char **)f->strings.value)[i] = fmu_copy(string_value[i]);
    f->callbacks.logger = fmu_log;
    f->callbacks.allocate = calloc;
    f->callbacks.release = free;
    fmu_open_library(f, folder);
    free(folder);
    fmu_find_functions(f);
    return f;
}

/* A new instance in initialization mode with the parameter values; it replaces one that failed. */
static void fmu_instantiate(Fmu *f, FmuInstance *instance, double time) {
    if (f->has_failed) ModelicaFormatError("%s: the FMU failed, see the messages before", f->name);
    if (instance->fmu) f->free_instance(instance->fmu);
    instance->fmu = f->instantiate(f->name, 0, f->guid, f->location, &f->callbacks, 0, 0);
    void *fmu = instance->fmu;
    if (!fmu) ModelicaFormatError("%s: fmi2Instantiate failed, see the messages before", f->name);
    fmu_check(f, f->setup(fmu, 0, 0.0, time, 0, 0.0), "fmi2SetupExperiment");
    const FmuValues *r = &f->reals, *i = &f->integers, *b = &f->booleans, *s = &f->strings;
    if (r->n) fmu_check(f, f->set_real(fmu, r->reference, r->n, r->value), "fmi2SetReal");
    if (i->n) fmu_check(f, f->set_integer(fmu, i->reference, i->n, i->value), "fmi2SetInteger");
    if (b->n) fmu_check(f, f->set_boolean(fmu, b->reference, b->n, b->value), "fmi2SetBoolean");
    if (s->n) fmu_check(f, f->set_string(fmu, s->reference, s->n, s->value), "fmi2SetString");
    fmu_check(f, f->enter_initialization(fmu), "fmi2EnterInitializationMode");
}

static void fmu_free(void *object) {
    Fmu *f = object;
    if (!f) return;
    if (f->initializing.fmu && !f->has_failed) f->free_instance(f->initializing.fmu);
    if (f->running.fmu && !f->has_failed) f->free_instance(f->running.fmu);
    for (size_t i = 0; i < f->strings.n; i++) free(((char **)f->strings.value)[i]);
    FmuValues *values[] = {&f->reals, &f->integers, &f->booleans, &f->strings};
    for (int i = 0; i < 4; i++) free(values[i]->reference), free(values[i]->value);
    free(f->name), free(f->identifier), free(f->guid), free(f->location), free(f);
}

/* ---- values */

static void fmu_set(Fmu *f, void *instance, const int *reference, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++) {
        const unsigned r = (unsigned)reference[i];
        fmu_check(f, f->set_real(instance, &r, 1, &value[i]), "fmi2SetReal");
    }
}

static void fmu_get(Fmu *f, void *instance, const int *reference, size_t n, double *value) {
    for (size_t i = 0; i < n; i++) {
        const unsigned r = (unsigned)reference[i];
        fmu_check(f, f->get_real(instance, &r, 1, &value[i]), "fmi2GetReal");
    }
}

/* Initial states. */
static void fmu_start(void *object, double time, const int *input, size_t nu, const double *u, const int *state,
                      size_t nx, double *x) {
    Fmu *f = object;
    if (!f->initializing.ready) fmu_instantiate(f, &f->initializing, time);
    f->initializing.ready = 1;
    fmu_set(f, f->initializing.fmu, input, nu, u);
    fmu_get(f, f->initializing.fmu, state, nx, x);
}

static double fmu_next_time(Fmu *f) {
    void *running = f->running.fmu;
    FmuEventInfo info;
    memset(&info, 0, sizeof info);
    do fmu_check(f, f->new_discrete_states(running, &info), "fmi2NewDiscreteStates");
    while (info.new_discrete_states_needed && !info.terminate_simulation);
    if (info.terminate_simulation) ModelicaFormatError("%s: the FMU requests the end of the simulation", f->name);
    if (info.values_changed) ModelicaFormatError("%s: states that change at an event are not supported", f->name);
    fmu_check(f, f->enter_continuous(running), "fmi2EnterContinuousTimeMode");
    return info.next_time_defined ? info.next_time : 1e60;
}

/* Set time, inputs and states of the running instance. */
static void fmu_set_point(Fmu *f, double time, const double *x, size_t nx, const int *input, size_t nu,
                          const double *u) {
    if (!f->running.ready) {
        fmu_instantiate(f, &f->running, time);
        fmu_set(f, f->running.fmu, input, nu, u);
        fmu_check(f, f->exit_initialization(f->running.fmu), "fmi2ExitInitializationMode");
        fmu_next_time(f);
        f->running.ready = 1;
    }
    fmu_check(f, f->set_time(f->running.fmu, time), "fmi2SetTime");
    fmu_set(f, f->running.fmu, input, nu, u);
    if (nx > 0) fmu_check(f, f->set_states(f->running.fmu, x, nx), "fmi2SetContinuousStates");
}

static void fmu_derivatives(void *object, double time, const double *x, size_t nx, const int *input, size_t nu,
                            const double *u, double *dx) {
    Fmu *f = object;
    fmu_set_point(f, time, x, nx, input, nu, u);
    fmu_check(f, f->get_derivatives(f->running.fmu, dx, nx), "fmi2GetDerivatives");
}

static void fmu_outputs(void *object, double time, const double *x, size_t nx, const int *input, size_t nu,
                        const double *u, const int *output, size_t ny, double *y) {
    Fmu *f = object;
    fmu_set_point(f, time, x, nx, input, nu, u);
    fmu_get(f, f->running.fmu, output, ny, y);
}

/* Time of the next time event, 1e60 if there is none. */
static double fmu_event(void *object, double time, const double *x, size_t nx, const int *input, size_t nu,
                        const double *u) {
    Fmu *f = object;
    fmu_set_point(f, time, x, nx, input, nu, u);
    fmu_check(f, f->enter_event(f->running.fmu), "fmi2EnterEventMode");
    return fmu_next_time(f);
}

#endif
