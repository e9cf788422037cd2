/* Lengths of the generated sens.c and its vectors of sensitivity columns. */

#ifndef SENS_H
#define SENS_H

#include <math.h>

#include "model.h"
#include "sens_lengths.h"

#pragma clang fp contract(fast)

typedef double Columns __attribute__((ext_vector_type(WIDTH)));

#endif
