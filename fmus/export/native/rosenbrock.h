/* Integrates the states of the model over one communication step. */

#ifndef ROSENBROCK_H
#define ROSENBROCK_H

#include "model.h"

/* Inputs over the step: u[i] = sum over k of coefficient[i][k] (tau - origin)^k, tau [s] since its start. */
typedef struct {
    double coefficient[ROOM(NU)][4];
    double origin;
    int moving; /* 0 when all inputs are constant */
} Motion;

/* Called after each accepted inner step, with the states at tau; it may change the motion of the inputs
   from there on, and returns where to stop: tau or later, `length` to go on to the end. */
typedef struct {
    double (*call)(void *owner, double tau, double length);
    void *owner;
} Between;

/* Scratch memory of the solver: nothing in it outlives a call. */
typedef struct {
    double jac[ROOM(NJ)]; /* what is not constant in df/dx */
    double lu[ROOM(NLU)]; /* factors of I / (gamma h) - df/dx */
    double b[ROOM(NX)];   /* right-hand side of a stage */
    double f0[ROOM(NX)], ft[ROOM(NX)];
    double x[ROOM(NX)]; /* states at a stage */
    double u[ROOM(NU)], du[ROOM(NU)];
    double k[6][ROOM(NX)];
} Work;

typedef enum { SOLVED, NOT_FINITE, SINGULAR, STEP_TOO_SMALL, TOO_MANY_STEPS } Outcome;

typedef struct {
    Outcome outcome;
    double tau;   /* how far it came [s] */
    double step;  /* last step tried [s] */
    int worst;    /* index of the state with the largest error, or of the derivative that is not finite */
    double error; /* its error over the tolerance */
} Report;

/* Value and slope of the inputs at tau. */
LOCAL void motion_value(const Motion *motion, double tau, double *u);
LOCAL void motion_slope(const Motion *motion, double tau, double *du);

/* Advances x by `length` [s], or up to where `between` stops it. `step` holds the proposal for the first
   inner step and returns the one for the next call; `smallest` is where the solver gives up. */
LOCAL Report rosenbrock(double *x, const double *p, const double *c, const Motion *motion, double length,
                        double tolerance, double smallest, const Between *between, double *step, Work *work);

#endif
