/* The error of a run, estimated while it runs: the errors of all inputs, carried through the linearised system.
 *
 * Inside a step an FMU uses the input u(s) that the master gave it, not the value of its source at that time. Along
 * the computed solution the source is known at both ends of the step, by value and slope, so the defect of the input is
 *
 *     d(s) = H(s) - u(s) + s^2 (h - s)^2 y4 / 24
 *
 * H: cubic through both ends; y4: fourth derivative of the source. Masters of order 4 step each FMU in two halves, and
 * the value of the source between them gives y4. Else y4 follows from the third derivatives of H in neighbouring
 * steps; and if the slope of the source changes much more than in the steps around, H is replaced by two straight lines
 * with a corner. To first order the errors e = truth - computed of all states are those of the linear system
 *
 *     e' = (A + B K C) e + B d(s)                                                          (linear_system.c)
 *
 * There is no K before d, because outputs with feed-through are known for inputs without defect.
 *
 * A section consists of as many steps as change the slopes of the sources by a part of their magnitude. Over a section
 * d(s) is the straight line with the same mean and the same first moment, and the system is solved by one step of the
 * L-stable Runge-Kutta method of order 4 with five stages and the same diagonal element gamma (Hairer and Wanner, Solving
 * Ordinary Differential Equations II, table 6.5). The system is linearised anew every `lag` steps, which is adapted to
 * its changes, and at corners. e is one step behind the run, because a defect needs the step that follows. After
 * `sample` steps the errors of the outputs follow from e by directional derivatives. They are at most the ranges of the
 * outputs so far: the slope of a valve that has just opened holds for a part of a bar, not for an error of several. Errors
 * inside the FMUs are not included.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

static const double SAME_STEP = 1e-9;           /* largest relative difference of two equal steps */
static const double QUARTIC_MEAN = 8.0 / 15.0;  /* mean of s^2 (h - s)^2 over its value in the middle */
enum { STAGES = 5 };
static const double GAMMA = 0.25;
static const double NODES[STAGES] = {0.25, 0.75, 0.55, 0.5, 1.0};
static const double WEIGHTS[STAGES][STAGES - 1] = {
    {0.0},
    {0.5},
    {17.0 / 50.0, -1.0 / 25.0},
    {371.0 / 1360.0, -137.0 / 2720.0, 15.0 / 544.0},
    {25.0 / 24.0, -49.0 / 48.0, 125.0 / 16.0, -85.0 / 12.0},
};
/* A corner: mean second derivative of its step over the largest in the steps around. That of past steps fades by the
 * second factor in each step. */
static const double CORNER = 4.0, FADING = 0.9;
/* Largest diagonal element of A + B K C times h. While a cavity collapses, the element is positive and grows to the
 * inverse of the remaining time, where the method would amplify an error without limit. */
static const double GROWTH = 0.25;
/* Change of the slopes over a section, over their magnitude; the magnitude of past steps fades by the second factor. */
static const double RESOLVED = 0.8, SLOPE_FADING = 0.95;
static const double COMPARABLE = 0.3; /* shortest step over the next one from which a fourth derivative follows */
static const double DIVIDED = 0.5;    /* step over the one before: it is divided, because the system changes */
static const double MUCH = 0.3, LITTLE = 0.1; /* relative change of a diagonal element that halves, doubles the lag */

/* The line nearest to a course that is straight up to a corner at tau [s] and straight from there on. */
static int find_corner(const CouplingInput *s, double h, double line[]) {
    const double jump = s->slope_end - s->slope, tau = (s->value + s->slope_end * h - s->value_end) / jump;
    if (!(tau > 0.0 && tau < h)) return 0;
    const double rest = h - tau; /* a ramp jump (s - tau) from tau on: its mean, and its moment about the middle */
    const double mean = jump * rest * rest / (2.0 * h), moment = jump * rest * rest * (h + 2.0 * tau) / 12.0;
    const double slope = 12.0 * moment / (h * h * h);
    line[0] = s->value + mean - slope * h / 2.0, line[1] = s->slope + slope;
    return 1;
}

/* The line nearest to a line that an FMU holds at its mean over each of n equal parts of the step. */
static void hold_in_parts(double line[], int32_t n, double h) {
    const double lost = line[1] / ((double)n * n);
    line[0] += lost * h / 2.0, line[1] -= lost;
}

