/* One instance of the model, independent of the FMI version: values, inputs over a step, integration, checks.
   No function here allocates memory, and instances share nothing. */

#ifndef CORE_H
#define CORE_H

#include <stdarg.h>
#include <stddef.h>

#include "model.h"
#include "solver.h"

/* A looser tolerance saves no time, and on badly scaled curves the states become wrong. */
#define LOOSEST_TOLERANCE 1e-3

/* Room for the text of a problem. */
enum { PROBLEM = 512 };

/* The outcome of a call and the severity of a message, with the values of FMI 2 and 3. */
typedef enum { OK, WARNING, DISCARD, ERROR } Status;

/* The complete state of an instance: the content of a saved FMU state. */
typedef struct {
    double time, start_time, stop_time; /* stop_time is infinite if it is not defined */
    double tolerance;
    StepMemory memory;
    double x[ROOM(NX)];        /* states */
    double p[ROOM(NP)];        /* parameters */
    double u[ROOM(NU)];        /* inputs at the current time */
    double last_set[ROOM(NU)]; /* inputs as last set: their values at the start of the next step */
    double end_derivative[ROOM(NU)];       /* time derivatives of the inputs at the end of the last step */
    double input_derivatives[ROOM(NU)][3]; /* derivatives of order 1 to 3 that were set for the next step */
    int has_derivatives[ROOM(NU)];         /* 1 if such derivatives were set */
    int had_derivatives[ROOM(NU)];         /* 1 if they were set for the last step */
    int beyond[ROOM(NWATCHED)];            /* 1 while a watched variable is above its limit, -1 while below */
    int warnings[ROOM(NWATCHED)];          /* that were logged of it */
    int initial;     /* 1 while fixed parameters may be set and the states are computed from start values */
    int start_fixed; /* 1 once the importer has the initial states: inputs no longer change them */
    int phase, type; /* state of the FMI state machine and kind of instance, see instance.h */
} State;

typedef struct Core {
    State s;
    /* Quantities that follow from `s`; computed on demand. */
    int c_valid, start_valid, z_valid, dx_valid, y_valid; /* z_valid: also of the outputs without inputs */
    int in_steps; /* 1 in co-simulation: z is known when derivatives are asked for */
    double c[ROOM(NC)], z[ROOM(NZ)], dx[ROOM(NX)], y[ROOM(NY)], require[ROOM(NREQUIRE)];
    double direction[ROOM(NUMBER_OF_VARIABLES)]; /* seed and result of a derivative, by value reference */
    InputPolynomials inputs;
    int inputs_changed; /* 1 if an input was set inside the step: `inputs` must be computed anew */
    struct {            /* inputs that move from step to step while their rate input stays 0 */
        double last[ROOM(NU)];
        double change[ROOM(NU)]; /* since the step before */
        int steps[ROOM(NU)];     /* so many in a row */
        double slope[ROOM(NU)], length; /* value of the rate input in the step before, and length of that [s] */
        int untrue[ROOM(NU)];           /* so many steps in a row did not change the input as its rate says */
        unsigned told; /* a bit for each Status with which it was told */
    } stepped;
    Work work;
    char problem[PROBLEM]; /* why the model could not compute its values, until it is reported; else empty */
    const char *call; /* name of the FMI function that runs, for messages */
    void (*report)(void *owner, Status kind, const char *text);
    /* If not null: called after each inner step, when the values are those of the current time and inputs may be
       set. Returns the time at which the step ends: the given end or earlier. */
    double (*intermediate_update)(void *owner, double end);
    void *owner;
} Core;

/* Reports the message "call: text" to the owner. */
SHARED void core_message(Core *core, Status kind, const char *format, ...);
LOCAL void core_message_of(Core *core, Status kind, const char *format, va_list arguments);

/* Sets all variables to their default values. */
LOCAL void core_reset(Core *core);

/* Invalidates all computed quantities; to be called after `s` was replaced. */
LOCAL void core_invalidate(Core *core);

/* Invalidates what was computed from the states; to be called after they were changed. */
LOCAL void core_invalidate_states(Core *core);

/* Gets the value of a variable; 0 and a message if it is not finite. */
LOCAL int core_get(Core *core, unsigned reference, double *value);

/* Checks a value before it is set; 0 and a message for NaN, for a value out of bounds, and for a variable that
   cannot be set. */
LOCAL int core_check_value(Core *core, unsigned reference, double value);
LOCAL void core_set(Core *core, unsigned reference, double value);

/* Time derivative of an input at the current time. */
LOCAL double core_input_derivative(const Core *core, int input);

/* Reports that the model could not compute its values, and returns 1; else 0. */
LOCAL int core_failed(Core *core);

/* Once in the log, and once as a warning when something else is reported, because they may be its cause: inputs that
   move while their rate input stays 0. */
LOCAL void core_tell_held_inputs(Core *core, Status kind);

/* Taylor polynomials of the inputs around `tau` [s] after the start of the step; u: their values there. */
LOCAL void core_plan_inputs(Core *core, const double *u, double tau);

/* Sets time and inputs to tau [s] after the start of the step, which was at `begin`. */
LOCAL void core_set_time(Core *core, double begin, double tau);

/* Checks that the requirements hold and that states and outputs are finite; else 0 and a message. */
LOCAL int core_check_state(Core *core);

/* Advances over `length` seconds, or until `intermediate_update` ends the step; 0 and a message if it fails. */
LOCAL int core_step(Core *core, double length);

/* ---- the model: equations.c, or python_model.c if its code is Python */

/* Loads what instances of this type need; null, or what is wrong, in PROBLEM bytes of `text`. */
SHARED const char *core_load(int type, const char *resources, char *text);

/* To be called after a message was logged. */
SHARED void core_reported(void);

SHARED void core_start(Core *core);       /* computes the initial states, before the initialisation is over */
LOCAL void core_derivatives(Core *core); /* computes dx */
LOCAL void core_outputs(Core *core);     /* computes y */
LOCAL void core_require(Core *core);     /* computes y, and the values that must be positive */

/* Directional derivatives of dx and y, from the directions of inputs and states; 0 and a message if there are none.
   With `starting`: of the initial states too, from the directions of parameters, inputs and start values. */
LOCAL int core_forward(Core *core, int starting);

/* Time [s] of the next time event; infinite if there is none. */
LOCAL double core_next_event(Core *core);

/* Moves states, inputs and time to the end of a step of `length` seconds, or to where `intermediate_update` ends it;
   0 and a message if that fails. */
LOCAL int core_advance(Core *core, double length);

/* ---- snapshot.c */

/* Saved states as bytes: a header that identifies the model, then the state. */
SHARED size_t snapshot_size(void);
LOCAL void snapshot_write(const State *state, char *bytes);
/* Reads a state; 0 and a message if it belongs to another model. With `verify`, damage is refused too. */
LOCAL int snapshot_read(Core *core, State *state, const char *bytes, size_t size, int verify);

/* Adds the checksum, by which damage of serialised bytes is detected when they are read. */
LOCAL void snapshot_add_checksum(char *bytes);

#endif
