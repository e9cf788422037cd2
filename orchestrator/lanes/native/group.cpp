/* Co-simulation of a group of machines in the lanes of a processor: what communication_step.c, coupling_input.c and
   simulation_loop.c of the engine do for one machine, with equal results up to the tolerance of the FMUs. The plan of
   the master is that of the engine (orchestrator/engine/masters.py). There are no calls: all values are in the
   instances of the models. FMUs follow cubics, and slopes of all outputs are known. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "group.h"

namespace engine {
#include "engine.h"
#include "step_size.c"
}

static_assert(sizeof(Course) == COURSE_VECTORS * sizeof(Lanes), "memory for courses");
static_assert(sizeof(Pace) == PACE_VECTORS * sizeof(Lanes), "memory for a pace");

static const Mask NONE = {Bits(0)};

static Lanes &input_value(const Group *g, const Plan *plan, int component, int input) {
    return g->instances[component]->values[plan->models[component]->parameters + input];
}

static void set_input(const Group *g, const Plan *plan, int component, int input, Lanes value) {
    input_value(g, plan, component, input) = g->instances[component]->last_set[input] = value;
}

static void note_change(Group *g, int component, Mask changed) {
    g->changed[component] = g->changed[component] || changed;
}

static Lanes source_value(const Group *g, const Connection *c) {
    return g->instances[c->source]->values[c->reference] * c->factor + c->offset;
}

static Lanes source_slope(const Group *g, const Connection *c) {
    return g->instances[c->source]->slopes[c->reference] * c->factor;
}

/* The machines that the models advance; the others cannot fail. */
static void set_moving(const Plan *plan, Group *g, Mask machines) {
    g->pace->moving = machines;
    for (int k = 0; k < plan->component_count; k++) *g->instances[k]->alive = machines;
}

/* A machine that has failed in one component is left out in all of them. */
static void collect_failures(const Plan *plan, Group *g, int component) {
    const Mask failed = g->pace->moving && !*g->instances[component]->alive;
    if (!any(failed)) return;
    for (int i = 0; i < LANES; i++) {
        if (!failed.bits[i]) continue;
        g->failures[i] = g->instances[component]->failures[i];
        g->failures[i].component = component;
        g->failures[i].time += g->pace->t[i]; /* from the beginning of the communication step */
    }
    g->pace->alive = g->pace->alive && !failed;
    set_moving(plan, g, g->pace->moving && !failed);
}

/* ---- polynomials of the inputs, as in coupling_input.c ----------------------------------------- */

static void set(Lanes *c, Lanes c0, Lanes c1, Lanes c2, Lanes c3) { c[0] = c0, c[1] = c1, c[2] = c2, c[3] = c3; }

/* Where all machines take equal steps, Time is double: the compiler divides by a step once for all. */
static double where(bool condition, double a, double b) { return condition ? a : b; }
template <class Time> static Time length_before(const Group *g);
template <> Lanes length_before(const Group *g) { return g->pace->length; }
template <> double length_before(const Group *g) { return g->pace->length[0]; }

