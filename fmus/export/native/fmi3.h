/* FMI 3.0: declarations that the fmi3*.c files share. */

#ifndef FMI3_H
#define FMI3_H

#include "fmi3Functions.h"
#include "instance.h"

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi3Status)(allowed(instance, __func__, mask) ? (body) : ERROR)

/* All variables are scalars: 1 if there are as many values as references, else 0 and a message. */
LOCAL int scalars(Instance *self, size_t n, size_t values);

/* Called by the core after each inner step: the importer reads values, sets inputs and may end the step. */
LOCAL double intermediate_update(void *owner, double end);

#endif
