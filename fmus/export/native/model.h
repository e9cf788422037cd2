/* The interface between generated and hand-written code: sizes, variables and equations of a model

       dx/dt = f(x, u, p)        y = g(x, u, p)        x(0) = s(x_start, u, p)

   sizes.h, model.c, initial.c, start.h and start.c are generated; all other files are the same for every model.
   model.c also defines three tables: model_variables (by value reference), model_watched (the variables with a
   warning limit) and model_statements (descriptions of the requirements; model_require computes
   the values that must be positive). start.c holds all that another set of parameter values changes.
   Vectors: x states, u inputs, p parameters, c quantities that depend on p alone, z on x and p alone. */

#ifndef MODEL_H
#define MODEL_H

#include <math.h>

#include "opening_curve.h"
#include "sizes.h"

/* <model>_fmu.c includes all other files, so all functions except those of FMI can be static. `harvester build`
   compiles some parts separately (IN_PARTS), to use them for both FMI versions or with other start values: what
   such a part needs of another is SHARED, not LOCAL. */
#define LOCAL static
#ifdef IN_PARTS
#define SHARED
#else
#define SHARED static
#endif

/* The value if the condition holds, else 0. A function, because code for several machines at once, with vectors in
   place of double, cannot branch. */
static inline double where(int condition, double value) { return condition ? value : 0.0; }

/* exp(a) of a value that is `least` or more, and most often `least`, whose exponential is known. */
static inline double exp_above(double a, double least, double known) { return a == least ? known : exp(a); }

/* Type of a comparison of doubles; another one if vectors take their place. */
#ifndef CONDITION
#define CONDITION int
#endif

/* Length of an array for n values: C99 has no arrays of length zero. */
#define ROOM(n) ((n) > 0 ? (n) : 1)

/* Value references are consecutive: parameters, inputs, states, derivatives, outputs. */
enum {
    FIRST_PARAMETER = 0,
    FIRST_INPUT = FIRST_PARAMETER + NP,
    FIRST_STATE = FIRST_INPUT + NU,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_OUTPUT = FIRST_DERIVATIVE + NDX,
    NUMBER_OF_VARIABLES = FIRST_OUTPUT + NY
};

typedef enum { FIXED, TUNABLE, INPUT, STATE, CALCULATED_STATE, DERIVATIVE, OUTPUT } Kind;

typedef struct {
    const char *name;
    const char *unit;
    Kind kind;
    double minimum, maximum; /* infinite if there is no bound */
    double nominal;
    double absolute_scale;   /* states: absolute tolerance / relative tolerance */
    int rate;                /* inputs: index of the input that is the time derivative of this one, or -1 */
    int held;                /* inputs: whether c depends on it; then it is constant in a step */
} Variable;

/* A variable with a warning limit, and the parts of the warning before and after its value. */
typedef struct {
    int reference;
    double above;            /* magnitude above which a warning is logged; infinite if there is no limit */
    double below;            /* value below which a warning is logged; -infinite if there is no limit */
    double factor, offset;   /* to the unit of readers */
    const char *meaning[2];  /* of a value above its limit, and of one below */
    const char *limit[2];    /* unit, limit and what follows from it */
} Watched;

#ifdef IN_PARTS
extern const Variable model_variables[ROOM(NUMBER_OF_VARIABLES)];
extern const double model_start_values[ROOM(NUMBER_OF_VARIABLES)];
extern const char model_guid[48], model_other_guid[144];
#endif

/* Computes c from p and the inputs that are held. */
LOCAL void model_prepare(const double *u, const double *p, double *c);

/* Computes the initial states x0 from the start values x. */
SHARED void model_start(const double *x, const double *u, const double *p, const double *c, double *x0);

/* Computes dx = f(x, u, p). */
LOCAL void model_dynamics(const double *x, const double *u, const double *p, const double *c, double *dx);

/* Computes dx as above, jac = the entries of df/dx that are not constant, ft = df/du du. */
LOCAL void model_jacobian(const double *x, const double *u, const double *p, const double *c,
                          const double *du, double *dx, double *jac, double *ft);

/* Computes the factors lu of I * diagonal - df/dx. If they are inaccurate, `accurate` is 0: a larger diagonal
   helps. */
LOCAL void model_factorise(const double *diagonal, const double *jac, double *lu, double *accurate);

/* Solves (I * diagonal - df/dx) k = b. */
LOCAL void model_solve(const double *lu, const double *b, double *k);

/* Computes the outputs y that do not depend on the inputs, and z: quantities that depend on x and p alone. */
LOCAL void model_observe_states(const double *x, const double *p, const double *c, double *y, double *z);

/* Computes the other outputs of y = g(x, u, p). */
LOCAL void model_observe(const double *x, const double *u, const double *p, const double *c, const double *z,
                         double *y);

/* Computes dx as model_dynamics does, in less time if z is known; the rounding errors differ. */
LOCAL void model_derivatives(const double *x, const double *u, const double *p, const double *c, const double *z,
                             double *dx);

/* Computes the values that must be positive. */
LOCAL void model_require(const double *x, const double *u, const double *p, const double *c, const double *z,
                         double *require);

/* Computes the delay [s] until the next time event, at which a derivative jumps; infinite if there is none. */
LOCAL void model_time_event(const double *x, const double *u, const double *p, const double *c, double *delay);

/* Directional derivatives of f and g along (vx, vu). */
LOCAL void model_forward(const double *x, const double *u, const double *p, const double *c, const double *vx,
                         const double *vu, double *vdx, double *vy);

/* Directional derivatives along (vx, vu, vp) of s, and of f and g at the initial states x. */
SHARED void model_start_forward(const double *x, const double *u, const double *p, const double *c,
                                const double *vx, const double *vu, const double *vp, double *vx0,
                                double *vdx0, double *vy0);

#endif
