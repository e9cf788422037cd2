/* FMI 2.0: an instance, its state machine and its log, shared by the three fmi2*.c files. */

#ifndef FMI2_INSTANCE_H
#define FMI2_INSTANCE_H

#include "core.h"
#include "fmi2Functions.h"

/* States of the FMI state machine; masks of them say where a function may be called, and for which
   kind of instance if not for both. */
enum {
    INSTANTIATED = 1,
    INITIALIZATION = 2,
    EVENT_MODE = 4,
    CONTINUOUS_TIME = 8,
    STEP_COMPLETE = 16,
    STEP_FAILED = 32,
    TERMINATED = 64,
    SIMULATING = EVENT_MODE | CONTINUOUS_TIME | STEP_COMPLETE,
    ANY = 127,
    MODEL_EXCHANGE = 128,
    CO_SIMULATION = 256
};

typedef struct {
    Core core;
    fmi2CallbackLogger logger;
    fmi2ComponentEnvironment environment;
    unsigned log; /* mask of severities that are logged */
    char name[];
} Instance;

/* 1 if the function may be called now; else 0 and an error message. */
int fmi2_allowed(Instance *self, const char *function, int mask);

/* The words for a fmi2Type. */
const char *fmi2_type_name(int type);

/* fmi2Error after a message. */
fmi2Status fmi2_refuse(Instance *self, const char *format, const char *detail);

#endif