template <class Time>
static Lanes value_at(const Lanes *c, Time s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
template <class Time>
static Lanes slope_at(const Lanes *c, Time s) { return c[1] + s * (2.0 * c[2] + s * (3.0 * c[3])); }

/* `length` of the last step; before the first one slope_before and chord_before make a straight line. */
template <class Time>
static void continued(const Course *s, int order, Time length, Lanes *c) {
    const Lanes a = s->slope, b = s->slope_before, chord = s->chord_before;
    length = where(length > 0.0, length, 1.0);
    if (order == 0) set(c, s->value, 0.0, 0.0, 0.0);
    else if (order == 1) set(c, s->value, a, 0.0, 0.0);
    else if (order == 2) set(c, s->value, a, (a - b) / (2.0 * length), 0.0);
    else set(c, s->value, a, (2.0 * a + b - 3.0 * chord) / length, (a + b - 2.0 * chord) / (length * length));
}

template <class Time>
static void between_ends(const Course *s, int degree, Time h, Lanes *c) {
    const Lanes chord = (s->value_end - s->value) / h, a = s->slope, b = s->slope_end;
    if (degree == 1) set(c, s->value, chord, 0.0, 0.0);
    else if (degree == 2) set(c, s->value, a, (chord - a) / h, 0.0);
    else set(c, s->value, a, (3.0 * chord - 2.0 * a - b) / h, (a + b - 2.0 * chord) / (h * h));
}

template <class Time>
static void extrapolate(const Group *g, Course *s, int order, Time h) {
    continued(s, order, length_before<Time>(g), s->c);
    s->expected = value_at(s->c, h);
    s->weight = 1.0;
}

/* Machines for which an autonomous source is a straight line over the step. */
template <class Time>
static Mask is_straight(const Course *s, Time h) {
    const Lanes chord = (s->value_end - s->value) / h;
    const Lanes tolerance = 1e-6 * (fabs(chord) + fabs(s->slope) + fabs(s->slope_end));
    return fmin(fabs(chord - s->slope), fabs(chord - s->slope_end)) <= tolerance;
}

template <class Time>
static void interpolate_at(const Group *g, Course *s, int degree, Time h) {
    Lanes past[FOLLOWED + 1], weight = 0.25;
    between_ends(s, degree, h, s->c);
    const Time before = length_before<Time>(g);
    continued(s, degree, before, past);
    for (int i = 1; i < degree; i++) weight = weight * (h / (h + before));
    s->expected = value_at(past, h);
    s->weight = weight;
}

/* Goes back to another polynomial for machines that are not in the mask. */
static void keep(Course *s, const Course *before, Mask changed) {
    for (int k = 0; k <= FOLLOWED; k++) s->c[k] = where(changed, s->c[k], before->c[k]);
    s->expected = where(changed, s->expected, before->expected);
    s->weight = where(changed, s->weight, before->weight);
}

template <class Time>
static void interpolate(const Group *g, Course *s, int degree, int autonomous, Time h) {
    const Mask straight = autonomous && degree > 1 ? is_straight(s, h) : NONE;
    interpolate_at(g, s, degree, h);
    if (!any(straight)) return;
    const Course curved = *s;
    interpolate_at(g, s, 1, h);
    keep(s, &curved, straight);
}

template <class Time>
static void accept(Course *s, Time h, Mask machines) {
    const Course before = *s;
    s->chord_before = (s->value_end - s->value) / h;
    s->slope_before = s->slope;
    s->slope = s->slope_end;
    s->value = s->value_end;
    s->scale = fmax(s->scale, fabs(s->value));
    if (all(machines)) return;
    s->chord_before = where(machines, s->chord_before, before.chord_before);
    s->slope_before = where(machines, s->slope_before, before.slope_before);
    s->slope = where(machines, s->slope, before.slope);
    s->value = where(machines, s->value, before.value);
    s->scale = where(machines, s->scale, before.scale);
}

static Lanes relative(const Course *s, Lanes deviation) {
    const Lanes magnitude = fmax(s->scale, fabs(s->value_end));
    return where(magnitude > 0.0, fabs(deviation) / magnitude);
}

/* ---- the scenario ------------------------------------------------------------------------------ */

static int64_t interval_at(const Plan *plan, Group *g, int lane, double t) {
    int64_t low = 0, high = plan->samples;
    const int64_t last = g->pace->interval[lane];
    if ((last == 0 || plan->time[last - 1] <= t) && (last == plan->samples || t < plan->time[last])) return last;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (t < plan->time[middle]) high = middle;
        else low = middle + 1;
    }
    return g->pace->interval[lane] = low;
}

/* Machines with equal steps have one time. */
static int lanes_in_time(const Plan *plan) { return plan->adaptive ? LANES : 1; }

static Lanes command(const Plan *plan, Group *g, int i, Lanes t) {
    const Drive *d = &plan->drives[i];
    Lanes value;
    if (g->commands) {
        memcpy((void *)&value, g->commands + (size_t)d->column * LANES, sizeof value);
        return value * d->factor + d->offset;
    }
    for (int lane = 0; lane < lanes_in_time(plan); lane++) {
        const int64_t k = interval_at(plan, g, lane, t[lane]), column = k * plan->width + d->column;
        const double x = plan->base[column] + (t[lane] - plan->anchor[k]) * plan->slopes[column];
        if (!plan->adaptive) return x * d->factor + d->offset;
        value.v[lane] = x;
    }
    return value * d->factor + d->offset;
}

