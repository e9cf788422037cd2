/* The loop over communication steps: tries, repeats and accepts them, records rows and adds up coupling energies.
 *
 * simulation_advance calls next_step until a block of rows is full; try_step calls communication_step.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double LEAST = 1e-9; /* smallest part of a discarded step that is repeated, over its length */

/* ---- communication points */

/* Sets driven inputs to their value at t [s], then exchanges outputs and inputs; those of first_reads are known. */
int exchange_after_reads(Simulation *sim, Real t) {
    const int verdict = scenario_set_inputs(sim, t);
    return verdict ? verdict : execute(sim, &sim->exchange);
}

int32_t simulation_exchange(Simulation *sim, Real t) {
    set_clocks(sim, t);
    const int verdict = execute(sim, &sim->first_reads);
    return verdict ? verdict : exchange_after_reads(sim, t);
}

static int read_slopes(Simulation *sim) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        verdict = execute(sim, &sim->components[k].slope_reads);
    return verdict;
}

/* Exchanges values at the end of a step, after all components have stepped. */
static int exchange_at_end(Simulation *sim, Real h) {
    int verdict = simulation_exchange(sim, sim->end);
    if (!verdict) verdict = read_slopes(sim);
    if (!verdict) set_source_ends(sim, h);
    return verdict;
}

/* ---- coupling energy of power bonds, see recorder.py */

/* Stores the inputs that the FMUs used, before new inputs are set. */
static int store_used_inputs(Simulation *sim) {
    EnergyMonitor *m = &sim->energy;
    const int verdict = m->count ? execute(sim, &m->input_reads) : CONTINUE;
    for (int32_t i = 0; i < m->count && !verdict; i++) {
        const int64_t k = m->indices[i];
        m->used_start[i] = m->varied[i] ? sim->input_ends[k] : sim->reals[m->set_indices[i]];
        m->used_end[i] = m->varied[i] ? sim->input_ends[sim->real_count + k] : m->read_values[m->read_indices[i]];
    }
    return verdict;
}

/* The next step of some machines begins with the present values. */
static void begin_energy(Simulation *sim, Mask machines) {
    EnergyMonitor *m = &sim->energy;
    for (int32_t i = 0; i < m->count; i++) m->start[i] = where(machines, sim->reals[m->indices[i]], m->start[i]);
}

static Real residual(const Real *truth, const Real *used) { return truth[0] * used[1] - used[0] * truth[1]; }

/* Adds the energies of the step of some machines, by the trapezoidal rule. */
static void add_energy(Simulation *sim, Real h, Mask machines) {
    EnergyMonitor *m = &sim->energy;
    const int32_t bonds = m->count / 2;
    for (int32_t i = 0; i < bonds; i++) {
        Real *start = m->start + 2 * i;
        const Real end[] = {sim->reals[m->indices[2 * i]], sim->reals[m->indices[2 * i + 1]]};
        const Real error = 0.5 * h * (residual(start, m->used_start + 2 * i) + residual(end, m->used_end + 2 * i));
        const Real exchanged = 0.5 * h * (fabs(start[0] * start[1]) + fabs(end[0] * end[1]));
        m->sums[i] += where(machines, error, 0.0);
        m->sums[bonds + i] += where(machines, fabs(error), 0.0);
        m->sums[2 * bonds + i] += where(machines, exchanged, 0.0);
        for (int j = 0; j < 2; j++) start[j] = where(machines, end[j], start[j]);
    }
}

/* ---- the beginning of inputs */

/* Lists the inputs that each component feeds. */
static void list_fed_inputs(Simulation *sim) {
    for (int32_t k = 0; k < sim->component_count; k++) sim->components[k].first_fed = -1;
    for (int32_t i = sim->input_count - 1; i >= 0; i--) {
        CouplingInput *s = &sim->inputs[i];
        if (s->source_component == DRIVEN) continue;
        int32_t *first = &sim->components[s->source_component].first_fed;
        s->next_fed = *first, *first = i;
    }
}

/* Marks inputs fed from algebraic loops; slopes of their sources depend on each other and are not used. */
static void mark_loops(Simulation *sim) {
    for (int32_t k = 0; k < sim->loop_count; k++) {
        AlgebraicLoop *loop = sim->loops[k];
        loop->solved_in_passes = loop->declared || loop->flags[CIRCULAR];
        for (int32_t j = 0; j < loop->output_count && loop->solved_in_passes; j++)
            for (int32_t i = 0; i < sim->input_count; i++)
                if (sim->inputs[i].source == loop->output_indices[j])
                    sim->inputs[i].in_loop = 1, sim->inputs[i].source_slope = NULL;
    }
}

