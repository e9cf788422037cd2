/* From communication point to communication point, a block of recorded points at a time. */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double LEAST = 1e-9; /* of a step: an FMU that gets no further than that gets nowhere */

/* ---- communication points */

/* Sets driven inputs to their value at t [s], then brings all outputs and inputs up to date. */
int32_t simulation_exchange(Simulation *sim, double t) {
    for (int32_t k = 0; k < sim->component_count; k++) sim->components[k].clock[0] = t;
    const int verdict = scenario_set(sim, t);
    return verdict ? verdict : carry_out(sim, &sim->exchange);
}

static int read_slopes(Simulation *sim) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        verdict = carry_out(sim, &sim->components[k].slope_reads);
    return verdict;
}

/* The end of a step for which all components have stepped. */
static int arrive(Simulation *sim, double h) {
    int verdict = simulation_exchange(sim, sim->t + h);
    if (!verdict) verdict = read_slopes(sim);
    if (!verdict) inputs_arrive(sim, h, EVERY_COMPONENT);
    return verdict;
}

static void record(Simulation *sim) {
    Recorder *r = &sim->recorder;
    double *reals = r->reals + (size_t)r->filled * (size_t)r->count;
    int32_t *wholes = r->wholes + (size_t)r->filled * (size_t)r->whole_count;
    r->time[r->filled] = sim->t;
    if (r->places)
        for (int32_t i = 0; i < r->count; i++) reals[i] = sim->real[r->places[i]];
    else memcpy(reals, sim->real, (size_t)r->count * sizeof *reals);
    for (int32_t i = 0; i < r->whole_count; i++) wholes[i] = sim->whole[r->whole_places[i]];
    r->filled++;
}

/* ---- the energy of power bonds, see energy in recorder.py */

/* Notes what the FMUs worked with, before new inputs are set. */
static int note_used(Simulation *sim) {
    EnergyMonitor *m = &sim->energy;
    const int verdict = m->count ? carry_out(sim, &m->readers) : CONTINUE;
    for (int32_t i = 0; i < m->count && !verdict; i++) {
        const int64_t place = m->places[i];
        m->first[i] = m->moved[i] ? sim->used[place] : sim->real[place];
        m->last[i] = m->moved[i] ? sim->used[sim->reals + place] : m->seen[m->spread[i]];
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
        const double end[] = {sim->real[m->places[2 * i]], sim->real[m->places[2 * i + 1]]};
        const double error = 0.5 * h * (residual(start, m->first + 2 * i) + residual(end, m->last + 2 * i));
        m->sums[i] += error;
        m->sums[bonds + i] += fabs(error);
        m->sums[2 * bonds + i] += 0.5 * h * (fabs(start[0] * start[1]) + fabs(end[0] * end[1]));
        memcpy(start, end, sizeof end);
    }
}

/* ---- steps */

static int save(Simulation *sim) {
    memcpy(sim->real_saved, sim->real, (size_t)sim->reals * sizeof *sim->real);
    memcpy(sim->whole_saved, sim->whole, (size_t)sim->wholes * sizeof *sim->whole);
    int verdict = CONTINUE;
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_save(sim, k);
    return verdict;
}

/* Back to the beginning of the step, as if it had not been tried. */
static int go_back(Simulation *sim) {
    int verdict = sim->check_status(0, 0, WITHDRAWN);
    memcpy(sim->real, sim->real_saved, (size_t)sim->reals * sizeof *sim->real);
    memcpy(sim->whole, sim->whole_saved, (size_t)sim->wholes * sizeof *sim->whole);
    for (int32_t k = 0; k < sim->component_count && !verdict; k++)
        if (sim->components[k].rollback) verdict = component_restore(sim, k);
    return verdict ? verdict : simulation_exchange(sim, sim->t); /* for inputs that are not part of the state */
}

/* An FMU did only the first part of a step. */
static int discarded(Simulation *sim, double h) {
    const double reached = sim->reached - sim->t;
    const double shorter = LEAST * h < smaller(reached, h - reached) ? reached : 0.5 * h; /* no part is noise */
    if (!sim->rollback || shorter <= LEAST * sim->step) return STOP;
    sim->shorter = shorter;
    return go_back(sim);
}