/* Notes the last step of an input, of length h [s]; halved: its source was read in the middle. */
static void note_step(const CouplingInput *s, ErrorInput *p, double h, int halved) {
    InputStep *step = &p->last;
    double course[DEGREE + 1], used[DEGREE + 1];
    if (s->source_component == DRIVEN) { /* a corner inside the step: Simpson's rule */
        step->line[0] = 2.0 / 3.0 * (s->expected - s->value_end);
        return;
    }
    input_true_course(s, h, course);
    step->third = course[DEGREE], step->bend = fabs(s->slope_end - s->slope) / h;
    if (s->source_slope)
        p->usual_slope = larger(SLOPE_FADING * p->usual_slope, larger(fabs(s->slope), fabs(s->slope_end)));
    step->smooth = s->source_slope && !s->autonomous && s->slopes_known > 1;
    step->measured = halved && !s->in_loop;
    step->off_cubic = polynomial_value(course, 0.5 * h) - polynomial_value(s->c, 0.5 * h);
    step->off_source = step->measured ? s->middle - polynomial_value(s->c, 0.5 * h) : step->off_cubic;
    memcpy(used, s->c, sizeof used);
    polynomial_project(used, 1, h);
    if (s->requested_degree && !s->fmu_degree) hold_in_parts(used, p->substeps, h);
    step->has_corner = step->smooth && find_corner(s, h, step->corner);
    polynomial_project(course, 1, h);
    for (int i = 0; i < 2; i++) step->line[i] = course[i] - used[i], step->corner[i] -= used[i];
}

/* Does the source have a corner in the step before the last one? */
static int has_corner(const ErrorInput *p) {
    return p->step.has_corner && p->step.bend > CORNER * larger(p->usual_bend, p->last.bend);
}

/* The defect of an input in the step before the last one. */
static void find_defect(const ErrorInput *p, const double h[], double d[]) {
    const InputStep *before = &p->before, *step = &p->step, *after = &p->last;
    memcpy(d, has_corner(p) && !step->measured ? step->corner : step->line, sizeof step->line);
    if (has_corner(p) || step->measured || !step->smooth || !before->smooth) return;
    double change = 0.0; /* of the third derivative; a much shorter step does not resolve it */
    if (h[0] > COMPARABLE * h[1]) change = (step->third - before->third) / (h[0] + h[1]);
    if (h[2] > COMPARABLE * h[1]) {
        const double right = (after->third - step->third) / (h[1] + h[2]);
        if (fabs(right) > fabs(change)) change = right;
    }
    const double fourth = 12.0 * change;
    d[0] += h[1] * h[1] * h[1] * h[1] * fourth / 720.0;
}

/* Adds the line d over a step of length h [s], which begins at `start` [s], to the defect over the section. */
static void add_defect(double sum[], const double d[], double start, double h) {
    const double mean = d[0] + d[1] * h / 2.0;
    sum[0] += mean * h;
    sum[1] += h * (mean * (start + h / 2.0) + d[1] * h * h / 12.0);
}

/* The line over a section of length h [s] with the same integral and the same first moment. */
static void find_line(const double sum[], double h, double d[]) {
    d[1] = 12.0 * (sum[1] - sum[0] * h / 2.0) / (h * h * h);
    d[0] = sum[0] / h - d[1] * h / 2.0;
}

/* B times constant and slope of the defects over a section of length h [s], shape (2, n). */
static void find_forcing(const ErrorPropagation *p, double h, double *forcing) {
    const LinearSystem *system = &p->system;
    vector_zero(forcing, 2 * system->n_padded);
    for (int k = 0; k < 2; k++) {
        vector_zero(p->w, system->m_padded);
        for (int32_t i = 0; i < system->m; i++) {
            double d[LINE + 1];
            find_line(&p->defects[2 * i], h, d);
            p->w[i] = d[k];
        }
        matrix_add_product(state_space(system).b, p->w, forcing + k * system->n_padded, system->m, system->n_padded);
    }
}

static void prepare(ErrorPropagation *p, double h) {
    if (!p->system.usable || fabs(h - p->factors_step) <= SAME_STEP * h) return;
    p->factors_step = h;
    for (int32_t i = 0; i < p->system.n; i++) {
        double *diagonal = &p->system.closed_loop[i * p->system.n_padded + i];
        *diagonal = smaller(*diagonal, GROWTH / h);
    }
    matrix_identity_minus(p->factors, p->system.closed_loop, GAMMA * h, p->system.n, p->system.n_padded);
    p->system.usable = matrix_factorise(p->factors, p->system.pivots, p->system.n, p->system.n_padded);
}

