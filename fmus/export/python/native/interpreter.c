#include "interpreter.h"

#include <stdlib.h>
#include <string.h>

#define MISSING                                                                                            \
    "this FMU needs Python, which is neither in this program nor found by name; set FMU_PYTHON to the path " \
    "of a " PYTHON_LIBRARY

#ifdef _WIN32
/* without what has the names of our constants */
#define WIN32_LEAN_AND_MEAN
#define NOGDI
#define NOUSER
#include <windows.h>

#define PYTHON_LIBRARY "python3xx.dll"
static const char *const NAMES[] = {"python314.dll", "python313.dll", "python312.dll", "python311.dll"};

static void *loaded_library(const char *name) { return (void *)GetModuleHandleA(name); }
static void *load_library(const char *name) { return (void *)LoadLibraryA(name); }
static void *symbol(void *library, const char *name) {
    const FARPROC function = GetProcAddress((HMODULE)library, name);
    void *address;
    memcpy(&address, &function, sizeof address);
    return address;
}
#else
#include <dlfcn.h>

#ifdef __APPLE__
#define PYTHON_LIBRARY "libpython3.x.dylib"
static const char *const NAMES[] = {"libpython3.14.dylib", "libpython3.13.dylib", "libpython3.12.dylib",
                                    "libpython3.11.dylib"};
#else
#define PYTHON_LIBRARY "libpython3.x.so"
static const char *const NAMES[] = {"libpython3.14.so.1.0", "libpython3.13.so.1.0", "libpython3.12.so.1.0",
                                    "libpython3.11.so.1.0"};
#endif

static void *symbol(void *library, const char *name) { return dlsym(library, name); }
/* The program itself if it contains Python or has loaded it globally; else a loaded library by name. */
static void *loaded_library(const char *name) {
    void *all = dlopen(NULL, RTLD_NOW);
    if (all && symbol(all, "Py_IsInitialized")) return all;
    return dlopen(name, RTLD_NOW | RTLD_NOLOAD);
}
/* Loaded globally: extension modules look up Python's functions there. */
static void *load_library(const char *name) { return dlopen(name, RTLD_NOW | RTLD_GLOBAL); }
#endif

static void *find_library(void) {
    const size_t n = sizeof NAMES / sizeof *NAMES;
    const char *chosen = getenv("FMU_PYTHON");
    void *library = NULL;
    for (size_t i = 0; i < n && !library; i++) library = loaded_library(NAMES[i]);
    if (!library && chosen) library = load_library(chosen);
    for (size_t i = 0; i < n && !library; i++) library = load_library(NAMES[i]);
    return library;
}

static const char *interpreter_start(void) {
    void *library = find_library();
    if (!library) return MISSING;
#define FIND(type, name, arguments)                                                  \
    {                                                                                \
        void *address = symbol(library, #name);                                      \
        if (!address) return "the Python of this program has no function " #name;    \
        memcpy(&py.name, &address, sizeof address);                                  \
    }
    PYTHON(FIND)
#undef FIND
    py.PyExc_KeyboardInterrupt = symbol(library, "PyExc_KeyboardInterrupt");
    if (!py.PyExc_KeyboardInterrupt) return "the Python of this program has no PyExc_KeyboardInterrupt";
    if (!py.Py_IsInitialized()) {
        /* Python is never finalised: packages such as NumPy cannot be initialised twice in a process. */
        py.Py_InitializeEx(0);
        py.PyEval_SaveThread();
    }
    return NULL;
}
