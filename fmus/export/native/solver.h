/* Integration of the model's states over one communication step. */

#ifndef SOLVER_H
#define SOLVER_H

#include "inputs.h"

/* Called after each accepted inner step, with the states at tau. It may change the polynomials of the inputs
   from there on. Returns where the integration ends: a value from tau to `length`. */
typedef struct {
    double (*call)(void *owner, double tau, double length);
    void *owner;
    int rodas_only; /* 1: no other method; work.k holds the stages of the step */
} StepCallback;

typedef struct {
    int left; /* inner steps before the method is tried again, after it failed */
    int next; /* length of the pause after its next failure */
} Pause;

/* The part of the solver's state that is kept between communication steps; zero at first. */
typedef struct {
    double step;  /* proposal for the next inner step [s], 0 if there is none */
    Pause cheap;  /* of the method that is tried first: Kutta's method or RODAS3 */
    Pause second; /* of the method of Cash and Karp */
} StepMemory;

/* Temporary arrays of the solver; they hold nothing between calls. */
typedef struct {
    double jac[ROOM(NJ)]; /* entries of df/dx that are not constant */
    double lu[ROOM(NLU)]; /* factors of I / (gamma h) - df/dx */
    double b[ROOM(NX)];   /* a second estimate of the error */
    double f0[ROOM(NX)], ft[ROOM(NX)];
    double x[ROOM(NX)]; /* states at a stage, finally at the end of the step */
    double error[ROOM(NX)];
    double u[ROOM(NU)], du[ROOM(NU)];
    double k[6][ROOM(NX)];
} Work;

typedef enum { SOLVED, NOT_FINITE, SINGULAR, STEP_TOO_SMALL, TOO_MANY_STEPS } Outcome;

typedef struct {
    Outcome outcome;
    double tau;  /* time reached, from the start of the communication step [s] */
    double step; /* last step tried [s] */
    int worst;   /* index of the state with the largest error, or of the derivative that is not finite */
} Report;

/* One step of size h from x at tau. Input: the inputs w->u, dx/dt in w->f0 and, for the implicit methods, w->lu and
   w->ft. Output: the new states w->x and their estimated error w->error. The explicit methods return 1 if they are
   stable in this step. `cash_karp` estimates the error of its solution of order 4, and that of order 3 in w->b. */
LOCAL void rodas(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                 double h, Work *w);
LOCAL void rodas3(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                  double h, Work *w);
LOCAL CONDITION kutta(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                      double h, Work *w);
LOCAL CONDITION cash_karp(const double *x, const double *p, const double *c, const InputPolynomials *inputs,
                          double tau, double h, Work *w);

/* Advances x by `length` [s] or until `callback` ends the integration. A step below `minimum_step` [s] is a
   failure. If the explicit methods are tried first, w->f0 must hold dx/dt at the start. */
LOCAL Report solve(double *x, const double *p, const double *c, const InputPolynomials *inputs, double length,
                   double tolerance, double minimum_step, const StepCallback *callback, StepMemory *memory,
                   Work *w);

#endif
