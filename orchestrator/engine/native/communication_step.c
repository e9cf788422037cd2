/* One communication step as the plan of a master says (masters.py).
 *
 * Jacobi:          all components step with inputs that are extrapolated from the beginning of the step.
 * Gauss-Seidel:    sequential; a component whose source has stepped already gets the polynomial to where that is.
 * Hermite:         the same in several passes, each from the saved states, with cubics between both ends.
 * Interface-Jacobian: sequential, with inputs that linear_prediction.c predicts.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

/* Give the inputs of a instance their polynomials from `begin` [s] after the start of the step on. */
int component_give(Simulation *sim, Component *p, double begin, double length, int last) {
    static const double factorial[] = {1.0, 2.0, 6.0};
    double *value = p->values, *derivative = p->derivatives, c[DEGREE + 1];
    for (int32_t i = 0; i < p->count; i++) {
        const CouplingInput *s = &sim->inputs[p->first + i];
        if (begin != 0.0) polynomial_shift(s->c, begin, c);
        else memcpy(c, s->c, sizeof c);
        polynomial_project(c, s->degree, length);
        if (p->sets_values && s->wanted) *value++ = c[0];
        for (int32_t k = 0; k < s->degree && k < s->wanted; k++) *derivative++ = factorial[k] * c[k + 1];
        if (begin == 0.0 && s->wanted) sim->used[s->target] = c[0];
        if (last && s->wanted) sim->used[sim->reals + s->target] = polynomial_value(c, length);
    }
    return carry_out(sim, &p->input_writes);
}

/* A instance's own steps; `clock` is the time now, and then [s]. */
int component_advance(Simulation *sim, int k, double h, double *clock) {
    Component *p = &sim->components[k];
    const int32_t many = p->factor;
    for (int32_t j = 0; j < many; j++) {
        const double begin = h * j / many, end = j == many - 1 ? h : h * (j + 1) / many, now = sim->t + begin;
        int verdict = component_give(sim, p, begin, end - begin, j == many - 1);
        if (!verdict) verdict = component_step(sim, k, now, p->even != 0.0 ? p->even : sim->t + end - now);
        if (verdict) return verdict;
    }
    const double before = *clock;
    *clock = seconds();
    p->busy += *clock - before;
    return CONTINUE;
}

/* Let inputs that could only be followed roughly end as they should, before outputs are read. */
static int end_inputs(Simulation *sim, const Component *p, double h) {
    if (!p->rough) return CONTINUE;
    double *value = p->values, *derivative = p->derivatives;
    for (int32_t i = 0; i < p->count; i++) {
        const CouplingInput *s = &sim->inputs[p->first + i];
        if (s->wanted) *value++ = polynomial_value(s->c, h);
        for (int32_t k = 0; k < s->degree && k < s->wanted; k++) *derivative++ = k == 0 ? polynomial_slope(s->c, h) : 0.0;
    }
    return carry_out(sim, &p->input_writes);
}

static void input_arrives(Simulation *sim, CouplingInput *s, double h) {
    const double value = sim->real[s->source] * s->factor + s->offset;
    const double slope = s->slope_index == NO_SLOPE ? 0.0 : sim->slopes[s->slope_index] * s->factor;
    input_arrive(s, value, slope, h, sim->length, sim->length_before);
}

void inputs_arrive(Simulation *sim, double h, int source_component) {
    for (int32_t i = 0; i < sim->input_count; i++) {
        CouplingInput *s = &sim->inputs[i];
        if (s->source_component == DRIVEN || (source_component != EVERY_COMPONENT && (s->source_component != source_component || s->in_loop))) continue;
        input_arrives(sim, s, h);
    }
}

static void shape(Simulation *sim, const Component *p, int n, double h) {
    for (int32_t i = 0; i < p->count; i++) {
        CouplingInput *s = &sim->inputs[p->first + i];
        if (s->source_component == DRIVEN) continue;
        if (s->predicted) {
            if (!n && sim->has_stepped[s->source_component] && !s->in_loop) input_end_at_source(s, h);
            continue;
        }
        if (s->wanted && (n || (sim->has_stepped[s->source_component] && !s->in_loop))) {
            input_interpolate(s, sim->degree, h, sim->length);
            continue;
        }
        input_extrapolate(s, h, sim->length);
        if (sim->corrected && s->wanted) input_correct(s, h, sim->length);
    }
}

