/* Co-simulation of a group of machines in the lanes of a processor: the files of the engine that step a system, with one
   double for each machine in a number. There are no calls: values and slopes are in the instances of the models, which
   follow cubics. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instance.h"

#define WIDTH 8

static_assert(WIDTH == LANES, "one number for each machine");

namespace {

typedef Lanes Real;
const Mask NO_MACHINE = {Bits(0)}, EVERY_MACHINE = {Bits(-1)};
Mask is_finite(Real a) { return finite(a); }
double where(bool condition, double a, double b) { return condition ? a : b; }
double machine(Real a, int i) { return a[i]; }
int chosen(Mask machines, int i) { return machines.bits[i] != 0; }
void remove_machine(Mask *machines, int i) { machines->bits[i] = 0; }
void set_machine(Real *a, int i, int count, double value) {
    if (count == 1) *a = value;
    else a->v[i] = value;
}

#include "engine.h"
#include "machines.h"

/* What lanes do not have. */
double ticks() { return 0.0; }
void environment_restore(Simulation *, const void *, int) {}
int loop_solve(Simulation *, AlgebraicLoop *) { return CONTINUE; }
int predict_inputs(Simulation *, Real) { return CONTINUE; }
int error_begin(Simulation *) { return CONTINUE; }
void error_jump(ErrorPropagation *) {}
int error_propagate(Simulation *, Real) { return CONTINUE; }
int pool_step(Pool *, Real) { return CONTINUE; }
int values_save(Simulation *) { return CONTINUE; }
int values_restore(Simulation *) { return CONTINUE; }
int values_set(Simulation *) { return CONTINUE; }

#include "coupling_input.c"
#include "communication_step.c"
#include "scenario.c"
#include "simulation_loop.c"
#include "step_size.c"

Group *group_of(Simulation *sim) { return (Group *)sim; } /* its first member */

/* ---- values ------------------------------------------------------------------------------------ */

void note_change(Group *g, const Wire *wire, Mask changed) {
    g->changed[wire->component] = g->changed[wire->component] || changed;
}

void copy(Group *g, const Wire *wires, int count, Mask machines) {
    Lanes *values = g->sim.reals;
    const int every = all(machines);
    for (const Wire *w = wires; w < wires + count; w++) {
        const Lanes now = values[w->source] * w->factor + w->offset, before = values[w->target];
        if (w->checked) note_change(g, w, before != now);
        values[w->target] = values[w->last_set] = every ? now : where(machines, now, before);
    }
}

/* The scenario has set inputs. */
void drive(Group *g, const Wire *wires, int count) {
    Lanes *values = g->sim.reals;
    for (const Wire *w = wires; w < wires + count; w++) {
        const Lanes now = values[w->target];
        if (w->checked) note_change(g, w, values[w->last_set] != now);
        values[w->last_set] = now;
    }
}

/* Gives the polynomials of its inputs to a component. */
void follow(Group *g, int k) {
    const Component *p = &g->sim.components[k];
    Instance *instance = g->instances[k];
    const Lanes *value = p->values, *derivative = p->derivatives;
    for (int i = p->first_input; i < p->first_input + p->input_count; i++) {
        const CouplingInput *s = &g->sim.inputs[i];
        if (!s->requested_degree) continue;
        const int input = (int)(g->sim.reals + s->target - instance->values) - g->models[k]->parameters;
        if (p->sets_values) g->sim.reals[s->target] = instance->last_set[input] = *value++;
        memcpy((void *)(instance->derivatives + DEGREE * input), derivative, DEGREE * sizeof *derivative);
        instance->has_derivatives[input] = 1;
        derivative += DEGREE;
    }
}

void renew_outputs(Group *g, int k) {
    if (any(g->changed[k])) g->models[k]->outputs_again(g->instances[k], g->changed[k]);
    g->changed[k] = NO_MACHINE;
}

int execute(Simulation *sim, const Program *program) {
    Group *g = group_of(sim);
    for (int i = 0; i < program->count; i++) {
        const Instruction *p = &program->instructions[i];
        const int k = p->index;
        if (p->type == COPY) copy(g, (const Wire *)p->operand, k, EVERY_MACHINE);
        else if (p->type == HOLD) copy(g, (const Wire *)p->operand, k, sim->computed);
        else if (p->type == DRIVE) drive(g, (const Wire *)p->operand, k);
        else if (p->type == FOLLOW) follow(g, k);
        else if (p->type == OUTPUTS) renew_outputs(g, k);
        else if (p->type == DERIVATIVES) g->models[k]->derivatives_now(g->instances[k]);
        else g->models[k]->slopes_now(g->instances[k]);
    }
    return CONTINUE;
}

/* An exchange begins. */
void set_clocks(Simulation *sim, Real) {
    for (int k = 0; k < sim->component_count; k++) group_of(sim)->changed[k] = NO_MACHINE;
}

/* ---- machines ---------------------------------------------------------------------------------- */

/* The machines that the models advance; the others cannot fail. */
void machines_move(Simulation *sim, Mask machines) {
    sim->moving = machines;
    for (int k = 0; k < sim->component_count; k++) *group_of(sim)->instances[k]->alive = machines;
}

/* A machine that has failed in one component is left out in all of them. */
void collect_failures(Simulation *sim, int k) {
    Group *g = group_of(sim);
    const Mask failed = sim->moving && !*g->instances[k]->alive;
    if (!any(failed)) return;
    for (int i = 0; i < LANES; i++) {
        if (!chosen(failed, i)) continue;
        g->failures[i] = g->instances[k]->failures[i];
        g->failures[i].component = k;
        g->failures[i].time += sim->t[i]; /* from the beginning of the communication step */
    }
    sim->alive = sim->alive && !failed;
    machines_move(sim, sim->moving && !failed);
}

