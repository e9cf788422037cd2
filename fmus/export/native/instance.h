/* What FMI 2 and FMI 3 share: an instance, its FMI state machine, its log, and the content of the FMI functions.
   fmi2*.c and fmi3*.c translate names and types. */

#ifndef INSTANCE_H
#define INSTANCE_H

#include "core.h"

/* States of the FMI state machine. A mask of them declares where a function may be called, with MODEL_EXCHANGE or
   CO_SIMULATION also for which kind of instance. */
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
    /* where the solver of the importer may read states and derivatives */
    READABLE = MODEL_EXCHANGE | INITIALIZATION | EVENT_MODE | CONTINUOUS_TIME | TERMINATED
};

typedef struct Instance {
    Core core;
    void (*write)(const struct Instance *self, Status kind, const char *text); /* writes to the importer's log */
    void (*logger)(void); /* the importer's logger, of the type of the FMI version */
    void (*update)(void); /* the importer's intermediate update; may be null */
    void *environment;
    int events;       /* co-simulation enters event mode */
    int early_return; /* a step may end early */
    unsigned log;     /* mask of the statuses whose messages are logged */
    int has_time;     /* the time is a variable, after the last one of the model */
    struct {          /* model exchange: detects an importer that holds the inputs over steps of its solver */
        double inputs[ROOM(NU)]; /* the inputs after their last change */
        double since;            /* time [s] of the first derivatives with these; NaN: there are none */
        int long_enough;         /* derivatives with these were computed over some time */
        int restart;             /* the next update at an event restarts the solver */
    } held;
    char name[];
} Instance;

/* ---- instance.c */

/* What is wrong with the arguments of an instantiation, or null; `text` has room for PROBLEM bytes. */
SHARED const char *instance_problem(const char *name, const char *guid, int type, const char *resources, char *text);
/* A new instance, or null if there is no memory; `type` is MODEL_EXCHANGE or CO_SIMULATION. */
SHARED Instance *instance_create(const char *name, int type, int logging);
/* The log category of messages with this status. */
SHARED const char *instance_category(Status kind);
/* 1 if the function may be called now; else 0 and a message. */
SHARED int allowed(Instance *self, const char *function, int mask);
/* 1 if the importer's array is not null and n is a possible length; else 0 and a message. */
SHARED int valid_array(Instance *self, const void *array, size_t n);
/* Reports an error message; returns ERROR. */
SHARED Status refuse(Instance *self, const char *format, ...);
SHARED Status instance_set_log(Instance *self, int on, size_t n, const char *const categories[]);
SHARED Status instance_setup(Instance *self, int tolerance_defined, double tolerance, double start,
                            int stop_defined, double stop);
SHARED Status instance_exit_initialization(Instance *self);
/* Changes the state of the FMI state machine. */
SHARED Status instance_enter(Instance *self, int phase);
SHARED Status instance_reset(Instance *self);

/* ---- values.c */

SHARED Status values_get(Instance *self, const unsigned r[], size_t n, double value[]);
SHARED Status values_set(Instance *self, const unsigned r[], size_t n, const double value[]);
/* 1 if this is the value reference of the time. */
SHARED int is_time(const Instance *self, unsigned r);
/* 1 if the states are computed from start values now. */
SHARED int is_starting(const Instance *self);
/* 1 if the variable may be a known or an unknown of a derivative; else 0 and a message. */
SHARED int is_known(Instance *self, unsigned r);
SHARED int is_unknown(Instance *self, unsigned r);
SHARED Status values_directional(Instance *self, const unsigned unknown[], size_t n_unknown,
                                const unsigned known[], size_t n_known, const double seed[], double result[]);
SHARED Status values_output_derivatives(Instance *self, const unsigned r[], size_t n, const int order[],
                                       double value[]);

/* ---- exchange.c */

/* Enters continuous-time mode. */
SHARED Status exchange_enter(Instance *self);
/* Fixes the initial states: inputs no longer change them. */
SHARED void exchange_fix_start(Instance *self);
/* Stores the inputs, with which later ones are compared. */
SHARED void exchange_keep_inputs(Instance *self);
/* 1 if the solver must restart after this update at an event; the second call returns 0. */
SHARED int exchange_restart_needed(Instance *self);
/* Checks a completed step of the solver; `*event` becomes 1 if the solver must restart. */
SHARED Status exchange_completed(Instance *self, int *event);
SHARED Status exchange_set_time(Instance *self, double time);
SHARED Status exchange_set_states(Instance *self, const double x[], size_t n);
SHARED Status exchange_states(Instance *self, double x[], size_t n);
SHARED Status exchange_derivatives(Instance *self, double dx[], size_t n);
SHARED Status exchange_indicators(Instance *self, size_t n);
SHARED Status exchange_nominals(Instance *self, double nominal[], size_t n);
/* 1 and the time of the next time event if there is one, else 0. */
SHARED int exchange_next_event(Instance *self, double *time);

/* ---- step.c */

SHARED Status do_step(Instance *self, double time, double length);

/* ---- states.c */

SHARED Status states_get(Instance *self, void **state);
SHARED Status states_set(Instance *self, const void *state);
SHARED Status states_serialize(Instance *self, const void *state, char bytes[], size_t size);
SHARED Status states_deserialize(Instance *self, const char bytes[], size_t size, void **state);
SHARED Status states_free(void **state);

#endif
