/* Inputs inside a communication step, as polynomials of time. */

#ifndef MOTION_H
#define MOTION_H

#include "model.h"

/* u_i(tau) = start[i] + sum over k of coefficients[i][k] (tau - origin)^(k+1), tau [s] from the start of the step. */
typedef struct {
    double start[ROOM(NU)];
    double coefficients[ROOM(NU)][3];
    int moving[ROOM(NU)]; /* indices of the `count` inputs that are not constant; only these have coefficients */
    int count;
    double origin;
} Motion;

LOCAL void motion_value(const Motion *motion, double tau, double *u);       /* values of all inputs at tau */
LOCAL void motion_update(const Motion *motion, double tau, double *u);      /* values of the moving inputs only */
LOCAL void motion_derivative(const Motion *motion, double tau, double *du); /* derivatives of all inputs */

#endif