/* Advances the errors of the states over a step of length h [s]. */
void error_advance(ErrorPropagation *p, double h) {
    const int32_t n = p->system.n, n_padded = p->system.n_padded;
    double *base = p->stages, *forcing = base + n_padded, *rates = forcing + 2 * n_padded;
    prepare(p, h);
    if (!p->system.usable) return;
    find_forcing(p, h, forcing);
    for (int k = 0; k < STAGES; k++) {
        double *rate = rates + k * n_padded; /* the stage, then h de/ds there */
        vector_copy(base, p->e, n_padded);
        for (int j = 0; j < k; j++)
            for (int32_t i = 0; i < n_padded; i++) base[i] += WEIGHTS[k][j] * rates[j * n_padded + i];
        for (int32_t i = 0; i < n_padded; i++)
            rate[i] = base[i] + GAMMA * h * (forcing[i] + NODES[k] * h * forcing[n_padded + i]);
        matrix_solve(p->factors, p->system.pivots, rate, n, n_padded);
        if (k == STAGES - 1) vector_copy(p->e, rate, n_padded);
        for (int32_t i = 0; i < n_padded; i++) rate[i] = (rate[i] - base[i]) / GAMMA;
    }
}

static int find_output_errors(Simulation *sim, const ErrorPropagation *p, const ErrorMember *member) {
    double *seed = member->outputs.seed;
    memcpy(seed, p->e + member->first_state, (size_t)member->state_count * sizeof *seed);
    memcpy(seed + member->state_count, p->w + member->first_input, (size_t)member->input_count * sizeof *seed);
    for (int32_t i = 0; i < member->copy_count; i++) seed[member->to[i]] = p->y[member->from[i]] * member->factors[i];
    return directional_derivative(sim, &member->outputs);
}

/* The errors of all outputs at the communication point t. Components with further inputs, which influence no state, are
 * evaluated again when the errors of their sources are known. */
static int sample(Simulation *sim, ErrorPropagation *p, double t) {
    vector_zero(p->w, p->system.m_padded);
    matrix_add_product(p->system.kc, p->e, p->w, p->system.n, p->system.m_padded);
    for (int round = 0; round < 2; round++)
        for (int32_t k = 0; k < p->member_count; k++) {
            if (round && !p->members[k].copy_count) continue;
            const int verdict = find_output_errors(sim, p, &p->members[k]);
            if (verdict) return verdict;
        }
    const int verdict = execute(sim, &p->output_reads);
    if (verdict) return verdict;
    for (int32_t i = 0; i < p->output_count; i++) {
        p->lowest[i] = smaller(p->lowest[i], p->values[i]), p->highest[i] = larger(p->highest[i], p->values[i]);
        const double range = p->highest[i] - p->lowest[i];
        if (range > 0.0) p->y[i] = larger(-range, smaller(p->y[i], range));
        p->squares[i] += p->y[i] * p->y[i] * p->since;
        p->largest[i] = larger(p->largest[i], fabs(p->y[i]));
    }
    p->time += p->since, p->since = 0.0;
    if (p->filled < p->capacity) {
        p->times[p->filled] = t;
        memcpy(p->rows + (size_t)p->filled++ * (size_t)p->output_count, p->y, (size_t)p->output_count * sizeof *p->y);
    }
    return CONTINUE;
}

/* Linearises the components. If a diagonal element has changed much since the last time, the next time is sooner. */
static int relinearise(Simulation *sim, ErrorPropagation *p) {
    const int32_t n = p->system.n, stride = p->system.n_padded + 1;
    for (int32_t i = 0; i < n; i++) p->diagonal[i] = p->system.closed_loop[i * stride];
    const int verdict = linear_system_evaluate(sim, &p->system);
    if (verdict) return verdict;
    linear_system_join(&p->system);
    p->factors_step = 0.0;
    double change = 0.0;
    const double least = 1.0 / (p->lag * p->lengths[2]);
    for (int32_t i = 0; i < n && p->lengths[2] > 0.0; i++) {
        const double old = p->diagonal[i], new = p->system.closed_loop[i * stride];
        change = larger(change, fabs(new - old) / (fabs(new) + fabs(old) + least));
    }
    if (change > MUCH) p->lag = p->lag > 1 ? p->lag / 2 : 1;
    else if (change < LITTLE) p->lag = 2 * p->lag > p->longest_lag ? p->longest_lag : 2 * p->lag;
    p->age = 0;
    return CONTINUE;
}

