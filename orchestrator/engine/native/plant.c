/* All components of a system in Model Exchange as one ODE: states in, time derivatives and outputs out.
 *
 * The inputs v of all components follow from their outputs y by the connections,
 *
 *     v = L y(v) + external
 *
 * Without an algebraic loop a finite number of substitutions solves this exactly; components whose inputs do not
 * change are not evaluated again. Otherwise Newton's method does,
 *
 *     v := v + K (L y + external - v),     K = 1 / (1 - L dy/dv)
 *
 * Python computes K when a function returns NEEDS_INVERSE, sets `inverse` and `inverse_state`, and calls
 * plant_iterate. */

#include <math.h>

#include "engine.h"

static const double AGREEMENT = 1e-13; /* tolerance of connected values, relative to their magnitude */
static const double RENEWAL = 0.1;     /* K is renewed when an iteration leaves more than this fraction of the error */
static const int MAX_ITERATIONS = 30;  /* of Newton's method */

static int evaluate(Simulation *sim, const PlantMember *member) {
    const int verdict = execute(sim, &member->writes);
    return verdict ? verdict : execute(sim, &member->reads);
}

static int evaluate_all(Simulation *sim, const Plant *p) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < p->member_count && !verdict; k++) verdict = evaluate(sim, &p->members[k]);
    return verdict;
}

static int get_rates(Simulation *sim, const Plant *p) {
    int verdict = CONTINUE;
    for (int32_t k = 0; k < p->member_count && !verdict; k++) verdict = execute(sim, &p->members[k].rates);
    return verdict;
}

/* The values of the inputs by the connections. */
static void follow_connections(const Plant *p) {
    for (int32_t i = 0; i < p->input_count; i++) p->expected[i] = p->external[i];
    for (int32_t i = 0; i < p->connection_count; i++)
        p->expected[p->rows[i]] += p->factors[i] * p->y[p->sources[i]];
}

/* Sets the inputs of a component to `expected`; 1 if an effective one changes. */
static int inputs_change(const Plant *p, const PlantMember *member) {
    int change = 0;
    for (int32_t i = member->first_input; i < member->first_input + member->input_count; i++) {
        if (p->v[i] == p->expected[i]) continue;
        p->v[i] = p->expected[i];
        change |= p->effective[i];
    }
    return change;
}

/* The largest error of an input, relative to its magnitude; infinity if one is not finite. */
static double largest_error(const Plant *p) {
    double largest = 0.0;
    follow_connections(p);
    for (int32_t i = 0; i < p->input_count; i++) p->magnitude[i] = 0.0;
    for (int32_t i = 0; i < p->connection_count; i++)
        p->magnitude[p->rows[i]] += fabs(p->factors[i] * p->y[p->sources[i]]);
    for (int32_t i = 0; i < p->input_count; i++) {
        p->residual[i] = p->expected[i] - p->v[i];
        if (!isfinite(p->residual[i])) return INFINITY;
        const double magnitude = fmax(p->magnitude[i], fabs(p->expected[i]));
        if (p->residual[i] != 0.0) largest = fmax(largest, fabs(p->residual[i]) / magnitude);
    }
    return largest;
}

int32_t plant_iterate(Simulation *sim, Plant *p) {
    for (; p->iterations < MAX_ITERATIONS; p->iterations++) {
        const double largest = largest_error(p);
        if (largest <= AGREEMENT) return get_rates(sim, p);
        if (!isfinite(largest)) return NOT_CONVERGED;
        if (p->inverse_state == MISSING || (p->inverse_state == OLD && largest > RENEWAL * p->last)) {
            p->inverse_state = MISSING;
            return NEEDS_INVERSE;
        }
        p->inverse_state = OLD, p->last = largest;
        for (int32_t i = 0; i < p->input_count; i++)
            for (int32_t j = 0; j < p->input_count; j++)
                p->v[i] += p->inverse[i * p->input_count + j] * p->residual[j];
        const int verdict = evaluate_all(sim, p);
        if (verdict) return verdict;
    }
    return NOT_CONVERGED;
}

int32_t plant_connect(Simulation *sim, Plant *p) {
    for (int32_t round = 0; round < p->rounds; round++) {
        int32_t changed = 0;
        follow_connections(p);
        for (int32_t k = 0; k < p->member_count; k++) {
            p->stale[k] = inputs_change(p, &p->members[k]);
            changed |= p->stale[k];
        }
        if (!changed) return get_rates(sim, p);
        for (int32_t k = 0; k < p->member_count; k++) {
            const int verdict = p->stale[k] ? evaluate(sim, &p->members[k]) : CONTINUE;
            if (verdict) return verdict;
        }
    }
    p->iterations = 0, p->last = INFINITY;
    return plant_iterate(sim, p);
}

int32_t plant_start(Simulation *sim, Plant *p) { return execute(sim, &p->starts); }

int32_t plant_settle(Simulation *sim, Plant *p) {
    if (sim->scenario) scenario_set_continuous(sim->scenario, *p->time, p->external);
    int verdict = execute(sim, &p->states);
    if (!verdict) verdict = evaluate_all(sim, p);
    return verdict ? verdict : plant_connect(sim, p);
}

int32_t plant_evaluate(Simulation *sim, Plant *p, int32_t member, int32_t with_states) {
    int verdict = with_states ? execute(sim, &p->states) : CONTINUE;
    if (!verdict) verdict = evaluate(sim, &p->members[member]);
    return verdict ? verdict : execute(sim, &p->members[member].rates);
}

int32_t plant_jacobian(Simulation *sim, Plant *p) {
    return linearise(sim, p->columns, p->column_count, p->jacobian);
}

int32_t plant_indicators(Simulation *sim, Plant *p) { return execute(sim, &p->indicators); }

int32_t plant_completed_step(Simulation *sim, Plant *p) {
    int verdict = execute(sim, &p->states);
    if (!verdict) verdict = execute(sim, &p->completed);
    p->requests = 0;
    for (int32_t i = 0; i < 2 * p->member_count; i++) p->requests |= p->results[i] != 0.0;
    return verdict;
}
