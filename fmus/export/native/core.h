/* One instance of the model, whatever the FMI version: values, inputs over a step, integration, checks.
   No function here allocates memory, and nothing is shared between instances. */

#ifndef CORE_H
#define CORE_H

#include <stdarg.h>
#include <stddef.h>

#include "model.h"
#include "solver.h"

/* A looser one gains no time, and states on badly scaled curves get lost at it. */
#define LOOSEST_TOLERANCE 1e-3

/* The outcome of a call, and the kind of a message; numbered as in FMI 2 and 3. */
typedef enum { OK, WARNING, DISCARD, ERROR } Status;

/* Everything that the future of an instance depends on: what a saved state holds. */
typedef struct {
    double time, start_time, stop_time; /* stop_time is infinite when not given */
    double tolerance;
    Pace pace;                /* of the solver */
    double x[ROOM(NX)];       /* states */
    double p[ROOM(NP)];       /* parameters */
    double u[ROOM(NU)];       /* inputs at the current time */
    double set[ROOM(NU)];     /* inputs as last set: where the next step starts */
    double slope[ROOM(NU)];   /* time derivative of the inputs at the end of the last step */
    double given[ROOM(NU)][3]; /* input derivatives of order 1 to 3 set for the next step */
    int is_given[ROOM(NU)];
    int was_given[ROOM(NU)]; /* 1 if the last step followed such derivatives */
    int warned[ROOM(NUMBER_OF_VARIABLES)]; /* 1 while a watched input or output is above its limit */
    int initial;          /* 1 as long as fixed parameters may be set, and states follow from the start values */
    int settled;          /* 1 once the caller has the states at the start: inputs no longer change them */
    int phase, type;      /* of the FMI state machine, see instance.h */
} State;

typedef struct Core {
    State s;
    /* What follows from `s`; computed when needed. */
    int c_valid, start_valid, dx_valid, y_valid;
    double c[ROOM(NC)], dx[ROOM(NX)], y[ROOM(NY)], require[ROOM(NREQUIRE)];
    double direction[ROOM(NUMBER_OF_VARIABLES)]; /* of each variable, by value reference */
    Motion motion;
    int touched; /* an input was set: the motion of the inputs has to be planned anew */
    Work work;
    const char *call; /* name of the interface function at work, for messages */
    void (*report)(void *owner, Status kind, const char *text);
    /* Called inside a step, with the values at the current time, if not null: inputs may be set. Returns the time
       at which to stop, the given end or earlier. */
    double (*pause)(void *owner, double end);
    void *owner;
} Core;

/* A message "call: text" to the owner. */
LOCAL void core_message(Core *core, Status kind, const char *format, ...);
LOCAL void core_message_of(Core *core, Status kind, const char *format, va_list arguments);

/* Default values of all variables. */
LOCAL void core_reset(Core *core);

/* Forgets everything computed: after the saved part `s` was replaced from outside. */
LOCAL void core_changed(Core *core);

/* Value of a variable; 0 if the computation gives no finite number (a message tells). */
LOCAL int core_get(Core *core, unsigned reference, double *value);

/* Would this value be accepted? Not for NaN, values out of bounds, or a variable that cannot be set. */
LOCAL int core_check(Core *core, unsigned reference, double value);
LOCAL void core_set(Core *core, unsigned reference, double value);

/* Time derivative of the inputs at the current time. */
LOCAL double core_input_slope(const Core *core, int input);

LOCAL void core_start(Core *core);       /* computes the states that follow from others at the start */
LOCAL void core_derivatives(Core *core); /* makes dx valid */
LOCAL void core_outputs(Core *core);     /* makes y and require valid */

/* Requirements hold and everything is finite; else a message and 0. */
LOCAL int core_sound(Core *core);

/* From the directions of inputs and states those of derivatives and outputs. With `starting` from those of
   parameters, inputs and start values, through the start equations, also those of the states. */
LOCAL void core_forward(Core *core, int starting);

/* From the current time over `length` seconds, or until `pause` stops it; 0 and a message when it fails. */
LOCAL int core_step(Core *core, double length);

/* Saved states as bytes: a header that identifies the model, then the state. */
LOCAL size_t snapshot_size(void);
LOCAL void snapshot_write(const State *state, char *bytes);
/* `sealed`: the bytes come from outside and must carry their check sum. */
LOCAL int snapshot_read(Core *core, State *state, const char *bytes, size_t size, int sealed);

/* Before the bytes leave the process: adds a check sum, by which damage is noticed when they are read. */
LOCAL void snapshot_seal(char *bytes);

#endif
