/* Inner steps with error control. A cheap method is tried first; if its error is too large, another one takes the step.

       models that are not stiff   Kutta's method (order 3), that of Cash and Karp (order 5), RODAS (order 4)
       stiff models                RODAS3 (order 3), RODAS (order 4)

   RODAS3 is tried if the tolerance is not tight and one step would cover the communication step: several of them cost
   more than a step of RODAS. A method that fails pauses, longer after repeated failures. That of Cash and Karp pauses if
   it is unstable only. */

#include "solver.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { MOST_STEPS = 1000000 };

/* Inner steps of a pause after a failure: 1, twice as many after each further one, but no more than this. */
enum { LONGEST_PAUSE = 16 };

static const double LOOSE = 1e-5; /* tightest tolerance for RODAS3 */

/* Error estimates are multiplied by these. RODAS3 is to be as accurate as RODAS, whose estimate is that of its embedded
   method and far too large. Cash and Karp: if f jumps inside a step, the estimate of order 4 is a 15th of that of
   order 3, which is right then. In smooth motion the latter is far too large. */
static const double RODAS3_FACTOR = 3.0, ORDER_4_FACTOR = 15.0, ORDER_3_FACTOR = 0.01;

/* A method at work; the arrays are those of `solve`. */
typedef struct {
    double *x;
    const double *p, *c;
    const InputPolynomials *inputs;
    double tolerance;
    StepMemory *memory;
    Work *w;
    double tau, h;   /* start and size of the inner step [s] */
    int cheap;       /* 1: the last step is one of the method that is tried first */
    int linearised;  /* 1: w->jac and w->ft are those at tau */
    double accurate; /* 0: the linear system of the last step was singular */
} Solver;

