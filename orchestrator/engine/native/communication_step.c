/* One communication step of length h, as the plan of a master (orchestrator/ssp/masters.py) describes it.
 *
 *     Jacobi               jacobi_pass: all components step with inputs that are extrapolated from the start of the step
 *     Gauss-Seidel         gauss_seidel_pass: each component steps with the new outputs of those before it
 *     Hermite              several gauss_seidel_pass, each from the saved states, with cubics between both ends
 *     Interface-Jacobian   gauss_seidel_pass with inputs that linear_prediction.c predicts
 *
 * gauss_seidel_pass does the following for one component after the other, in the order of the plan:
 *
 *     1. set_polynomials        each coupling input becomes a polynomial over the step: interpolated if its source has
 *                               stepped in this pass or an earlier one, else extrapolated (coupling_input.c);
 *                               predicted inputs keep their prediction
 *     2. held_inputs            inputs that cannot change inside a step get the newest value of their source
 *     3. component_advance      the FMU gets the polynomials and steps
 *     4. set_exact_inputs       inputs that it followed at a lower degree are set to the end of their polynomial
 *     5. output_reads           its new outputs, and their slopes, are read
 *     6. set_ends_from          they become the ends of the inputs that they feed, for the components that follow
 *
 * After the step simulation_loop.c exchanges all values at the new communication point.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

/* ---- one component */

/* The constant or the line with the end of a polynomial, for events of an FMU that follow from its inputs. */
static void end_exactly(Real c[], int32_t degree, Real h) {
    const Real end = polynomial_value(c, h);
    c[1] = degree && any(h > 0.0) ? (end - c[0]) / h : c[1] * (double)(degree > 0); /* h = 0 where inputs begin */
    if (!degree) c[0] = end;
    c[2] = c[3] = 0.0;
}

/* Set the coupling inputs of a component from `begin` [s] after the start of the step on, for `length` [s]. */
int component_set_inputs(Simulation *sim, Component *p, Real begin, Real length, int last) {
    static const double factorial[] = {1.0, 2.0, 6.0};
    const int first = !any(begin > 0.0), keeps_ends = sim->input_ends != NULL;
    Real *value = p->values, *derivative = p->derivatives, part[DEGREE + 1];
    for (int32_t i = 0; i < p->input_count; i++) {
        const CouplingInput *s = &sim->inputs[p->first_input + i];
        const Real *c = s->c;
        if (!first || s->fmu_degree < DEGREE) {
            if (first) memcpy((void *)part, s->c, sizeof part);
            else polynomial_shift(s->c, begin, part);
            if (s->at_end == EXACT || (s->at_end && sim->events.high > 0.0)) end_exactly(part, s->fmu_degree, length);
            else polynomial_project(part, s->fmu_degree, length);
            c = part;
        }
        if (p->sets_values && s->requested_degree) *value++ = c[0];
        for (int32_t k = 0; k < s->fmu_degree && k < s->requested_degree; k++) *derivative++ = factorial[k] * c[k + 1];
        if (!keeps_ends || !s->requested_degree) continue;
        if (first) sim->input_ends[s->target] = c[0];
        if (last) sim->input_ends[sim->real_count + s->target] = polynomial_value(c, length);
    }
    return execute(sim, &p->input_writes);
}

/* Set the inputs that the FMU could only follow at a lower degree to their polynomials, `at` [s] after the start of the
 * step, before outputs are read. */
static int set_exact_inputs(Simulation *sim, const Component *p, Real at) {
    if (!p->simplifies_inputs) return CONTINUE;
    Real *value = p->values, *derivative = p->derivatives;
    for (int32_t i = 0; i < p->input_count; i++) {
        const CouplingInput *s = &sim->inputs[p->first_input + i];
        if (s->requested_degree) *value++ = polynomial_value(s->c, at);
        for (int32_t k = 0; k < s->fmu_degree && k < s->requested_degree; k++)
            *derivative++ = k == 0 ? polynomial_slope(s->c, at) : 0.0;
    }
    return execute(sim, &p->input_writes);
}

/* Read the outputs of a component in the middle of the step, for the inputs that they feed. */
static int read_middle(Simulation *sim, int k, Real h) {
    const Component *p = &sim->components[k];
    int verdict = set_exact_inputs(sim, p, 0.5 * h);
    if (!verdict) verdict = execute(sim, &p->output_reads);
    for (int32_t i = p->first_fed; i >= 0; i = sim->inputs[i].next_fed) {
        CouplingInput *s = &sim->inputs[i];
        s->middle = sim->reals[s->source] * s->factor + s->offset;
    }
    return verdict;
}

