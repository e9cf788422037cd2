/* What FMI 2 and FMI 3 share: an instance, its state machine, its log, and what the functions do.
   fmi2.c and fmi3.c translate names and types. */

#ifndef INSTANCE_H
#define INSTANCE_H

#include "core.h"

/* States of the FMI state machine; masks of them say where a function may be called, and for which
   kind of instance if not for both. */
enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    EVENT_MODE = 4,
    CONTINUOUS_TIME = 8,
    STEP_MODE = 16, /* between the steps of co-simulation */
    INSIDE_STEP = 32,
    STEP_FAILED = 64,
    TERMINATED = 128,
    SIMULATING = EVENT_MODE | CONTINUOUS_TIME | STEP_MODE,
    ANY = 255,
    OUTSIDE = ANY & ~INSIDE_STEP,
    MODEL_EXCHANGE = 256,
    CO_SIMULATION = 512,
    READABLE = MODEL_EXCHANGE | INITIALIZATION | EVENT_MODE | CONTINUOUS_TIME | TERMINATED /* by a solver */
};

typedef struct Instance {
    Core core;
    void (*write)(const struct Instance *self, Status kind, const char *text); /* to the caller's log */
    void (*logger)(void); /* the caller's function, of the type of the FMI version */
    void (*update)(void); /* the same for values inside a step; may be null */
    void *environment;
    int events;       /* co-simulation enters event mode */
    int early_return; /* a step may end early */
    unsigned log;     /* mask of kinds of messages that are logged */
    int has_time;     /* the time is a variable, the one after the last */
    struct {          /* model exchange: does the caller hold the inputs over the steps of its solver? */
        double at[ROOM(NU)]; /* the inputs after their last change */
        int evaluated;       /* derivatives were computed since then */
        int moved;           /* with other inputs */
        int restart;         /* the next update at an event makes the solver start anew */
    } held;
    char name[];
} Instance;

/* ---- instance.c */

/* What is wrong with the arguments of an instantiation, or null. */
LOCAL const char *instance_problem(const char *name, const char *guid);
/* A new instance, or null when there is no memory; `type` is MODEL_EXCHANGE or CO_SIMULATION. */
LOCAL Instance *instance_create(const char *name, int type, int logging);
/* The category of messages of one kind. */
LOCAL const char *instance_category(Status kind);
/* 1 if the function may be called now; else 0 and an error message. */
LOCAL int allowed(Instance *self, const char *function, int mask);
/* 1 if the caller's array has an address and n is a possible length; else 0 and an error message. */
LOCAL int given(Instance *self, const void *array, size_t n);
/* ERROR after a message. */
LOCAL Status refuse(Instance *self, const char *format, ...);
LOCAL Status instance_set_log(Instance *self, int on, size_t n, const char *const categories[]);
LOCAL Status instance_setup(Instance *self, int tolerance_defined, double tolerance, double start,
                            int stop_defined, double stop);
LOCAL Status instance_initialized(Instance *self);
/* To another state of the state machine. */
LOCAL Status instance_enter(Instance *self, int phase);
LOCAL Status instance_reset(Instance *self);

/* ---- values.c */

LOCAL Status values_get(Instance *self, const unsigned r[], size_t n, double value[]);
LOCAL Status values_set(Instance *self, const unsigned r[], size_t n, const double value[]);
/* Is this the value reference of the time? */
LOCAL int is_time(const Instance *self, unsigned r);
/* Do states follow from start values now? */
LOCAL int is_starting(const Instance *self);
/* May this variable be a known or an unknown of a derivative? A message if not. */
LOCAL int is_known(Instance *self, unsigned r);
LOCAL int is_unknown(Instance *self, unsigned r);
LOCAL Status values_directional(Instance *self, const unsigned unknown[], size_t n_unknown,
                                const unsigned known[], size_t n_known, const double seed[], double result[]);
LOCAL Status values_output_derivatives(Instance *self, const unsigned r[], size_t n, const int order[],
                                       double value[]);

/* ---- exchange.c */

/* Continuous-time mode begins. */
LOCAL Status exchange_enter(Instance *self);
/* The caller has the states at the start. */
LOCAL void exchange_settle(Instance *self);
/* The inputs are as they are from here on, whatever they were. */
LOCAL void exchange_hold(Instance *self);
/* Must the solver start anew after this update at an event? Asked once. */
LOCAL int exchange_restarts(Instance *self);
/* The solver's step is done; `*event` is 1 where it must start anew. */
LOCAL Status exchange_completed(Instance *self, int *event);
LOCAL Status exchange_set_time(Instance *self, double time);
LOCAL Status exchange_set_states(Instance *self, const double x[], size_t n);
LOCAL Status exchange_states(Instance *self, double x[], size_t n);
LOCAL Status exchange_derivatives(Instance *self, double dx[], size_t n);
LOCAL Status exchange_indicators(Instance *self, size_t n);
LOCAL Status exchange_nominals(Instance *self, double nominal[], size_t n);
/* 1 and the time of the next time event if there is one, else 0. */
LOCAL int exchange_next_event(Instance *self, double *time);

/* ---- step.c */

LOCAL Status do_step(Instance *self, double time, double length);

/* ---- states.c: a saved state is the bytes of snapshot.c */

LOCAL Status states_get(Instance *self, void **state);
LOCAL Status states_set(Instance *self, const void *state);
LOCAL Status states_serialize(Instance *self, const void *state, char bytes[], size_t size);
LOCAL Status states_deserialize(Instance *self, const char bytes[], size_t size, void **state);
LOCAL Status states_free(void **state);

#endif