int machines_check(Simulation *sim) {
    for (int k = 0; k < sim->component_count; k++) {
        group_of(sim)->models[k]->check(group_of(sim)->instances[k], 0.0);
        collect_failures(sim, k);
    }
    return CONTINUE;
}

int component_step(Simulation *sim, int k, Real, Real length) {
    group_of(sim)->models[k]->step(group_of(sim)->instances[k], length, sim->computed);
    collect_failures(sim, k);
    return CONTINUE;
}

int component_save(Simulation *sim, int k) {
    group_of(sim)->models[k]->save(group_of(sim)->instances[k]);
    return CONTINUE;
}

int component_restore(Simulation *sim, int k, Mask machines) {
    group_of(sim)->models[k]->restore(group_of(sim)->instances[k], machines);
    return CONTINUE;
}

void write_row(Group *g) {
    if (!g->rows || g->row >= g->points) return;
    for (int i = 0; i < g->signal_count; i++) {
        const Signal *signal = &g->signals[i];
        const Lanes value = where(g->sim.alive, g->instances[signal->component]->values[signal->reference], NAN);
        double *to = g->rows[i] + g->machine * g->points + g->row;
        for (int lane = 0; lane < g->machines; lane++) to[lane * g->points] = value[lane];
    }
    g->row++;
}

void record(Simulation *sim) {
    Group *g = group_of(sim);
    if (sim->done % g->every == 0 || sim->done == sim->total) write_row(g);
}

} // namespace

#undef EXPORT
#ifdef _WIN32
#define EXPORT extern "C" __declspec(dllexport)
#else
#define EXPORT extern "C" __attribute__((visibility("default")))
#endif

/* Makes start values, inputs and outputs consistent: computes the initial states and copies values along the
   connections until nothing changes. Returns 0 if they keep changing: there is an algebraic loop. */
EXPORT int32_t group_initialise(void *group) {
    Group *g = (Group *)group;
    Simulation *sim = &g->sim;
    const int rounds = sim->component_count + 2;
    for (int k = 0; k < sim->component_count; k++) g->models[k]->prepare(g->instances[k]);
    sim->t = sim->start;
    scenario_set_inputs(sim, sim->t);
    for (int round = 0; round < rounds; round++) {
        int changed = 0;
        for (int k = 0; k < sim->component_count; k++) {
            g->models[k]->start(g->instances[k]);
            g->models[k]->outputs_now(g->instances[k]);
        }
        for (int i = 0; i < g->wire_count; i++) {
            const Lanes *input = &sim->reals[g->wires[i].target], before = *input;
            copy(g, &g->wires[i], 1, EVERY_MACHINE);
            const Lanes now = *input;
            changed |= any(before != now && (before == before || now == now));
        }
        if (!changed) return 1;
    }
    return 0;
}

/* Begins the run at the consistent values, and records them. */
EXPORT int32_t group_begin(void *group) { return !simulation_begin((Simulation *)group); }

/* Steps up to a communication point, or until another thread stops it. With commands only the last point is
   recorded. Returns 0 if all machines have failed. */
EXPORT int32_t group_advance(void *group, int64_t point) {
    Group *g = (Group *)group;
    Simulation *sim = &g->sim;
    const int commanded = sim->scenario && sim->scenario->commands;
    if (commanded) {
        g->row = g->points;
        const Mask jumps = scenario_jumps(sim->scenario, sim->t, sim->alive);
        if (any(jumps)) jump(sim, jumps);
    }
    while (sim->done < point && any(sim->alive) && !*(volatile int32_t *)&g->stop) next_step(sim);
    if (!any(sim->alive)) sim->done = point, sim->t = point_at(sim, point);
    if (commanded) g->row = 0, write_row(g);
    return any(sim->alive);
}

/* Replaces machines by those in the same lanes of another group, which have just begun; lanes: 1 to replace, else 0. */
EXPORT int32_t group_adopt(void *group, const void *other, const int64_t *lanes) {
    Group *g = (Group *)group;
    const Group *from = (const Group *)other;
    Simulation *sim = &g->sim;
    Bits bits;
    memcpy((void *)&bits, lanes, sizeof bits);
    const Mask machines = {bits != 0};
    if (sim->step_size) sim->length = where(machines, from->sim.length, sim->length); /* else it is that of all */
    sim->t = point_at(sim, sim->done); /* with steps of their own, failed ones have stopped */
    for (int i = 0; i < LANES; i++) {
        if (!lanes[i]) continue;
        g->failures[i] = from->failures[i];
        if (sim->step_size) sim->step_size[i] = from->sim.step_size[i];
    }
    for (int k = 0; k < sim->component_count; k++) g->models[k]->adopt(g->instances[k], from->instances[k], machines);
    for (int i = 0; i < sim->input_count; i++) input_replace(&sim->inputs[i], &from->sim.inputs[i], machines);
    EnergyMonitor *energy = &sim->energy;
    for (int i = 0; i < energy->count; i++)
        energy->start[i] = where(machines, from->sim.energy.start[i], energy->start[i]);
    for (int i = 0; i < 3 * energy->count / 2; i++) energy->sums[i] = where(machines, 0.0, energy->sums[i]);
    sim->alive = (sim->alive && !machines) || (from->sim.alive && machines);
    machines_move(sim, sim->alive);
    return any(sim->alive);
}
