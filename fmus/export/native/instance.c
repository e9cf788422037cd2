/* Creation, setup and reset of an instance, its FMI state machine, its log. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

/* ---- messages -------------------------------------------------------------------------------- */

typedef struct {
    const char *name;
    unsigned mask;
} Category;

/* The index of the first four is the status of the message. */
static const Category CATEGORIES[] = {
    {"logEvents", 1u << OK},           {"logStatusWarning", 1u << WARNING},
    {"logStatusDiscard", 1u << DISCARD}, {"logStatusError", 1u << ERROR},
    {"logAll", ~0u},
};
enum { NUMBER_OF_CATEGORIES = sizeof CATEGORIES / sizeof *CATEGORIES };

/* Warnings and errors are also logged if debug logging is off. */
enum { ALWAYS_LOGGED = 1u << WARNING | 1u << ERROR };

const char *instance_category(Status kind) { return CATEGORIES[kind].name; }

static void report(void *owner, Status kind, const char *text) {
    const Instance *self = owner;
    if (self->logger && (self->log & 1u << kind)) self->write(self, kind, text);
    core_reported();
}

Status refuse(Instance *self, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    core_message_of(&self->core, ERROR, format, arguments);
    va_end(arguments);
    return ERROR;
}

static const char *phase_name(int phase) {
    switch (phase) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZATION: return "initialization mode";
    case EVENT_MODE: return "event mode";
    case CONTINUOUS_TIME: return "continuous-time mode";
    case STEP_MODE: return "step complete";
    case INSIDE_STEP: return "inside a step";
    case STEP_FAILED: return "failed";
    default: return "terminated";
    }
}

static const char *type_name(int type) {
    return type == CO_SIMULATION ? "co-simulation" : "model exchange";
}

int allowed(Instance *self, const char *function, int mask) {
    if (!self) return 0;
    const State *s = &self->core.s;
    self->core.call = function;
    if (mask & (MODEL_EXCHANGE | CO_SIMULATION) & ~s->type) {
        refuse(self, "not allowed in an instance for %s", type_name(s->type));
        return 0;
    }
    if (!(s->phase & mask)) {
        refuse(self, "not allowed in state \"%s\" of the FMI state machine", phase_name(s->phase));
        return 0;
    }
    if (self->log & 1u << OK) core_message(&self->core, OK, "t = %.9g s", s->time);
    return 1;
}

int valid_array(Instance *self, const void *array, size_t n) {
    if (n == 0) return 1;
    if (array && n <= ~(size_t)0 / 16) return 1; /* a negative length was converted to a huge one */
    core_message(&self->core, ERROR, array ? "%zu values, expected fewer" : "a null pointer for %zu values", n);
    return 0;
}

Status instance_set_log(Instance *self, int on, size_t n, const char *const categories[]) {
    if (!valid_array(self, categories, n)) return ERROR;
    /* Without names all categories are meant; warnings and errors can be switched off only by name. */
    unsigned mask = n == 0 ? (on ? ~0u : ~(unsigned)ALWAYS_LOGGED) : 0u;
    for (size_t i = 0; i < n; i++) {
        int known = 0;
        if (!valid_array(self, categories[i], 1)) return ERROR;
        for (int k = 0; k < NUMBER_OF_CATEGORIES; k++)
            if (strcmp(categories[i], CATEGORIES[k].name) == 0) {
                mask |= CATEGORIES[k].mask;
                known = 1;
            }
        if (!known) return refuse(self, "log category \"%s\" is unknown", categories[i]);
    }
    self->log = on ? self->log | mask : self->log & ~mask;
    return OK;
}

/* ---- creation, setup, reset ------------------------------------------------------------------ */

const char *instance_problem(const char *name, const char *guid, int type, const char *resources, char *text) {
    if (!name || strspn(name, " \t\r\n") == strlen(name)) return "the instance name is empty";
    return guid && strcmp(guid, model_guid) == 0 ? core_load(type, resources, text) : model_other_guid;
}

static void initialise(Instance *self, int type) {
    core_reset(&self->core);
    self->core.s.type = type;
    self->core.in_steps = type == CO_SIMULATION;
    self->core.s.phase = INSTANTIATED;
}

Instance *instance_create(const char *name, int type, int logging) {
    Instance *self = calloc(1, sizeof *self + strlen(name) + 1);
    if (!self) return NULL;
    strcpy(self->name, name);
    self->log = logging ? ~0u : ALWAYS_LOGGED;
    self->core.report = report;
    self->core.owner = self;
    initialise(self, type);
    return self;
}

Status instance_setup(Instance *self, int tolerance_defined, double tolerance, double start_time,
                      int stop_defined, double stop_time) {
    State *s = &self->core.s;
    if (!isfinite(start_time)) return refuse(self, "the start time is not finite");
    if (stop_defined && !(stop_time >= start_time))
        return refuse(self, "the stop time is before the start time");
    if (tolerance_defined && !(tolerance > 0.0 && tolerance < 1.0))
        return refuse(self, "the tolerance is out of range, expected > 0 and < 1");
    s->time = s->start_time = start_time;
    core_invalidate_states(&self->core);
    s->stop_time = stop_defined ? stop_time : HUGE_VAL;
    s->tolerance = tolerance_defined ? fmin(tolerance, LOOSEST_TOLERANCE) : DEFAULT_TOLERANCE;
    return OK;
}

Status instance_exit_initialization(Instance *self) {
    State *s = &self->core.s;
    if (!core_check_state(&self->core)) return ERROR;
    s->initial = s->type == MODEL_EXCHANGE; /* see exchange.c: until states are set or integrated */
    s->phase = s->type == CO_SIMULATION && !self->events ? STEP_MODE : EVENT_MODE;
    return OK;
}

Status instance_enter(Instance *self, int phase) {
    self->core.s.phase = phase;
    return OK;
}

Status instance_reset(Instance *self) {
    initialise(self, self->core.s.type);
    exchange_keep_inputs(self);
    return OK;
}
