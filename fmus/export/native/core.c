#include "core.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

LOCAL void core_message_of(Core *core, Status kind, const char *format, va_list arguments) {
    char text[768];
    const int used = snprintf(text, sizeof text, "%s: ", core->call);
    vsnprintf(text + used, sizeof text - (size_t)used, format, arguments);
    core->report(core->owner, kind, text);
}

SHARED void core_message(Core *core, Status kind, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    core_message_of(core, kind, format, arguments);
    va_end(arguments);
}

LOCAL void core_invalidate_states(Core *core) { core->z_valid = core->dx_valid = core->y_valid = 0; }

LOCAL void core_invalidate(Core *core) {
    core->c_valid = core->start_valid = 0;
    core_invalidate_states(core);
}

LOCAL void core_reset(Core *core) {
    State *s = &core->s;
    memset(s, 0, sizeof *s);
    s->stop_time = INFINITY;
    s->tolerance = DEFAULT_TOLERANCE;
    for (int i = 0; i < NP; i++) s->p[i] = model_start_values[FIRST_PARAMETER + i];
    for (int i = 0; i < NU; i++) s->u[i] = s->last_set[i] = model_start_values[FIRST_INPUT + i];
    for (int i = 0; i < NX; i++) s->x[i] = model_start_values[FIRST_STATE + i];
    s->initial = 1;
    memset(&core->stepped, 0, sizeof core->stepped);
    memcpy(core->stepped.last, s->u, sizeof s->u);
    core_invalidate(core);
}

/* ---- values ---------------------------------------------------------------------------------- */

static double value_of(Core *core, int r) {
    if (r >= FIRST_OUTPUT) {
        if (!core->y_valid) core_outputs(core);
        return core->y[r - FIRST_OUTPUT];
    }
    if (r >= FIRST_DERIVATIVE) {
        if (!core->dx_valid) core_derivatives(core);
        return core->dx[r - FIRST_DERIVATIVE];
    }
    if (NP > 0 && r < FIRST_INPUT) return core->s.p[r - FIRST_PARAMETER];
    if (NU > 0 && r < FIRST_STATE) return core->s.u[r - FIRST_INPUT];
    core_start(core);
    return core->s.x[r - FIRST_STATE];
}

/* ---- inputs that move in steps -------------------------------------------------------------------- */

/* An input that moved in fewer steps has jumped, which no rate input would tell. */
enum { MOVING = 3 };

/* The input that moves most. */
LOCAL void core_tell_held_inputs(Core *core, Status kind) {
    int most = -1;
    double largest = 0.0;
    for (int i = 0; i < NU && !(core->stepped.told & 1u << kind); i++) {
        const double change = fabs(core->stepped.change[i]) / model_variables[FIRST_INPUT + i].nominal;
        if (core->stepped.steps[i] < MOVING || change <= largest) continue;
        most = i;
        largest = change;
    }
    if (most < 0) return;
    core->stepped.told |= 1u << kind;
    const Variable *v = &model_variables[FIRST_INPUT + most];
    core_message(core, kind,
                 "%s moved in each of the last %d steps while its rate input %s stayed 0. Held inputs can make "
                 "connected FMUs unstable: connect the rate inputs, or take shorter steps",
                 v->name, core->stepped.steps[most], model_variables[FIRST_INPUT + v->rate].name);
}

/* A rate is untrue if the input leaves it by half of what it says, except little of the nominal value. */
static const double UNTRUE = 0.5, LITTLE = 0.01;
enum { UNTRUE_STEPS = 100, UNTRUE_TOLD = 1 << 8 }; /* in a row; a further bit of `told` */

/* Once, if an input has not moved in the last steps as its rate input says, which is held over a step. */
static void watch_rate(Core *core, int i, double slope) {
    const double length = core->stepped.length, before = core->stepped.slope[i], told = before * length;
    const double change = core->stepped.change[i];
    const Variable *v = &model_variables[FIRST_INPUT + i];
    const int untrue = fabs(change - told) > UNTRUE * fabs(told) && fabs(told) > LITTLE * v->nominal;
    core->stepped.untrue[i] = untrue && !core->s.has_derivatives[i] ? core->stepped.untrue[i] + 1 : 0;
    core->stepped.slope[i] = slope;
    if (core->stepped.untrue[i] < UNTRUE_STEPS || core->stepped.told & UNTRUE_TOLD) return;
    core->stepped.told |= UNTRUE_TOLD;
    core_message(core, WARNING, "%s did not move in the last %d steps as its rate input %s says, which is held over a "
                 "step: leave that open, or take steps of at most %.1g s", v->name, UNTRUE_STEPS,
                 model_variables[FIRST_INPUT + v->rate].name, fmin(fabs(change / (slope - before)), length / 4));
}