int error_begin(Simulation *sim) { return relinearise(sim, sim->errors); }

/* Inputs have jumped after the last step: no derivative follows from steps on both sides. */
void error_jump(ErrorPropagation *p) {
    for (int32_t i = 0; i < p->system.m; i++) p->inputs[i].last.smooth = p->inputs[i].last.has_corner = 0;
    p->age = p->lag;
}

/* Advances the errors over the section, which ends at t. */
static int end_section(Simulation *sim, ErrorPropagation *p, double t) {
    if (!p->taken) return CONTINUE;
    const int verdict = p->age < p->lag ? CONTINUE : relinearise(sim, p); /* so that e is as new as the outputs */
    if (verdict) return verdict;
    error_advance(p, p->section);
    memset(p->defects, 0, 2 * (size_t)p->system.m * sizeof *p->defects);
    p->since += p->section, p->since_sample += p->taken;
    p->section = 0.0, p->taken = 0;
    if (p->since_sample < p->sample) return CONTINUE;
    p->since_sample = 0;
    return sample(sim, p, t);
}

/* The number of steps in which the slopes of the sources, and with them the errors, change by a part of their
 * magnitude. */
static int32_t steps_together(const ErrorPropagation *p) {
    double sum = 0.0;
    int32_t count = 0;
    for (int32_t i = 0; i < p->system.m; i++) {
        const ErrorInput *input = &p->inputs[i];
        if (input->input < 0 || !(input->usual_slope > 0.0)) continue;
        const double change = larger(input->step.bend, input->usual_bend) * p->lengths[1] / input->usual_slope;
        sum += change * change;
        count++;
    }
    if (sum == 0.0) return 1;
    return (int32_t)smaller(RESOLVED / sqrt(sum / count), p->longest_section);
}

/* Adds the fourth powers in the defects of measured inputs. What was measured contains the defects of inputs with
 * feed-through; K removes them. */
static void add_measured(ErrorPropagation *p) {
    for (int32_t i = 0; i < p->system.m; i++) p->w[i] = p->inputs[i].step.off_source;
    linear_system_respond(&p->system, p->w, p->middle);
    for (int32_t i = 0; i < p->system.m; i++) {
        InputStep *step = &p->inputs[i].step;
        if (step->measured) step->line[0] += QUARTIC_MEAN * (p->middle[i] - step->off_cubic);
    }
}

/* Adds the step before the last one, which is known to be accepted, to the section. At a corner a new one begins. */
static int advance(Simulation *sim, ErrorPropagation *p) {
    const double h = p->lengths[1];
    int corners = 0, verdict = CONTINUE;
    for (int32_t i = 0; i < p->system.m; i++) corners += has_corner(&p->inputs[i]);
    if (corners) verdict = end_section(sim, p, p->starts[0]);
    if (corners && !verdict) verdict = relinearise(sim, p);
    if (verdict) return verdict;
    if (p->halves) add_measured(p);
    for (int32_t i = 0; i < p->system.m; i++) {
        double d[LINE + 1];
        if (p->inputs[i].input < 0) continue;
        find_defect(&p->inputs[i], p->lengths, d);
        add_defect(&p->defects[2 * i], d, p->section, h);
    }
    p->section += h, p->taken++, p->age++;
    return corners || p->taken >= steps_together(p) ? end_section(sim, p, p->starts[1]) : CONTINUE;
}

/* Takes note of an accepted step of length h [s], before its end becomes the beginning of the next one. */
int error_propagate(Simulation *sim, double h) {
    ErrorPropagation *p = sim->errors;
    p->lengths[0] = p->lengths[1], p->lengths[1] = p->lengths[2], p->lengths[2] = h;
    p->starts[0] = p->starts[1], p->starts[1] = sim->t;
    for (int32_t i = 0; i < p->system.m; i++) {
        ErrorInput *input = &p->inputs[i];
        input->usual_bend = larger(FADING * input->usual_bend, input->step.bend);
        input->before = input->step, input->step = input->last;
        if (input->input < 0) continue;
        const CouplingInput *s = &sim->inputs[input->input];
        note_step(s, input, h, s->source_component != DRIVEN && sim->components[s->source_component].halved);
    }
    if (h < DIVIDED * p->lengths[1]) p->age = p->lag;
    return p->lengths[1] > 0.0 ? advance(sim, p) : CONTINUE;
}
