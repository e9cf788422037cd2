/* What the library of a model (model.cpp) and the library that couples models (group.cpp) share: a group of LANES
   machines, each in one lane of the vectors. Machines meet at communication points; between two of them each one takes
   its own steps, so its results do not depend on the others. A machine that fails is left out from then on. */

#ifndef GROUP_H
#define GROUP_H

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

enum { FOLLOWED = 3, DRIVEN = -1, COURSE_VECTORS = 13, PACE_VECTORS = 6 }; /* in a Course, in a Pace */
enum { COPY, OUTPUTS, DERIVATIVES }; /* types of instructions */

typedef struct Connection { /* an output of a component that feeds an input of another */
    int32_t source, reference, target, input;
    double factor, offset;
    int32_t checked, unused; /* checked: outputs of the target depend on the input, which a step may leave at another value */
} Connection;

typedef struct Input { /* an input that varies inside a communication step, or that is watched, as CouplingInput of engine.h */
    Connection from; /* source DRIVEN: by the scenario */
    double nominal;
    int32_t requested_degree, order, autonomous, in_order; /* in_order: the source steps before the target */
} Input;

typedef struct Instruction {
    int32_t type, index, count; /* COPY: connections; others: of a component, if its inputs have changed */
} Instruction;

typedef struct Drive { /* a column of the scenario that drives an input */
    int32_t column, component, input, coupling_input;
    int32_t rate, unused; /* rate: the input for its slope; negative: none */
    double factor, offset;
} Drive;

typedef struct Signal {
    int32_t component, reference;
} Signal;

typedef struct Plan { /* what all groups of a system have in common */
    const Model *const *models;
    const Input *inputs;
    const Connection *connections, *held; /* held: set to the newest value before the target steps */
    const Instruction *exchange;
    const int32_t *order, *first_input, *first_held; /* first_...: by component, and the end */
    const int32_t *repeated, *needs_slopes;          /* by component */
    const Drive *drives;
    const double *time, *base, *slopes, *anchor; /* of the scenario, see scenario.c */
    const Signal *signals;                       /* recorded */
    const double *events;
    int64_t samples, width, steps, every, event_count;
    double start, step, pass_tolerance, guard;
    int32_t component_count, input_count, connection_count, exchange_count, drive_count, signal_count;
    int32_t degree, sequential, passes, initial_rounds, adaptive;
} Plan;

typedef struct { /* one input in a group, as CouplingInput of engine.h */
    Lanes value, slope, value_end, slope_end, slope_before, chord_before, expected, weight, scale, c[FOLLOWED + 1];
} Course;

typedef struct { /* of each machine */
    Lanes t, length;    /* time, and length of the last step; 0: none [s] */
    Mask alive, moving; /* has not failed; takes the present step */
    int64_t event[LANES], interval[LANES]; /* the next event; the interval of the scenario */
} Pace;

typedef struct Group {
    Instance *const *instances;
    Course *courses;
    Pace *pace;
    const double *commands; /* in place of the columns of the scenario, for each machine, held; NULL: none */
    double *const *rows;    /* recorded signals: each an array of shape (machines, points) */
    Failure *failures;
    Mask *changed; /* by component: machines in which an input has changed since its outputs were computed */
    int64_t machine, machines, points, row; /* number of the first machine; machines in use; shape of the arrays */
    int64_t done;
    void *step_size;      /* StepSize of engine.h, one per lane */
    int32_t stop, unused; /* stop: set by another thread */
} Group;

#endif
