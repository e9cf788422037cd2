/* What the library of a model (model.cpp) and the library that couples models (machines.cpp) share: the model of LANES
   machines, each in one lane of the vectors. */

#ifndef INSTANCE_H
#define INSTANCE_H

#include <stdint.h>

#include "lanes.h"

enum { NO_FAILURE, DERIVATIVE_NOT_FINITE, TOLERANCE_NOT_REACHED, SINGULAR_SYSTEM, TOO_MANY_INNER_STEPS,
       REQUIREMENT_VIOLATED, VALUE_NOT_FINITE }; /* kinds of failures */

typedef struct Failure { /* why a machine failed */
    int32_t kind, component;
    int32_t index;   /* value reference; REQUIREMENT_VIOLATED: number of the requirement */
    int32_t unused;
    double value;    /* of the variable or of the requirement */
    double derivative, step;
    double time;     /* [s] from the beginning of the communication step, then of the run */
} Failure;

/* The part of an instance that is not private to its model; the arrays have one element per value reference, input or
   state of the model. */
typedef struct Instance {
    Lanes *values;            /* parameters, inputs, states, derivatives, outputs, by value reference */
    Lanes *start;             /* start values of the states */
    Lanes *slopes;            /* time derivatives of states and outputs, by value reference */
    Lanes *last_set;          /* inputs as last set: their values at the beginning of the next step */
    Lanes *derivatives;       /* time derivatives of inputs of order 1 to 3 for the next step */
    int32_t *has_derivatives; /* 1 if they are set */
    Mask *alive;              /* machines that have not failed */
    Failure *failures;        /* one per lane */
    double tolerance;
    int64_t inner_steps;
} Instance;

typedef Instance *Create(void *memory, double tolerance);
typedef void Action(Instance *);
typedef void Stepping(Instance *, Lanes length, Mask machines);
typedef void MaskedAction(Instance *, Mask machines);
typedef void Check(Instance *, Lanes time);
typedef void Adoption(Instance *, const Instance *from, Mask machines);
typedef const char *Description(int32_t);

typedef struct Model { /* the functions of a model */
    int64_t size; /* of an instance [bytes] */
    int32_t lanes, parameters, inputs, states, outputs, requirements;
    Create *create;           /* an instance with default values for all machines */
    Action *prepare;          /* to be called when parameters have changed */
    Action *start;            /* computes the initial states from start values, inputs and parameters */
    Action *outputs_now;
    MaskedAction *outputs_again; /* the outputs of machines in which only inputs have changed since */
    Action *derivatives_now;
    Action *slopes_now;       /* of states and outputs, from the derivatives of the inputs */
    Action *save;
    MaskedAction *restore;
    Stepping *step;           /* over a length [s]; computes the outputs, and checks them */
    Check *check;             /* outputs and requirements; machines that violate them fail, at a time [s] */
    Adoption *adopt;          /* replaces machines by those of another instance */
    Description *requirement; /* by its number */
} Model;

#endif
