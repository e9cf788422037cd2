/* Get and set of variables, directional derivatives, derivatives of outputs. */

#include <math.h>
#include <string.h>

#include "instance.h"

int is_time(const Instance *self, unsigned r) { return self->has_time && r == NUMBER_OF_VARIABLES; }

Status values_get(Instance *self, const unsigned r[], size_t n, double value[]) {
    if (!valid_array(self, r, n) || !valid_array(self, value, n)) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (is_time(self, r[i])) value[i] = self->core.s.time;
        else if (!core_get(&self->core, r[i], &value[i])) return ERROR;
    }
    return OK;
}

Status values_set(Instance *self, const unsigned r[], size_t n, const double value[]) {
    Core *core = &self->core;
    if (!valid_array(self, r, n) || !valid_array(self, value, n)) return ERROR;
    for (size_t i = 0; i < n; i++) {
        if (is_time(self, r[i])) return refuse(self, "the time cannot be set as a variable");
        if (!core_check_value(core, r[i], value[i])) return ERROR;
        if (core->s.phase & (CONTINUOUS_TIME | INSIDE_STEP) && model_variables[r[i]].kind != INPUT)
            return refuse(self, "%s can be set only between steps and at events", model_variables[r[i]].name);
    }
    for (size_t i = 0; i < n; i++) core_set(core, r[i], value[i]);
    return OK;
}

/* ---- derivatives ----------------------------------------------------------------------------- */

static const char *name_of(unsigned r) {
    return r < NUMBER_OF_VARIABLES ? model_variables[r].name : "(unknown value reference)";
}

int is_starting(const Instance *self) { return self->core.s.phase & (INSTANTIATED | INITIALIZATION); }

/* A known is an input or a state; until the initialization is over an input, a parameter or a state with a start
   value. */
int is_known(Instance *self, unsigned r) {
    if (r < NUMBER_OF_VARIABLES) {
        const Kind kind = model_variables[r].kind;
        if (kind == INPUT || kind == STATE) return 1;
        if (is_starting(self) ? kind == FIXED || kind == TUNABLE : kind == CALCULATED_STATE) return 1;
    }
    refuse(self, "%s is not a known, expected %s", name_of(r),
           is_starting(self) ? "an input, a parameter or a state with a start value" : "an input or a state");
    return 0;
}

/* An unknown is an output, a derivative or a state. */
int is_unknown(Instance *self, unsigned r) {
    if (r < NUMBER_OF_VARIABLES) {
        const Kind kind = model_variables[r].kind;
        if (kind != FIXED && kind != TUNABLE && kind != INPUT) return 1;
    }
    refuse(self, "%s is not an unknown, expected an output, a derivative or a state", name_of(r));
    return 0;
}

Status values_directional(Instance *self, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                          size_t n_known, const double seed[], double result[]) {
    Core *core = &self->core;
    if (!valid_array(self, unknown, n_unknown) || !valid_array(self, result, n_unknown)) return ERROR;
    if (!valid_array(self, known, n_known) || !valid_array(self, seed, n_known)) return ERROR;
    memset(core->direction, 0, sizeof core->direction);
    for (size_t i = 0; i < n_known; i++) {
        if (is_time(self, known[i])) continue; /* no variable depends on the time */
        if (!is_known(self, known[i])) return ERROR;
        core->direction[known[i]] += seed[i];
    }
    if (!core_forward(core, is_starting(self))) return ERROR;
    for (size_t i = 0; i < n_unknown; i++) {
        if (!is_unknown(self, unknown[i])) return ERROR;
        result[i] = core->direction[unknown[i]];
        if (!isfinite(result[i]))
            return refuse(self, "the derivative of %s is not finite", name_of(unknown[i]));
    }
    return OK;
}

/* Of outputs and states. Orders above 1 are not available; the standard requires zero for them. */
Status values_output_derivatives(Instance *self, const unsigned r[], size_t n, const int order[],
                                 double value[]) {
    Core *core = &self->core;
    if (!valid_array(self, r, n) || !valid_array(self, order, n) || !valid_array(self, value, n)) return ERROR;
    core_derivatives(core);
    for (int i = 0; i < NX; i++) core->direction[FIRST_STATE + i] = core->dx[i];
    for (int i = 0; i < NU; i++) core->direction[FIRST_INPUT + i] = core_input_derivative(core, i);
    if (!core_forward(core, is_starting(self))) return ERROR;
    for (size_t i = 0; i < n; i++) {
        const Variable *v = r[i] < NUMBER_OF_VARIABLES ? &model_variables[r[i]] : NULL;
        if (!v || (v->kind != OUTPUT && v->kind != STATE && v->kind != CALCULATED_STATE))
            return refuse(self, "%s is not an output or a state", name_of(r[i]));
        if (order[i] < 1) return refuse(self, "the order of the derivative of %s is less than 1", v->name);
        value[i] = order[i] > 1 ? 0.0 : core->direction[r[i]];
        if (!isfinite(value[i])) return refuse(self, "the derivative of %s is not finite", v->name);
    }
    return OK;
}