static Lanes slope(const Plan *plan, Group *g, const Drive *d, Lanes t) {
    Lanes result = 0.0;
    for (int lane = 0; lane < lanes_in_time(plan) && !g->commands; lane++) {
        const double x = plan->slopes[interval_at(plan, g, lane, t[lane]) * plan->width + d->column] * d->factor;
        if (!plan->adaptive) return x;
        result.v[lane] = x;
    }
    return result;
}

static void set_driven_inputs(const Plan *plan, Group *g, Lanes t) {
    for (int i = 0; i < plan->drive_count; i++) {
        const Drive *d = &plan->drives[i];
        set_input(g, plan, d->component, d->input, command(plan, g, i, t));
        if (d->rate < 0) continue;
        const Lanes rate = slope(plan, g, d, t);
        note_change(g, d->component, input_value(g, plan, d->component, d->rate) != rate);
        set_input(g, plan, d->component, d->rate, rate);
    }
}

template <class Time>
static void set_driven_courses(const Plan *plan, Group *g, Time h) {
    for (int i = 0; i < plan->drive_count; i++) {
        Course *s = &g->courses[plan->drives[i].coupling_input];
        const Lanes middle = command(plan, g, i, g->pace->t + 0.5 * h);
        s->value_end = command(plan, g, i, g->pace->t + h);
        if (g->commands) s->value = s->value_end; /* a held command jumps at the beginning of a step */
        between_ends(s, 1, h, s->c);
        s->expected = s->value_end + (middle - 0.5 * (s->value + s->value_end));
        s->weight = 1.0;
    }
}

/* ---- one communication step, as in communication_step.c ---------------------------------------- */

static void copy(const Plan *plan, Group *g, const Connection *connections, int count) {
    for (int i = 0; i < count; i++) {
        const Connection *c = &connections[i];
        const Lanes now = source_value(g, c);
        if (c->checked) note_change(g, c->target, input_value(g, plan, c->target, c->input) != now);
        set_input(g, plan, c->target, c->input, now);
    }
}

/* Sets the inputs that the master does not vary to the newest values of their sources. */
static void set_held(const Plan *plan, Group *g, int component, Mask machines) {
    for (int i = plan->first_held[component]; i < plan->first_held[component + 1]; i++) {
        const Connection *c = &plan->held[i];
        const Lanes now = source_value(g, c), before = input_value(g, plan, component, c->input);
        set_input(g, plan, component, c->input, all(machines) ? now : where(machines, now, before));
    }
}

/* Exchanges all outputs and inputs at t [s], after outputs have been computed from the inputs at the end of a step. */
static void exchange(const Plan *plan, Group *g, Lanes t) {
    for (int k = 0; k < plan->component_count; k++) g->changed[k] = NONE;
    set_driven_inputs(plan, g, t);
    for (int i = 0; i < plan->exchange_count; i++) {
        const Instruction *p = &plan->exchange[i];
        if (p->type == COPY) copy(plan, g, plan->connections + p->index, p->count);
        if (p->type == DERIVATIVES) plan->models[p->index]->derivatives_now(g->instances[p->index]);
        if (p->type != OUTPUTS || !any(g->changed[p->index])) continue;
        plan->models[p->index]->outputs_again(g->instances[p->index], g->changed[p->index]);
        g->changed[p->index] = NONE;
    }
}

static void read_slopes(const Plan *plan, Group *g) {
    for (int k = 0; k < plan->component_count; k++)
        if (plan->needs_slopes[k]) plan->models[k]->slopes_now(g->instances[k]);
}

/* The outputs of a component, or of all (-1), are the ends of the inputs that they feed. */
static void set_source_ends(const Plan *plan, Group *g, int component) {
    for (int i = 0; i < plan->input_count; i++) {
        const Connection *from = &plan->inputs[i].from;
        if (from->source == DRIVEN || (component >= 0 && from->source != component)) continue;
        g->courses[i].value_end = source_value(g, from);
        if (plan->needs_slopes[from->source]) g->courses[i].slope_end = source_slope(g, from);
    }
}

