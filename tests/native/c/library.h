/* A shared library and the functions in it, on Linux and Windows. */

#ifndef LIBRARY_H
#define LIBRARY_H

#include <stdio.h>
#include <stdlib.h>

#ifdef _WIN32
#include <windows.h>
static void *library_open(const char *path) { return (void *)LoadLibraryA(path); }
static void *library_find(void *library, const char *name) {
    return (void *)(size_t)GetProcAddress((HMODULE)library, name);
}
static void library_close(void *library) { FreeLibrary((HMODULE)library); }
#else
#include <dlfcn.h>
static void *library_open(const char *path) { return dlopen(path, RTLD_NOW | RTLD_LOCAL); }
static void *library_find(void *library, const char *name) { return dlsym(library, name); }
static void library_close(void *library) { dlclose(library); }
#endif

/* Ends the program with a message if the library or the function is not there. */
static void *function(void *library, const char *name) {
    void *found = library ? library_find(library, name) : NULL;
    if (!found) {
        fprintf(stderr, "the library or its function %s cannot be loaded\n", name);
        exit(2);
    }
    return found;
}

#endif