/* Before each step: counts steps in which an input moves while its rate input stays 0, or not as that says. */
static void watch_held_inputs(Core *core, double length) {
    const State *s = &core->s;
    for (int i = 0; i < NU; i++) {
        const int rate = model_variables[FIRST_INPUT + i].rate;
        if (rate < 0) continue;
        core->stepped.change[i] = s->last_set[i] - core->stepped.last[i];
        const int held = core->stepped.change[i] != 0.0 && s->last_set[rate] == 0.0 && !s->has_derivatives[i];
        core->stepped.steps[i] = held ? core->stepped.steps[i] + 1 : 0;
        core->stepped.last[i] = s->last_set[i];
        watch_rate(core, i, s->last_set[rate]);
    }
    core->stepped.length = length;
    core_tell_held_inputs(core, OK);
}

LOCAL int core_failed(Core *core) {
    if (!*core->problem) return 0;
    core_message(core, ERROR, "%s", core->problem);
    *core->problem = '\0';
    return 1;
}

/* Reports that a requirement is violated; returns 0. */
static int violated(Core *core, int i) {
    core_tell_held_inputs(core, WARNING);
    core_message(core, ERROR, "requirement \"%s\" is violated at t = %.9g s: %.6g, expected > 0",
                 model_statements[i], core->s.time, core->require[i]);
    return 0;
}

LOCAL int core_get(Core *core, unsigned reference, double *value) {
    if (reference >= NUMBER_OF_VARIABLES) {
        core_message(core, ERROR, "value reference %u is unknown, expected 0 to %d", reference,
                     NUMBER_OF_VARIABLES - 1);
        return 0;
    }
    *value = value_of(core, (int)reference);
    if ((int)reference >= FIRST_STATE && core_failed(core)) return 0;
    if (isfinite(*value)) return 1;
    core_require(core);
    if (core_failed(core)) return 0;
    for (int i = 0; i < NREQUIRE; i++) /* a violated requirement explains the value better */
        if (core->require[i] <= 0.0) return violated(core, i);
    core_message(core, ERROR, "%s is %g at t = %.9g s, expected a finite number",
                 model_variables[reference].name, *value, core->s.time);
    return 0;
}

/* 1 if a variable of this kind may be set now. */
static int settable(const Core *core, Kind kind) {
    if (kind == INPUT || kind == TUNABLE) return 1;
    return core->s.initial && (kind == FIXED || kind == STATE);
}

static const char *reason(Kind kind) {
    switch (kind) {
    case FIXED: return "a fixed parameter can be set only before the initialisation is over";
    case STATE: return "a state can be set only before the initialisation is over";
    case CALCULATED_STATE: return "its start value is calculated";
    case DERIVATIVE: return "it is a derivative";
    default: return "it is an output";
    }
}

LOCAL int core_check_value(Core *core, unsigned reference, double value) {
    if (reference >= NUMBER_OF_VARIABLES) {
        core_message(core, ERROR, "value reference %u is unknown, expected 0 to %d", reference,
                     NUMBER_OF_VARIABLES - 1);
        return 0;
    }
    const Variable *v = &model_variables[reference];
    if (!settable(core, v->kind)) {
        core_message(core, ERROR, "%s cannot be set to %g at t = %.9g s: %s", v->name, value, core->s.time,
                     reason(v->kind));
        return 0;
    }
    if (!isfinite(value)) {
        core_message(core, ERROR, "%s cannot be set to %g at t = %.9g s, expected a finite number", v->name,
                     value, core->s.time);
        return 0;
    }
    if (value < v->minimum || value > v->maximum) {
        core_message(core, ERROR, "%s cannot be set to %.9g %s at t = %.9g s, expected %g to %g", v->name,
                     value, v->unit, core->s.time, v->minimum, v->maximum);
        return 0;
    }
    return 1;
}

LOCAL void core_set(Core *core, unsigned reference, double value) {
    State *s = &core->s;
    switch (model_variables[reference].kind) {
    case FIXED:
    case TUNABLE:
        s->p[reference - FIRST_PARAMETER] = value;
        core->c_valid = 0;
        break;
    case INPUT:
        if (s->u[reference - FIRST_INPUT] != value) {
            core->start_valid &= s->start_fixed;
            core->dx_valid = core->y_valid = 0;
            if (model_variables[reference].held) core->c_valid = core->z_valid = 0;
        }
        s->u[reference - FIRST_INPUT] = s->last_set[reference - FIRST_INPUT] = value;
        core->inputs_changed = 1;
        return;
    default: s->x[reference - FIRST_STATE] = value;
    }
    core->start_valid = 0;
    core_invalidate_states(core);
}

/* ---- inputs over a step ---------------------------------------------------------------------- */

/* Derivatives of an input of order 1 to 3 as they were set, else from its rate input, the rate input of that one and
   so on; u: values of the inputs. */
