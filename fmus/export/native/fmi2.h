/* FMI 2.0: the macro that the fmi2*.c files share. */

#ifndef FMI2_H
#define FMI2_H

#include "fmi2Functions.h"
#include "instance.h"

/* The body of a function that is allowed in the states `mask`. */
#define CALL(mask, body) return (fmi2Status)(allowed(c, __func__, mask) ? (body) : ERROR)

#endif