static void begin_input(const Simulation *sim, CouplingInput *s, Mask machines) {
    const CouplingInput before = *s;
    if (s->source_component == DRIVEN) input_begin(s, sim->reals[s->target], 0.0);
    else input_begin(s, sim->reals[s->source] * s->factor + s->offset, source_slope(s));
    if (all(machines)) return;
    input_replace(s, &before, !machines);
    s->c[0] = s->value, s->c[1] = s->slope, s->c[2] = s->c[3] = 0.0; /* where the others are */
}

/* Begins all inputs of some machines. The slope of an output may depend on slopes of inputs, so slopes are read in
 * several rounds. */
static int begin_inputs(Simulation *sim, Mask machines) {
    int verdict = CONTINUE;
    for (int32_t n = 0; n < sim->initial_rounds && !verdict; n++) {
        verdict = read_slopes(sim);
        for (int32_t i = 0; i < sim->input_count; i++) begin_input(sim, &sim->inputs[i], machines);
        for (int32_t k = 0; k < sim->component_count && !verdict; k++)
            verdict = component_set_inputs(sim, &sim->components[k], 0.0, 0.0, 0);
    }
    return verdict;
}

/* ---- steps */

static int save_states(Simulation *sim) {
    int verdict = values_save(sim);
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_save(sim, k);
    return verdict;
}

/* Machines go back to the beginning of the step. */
static int go_back(Simulation *sim, Mask machines) {
    int verdict = values_restore(sim);
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_restore(sim, k, machines);
    return verdict ? verdict : values_set(sim);
}

#if WIDTH == 1
/* Goes back after a step with an event inside, or one that has become too short for it. */
static int repeat_for_event(Simulation *sim, double h, int met) {
    int goes_back = 1;
    const int verdict = met ? event_approached(sim, h, &goes_back) : CONTINUE;
    return verdict || !goes_back ? verdict : go_back(sim, EVERY_MACHINE);
}

/* Goes back after a step of which an FMU did only the first part; the next one is shorter. */
static int retry_discarded(Simulation *sim, double h) {
    const double reached = sim->reached - sim->t;
    const double shorter = LEAST * h < smaller(reached, h - reached) ? reached : 0.5 * h; /* neither part is rounding */
    if (!sim->rollback || shorter <= LEAST * sim->step) return STOP;
    sim->shorter = shorter;
    return go_back(sim, EVERY_MACHINE);
}
#endif

/* The machines whose error is small enough; proposes the next length of each. With equal steps all go on, also those
 * that have failed. */
static Mask accepted(Simulation *sim, Real h) {
    if (!sim->step_size) return EVERY_MACHINE;
    const Real error = step_error(sim, h) / sim->error_tolerance;
    Mask machines = sim->moving;
    for (int i = 0; i < WIDTH; i++)
        if (chosen(machines, i) && !step_size_accepts(&sim->step_size[i], machine(error, i), machine(h, i)))
            remove_machine(&machines, i);
    sim->diverged = WIDTH == 1 && any(machines && !is_finite(error));
    return machines;
}

static void accept_input(CouplingInput *s, Real h, Mask machines) {
    const int others = !all(machines);
    CouplingInput before;
    if (others) before = *s;
    input_accept(s, h);
    if (others) input_replace(s, &before, !machines);
}

/* The end of the step is the beginning of the next one. */
static int accept(Simulation *sim, Real h, Mask machines) {
    const int verdict = sim->errors ? error_propagate(sim, h) : CONTINUE;
    if (verdict) return verdict;
#if WIDTH == 1
    looks_compare(sim, h);
#endif
    for (int32_t i = 0; i < sim->input_count; i++) accept_input(&sim->inputs[i], h, machines);
    if (sim->prediction) sim->prediction->valid = 0;
    add_energy(sim, h, machines);
    sim->length_before = where(machines, sim->length, sim->length_before);
    sim->length = where(machines, h, sim->length);
    return CONTINUE;
}