static int set_and_step(Simulation *sim, int k, Real begin, Real length, int last) {
    const int verdict = component_set_inputs(sim, &sim->components[k], begin, length, last);
    return verdict ? verdict : component_step(sim, k, begin, length);
}

#if WIDTH == 1
/* Goes on where steps are not repeated for events, after the first try of a step from `begin` to `end` [s]: the component
 * goes through those inside of the step alone. One that goes back to its beginning gets shorter steps up to the event. */
static int go_on_alone(Simulation *sim, int k, int verdict, double begin, double end, int last) {
    const double least = sim->events.tolerance;
    double length = end - begin;
    while (verdict == AT_EVENT || (!verdict && end - begin - length > least)) {
        const double at = verdict && length > least ? sim->reached - sim->t : begin + length;
        if (verdict && at - begin <= least && length > least) length *= 0.5;
        else {
            if (verdict) verdict = python_call(sim, ALONE, k, sim->reached, 0.0);
            begin = at, length = end - at;
            if (verdict || length <= least) return verdict;
        }
        verdict = set_and_step(sim, k, begin, length, last);
    }
    return verdict;
}
#endif

/* Take a component over the communication step, in its own steps; `counter` is that of ticks before, and after. */
int component_advance(Simulation *sim, int k, Real h, double *counter) {
    Component *p = &sim->components[k];
    const int32_t n = p->halved ? 2 : p->substeps;
    const Real length = h / (double)n;
    for (int32_t j = 0; j < n; j++) {
        const Real begin = h * (double)j / (double)n;
#if WIDTH == 1
        if (j && sim->t + begin >= sim->end) break; /* the only FMU has stopped */
#endif
        int verdict = set_and_step(sim, k, begin, length, j == n - 1);
#if WIDTH == 1
        if (verdict == AT_EVENT && !sim->events.located)
            verdict = go_on_alone(sim, k, verdict, begin, begin + length, j == n - 1);
#endif
        if (!verdict && p->halved && j == 0) verdict = read_middle(sim, k, h);
        if (verdict) return verdict;
    }
    const double before = *counter;
    *counter = ticks();
    p->busy += *counter - before;
    return CONTINUE;
}

/* ---- coupling inputs */

static void set_source_end(Simulation *sim, CouplingInput *s, Real h) {
    const Real value = sim->reals[s->source] * s->factor + s->offset;
    input_set_end(s, value, source_slope(s), h, sim->length, sim->length_before);
}

/* The outputs of all components are the ends of the inputs that they feed. */
void set_source_ends(Simulation *sim, Real h) {
    for (int32_t i = 0; i < sim->input_count; i++)
        if (sim->inputs[i].source_component != DRIVEN) set_source_end(sim, &sim->inputs[i], h);
}

/* The outputs of one component are the ends of the inputs that it feeds outside of loops. */
static void set_ends_from(Simulation *sim, const Component *p, Real h) {
    for (int32_t i = p->first_fed; i >= 0; i = sim->inputs[i].next_fed)
        if (!sim->inputs[i].in_loop) set_source_end(sim, &sim->inputs[i], h);
}

static void set_polynomial(const Simulation *sim, CouplingInput *s, int n, Real h, int follows) {
    const int stepped = sim->has_stepped[s->source_component] && !s->in_loop && follows;
    if (s->predicted) {
        if (!n && stepped) input_end_at_source(s, h);
    } else if (s->requested_degree && (n || stepped)) {
        input_interpolate(s, sim->degree, h, sim->length);
    } else {
        input_extrapolate(s, h, sim->length);
    }
}

/* Make the polynomials of the inputs of a component, in pass n = 0, 1, ... */
static void set_polynomials(const Simulation *sim, const Component *p, int n, Real h) {
    for (int32_t i = 0; i < p->input_count; i++) {
        CouplingInput *s = &sim->inputs[p->first_input + i];
        if (s->source_component == DRIVEN) continue;
        const int others = n && !all(sim->computed); /* machines whose last pass was final */
        Real before[POLYNOMIAL];
        if (others) memcpy((void *)before, s->c, sizeof before);
        set_polynomial(sim, s, n, h, !sim->parallel || p->events);
        if (others) input_replace_polynomial(s, before, !sim->computed);
    }
}

static void set_driven_polynomials(Simulation *sim, Real h) {
    Scenario *d = sim->scenario;
    if (!d) return;
    scenario_evaluate(d, sim->t + 0.5 * h);
    memcpy((void *)d->at_midpoint, d->at_end, (size_t)d->count * sizeof *d->at_midpoint);
    scenario_evaluate(d, sim->end);
    for (int32_t i = 0; i < d->count; i++) {
        CouplingInput *s = &sim->inputs[d->inputs[i]];
        input_drive(s, d->at_midpoint[i], d->at_end[i], h);
    }
}

