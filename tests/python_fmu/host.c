/* A program without Python that runs an FMU twice, loading its library anew: host LIBRARY RESOURCES GUID. */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "fmi2FunctionTypes.h"

static void log_line(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                     fmi2String category, fmi2String message, ...) {
    (void)environment, (void)name;
    printf("log %d %s: ", (int)status, category);
    va_list arguments;
    va_start(arguments, message);
    vprintf(message, arguments);
    va_end(arguments);
    printf("\n");
}

static void *function(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) printf("no %s\n", name);
    return found;
}

static int once(const char *path, const char *resources, const char *guid) {
    const fmi2CallbackFunctions callbacks = {log_line, 0, 0, 0, 0};
    void *library = dlopen(path, RTLD_NOW);
    if (!library) {
        printf("not loaded: %s\n", dlerror());
        return 1;
    }
    fmi2InstantiateTYPE *instantiate;
    fmi2FreeInstanceTYPE *release;
    fmi2SetupExperimentTYPE *setup;
    fmi2EnterInitializationModeTYPE *enter, *leave;
    fmi2DoStepTYPE *step;
    fmi2GetRealTYPE *get;
    *(void **)&instantiate = function(library, "fmi2Instantiate");
    *(void **)&release = function(library, "fmi2FreeInstance");
    *(void **)&setup = function(library, "fmi2SetupExperiment");
    *(void **)&enter = function(library, "fmi2EnterInitializationMode");
    *(void **)&leave = function(library, "fmi2ExitInitializationMode");
    *(void **)&step = function(library, "fmi2DoStep");
    *(void **)&get = function(library, "fmi2GetReal");
    fmi2Component c = instantiate("one", fmi2CoSimulation, guid, resources, &callbacks, 0, 0);
    if (!c) return 1;
    const fmi2ValueReference first = 0;
    double value = 0;
    int failed = setup(c, 0, 0, 0, 0, 0) || enter(c) || leave(c) || step(c, 0.0, 1e-3, 1) || get(c, &first, 1, &value);
    printf("value %.17g\n", value);
    release(c);
    dlclose(library);
    return failed;
}

int main(int argc, char **argv) {
    if (argc < 4) return 2;
    const int failed = once(argv[1], argv[2], argv[3]) || once(argv[1], argv[2], argv[3]);
    printf(failed ? "failed\n" : "done\n");
    return failed;
}
