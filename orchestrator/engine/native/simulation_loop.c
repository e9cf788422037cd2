/* The loop over communication steps: tries, repeats and accepts them, records rows and adds up coupling energies.
 *
 * simulation_advance calls next_step until a block of rows is full; try_step calls communication_step.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double LEAST = 1e-9; /* smallest part of a discarded step that is repeated, over its length */

/* ---- communication points */

/* Sets driven inputs to their value at t [s], then exchanges all outputs and inputs. */
int32_t simulation_exchange(Simulation *sim, double t) {
    for (int32_t k = 0; k < sim->component_count; k++) sim->components[k].clock[0] = t;
    const int verdict = scenario_set_inputs(sim, t);
    return verdict ? verdict : execute(sim, &sim->exchange);
}

static int read_slopes(Simulation *sim) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        verdict = execute(sim, &sim->components[k].slope_reads);
    return verdict;
}

/* Exchanges values at the end of a step, after all components have stepped. */
static int exchange_at_end(Simulation *sim, double h) {
    int verdict = simulation_exchange(sim, sim->t + h);
    if (!verdict) verdict = read_slopes(sim);
    if (!verdict) set_source_ends(sim, h, EVERY_COMPONENT);
    return verdict;
}

static void record(Simulation *sim) {
    Recorder *r = &sim->recorder;
    double *reals = r->reals + (size_t)r->filled * (size_t)r->real_count;
    int32_t *integers = r->integers + (size_t)r->filled * (size_t)r->integer_count;
    r->time[r->filled] = sim->t;
    if (r->real_indices)
        for (int32_t i = 0; i < r->real_count; i++) reals[i] = sim->reals[r->real_indices[i]];
    else memcpy(reals, sim->reals, (size_t)r->real_count * sizeof *reals);
    for (int32_t i = 0; i < r->integer_count; i++) integers[i] = sim->integers[r->integer_indices[i]];
    r->filled++;
}

/* ---- coupling energy of power bonds, see recorder.py */

/* Stores the inputs that the FMUs used, before new inputs are set. */
static int store_used_inputs(Simulation *sim) {
    EnergyMonitor *m = &sim->energy;
    const int verdict = m->count ? execute(sim, &m->input_reads) : CONTINUE;
    for (int32_t i = 0; i < m->count && !verdict; i++) {
        const int64_t k = m->indices[i];
        m->used_start[i] = m->varied[i] ? sim->input_ends[k] : sim->reals[k];
        m->used_end[i] = m->varied[i] ? sim->input_ends[sim->real_count + k] : m->read_values[m->read_indices[i]];
    }
    return verdict;
}

static double residual(const double *truth, const double *used) { return truth[0] * used[1] - used[0] * truth[1]; }

/* Adds the energies of the step, by the trapezoidal rule. */
static void add_energy(Simulation *sim, double h) {
    EnergyMonitor *m = &sim->energy;
    const int32_t bonds = m->count / 2;
    for (int32_t i = 0; i < bonds; i++) {
        double *start = m->start + 2 * i;
        const double end[] = {sim->reals[m->indices[2 * i]], sim->reals[m->indices[2 * i + 1]]};
        const double error = 0.5 * h * (residual(start, m->used_start + 2 * i) + residual(end, m->used_end + 2 * i));
        m->sums[i] += error;
        m->sums[bonds + i] += fabs(error);
        m->sums[2 * bonds + i] += 0.5 * h * (fabs(start[0] * start[1]) + fabs(end[0] * end[1]));
        memcpy(start, end, sizeof end);
    }
}

/* ---- steps */

static int save_states(Simulation *sim) {
    memcpy(sim->saved_reals, sim->reals, (size_t)sim->real_count * sizeof *sim->reals);
    memcpy(sim->saved_integers, sim->integers, (size_t)sim->integer_count * sizeof *sim->integers);
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_save(sim, k);
    return verdict;
}

/* Goes back to the beginning of the step and withdraws its messages. */
static int go_back(Simulation *sim) {
    int verdict = sim->check_status(0, 0, WITHDRAWN);
    memcpy(sim->reals, sim->saved_reals, (size_t)sim->real_count * sizeof *sim->reals);
    memcpy(sim->integers, sim->saved_integers, (size_t)sim->integer_count * sizeof *sim->integers);
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_restore(sim, k);
    return verdict ? verdict : simulation_exchange(sim, sim->t); /* inputs may not be part of the state of an FMU */
}

/* Goes back after a step of which an FMU did only the first part; the next one is shorter. */
static int retry_discarded(Simulation *sim, double h) {
    const double reached = sim->reached - sim->t;
    const double shorter = LEAST * h < smaller(reached, h - reached) ? reached : 0.5 * h; /* neither part is rounding */
    if (!sim->rollback || shorter <= LEAST * sim->step) return STOP;
    sim->shorter = shorter;
    return go_back(sim);
}

