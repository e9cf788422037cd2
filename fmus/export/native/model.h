/* What a generated model provides: its sizes, its variables and its equations

       dx/dt = f(x, u, p)        y = g(x, u, p)        x(0) = s(x_start, u, p)

   sizes.h, model.c and adjoint.c are generated; everything else is the same for every model. model.c also
   defines the tables model_variables (by value reference), model_watched (value references of what warn_above
   watches) and model_statements (what must stay positive, in words; values come from model_observe).
   Vectors: x states, u inputs, p parameters, c quantities that depend on p alone. */

#ifndef MODEL_H
#define MODEL_H

#include "sizes.h"

/* All files are compiled as one (<model>_fmu.c), so that nothing but the FMI functions has a name outside. */
#define LOCAL static

/* Length of an array for n numbers: C99 has no arrays of length zero. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* Value references are consecutive: parameters, inputs, states, derivatives, outputs. */
enum {
    FIRST_PARAMETER = 0,
    FIRST_INPUT = FIRST_PARAMETER + NP,
    FIRST_STATE = FIRST_INPUT + NU,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_OUTPUT = FIRST_DERIVATIVE + NX,
    NUMBER_OF_VARIABLES = FIRST_OUTPUT + NY
};

typedef enum { FIXED, TUNABLE, INPUT, STATE, CALCULATED_STATE, DERIVATIVE, OUTPUT } Kind;

typedef struct {
    const char *name;
    const char *unit;
    Kind kind;
    double start;
    double minimum, maximum; /* infinite where there is no bound */
    double nominal;          /* magnitude, for scaling */
    double absolute;         /* states: absolute tolerance over the relative one */
    double warn_above;       /* infinite where nothing is watched */
    int rate;                /* inputs: index of the input with the time derivative, or -1 */
} Variable;

/* c from p */
LOCAL void model_prepare(const double *p, double *c);

/* x0: states at the start from their start values x */
LOCAL void model_start(const double *x, const double *u, const double *p, const double *c, double *x0);

/* dx = f(x, u, p) */
LOCAL void model_dynamics(const double *x, const double *u, const double *p, const double *c, double *dx);

/* dx as above, jac = what is not constant in df/dx, ft = df/du du */
LOCAL void model_jacobian(const double *x, const double *u, const double *p, const double *c,
                          const double *du, double *dx, double *jac, double *ft);

/* factors lu of I * diagonal - df/dx; trust is 0 where they are not accurate: try a larger diagonal */
LOCAL void model_factorise(const double *diagonal, const double *jac, double *lu, double *trust);

/* k from (I * diagonal - df/dx) k = b */
LOCAL void model_solve(const double *lu, const double *b, double *k);

/* y = g(x, u, p) and the values that must be positive */
LOCAL void model_observe(const double *x, const double *u, const double *p, const double *c, double *y,
                         double *require);

/* wait [s] until the next known instant at which a rate jumps; infinite if there is none */
LOCAL void model_corner(const double *x, const double *u, const double *p, const double *c, double *wait);

/* directional derivatives of f and g along (vx, vu) */
LOCAL void model_forward(const double *x, const double *u, const double *p, const double *c, const double *vx,
                         const double *vu, double *vdx, double *vy);

/* directional derivatives of s and of f and g at the start along (vx, vu, vp); x are the states at the start */
LOCAL void model_start_forward(const double *x, const double *u, const double *p, const double *c,
                               const double *vx, const double *vu, const double *vp, double *vx0,
                               double *vdx0, double *vy0);

#endif