/* ---- one pass over all components */

static int jacobi_pass(Simulation *sim, Real h) {
    for (int32_t k = 0; k < sim->component_count; k++) set_polynomials(sim, &sim->components[k], 0, h);
    if (sim->pool) return pool_step(sim->pool, h);
    double counter = ticks();
    for (int32_t i = 0; i < sim->component_count; i++) {
        const int verdict = component_advance(sim, sim->order[i], h, &counter);
        if (verdict) return verdict;
    }
    return CONTINUE;
}

static int gauss_seidel_pass(Simulation *sim, int n, Real h) {
    memset(sim->has_stepped, 0, (size_t)sim->component_count);
    for (int32_t i = 0; i < sim->component_count; i++) {
        const int k = sim->order[i];
        Component *p = &sim->components[k];
        int verdict = CONTINUE;
        if (sim->prediction && i == sim->prediction->leading_count) {
            verdict = predict_inputs(sim, h);
            if (verdict) return verdict;
        }
        if (n && !p->repeated) continue; /* its inputs are the same as in the first pass */
        set_polynomials(sim, p, n, h);
        if (n) verdict = component_restore(sim, k, sim->computed);
        if (!verdict) verdict = execute(sim, &p->held_inputs);
        double counter = ticks(); /* here, so that the time of the component contains no reads of others */
        if (!verdict) verdict = component_advance(sim, k, h, &counter);
        if (!verdict) verdict = set_exact_inputs(sim, p, h);
        if (!verdict) verdict = execute(sim, &p->output_reads);
        if (!verdict) verdict = execute(sim, &p->slope_reads);
        if (verdict) return verdict;
        set_ends_from(sim, p, h);
        sim->has_stepped[k] = 1;
    }
    return CONTINUE;
}

/* ---- the step */

/* Solve the algebraic loops at the end of a step that may be computed again. */
static int solve_loops(Simulation *sim, Real h) {
    for (int32_t k = 0; k < sim->loop_count; k++) {
        const int verdict = sim->loops[k]->solved_in_passes ? loop_solve(sim, sim->loops[k]) : CONTINUE;
        if (verdict) return verdict;
    }
    for (int32_t i = 0; i < sim->input_count; i++)
        if (sim->inputs[i].in_loop) set_source_end(sim, &sim->inputs[i], h);
    return CONTINUE;
}

/* The largest relative change of an input that a further pass could make. */
static Real largest_mismatch(const Simulation *sim, Real h) {
    Real worst = 0.0;
    for (int32_t i = 0; i < sim->input_count; i++)
        if (sim->inputs[i].source_component != DRIVEN) worst = worse(worst, input_mismatch(&sim->inputs[i], h));
    return worst;
}

int communication_step(Simulation *sim, Real h, int *passes) {
#if WIDTH == 1
    *passes = 1;
    if (sim->in_python) return python_call(sim, MASTER, 0, sim->t, h);
#endif
    sim->computed = sim->moving;
    set_driven_polynomials(sim, h);
    for (int n = 0; n < sim->passes && any(sim->computed); n++) {
        int verdict = sim->sequential ? gauss_seidel_pass(sim, n, h) : jacobi_pass(sim, h);
        *passes = n + 1;
        if (!verdict && sim->passes > 1) verdict = solve_loops(sim, h);
        if (verdict) return verdict;
        if (sim->passes > 1) sim->computed = sim->computed && sim->moving && largest_mismatch(sim, h) > sim->tolerance;
    }
    if (sim->sequential) return CONTINUE;
    for (int32_t k = 0; k < sim->component_count; k++) {
        if (!sim->components[k].slope_reads.count) continue;
        const int verdict = set_exact_inputs(sim, &sim->components[k], h); /* slopes of outputs may depend on inputs */
        if (verdict) return verdict;
    }
    return CONTINUE;
}

/* ---- the estimated error of the step */

/* The largest of the inputs, relative to their magnitudes, without those that a shorter step would leave as large. */
Real step_error(const Simulation *sim, Real h) {
    Real worst = 0.0;
    for (int32_t i = 0; i < sim->input_count; i++) {
        const CouplingInput *s = &sim->inputs[i];
        if (s->noisy) continue;
        const Real deviation = input_deviation(s, h, sim->passes > 1);
        worst = worse(worst, input_relative(s, deviation));
    }
    return worst;
}
