/* Inner steps with error control. A model that is declared stiff is solved by the implicit method alone. For other
   models each inner step is tried with the explicit method first, which costs half as much. If its error is too
   large or it is unstable, the implicit method repeats the step, and the explicit method pauses: for 8 inner steps
   at first, for up to 1024 after repeated failures. */

#include "solver.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { MOST_STEPS = 1000000, SHORTEST_PAUSE = 8, LONGEST_PAUSE = 1024 };

static const double DIAGONAL = 4.0; /* 1 / gamma of RODAS */

/* Weighted root mean square of the error estimate; stores the largest part in the report. */
static double error_norm(const double *x, const Work *w, double tolerance, Report *report) {
    double sum = 0.0, largest = -1.0;
    for (int i = 0; i < NX; i++) {
        const double magnitude = fmax(fabs(x[i]), fabs(w->x[i]));
        const double weight = tolerance * (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        const double part = fabs(w->error[i]) / weight;
        sum += part * part;
        if (!isnan(largest) && !(part <= largest)) {
            largest = part;
            report->worst = i;
        }
    }
    report->error = largest;
    return sqrt(sum / ROOM(NX));
}

/* Index of the first derivative that is not finite, or -1. */
static int not_finite(const double *f) {
    for (int i = 0; i < NX; i++)
        if (!isfinite(f[i])) return i;
    return -1;
}

/* 1 if the explicit method is to be tried in this inner step. */
static int explicit_is_due(StepMemory *memory) {
    if (memory->pause <= 0) return 1;
    memory->pause--;
    return 0;
}

static void update_memory(StepMemory *memory, int success) {
    int pause = memory->next_pause;
    if (pause < SHORTEST_PAUSE) pause = SHORTEST_PAUSE;
    if (pause > LONGEST_PAUSE) pause = LONGEST_PAUSE;
    memory->pause = success ? 0 : pause;
    memory->next_pause = success ? pause - 1 : 2 * pause;
}

LOCAL Report solve(double *x, const double *p, const double *c, const InputPolynomials *inputs, double length,
                   double tolerance, double minimum_step, const StepCallback *callback, StepMemory *memory,
                   Work *w) {
    Report report = {SOLVED, 0.0, 0.0, 0, 0.0};
    double tau = 0.0, proposal = memory->step > 0.0 ? memory->step : length;
    int linearised = 0, rejected = 0;
    for (int count = 0; tau < length; count++) {
        /* Equal steps to the end, none larger than the proposal: no tiny last step. */
        const double parts = ceil((length - tau) / proposal * (1.0 - 1e-9));
        const double h = parts > 1.0 ? (length - tau) / parts : length - tau;
        double error = INFINITY, accurate = 1.0;
        report.tau = tau;
        report.step = h;
        if (count == MOST_STEPS) {
            report.outcome = TOO_MANY_STEPS;
            return report;
        }
        if (!linearised) {
            inputs_value(inputs, tau, w->u);
            if (EXPLICIT_FIRST && explicit_is_due(memory)) {
                model_dynamics(x, w->u, p, c, w->f0);
                if (kutta(x, p, c, inputs, tau, h, w)) error = error_norm(x, w, tolerance, &report);
                update_memory(memory, error <= 1.0);
            }
        }
        if (!(error <= 1.0)) {
            if (!linearised) {
                inputs_update(inputs, tau, w->u);
                inputs_derivative(inputs, tau, w->du);
                model_jacobian(x, w->u, p, c, w->du, w->f0, w->jac, w->ft);
                linearised = 1;
                if (not_finite(w->f0) >= 0) {
                    report.outcome = NOT_FINITE;
                    report.worst = not_finite(w->f0);
                    return report;
                }
            }
            const double diagonal = DIAGONAL / h;
            error = INFINITY;
            model_factorise(&diagonal, w->jac, w->lu, &accurate);
            if (accurate != 0.0) {
                rosenbrock(x, p, c, inputs, tau, h, w);
                error = error_norm(x, w, tolerance, &report);
            }
        }
        if (error <= 1.0) {
            /* The estimate of RODAS has order 3: its error grows as h^4, that of Kutta's method as h^3. */
            const double growth = fmin(5.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
            const double next = h * (rejected ? fmin(1.0, growth) : growth);
            /* A step that was shortened by the end of the interval does not lower the proposal. */
            proposal = growth < 5.0 || rejected ? next : fmax(next, proposal);
            memcpy(x, w->x, NX * sizeof *x);
            tau = parts > 1.0 ? tau + h : length;
            linearised = rejected = 0;
            if (callback->call) length = callback->call(callback->owner, tau, length);
        } else {
            proposal = h * (error < DBL_MAX ? fmax(0.2, 0.9 / sqrt(sqrt(error))) : 0.2);
            rejected = 1;
            if (proposal < minimum_step) {
                report.outcome = accurate != 0.0 ? STEP_TOO_SMALL : SINGULAR;
                return report;
            }
        }
    }
    report.tau = tau;
    memory->step = proposal;
    return report;
}