/* Makes the polynomials of the inputs of a component, for those machines that compute it in this pass. */
template <class Time>
static void set_courses(const Plan *plan, Group *g, int component, int pass, Time h, Mask machines) {
    for (int i = plan->first_input[component]; i < plan->first_input[component + 1]; i++) {
        const Input *input = &plan->inputs[i];
        Course *s = &g->courses[i];
        if (input->from.source == DRIVEN) continue;
        const Course before = *s;
        if (input->requested_degree && (pass || (plan->sequential && input->in_order)))
            interpolate(g, s, plan->degree, input->autonomous, h);
        else extrapolate(g, s, input->order, h);
        if (pass) keep(s, &before, machines);
    }
}

static void set_coupling_inputs(const Plan *plan, Group *g, int component) {
    Instance *instance = g->instances[component];
    for (int i = plan->first_input[component]; i < plan->first_input[component + 1]; i++) {
        const Input *input = &plan->inputs[i];
        const Course *s = &g->courses[i];
        if (!input->requested_degree) continue;
        Lanes *derivatives = instance->derivatives + 3 * input->from.input;
        if (g->commands) set_input(g, plan, component, input->from.input, s->c[0]);
        derivatives[0] = s->c[1], derivatives[1] = 2.0 * s->c[2], derivatives[2] = 6.0 * s->c[3];
        instance->has_derivatives[input->from.input] = 1;
    }
}

template <class Time>
static void pass_over_components(const Plan *plan, Group *g, int pass, Time h, Mask machines) {
    for (int i = 0; i < plan->component_count; i++) {
        const int k = plan->order[i];
        if (pass && !plan->repeated[k]) continue;
        if (plan->sequential) set_courses(plan, g, k, pass, h, machines);
        if (pass) plan->models[k]->restore(g->instances[k], machines);
        set_held(plan, g, k, machines);
        set_coupling_inputs(plan, g, k);
        plan->models[k]->step(g->instances[k], h, machines);
        collect_failures(plan, g, k);
        if (!plan->sequential) continue;
        if (plan->needs_slopes[k]) plan->models[k]->slopes_now(g->instances[k]);
        set_source_ends(plan, g, k);
    }
}

/* Machines for which a further pass could change an input by more than the tolerance. */
template <class Time>
static Mask mismatched(const Plan *plan, const Group *g, Time h) {
    Lanes most = 0.0;
    for (int i = 0; i < plan->input_count; i++) {
        const Course *s = &g->courses[i];
        if (plan->inputs[i].from.source == DRIVEN) continue;
        Lanes deviation = fabs(value_at(s->c, h) - s->value_end);
        if (!plan->inputs[i].autonomous) deviation = fmax(deviation, h * fabs(slope_at(s->c, h) - s->slope_end));
        most = fmax(most, relative(s, deviation));
    }
    return g->pace->moving && most > plan->pass_tolerance;
}

template <class Time>
static void communication_step(const Plan *plan, Group *g, Time h) {
    Mask machines = g->pace->moving;
    set_driven_courses(plan, g, h);
    for (int k = 0; k < plan->component_count && !plan->sequential; k++) set_courses(plan, g, k, 0, h, machines);
    for (int pass = 0; pass < plan->passes && any(machines); pass++) {
        pass_over_components(plan, g, pass, h, machines);
        if (plan->passes > 1) machines = machines && mismatched(plan, g, h);
    }
}

/* The estimated error of the step of each machine. */
static Lanes step_error(const Plan *plan, const Group *g, Lanes h) {
    Lanes most = 0.0;
    for (int i = 0; i < plan->input_count; i++) {
        const Course *s = &g->courses[i];
        const Lanes by_past = s->weight * (s->expected - s->value_end), at_end = value_at(s->c, h) - s->value_end;
        const Mask further = plan->passes > 1 ? fabs(at_end) > fabs(by_past) : at_end != at_end;
        const Lanes error = relative(s, where(further, at_end, by_past));
        most = where(error <= most || most != most, most, error); /* NaN if one is */
    }
    return most;
}

