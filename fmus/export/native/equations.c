/* The model in equations: initial states, derivatives, outputs, requirements, and how the states advance. An FMU whose
   code is Python has ../python/native/python_model.c in place of this file and of the solver. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "core.h"

SHARED const char *core_load(int type, const char *resources, char *text) {
    (void)type, (void)resources, (void)text;
    return NULL;
}

SHARED void core_reported(void) {}

static void prepare(Core *core) {
    if (!core->c_valid) model_prepare(core->s.u, core->s.p, core->c);
    core->c_valid = 1;
}

SHARED void core_start(Core *core) {
    prepare(core);
    if (core->s.initial && !core->start_valid) {
        double start[ROOM(NX)];
        model_start(core->s.x, core->s.u, core->s.p, core->c, start);
        memcpy(core->s.x, start, NX * sizeof *start);
        core->start_valid = 1;
        core_invalidate_states(core);
    }
}

static void observe_states(Core *core) {
    if (!core->z_valid) model_observe_states(core->s.x, core->s.p, core->c, core->y, core->z);
    core->z_valid = 1;
}

LOCAL void core_derivatives(Core *core) {
    const State *s = &core->s;
    core_start(core);
    if (core->dx_valid) return;
    core->dx_valid = 1;
    if (core->in_steps) {
        observe_states(core);
        model_derivatives(s->x, s->u, s->p, core->c, core->z, core->dx);
    } else {
        model_dynamics(s->x, s->u, s->p, core->c, core->dx);
    }
}

LOCAL void core_outputs(Core *core) {
    core_start(core);
    observe_states(core);
    if (!core->y_valid) model_observe(core->s.x, core->s.u, core->s.p, core->c, core->z, core->y);
    core->y_valid = 1;
}

LOCAL int core_forward(Core *core, int starting) {
    core_start(core);
    const State *s = &core->s;
    double *v = core->direction, *vx = v + FIRST_STATE, *vu = v + FIRST_INPUT;
    double *vdx = v + FIRST_DERIVATIVE, *vy = v + FIRST_OUTPUT;
    if (starting) {
        double start[ROOM(NX)];
        model_start_forward(s->x, s->u, s->p, core->c, vx, vu, v + FIRST_PARAMETER, start, vdx, vy);
        memcpy(vx, start, NX * sizeof *start);
    } else {
        model_forward(s->x, s->u, s->p, core->c, vx, vu, vdx, vy);
    }
    return 1;
}

LOCAL void core_require(Core *core) {
    core_outputs(core);
    model_require(core->s.x, core->s.u, core->s.p, core->c, core->z, core->require);
}

LOCAL double core_next_event(Core *core) {
    double delay;
    core_start(core);
    model_time_event(core->s.x, core->s.u, core->s.p, core->c, &delay);
    return core->s.time + delay;
}

/* ---- steps ----------------------------------------------------------------------------------------- */

static void report_failure(Core *core, const Report *report) {
    const double time = core->s.time + report->tau;
    const Variable *state = &model_variables[FIRST_STATE + report->worst];
    core_tell_held_inputs(core, WARNING);
    const double value = core->s.x[report->worst];
    switch (report->outcome) {
    case NOT_FINITE:
        core_message(core, ERROR, "the derivative of %s is %g at t = %.9g s (%s = %.6g %s)", state->name,
                     core->work.f0[report->worst], time, state->name, value, state->unit);
        break;
    case SINGULAR:
        core_message(core, ERROR,
                     "the linear system of the smallest inner step that was tried is singular at t = %.9g s",
                     time);
        break;
    case TOO_MANY_STEPS:
        core_message(core, ERROR,
                     "more inner steps than allowed at t = %.9g s; the largest error is in %s = %.6g %s",
                     time, state->name, value, state->unit);
        break;
    default:
        core_message(core, ERROR,
                     "tolerance %g not reached with an inner step of %.3g s at t = %.9g s; "
                     "the largest error is in %s = %.6g %s",
                     core->s.tolerance, report->step, time, state->name, value, state->unit);
    }
}

typedef struct {
    Core *core;
    double begin; /* time at the start of the step */
} StepContext;

/* A StepCallback: the importer may read values, set inputs and end the step. */
static double after_inner_step(void *owner, double tau, double length) {
    const StepContext *context = owner;
    Core *core = context->core;
    core_set_time(core, context->begin, tau);
    core->inputs_changed = 0;
    const double end = core->intermediate_update(core->owner, context->begin + length) - context->begin;
    if (core->inputs_changed) core_plan_inputs(core, core->s.u, tau);
    return end < length ? fmax(tau, end) : length;
}

/* The states of a sampled model advance by Euler's method at each multiple of SAMPLING, as in a control unit;
   memory.step is the time since the last sample. Returns the number of samples, or -1 after an error. */
static int advance_samples(Core *core, double length) {
    State *s = &core->s;
    Work *w = &core->work;
    double tau = SAMPLING - s->memory.step; /* of the next sample */
    int count = 0;
    for (; tau <= length + 1e-9 * SAMPLING; tau += SAMPLING, count++) {
        inputs_value(&core->inputs, fmin(tau, length), w->u);
        model_dynamics(s->x, w->u, s->p, core->c, w->f0);
        for (int i = 0; i < NX; i++) {
            s->x[i] += SAMPLING * w->f0[i];
            if (isfinite(w->f0[i])) continue;
            const Report report = {NOT_FINITE, tau, SAMPLING, i};
            report_failure(core, &report);
            return -1;
        }
    }
    s->memory.step = length - (tau - SAMPLING);
    return count;
}

LOCAL int core_advance(Core *core, double length) {
    State *s = &core->s;
    StepContext context = {core, s->time};
    const StepCallback callback = {core->intermediate_update ? after_inner_step : 0, &context, 0};
    const double minimum_step = fmax(1e-14 * length, DBL_MIN); /* a smaller one does not change the time */
    double tau = length;
    int observed = 0; /* 1: the states have not changed since z was computed */
    prepare(core);
    if (SAMPLING > 0.0) {
        const int samples = advance_samples(core, length);
        if (samples < 0) return 0;
        observed = core->z_valid && samples == 0;
    } else if (NX > 0) {
        if (EXPLICIT_FIRST) {
            observe_states(core);
            model_derivatives(s->x, s->last_set, s->p, core->c, core->z, core->work.f0);
        }
        const Report report = solve(s->x, s->p, core->c, &core->inputs, length, s->tolerance, minimum_step,
                                    &callback, &s->memory, &core->work);
        s->time = context.begin;
        core_invalidate_states(core);
        if (report.outcome != SOLVED) {
            report_failure(core, &report);
            return 0;
        }
        tau = report.tau;
    }
    core_set_time(core, context.begin, tau);
    core->z_valid = observed;
    return 1;
}