/* One step of length h; `stands` says whether it was good. */
static int one_step(Simulation *sim, double h, int *stands) {
    int passes = 0;
    *stands = 0;
    int verdict = sim->saves ? save(sim) : CONTINUE;
    if (verdict) return verdict;
    verdict = communication_step(sim, h, &passes);
    if (verdict == DISCARDED) return discarded(sim, h);
    if (verdict) return verdict;
    sim->all_passes += passes;
    verdict = note_used(sim);
    if (!verdict) verdict = arrive(sim, h);
    if (verdict) return verdict;
    if (sim->step_size) {
        const double e = (sim->by_energy ? power_error(sim, h) : step_error(sim, h)) / sim->error_tolerance;
        if (!step_size_accepts(sim->step_size, e, h)) return go_back(sim);
        sim->diverged = !isfinite(e);
    }
    for (int32_t i = 0; i < sim->input_count; i++) input_accept(&sim->inputs[i], h, sim->length);
    if (sim->prediction) prediction_accept(sim->prediction, h);
    sim->length_before = sim->length;
    sim->length = h;
    add_energy(sim, h);
    *stands = 1;
    return CONTINUE;
}

/* The next communication step; it may have to be repeated, which is another one. */
static int next(Simulation *sim) {
    const double point = sim->start + (double)(sim->done + 1) * sim->step;
    while (sim->event < sim->event_count && sim->events[sim->event] <= sim->t) sim->event++;
    const double target = sim->event < sim->event_count ? smaller(point, sim->events[sim->event]) : point;
    const double room = target - sim->t;
    double h = sim->step_size ? step_size_next(sim->step_size, room) : room;
    int stands;
    if (sim->shorter > 0.0) h = smaller(h, sim->shorter);
    const int verdict = one_step(sim, h, &stands);
    if (verdict) return verdict;
    if (!stands) {
        sim->repeated++;
        return CONTINUE;
    }
    sim->t = h == room ? target : sim->t + h;
    sim->shorter = 0.0;
    sim->steps++;
    sim->shortest = smaller(sim->shortest, h);
    sim->longest = larger(sim->longest, h);
    if (sim->t == point) sim->done++;
    if (sim->t == point || sim->free || sim->diverged) record(sim);
    return CONTINUE;
}

/* ---- the run */

/* Slopes of outputs in an algebraic loop depend on each other, and are not used. */
static void mark_loops(Simulation *sim) {
    for (int32_t k = 0; k < sim->loop_count; k++) {
        AlgebraicLoop *loop = sim->loops[k];
        loop->solved_in_passes = loop->declared || loop->flags[CIRCULAR];
        for (int32_t j = 0; j < loop->outputs && loop->solved_in_passes; j++)
            for (int32_t i = 0; i < sim->input_count; i++)
                if (sim->inputs[i].source == loop->sources[j])
                    sim->inputs[i].in_loop = 1, sim->inputs[i].slope_index = NO_SLOPE;
    }
}

static void begin_input(const Simulation *sim, CouplingInput *s) {
    if (s->source_component == DRIVEN) {
        input_begin(s, sim->real[s->target], 0.0);
        return;
    }
    const double slope = s->slope_index == NO_SLOPE ? 0.0 : sim->slopes[s->slope_index] * s->factor;
    input_begin(s, sim->real[s->source] * s->factor + s->offset, slope);
}

/* Makes everything known at the start, and records it. The slope of an output may depend on those of the inputs, so
 * they are read until all have passed. */
int32_t simulation_begin(Simulation *sim) {
    int verdict = simulation_exchange(sim, sim->t);
    mark_loops(sim);
    for (int32_t n = 0; n < sim->rounds_at_start && !verdict; n++) {
        verdict = read_slopes(sim);
        for (int32_t i = 0; i < sim->input_count; i++) begin_input(sim, &sim->inputs[i]);
        for (int32_t k = 0; k < sim->component_count && !verdict; k++)
            verdict = component_give(sim, &sim->components[k], 0.0, 0.0, 0);
    }
    if (verdict) return verdict;
    for (int32_t i = 0; i < sim->energy.count; i++) sim->energy.start[i] = sim->real[sim->energy.places[i]];
    record(sim);
    return CONTINUE;
}

/* Goes on until the recorder's block is full, to the end, or for `patience` [s]. */
int32_t simulation_advance(Simulation *sim) {
    if (sim->threads > 1 && !sim->pool) sim->pool = pool_start(sim, sim->threads);
    const double until = seconds() + sim->patience;
    sim->diverged = 0;
    while (sim->done < sim->total && sim->recorder.filled < sim->recorder.room) {
        const int verdict = next(sim);
        if (verdict) return verdict;
        if (sim->diverged || seconds() > until) break; /* who looks at the record will end a run that diverged */
    }
    return CONTINUE;
}

int32_t simulation_close(Simulation *sim) {
    pool_stop(sim->pool);
    sim->pool = NULL;
    return CONTINUE;
}