/* ---- the run, as in simulation_loop.c ---------------------------------------------------------- */

static void save(const Plan *plan, Group *g) {
    for (int k = 0; k < plan->component_count; k++) plan->models[k]->save(g->instances[k]);
}

static void record(const Plan *plan, Group *g) {
    if (!g->rows || g->row >= g->points) return;
    const Mask left = g->pace->alive;
    for (int i = 0; i < plan->signal_count; i++) {
        const Signal *signal = &plan->signals[i];
        const Lanes value = where(left, g->instances[signal->component]->values[signal->reference], NAN);
        double *to = g->rows[i] + g->machine * g->points + g->row;
        for (int lane = 0; lane < g->machines; lane++) to[lane * g->points] = value[lane];
    }
    g->row++;
}

static void begin_course(const Plan *plan, const Group *g, int i) {
    const Input *input = &plan->inputs[i];
    const int driven = input->from.source == DRIVEN, with_slope = !driven && plan->needs_slopes[input->from.source];
    Course *s = &g->courses[i];
    s->value = driven ? input_value(g, plan, input->from.target, input->from.input) : source_value(g, &input->from);
    s->slope = with_slope ? source_slope(g, &input->from) : 0.0;
    s->slope_before = s->chord_before = s->slope; /* until there is a history: a straight line */
    s->scale = fmax(input->nominal, fabs(s->value));
    set(s->c, s->value, s->slope, 0.0, 0.0);
}

/* Machines whose error over a step of length h is small enough; proposes the next length of each. With equal steps all
   lanes go on, also those of machines that have failed: the first one has the time of all. */
static Mask accepted(const Plan *plan, Group *g, Lanes h) {
    if (!plan->adaptive) return !NONE;
    const Lanes error = step_error(plan, g, h) / plan->guard;
    engine::StepSize *sizes = (engine::StepSize *)g->step_size;
    Mask result = g->pace->moving;
    for (int i = 0; i < LANES; i++)
        if (result.bits[i] && !engine::step_size_accepts(&sizes[i], error[i], h[i])) result.bits[i] = 0;
    return result;
}

/* Takes a step of length h [s]. Machines whose error is too large, and those that do not move, are back at its
   beginning. Returns the others. */
template <class Time>
static Mask try_step(const Plan *plan, Group *g, Time h) {
    Pace *pace = g->pace;
    if (plan->passes > 1 || plan->adaptive) save(plan, g);
    communication_step(plan, g, h);
    exchange(plan, g, pace->t + h);
    read_slopes(plan, g);
    set_source_ends(plan, g, -1);
    const Mask done = accepted(plan, g, h), back = pace->alive && !done;
    for (int i = 0; i < plan->input_count; i++) accept(&g->courses[i], h, done);
    pace->length = where(done, h, pace->length);
    for (int k = 0; k < plan->component_count && any(back); k++) plan->models[k]->restore(g->instances[k], back);
    return done;
}

/* Tries the next step of each machine once, up to the next point or event at most. */
static void next_step(const Plan *plan, Group *g) {
    const double point = plan->start + (double)(g->done + 1) * plan->step;
    Pace *pace = g->pace;
    Lanes h = plan->step, target = point; /* any for machines that wait at the point */
    set_moving(plan, g, pace->alive && pace->t < point);
    for (int i = 0; i < lanes_in_time(plan); i++) {
        if (plan->adaptive && !pace->moving.bits[i]) continue;
        int64_t *event = &pace->event[i];
        while (*event < plan->event_count && plan->events[*event] <= pace->t[i]) ++*event;
        if (*event < plan->event_count) target.v[i] = fmin(point, plan->events[*event]);
        h.v[i] = target[i] - pace->t[i];
        if (plan->adaptive) h.v[i] = engine::step_size_next((engine::StepSize *)g->step_size + i, h[i]);
    }
    if (!plan->adaptive) h = h[0], target = target[0];
    const Mask last = h == target - pace->t;
    const Mask done = plan->adaptive ? try_step(plan, g, h) : try_step(plan, g, h[0]);
    pace->t = where(done, where(last, target, pace->t + h), pace->t);
    set_moving(plan, g, pace->alive);
    if (any(pace->alive && pace->t < point)) return;
    g->done++;
    if (g->done % plan->every == 0 || g->done == plan->steps) record(plan, g);
}

