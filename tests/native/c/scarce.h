/* For the sources of an FMU that come next: once in a while there is no memory. */

#ifndef SCARCE_H
#define SCARCE_H

#include <stdlib.h>

static unsigned allocations;

static void *scarce_malloc(size_t size) { return ++allocations % 89 ? malloc(size) : NULL; }
static void *scarce_calloc(size_t n, size_t size) { return ++allocations % 89 ? calloc(n, size) : NULL; }

#define malloc scarce_malloc
#define calloc scarce_calloc

#endif