/* Takes a step of length h. Machines whose error is too large, and those that do not move, go back; `done`: the others. */
static int try_step(Simulation *sim, Real h, Mask *done) {
    int passes = 0;
    *done = NO_MACHINE;
    int verdict = CONTINUE;
#if WIDTH == 1
    verdict = looks_take(sim, h);
#endif
    if (!verdict && sim->saves) verdict = save_states(sim);
    if (verdict) return verdict;
#if WIDTH == 1
    const double end = sim->end;
    const int with_events = sim->events.present;
    if (with_events) event_try(sim);
#endif
    verdict = communication_step(sim, h, &passes);
#if WIDTH == 1
    if (with_events && sim->end < end) h = sim->end - sim->t; /* the only FMU has stopped */
#endif
    if (!verdict) verdict = store_used_inputs(sim);
    if (!verdict) verdict = exchange_at_end(sim, h);
#if WIDTH == 1
    if (verdict == DISCARDED) return retry_discarded(sim, h);
    if (verdict == AT_EVENT) return repeat_for_event(sim, h, 1);
    if (!verdict && with_events) {
        if (event_missed(sim, h)) return repeat_for_event(sim, h, 0);
        sim->events.low = sim->events.high = 0.0, sim->events.tries = 0;
    }
#endif
    if (verdict) return verdict;
    sim->all_passes += passes;
    if (!rounds_to_nearest()) environment_restore(sim, NULL, ANY_COMPONENT);
    *done = accepted(sim, h);
    if (any(*done)) verdict = accept(sim, h, *done);
    if (verdict || all(*done)) return verdict;
    return any(sim->alive && !*done) ? go_back(sim, sim->alive && !*done) : CONTINUE;
}

static double point_at(const Simulation *sim, int64_t n) { return sim->start + (double)n * sim->step; }

/* The length of the next step of each machine, up to the next point or division at most; `target`: that time,
 * `rest`: the time until then. From point to point it is exactly the step, not the difference of two rounded times. */
static Real next_length(Simulation *sim, Real *target, Real *rest) {
    const int count = sim->step_size ? WIDTH : 1;
    const double last = point_at(sim, sim->done), point = point_at(sim, sim->done + 1);
    Real h = sim->step; /* any for machines that wait at the point */
    *target = point, *rest = sim->step;
    for (int i = 0; i < count; i++) {
        if (sim->step_size && !chosen(sim->moving, i)) continue;
        const double t = machine(sim->t, i);
        int64_t *next = &sim->next_divided[i];
        while (*next < sim->divided_count && sim->divided[*next] <= t) ++*next;
        double to = *next < sim->divided_count ? smaller(point, sim->divided[*next]) : point;
#if WIDTH == 1
        const double event = sim->events.next; /* one that is nearly at the point takes place there */
        if (sim->events.divides && event > t && event < to - sim->events.tolerance) to = event;
        if (sim->events.period > 0.0) to = event_expected(sim, t, to);
#endif
        const double left = t == last && to == point ? sim->step : to - t;
        set_machine(target, i, count, to);
        set_machine(rest, i, count, left);
        set_machine(&h, i, count, sim->step_size ? step_size_next(&sim->step_size[i], left) : left);
    }
    return sim->shorter > 0.0 ? smaller(h, sim->shorter) : h;
}

/* All inputs begin anew after a jump of the scenario, or an event: the past does not tell their course. sizes: lengths of
 * adaptive steps, too. */
static int restart(Simulation *sim, Mask machines, int sizes) {
    sim->length = where(machines, 0.0, sim->length);
    sim->length_before = where(machines, 0.0, sim->length_before);
    const int verdict = begin_inputs(sim, machines);
    begin_energy(sim, machines);
#if WIDTH == 1
    looks_begin(sim);
#endif
    for (int i = 0; sizes && i < WIDTH && sim->step_size; i++)
        if (chosen(machines, i)) step_size_begin(&sim->step_size[i]);
    if (sim->errors) error_jump(sim->errors);
    return verdict;
}

/* Exchanges the values after a jump of the scenario. */
static int jump(Simulation *sim, Mask machines) {
    sim->scenario->since = sim->t;
    sim->scenario->evaluated_at = NAN;
    const int verdict = simulation_exchange(sim, sim->t);
    return verdict ? verdict : restart(sim, machines, 1);
}

#if WIDTH == 1
static int go_through_events(Simulation *sim) {
    const int after_each = sim->t - sim->length <= sim->events.instant + sim->events.tolerance; /* steps would not grow */
    const int verdict = event_instant(sim);
    return verdict ? verdict : restart(sim, EVERY_MACHINE, !after_each);
}
#endif

#if WIDTH == 1
/* A row of this time is replaced; it stays if Python has taken it already. */
static void record_end(Simulation *sim) {
    Recorder *r = &sim->recorder;
    const double latest = r->latest;
    const int again = r->collected + r->filled > 0 && sim->t - latest <= sim->events.tolerance;
    if (again && !r->filled) return;
    r->filled -= again;
    record(sim);
    if (again) r->time[r->filled - 1] = latest;
}
#endif