extern "C" {

/* Makes start values, inputs and outputs consistent: computes the initial states and copies values along the
   connections until nothing changes. Returns 0 if they keep changing: there is an algebraic loop. */
EXPORT int32_t group_initialise(const Plan *plan, Group *g) {
    const int rounds = plan->component_count + 2;
    for (int k = 0; k < plan->component_count; k++) plan->models[k]->prepare(g->instances[k]);
    g->pace->t = plan->start;
    set_driven_inputs(plan, g, g->pace->t);
    for (int round = 0; round < rounds; round++) {
        int changed = 0;
        for (int k = 0; k < plan->component_count; k++) {
            plan->models[k]->start(g->instances[k]);
            plan->models[k]->outputs_now(g->instances[k]);
        }
        for (int i = 0; i < plan->connection_count; i++) {
            const Connection *c = &plan->connections[i];
            const Lanes before = input_value(g, plan, c->target, c->input), now = source_value(g, c);
            changed |= any(before != now && (before == before || now == now));
            set_input(g, plan, c->target, c->input, now);
        }
        if (!changed) return 1;
    }
    return 0;
}

/* Begins the run at the consistent values, and records them. */
EXPORT int32_t group_begin(const Plan *plan, Group *g) {
    exchange(plan, g, g->pace->t);
    set_moving(plan, g, g->pace->alive);
    for (int n = 0; n < plan->initial_rounds; n++) {
        read_slopes(plan, g);
        for (int i = 0; i < plan->input_count; i++) begin_course(plan, g, i);
        for (int k = 0; k < plan->component_count; k++) set_coupling_inputs(plan, g, k);
    }
    for (int k = 0; k < plan->component_count; k++) {
        plan->models[k]->check(g->instances[k], 0.0);
        collect_failures(plan, g, k);
    }
    record(plan, g);
    return 1;
}

/* Steps up to a communication point, or until another thread stops it. With commands only the last point is
   recorded. Returns 0 if all machines have failed. */
EXPORT int32_t group_advance(const Plan *plan, Group *g, int64_t point) {
    if (g->commands) g->row = g->points;
    while (g->done < point && any(g->pace->alive) && !*(volatile int32_t *)&g->stop) next_step(plan, g);
    if (!any(g->pace->alive)) {
        g->done = point;
        g->pace->t = plan->start + (double)point * plan->step;
    }
    if (g->commands) {
        g->row = 0;
        record(plan, g);
    }
    return any(g->pace->alive);
}

/* Replaces machines by those in the same lanes of another group, which have just begun; lanes: 1 to replace, else 0. */
EXPORT int32_t group_adopt(const Plan *plan, Group *g, const Group *from, const int64_t *lanes) {
    Bits bits;
    memcpy((void *)&bits, lanes, sizeof bits);
    const Mask chosen = {bits != 0};
    const Mask alive = (g->pace->alive && !chosen) || (from->pace->alive && chosen);
    const engine::StepSize *sizes = (const engine::StepSize *)from->step_size;
    g->pace->alive = alive;
    g->pace->length = where(chosen, from->pace->length, g->pace->length);
    g->pace->t = plan->start + (double)g->done * plan->step; /* with steps of their own, failed ones have stopped */
    for (int i = 0; i < LANES; i++) {
        if (!lanes[i]) continue;
        g->failures[i] = from->failures[i];
        if (plan->adaptive) ((engine::StepSize *)g->step_size)[i] = sizes[i];
    }
    for (int k = 0; k < plan->component_count; k++) plan->models[k]->adopt(g->instances[k], from->instances[k], chosen);
    set_moving(plan, g, alive);
    Lanes *to = (Lanes *)g->courses;
    const Lanes *new_ones = (const Lanes *)from->courses;
    for (int i = 0; i < plan->input_count * COURSE_VECTORS; i++) to[i] = where(chosen, new_ones[i], to[i]);
    return any(alive);
}
}
