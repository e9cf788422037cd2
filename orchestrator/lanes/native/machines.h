/* A group of LANES machines, each in one lane of the vectors: the simulation of engine.h, and what machines.cpp adds.
   Machines meet at communication points; between two of them each one takes its own steps, so its results do not depend
   on the others. A machine that fails is left out from then on. */

#ifndef MACHINES_H
#define MACHINES_H

/* Further types of instructions; index: the component, or the number of wires in the operand */
enum { HOLD = 16, DRIVE, FOLLOW, OUTPUTS, DERIVATIVES, SLOPES };

typedef struct Wire { /* an input of a component and its source: indices in the memory of the group */
    double factor, offset;
    int32_t source, target, last_set, component;
    int32_t checked; /* outputs depend on the input, which a step may leave at another value */
} Wire;

typedef struct Signal {
    int32_t component, reference;
} Signal;

typedef struct Group {
    Simulation sim; /* the Real values are the memory of all instances */
    Instance *const *instances;
    const Model *const *models;
    const Wire *wires;     /* all connections */
    const Signal *signals; /* recorded */
    double *const *rows;   /* of each signal: an array of shape (machines, points) */
    Failure *failures;
    Mask *changed;  /* by component: machines in which an input has changed since its outputs were computed */
    int64_t machine, machines, points, row; /* number of the first machine; machines in use; shape of the arrays */
    int64_t every;                          /* communication points from one row to the next */
    int32_t wire_count, signal_count;
    int32_t stop; /* set by another thread */
} Group;

#endif