/* Weighted root mean square of an error of the new states. */
static double norm(const Solver *s, const double *error) {
    double sum = 0.0;
    for (int i = 0; i < NX; i++) {
        const double magnitude = fmax(fabs(s->x[i]), fabs(s->w->x[i]));
        const double part = error[i] / (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        sum += part * part;
    }
    return sqrt(sum / ROOM(NX)) / s->tolerance;
}

/* Index of the state with the largest error of the last step that was tried. */
static int worst_state(const Solver *s) {
    double largest = -1.0;
    int worst = 0;
    for (int i = 0; i < NX && !isnan(largest); i++) {
        const double magnitude = fmax(fabs(s->x[i]), fabs(s->w->x[i]));
        const double part = fabs(s->w->error[i]) / (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        if (part <= largest) continue;
        largest = part;
        worst = i;
    }
    return worst;
}

/* Index of the first derivative that is not finite, or -1. */
static int not_finite(const double *f) {
    for (int i = 0; i < NX; i++)
        if (!isfinite(f[i])) return i;
    return -1;
}

/* 1 if the method is to be tried now. */
static int is_due(Pause *p) {
    if (p->left <= 0) return 1;
    p->left--;
    return 0;
}

static void update_pause(Pause *p, int success) {
    const int pause = p->next < 1 ? 1 : p->next > LONGEST_PAUSE ? LONGEST_PAUSE : p->next;
    p->left = success ? 0 : pause;
    p->next = success ? pause - 1 : 2 * pause;
}

/* Error of a step of an explicit method, in units of the tolerance; infinite if both are unstable or pause. */
static double explicit_step(Solver *s) {
    Work *w = s->w;
    double error = INFINITY;
    if (s->tau > 0.0) model_dynamics(s->x, w->u, s->p, s->c, w->f0);
    if (is_due(&s->memory->cheap)) {
        if (kutta(s->x, s->p, s->c, s->inputs, s->tau, s->h, w)) error = norm(s, w->error);
        s->cheap = error <= 1.0;
        update_pause(&s->memory->cheap, s->cheap);
    }
    if (!(error <= 1.0) && is_due(&s->memory->second)) {
        const int stable = cash_karp(s->x, s->p, s->c, s->inputs, s->tau, s->h, w);
        error = stable ? fmax(ORDER_4_FACTOR * norm(s, w->error), ORDER_3_FACTOR * norm(s, w->b)) : INFINITY;
        update_pause(&s->memory->second, stable);
    }
    return error;
}

/* Computes f and its derivatives at tau. */
static void linearise(Solver *s) {
    Work *w = s->w;
    inputs_update(s->inputs, s->tau, w->u);
    inputs_derivative(s->inputs, s->tau, w->du);
    model_jacobian(s->x, w->u, s->p, s->c, w->du, w->f0, w->jac, w->ft);
    s->linearised = 1;
}

typedef void Rosenbrock(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                        double h, Work *w);

/* Error of a step of an implicit method with this gamma, in units of the tolerance; infinite if the linear system is
   singular. */
static double implicit_step(Solver *s, Rosenbrock *method, double gamma) {
    const double diagonal = 1.0 / (gamma * s->h);
    model_factorise(&diagonal, s->w->jac, s->w->lu, &s->accurate);
    if (s->accurate == 0.0) return INFINITY;
    method(s->x, s->p, s->c, s->inputs, s->tau, s->h, s->w);
    return norm(s, s->w->error);
}

/* The proposal for the step after an accepted one. The estimate of RODAS has order 3, so its error grows as h^4. The other
   errors grow in a similar way. */
static double next_step(const Solver *s, double error, double proposal, int rejected) {
    const double growth = fmin(rejected ? 1.0 : 5.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
    const double next = s->h * growth;
    /* The method that is tried first leaves the step to the next one, and a step that was shortened by the end of the
       interval does not lower the proposal. */
    return s->cheap || growth == 5.0 ? fmax(next, proposal) : next;
}

static Report failure(const Solver *s, Report report, Outcome outcome) {
    report.outcome = outcome;
    report.worst = outcome == NOT_FINITE ? not_finite(s->w->f0) : worst_state(s);
    return report;
}

LOCAL Report solve(double *x, const double *p, const double *c, const InputPolynomials *inputs, double length,
                   double tolerance, double minimum_step, const StepCallback *callback, StepMemory *memory,
                   Work *w) {
    Report report = {SOLVED, 0.0, 0.0, 0};
    Solver s = {x, p, c, inputs, tolerance, memory, w, 0.0, 0.0, 0, 0, 1.0};
    const int explicit_first = EXPLICIT_FIRST && !callback->rodas_only;
    const int try_rodas3 = !EXPLICIT_FIRST && !callback->rodas_only && tolerance >= LOOSE;
    double proposal = memory->step > 0.0 ? memory->step : length;
    int rejected = 0;
    for (int count = 0; s.tau < length; count++) {
        /* Equal steps to the end, none larger than the proposal: no tiny last step. */
        const double rest = length - s.tau, ratio = rest / proposal * (1.0 - 1e-9);
        const double parts = ratio > 1.0 ? ceil(ratio) : 1.0;
        double error = INFINITY;
        s.h = rest / parts;
        s.cheap = 0;
        report.tau = s.tau;
        report.step = s.h;
        if (count == MOST_STEPS) return failure(&s, report, TOO_MANY_STEPS);
        if (!s.linearised) {
            inputs_value(inputs, s.tau, w->u);
            if (explicit_first) error = explicit_step(&s);
        }
        if (!(error <= 1.0) && !s.linearised) {
            linearise(&s);
            if (not_finite(w->f0) >= 0) return failure(&s, report, NOT_FINITE);
            if (try_rodas3 && s.h == length && is_due(&memory->cheap)) {
                error = RODAS3_FACTOR * implicit_step(&s, rodas3, RODAS3_GAMMA);
                s.cheap = error <= 1.0;
                update_pause(&memory->cheap, s.cheap);
            }
        }
        if (!(error <= 1.0)) error = implicit_step(&s, rodas, GAMMA);
        if (error <= 1.0) {
            proposal = next_step(&s, error, proposal, rejected);
            memcpy(x, w->x, NX * sizeof *x);
            s.tau = parts > 1.0 ? s.tau + s.h : length;
            s.linearised = rejected = 0;
            if (callback->call) length = callback->call(callback->owner, s.tau, length);
        } else {
            proposal = s.h * (error < DBL_MAX ? fmax(0.2, 0.9 / sqrt(sqrt(error))) : 0.2);
            rejected = 1;
            if (proposal < minimum_step) return failure(&s, report, s.accurate != 0.0 ? STEP_TOO_SMALL : SINGULAR);
        }
    }
    report.tau = s.tau;
    memory->step = proposal;
    return report;
}