/* Tries the next step of each machine once. */
static int next_step(Simulation *sim) {
    const double point = point_at(sim, sim->done + 1);
    Real target, rest;
    Mask done;
    machines_move(sim, sim->alive && sim->t < point);
    const Real h = next_length(sim, &target, &rest);
    sim->end = where(h == rest, target, sim->t + h);
    int verdict = try_step(sim, h, &done);
    if (verdict) return verdict;
    if (!any(done)) {
        sim->repeated++;
#if WIDTH == 1
        if (sim->events.due == AT_BEGINNING) return go_through_events(sim);
#endif
        return CONTINUE;
    }
    sim->t = where(done, sim->end, sim->t);
    sim->shorter = 0.0;
    sim->steps++;
    sim->shortest = smaller(sim->shortest, h);
    sim->longest = larger(sim->longest, h);
    const int there = !any(sim->alive && sim->t < point);
    sim->done += there;
    const Mask jumps = sim->scenario && !sim->scenario->commands ? scenario_jumps(sim->scenario, sim->t, done) : NO_MACHINE;
    verdict = any(jumps) ? jump(sim, jumps) : CONTINUE;
#if WIDTH == 1
    const int jumped = any(jumps) && sim->events.used;
    if (!verdict && sim->events.present && (jumped || event_due(sim))) verdict = go_through_events(sim);
    if (sim->events.ends) record_end(sim); /* all FMUs are at the event in which the run ends */
#endif
    if (verdict) return verdict;
    if (there || sim->free || sim->diverged) record(sim);
    return CONTINUE;
}

/* ---- the run */

/* Exchanges values at the start and records them. */
int32_t simulation_begin(Simulation *sim) {
    machines_move(sim, sim->alive = EVERY_MACHINE);
    int verdict = sim->prediction ? CONTINUE : simulation_exchange(sim, sim->t); /* done to begin the prediction */
    list_fed_inputs(sim);
    mark_loops(sim);
    if (!verdict) verdict = begin_inputs(sim, EVERY_MACHINE);
    if (!verdict) verdict = machines_check(sim);
    if (verdict) return verdict;
    if (sim->scenario) sim->scenario->since = sim->t;
    begin_energy(sim, EVERY_MACHINE);
#if WIDTH == 1
    looks_begin(sim);
    sim->events.present = sim->events.used || sim->events.real_count || sim->events.integer_count;
    event_values(sim);
    sim->events.instant = sim->t;
#endif
    record(sim);
    return sim->errors ? error_begin(sim) : CONTINUE;
}

#if WIDTH == 1
/* Goes on from a saved state; where another scenario has other values there, its inputs jump. */
int32_t simulation_resume(Simulation *sim) {
    if (!scenario_differs(sim)) return CONTINUE;
    const int verdict = jump(sim, EVERY_MACHINE);
    return !verdict && (sim->events.used || event_due(sim)) ? go_through_events(sim) : verdict;
}

/* Does Python have to collect estimated errors before the next step, which may add two rows of them? */
static int errors_are_full(const ErrorPropagation *p) { return p && p->filled + 2 > p->capacity; }

/* Steps until a block of points or of estimated errors is full, the run ends, or `patience` [s] of wall time have
 * passed. If the run diverged, Python finds the value that is not finite and ends the run. */
int32_t simulation_advance(Simulation *sim) {
    if (sim->threads > 1 && !sim->pool) sim->pool = pool_start(sim, sim->threads);
    const double began = seconds(), first = ticks();
    int verdict = CONTINUE;
    sim->diverged = 0;
    while (!verdict && sim->done < sim->total && sim->recorder.filled < sim->recorder.capacity) {
        verdict = next_step(sim);
        const double spent = sim->tick > 0.0 ? (ticks() - first) * sim->tick : seconds() - began;
        if (sim->diverged || errors_are_full(sim->errors) || spent > sim->patience || sim->t >= sim->pause) break;
    }
    sim->spent += seconds() - began, sim->counted += ticks() - first;
    if (sim->counted > 0.0) sim->tick = sim->spent / sim->counted;
    if (!verdict) environment_restore(sim, NULL, ANY_COMPONENT);
    return verdict;
}

int32_t simulation_close(Simulation *sim) {
    pool_stop(sim->pool);
    sim->pool = NULL;
    return CONTINUE;
}
#endif