/* All components once: at the same time (Jacobi), or each with the new outputs of those before (Gauss-Seidel). */
static int step_components(Simulation *sim, int n, double h) {
    double clock = seconds();
    memset(sim->has_stepped, 0, (size_t)sim->component_count);
    if (sim->pool) {
        for (int32_t k = 0; k < sim->component_count; k++) shape(sim, &sim->components[k], n, h);
        return pool_step(sim->pool, h);
    }
    for (int32_t i = 0; i < sim->component_count; i++) {
        const int k = sim->order[i];
        Component *p = &sim->components[k];
        const int looks = sim->prediction && i == sim->prediction->leads;
        int verdict = looks ? predict_inputs(sim, h) : CONTINUE;
        if (verdict) return verdict;
        if (looks) clock = seconds();
        if (n && !p->repeated) continue; /* nothing changes what it did */
        shape(sim, p, n, h);
        if (n) verdict = component_restore(sim, k);
        if (!verdict) verdict = carry_out(sim, &p->held_inputs);
        if (!verdict) verdict = component_advance(sim, k, h, &clock);
        if (verdict) return verdict;
        if (!sim->sequential) continue;
        verdict = end_inputs(sim, p, h);
        if (!verdict) verdict = carry_out(sim, &p->output_reads);
        if (!verdict) verdict = carry_out(sim, &p->slope_reads);
        if (verdict) return verdict;
        inputs_arrive(sim, h, k);
        sim->has_stepped[k] = 1;
    }
    return CONTINUE;
}

/* Solves the algebraic loops at the end of a step that may be computed again. */
static int solve_loops(Simulation *sim, double h) {
    for (int32_t k = 0; k < sim->loop_count; k++) {
        const int verdict = sim->loops[k]->solved_in_passes ? loop_solve(sim, sim->loops[k]) : CONTINUE;
        if (verdict) return verdict;
    }
    for (int32_t i = 0; i < sim->input_count; i++)
        if (sim->inputs[i].in_loop) input_arrives(sim, &sim->inputs[i], h);
    return CONTINUE;
}

/* What another pass could change, at most. */
static double largest_mismatch(const Simulation *sim, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < sim->input_count; i++)
        if (sim->inputs[i].source_component != DRIVEN) worst = worse(worst, input_mismatch(&sim->inputs[i], h));
    return worst;
}

static void ahead(Simulation *sim, double h) {
    Scenario *d = sim->scenario;
    if (!d) return;
    scenario_look(d, sim->t + 0.5 * h);
    memcpy(d->middle, d->coming, (size_t)d->count * sizeof *d->middle);
    scenario_look(d, sim->t + h);
    for (int32_t i = 0; i < d->count; i++)
        input_drive(&sim->inputs[d->inputs[i]], d->middle[i], d->coming[i], h);
}

int communication_step(Simulation *sim, double h, int *passes) {
    ahead(sim, h);
    for (int n = 0; n < sim->passes; n++) {
        int verdict = step_components(sim, n, h);
        *passes = n + 1;
        if (!verdict && sim->passes > 1) verdict = solve_loops(sim, h);
        if (verdict) return verdict;
        if (sim->passes > 1 && !(largest_mismatch(sim, h) > sim->tolerance)) break;
    }
    if (sim->sequential) return CONTINUE;
    for (int32_t k = 0; k < sim->component_count; k++) {
        if (!sim->components[k].slope_reads.count) continue;
        const int verdict = end_inputs(sim, &sim->components[k], h); /* slopes of outputs may follow from theirs */
        if (verdict) return verdict;
    }
    return CONTINUE;
}

double step_error(const Simulation *sim, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < sim->input_count; i++) {
        const CouplingInput *s = &sim->inputs[i];
        const int by_mean = sim->corrected && s->source_component != DRIVEN;
        const double off = by_mean ? input_mean_error(s, h) : input_deviation(s, h, sim->passes > 1);
        worst = worse(worst, input_share(s, off));
    }
    return worst;
}

double power_error(const Simulation *sim, double h) {
    double worst = 0.0;
    for (int32_t i = 0; i < sim->bond_count; i++) {
        const CouplingInput *effort = &sim->inputs[sim->bonds[2 * i]], *flow = &sim->inputs[sim->bonds[2 * i + 1]];
        const int repeated = sim->passes > 1;
        const double power =
            effort->value_end * input_deviation(flow, h, repeated) - flow->value_end * input_deviation(effort, h, repeated);
        const double size = input_magnitude(effort) * input_magnitude(flow);
        worst = worse(worst, size > 0.0 ? fabs(power) / size : 0.0);
    }
    return worst;
}
