/* Integrates the states of the model over one communication step. */

#ifndef SOLVER_H
#define SOLVER_H

#include "motion.h"

/* Called after each accepted inner step, with the states at tau; it may change the motion of the inputs
   from there on, and returns where to stop: tau or later, `length` to go on to the end. */
typedef struct {
    double (*call)(void *owner, double tau, double length);
    void *owner;
} Between;

/* What the solver remembers from step to step; all zero at first. */
typedef struct {
    double step;  /* proposal for the next inner step [s], 0 if none */
    int rest;     /* inner steps for which the explicit method rests, because it failed */
    int patience; /* how many it rests when it fails the next time */
} Pace;

/* Scratch memory of the solver: nothing in it outlives a call. */
typedef struct {
    double jac[ROOM(NJ)]; /* what is not constant in df/dx */
    double lu[ROOM(NLU)]; /* factors of I / (gamma h) - df/dx */
    double b[ROOM(NX)];   /* right-hand side of a stage */
    double f0[ROOM(NX)], ft[ROOM(NX)];
    double x[ROOM(NX)]; /* states at a stage, in the end at the end of the step */
    double error[ROOM(NX)];
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

/* One step of size h from x at tau, where w->u are the inputs, w->f0 is dx/dt and, for the implicit method,
   w->lu and w->ft are made: new states in w->x, estimate of their error in w->error. The explicit method tells
   whether it is stable there. */
LOCAL void rosenbrock(const double *x, const double *p, const double *c, const Motion *motion, double tau,
                      double h, Work *w);
LOCAL int kutta(const double *x, const double *p, const double *c, const Motion *motion, double tau,
                double h, Work *w);

/* Advances x by `length` [s], or up to where `between` stops it; `smallest` is where it gives up. */
LOCAL Report solve(double *x, const double *p, const double *c, const Motion *motion, double length,
                   double tolerance, double smallest, const Between *between, Pace *pace, Work *work);

#endif
