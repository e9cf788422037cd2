/* Inputs inside a communication step, as polynomials of time. */

#ifndef INPUTS_H
#define INPUTS_H

#include "model.h"

/* u_i(tau) = start[i] + sum over k of coefficients[i][k] (tau - origin)^(k+1), tau [s] from the start of the step. */
typedef struct {
    double start[ROOM(NU)];
    double coefficients[ROOM(NU)][3];
    int moving[ROOM(NU)]; /* indices of the `count` inputs that are not constant; only these have coefficients */
    int count;
    double origin;
} InputPolynomials;

LOCAL void inputs_value(const InputPolynomials *inputs, double tau, double *u);       /* all values at tau */
LOCAL void inputs_update(const InputPolynomials *inputs, double tau, double *u);      /* those that move only */
LOCAL void inputs_derivative(const InputPolynomials *inputs, double tau, double *du); /* all derivatives */

#endif
