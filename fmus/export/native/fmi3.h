/* FMI 3.0: declarations that the fmi3*.c files share. */

#ifndef FMI3_H
#define FMI3_H

#include "fmi3Functions.h"
#include "instance.h"

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi3Status)(allowed(instance, __func__, mask) ? (body) : ERROR)

/* All variables are scalars: 1 if there are as many values as references, else 0 and a message. */
LOCAL int scalars(Instance *self, size_t n, size_t values);

/* ---- adjoint.c: derivatives along weights (wdx, wy) of dx and y; at the start also along wx0, weights of x0 */

SHARED void model_reverse(const double *x, const double *u, const double *p, const double *c, const double *wdx,
                          const double *wy, double *wx, double *wu);
SHARED void model_start_reverse(const double *x, const double *u, const double *p, const double *c,
                                const double *wx0, const double *wdx, const double *wy, double *wx, double *wu,
                                double *wp);

/* Called by the core after each inner step: the importer reads values, sets inputs and may end the step. */
LOCAL double intermediate_update(void *owner, double end);

#endif