static void input_derivatives(const State *s, const double *u, int input, double *result) {
    result[0] = result[1] = result[2] = 0.0;
    for (int order = 0, i = input; order < 3 && i >= 0; order++) {
        if (s->has_derivatives[i]) {
            for (int k = 0; order < 3; k++, order++) result[order] = s->input_derivatives[i][k];
            return;
        }
        i = model_variables[FIRST_INPUT + i].rate;
        if (i >= 0) result[order] = u[i];
    }
}

LOCAL double core_input_derivative(const Core *core, int input) {
    const State *s = &core->s;
    if (s->has_derivatives[input]) return s->input_derivatives[input][0];
    const int rate = model_variables[FIRST_INPUT + input].rate;
    return rate < 0 || s->had_derivatives[input] ? s->end_derivative[input] : s->u[rate];
}

LOCAL void core_plan_inputs(Core *core, const double *u, double tau) {
    const State *s = &core->s;
    InputPolynomials *inputs = &core->inputs;
    inputs->origin = tau;
    inputs->count = 0;
    memcpy(inputs->start, u, NU * sizeof *u);
    for (int i = 0; i < NU; i++) {
        if (model_variables[FIRST_INPUT + i].held) continue;
        if (!s->has_derivatives[i] && model_variables[FIRST_INPUT + i].rate < 0) continue;
        double *m = inputs->coefficients[i];
        input_derivatives(s, u, i, m);
        if (m[0] == 0.0 && m[1] == 0.0 && m[2] == 0.0) continue;
        m[1] *= 1.0 / 2.0;
        m[2] *= 1.0 / 6.0;
        inputs->moving[inputs->count++] = i;
    }
}

/* ---- checks and steps ------------------------------------------------------------------------ */

/* Relative excess over a limit without a warning: rounding of a ramp at its limit. A message near
   the limit has six digits, so a value within the margin would be printed as the limit itself. */
static const double WARNING_MARGIN = 1e-5;

/* Warnings of one variable; later excursions are not logged. */
enum { MOST_WARNINGS = 3 };

/* A warning for each of the first excursions of a watched input or output. */
static void watch(Core *core) {
    for (int k = 0; k < NWATCHED; k++) {
        const Watched *w = &model_watched[k];
        const double value = value_of(core, w->reference);
        const int below = value < w->below - WARNING_MARGIN * fabs(w->below);
        const int beyond = below ? -1 : fabs(value) > (1.0 + WARNING_MARGIN) * w->above;
        if (beyond && beyond != core->s.beyond[k] && core->s.warnings[k] < MOST_WARNINGS) {
            const int last = ++core->s.warnings[k] == MOST_WARNINGS;
            core_tell_held_inputs(core, WARNING);
            const double limit = below ? w->below : w->above, size = below ? value : fabs(value);
            const double shown = w->factor * size + w->offset;
            const int digits = fabs(size - limit) < 1e-3 * fabs(limit) || fabs(shown) >= 1e4 ? 6 : 4;
            core_message(core, WARNING, "%s at t = %.6g s: %s = %.*g%s%s", w->meaning[below], core->s.time,
                         model_variables[w->reference].name, digits, shown, w->limit[below],
                         last ? "; no further warning of it follows" : "");
        }
        core->s.beyond[k] = beyond;
    }
}

static int all_finite(const double *values, int count) {
    int finite = 1;
    for (int i = 0; i < count; i++) finite &= isfinite(values[i]) != 0;
    return finite;
}

LOCAL int core_check_state(Core *core) {
    double value;
    core_require(core);
    if (core_failed(core)) return 0;
    if (!all_finite(core->s.x, NX))
        for (unsigned r = FIRST_STATE; r < FIRST_DERIVATIVE; r++)
            if (!core_get(core, r, &value)) return 0;
    for (int i = 0; i < NREQUIRE; i++)
        if (!(core->require[i] > 0.0)) return violated(core, i);
    if (!all_finite(core->y, NY))
        for (unsigned r = FIRST_OUTPUT; r < NUMBER_OF_VARIABLES; r++)
            if (!core_get(core, r, &value)) return 0;
    watch(core);
    return 1;
}

LOCAL void core_set_time(Core *core, double begin, double tau) {
    State *s = &core->s;
    s->time = begin + tau;
    inputs_value(&core->inputs, tau, s->u);
    inputs_derivative(&core->inputs, tau, s->end_derivative);
    core->start_valid = 0;
    core_invalidate_states(core);
}

LOCAL int core_step(Core *core, double length) {
    State *s = &core->s;
    const double begin = s->time;
    watch_held_inputs(core, length);
    core_plan_inputs(core, s->last_set, 0.0);
    if (!core_advance(core, length)) return 0;
    memcpy(s->had_derivatives, s->has_derivatives, sizeof s->has_derivatives);
    memset(s->has_derivatives, 0, sizeof s->has_derivatives);
    if (core_check_state(core)) return 1;
    s->time = begin;
    return 0;
}