/* Takes a step of length h; goes back if its error is too large. */
static int try_step(Simulation *sim, double h, int *accepted) {
    int passes = 0;
    *accepted = 0;
    int verdict = sim->saves ? save_states(sim) : CONTINUE;
    if (verdict) return verdict;
    verdict = communication_step(sim, h, &passes);
    if (verdict == DISCARDED) return retry_discarded(sim, h);
    if (verdict) return verdict;
    sim->all_passes += passes;
    verdict = store_used_inputs(sim);
    if (!verdict) verdict = exchange_at_end(sim, h);
    if (!rounds_to_nearest()) environment_restore(sim, ANY_COMPONENT);
    if (verdict) return verdict;
    if (sim->step_size) {
        const double e = (sim->by_energy ? power_error(sim, h) : step_error(sim, h)) / sim->error_tolerance;
        if (!step_size_accepts(sim->step_size, e, h)) return go_back(sim);
        sim->diverged = !isfinite(e);
    }
    if (sim->errors) verdict = error_propagate(sim, h);
    if (verdict) return verdict;
    for (int32_t i = 0; i < sim->input_count; i++) input_accept(&sim->inputs[i], h, sim->length);
    if (sim->prediction) prediction_accept(sim->prediction, h);
    sim->length_before = sim->length;
    sim->length = h;
    add_energy(sim, h);
    *accepted = 1;
    return CONTINUE;
}

/* Tries the next communication step once, up to the next point or event at most. */
static int next_step(Simulation *sim) {
    const double point = sim->start + (double)(sim->done + 1) * sim->step;
    while (sim->event < sim->event_count && sim->events[sim->event] <= sim->t) sim->event++;
    const double target = sim->event < sim->event_count ? smaller(point, sim->events[sim->event]) : point;
    const double remaining = target - sim->t;
    double h = sim->step_size ? step_size_next(sim->step_size, remaining) : remaining;
    int accepted;
    if (sim->shorter > 0.0) h = smaller(h, sim->shorter);
    const int verdict = try_step(sim, h, &accepted);
    if (verdict) return verdict;
    if (!accepted) {
        sim->repeated++;
        return CONTINUE;
    }
    sim->t = h == remaining ? target : sim->t + h;
    sim->shorter = 0.0;
    sim->steps++;
    sim->shortest = smaller(sim->shortest, h);
    sim->longest = larger(sim->longest, h);
    if (sim->t == point) sim->done++;
    if (sim->t == point || sim->free || sim->diverged) record(sim);
    return CONTINUE;
}

/* ---- the run */

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

static void begin_input(const Simulation *sim, CouplingInput *s) {
    if (s->source_component == DRIVEN) {
        input_begin(s, sim->reals[s->target], 0.0);
        return;
    }
    input_begin(s, sim->reals[s->source] * s->factor + s->offset, source_slope(s));
}

/* Exchanges values at the start and records them. The slope of an output may depend on slopes of inputs, so slopes are
 * read in several rounds. */
int32_t simulation_begin(Simulation *sim) {
    int verdict = simulation_exchange(sim, sim->t);
    mark_loops(sim);
    for (int32_t n = 0; n < sim->initial_rounds && !verdict; n++) {
        verdict = read_slopes(sim);
        for (int32_t i = 0; i < sim->input_count; i++) begin_input(sim, &sim->inputs[i]);
        for (int32_t k = 0; k < sim->component_count && !verdict; k++)
            verdict = component_set_inputs(sim, &sim->components[k], 0.0, 0.0, 0);
    }
    if (verdict) return verdict;
    for (int32_t i = 0; i < sim->energy.count; i++) sim->energy.start[i] = sim->reals[sim->energy.indices[i]];
    record(sim);
    return sim->errors ? error_begin(sim) : CONTINUE;
}

/* Does Python have to collect estimated errors before the next step, which may add two rows of them? */
static int errors_are_full(const ErrorPropagation *p) { return p && p->filled + 2 > p->capacity; }

/* Steps until a block of points or of estimated errors is full, the run ends, or `patience` [s] of wall time have
 * passed. If the run diverged, Python finds the value that is not finite and ends the run. */
int32_t simulation_advance(Simulation *sim) {
    if (sim->threads > 1 && !sim->pool) sim->pool = pool_start(sim, sim->threads);
    const double until = seconds() + sim->patience;
    sim->diverged = 0;
    while (sim->done < sim->total && sim->recorder.filled < sim->recorder.capacity) {
        const int verdict = next_step(sim);
        if (verdict) return verdict;
        if (sim->diverged || errors_are_full(sim->errors) || seconds() > until) break;
    }
    environment_restore(sim, ANY_COMPONENT);
    return CONTINUE;
}

int32_t simulation_close(Simulation *sim) {
    pool_stop(sim->pool);
    sim->pool = NULL;
    return CONTINUE;
}
