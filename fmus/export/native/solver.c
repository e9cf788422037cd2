/* Inner steps with error control, by the implicit method. Of a model that is not declared stiff each is tried with
   the explicit method first, at half the cost; where its error is too large or it is not stable, for the model
   bends or is stiff there, the implicit one does it, and the explicit one rests: for 8 inner steps at first, for
   up to 1024 where it fails again and again. */

#include "solver.h"

#include <float.h>
#include <math.h>
#include <string.h>

enum { MOST_STEPS = 1000000, SHORTEST_REST = 8, LONGEST_REST = 1024 };

static const double DIAGONAL = 4.0; /* 1 / gamma of RODAS */

/* Weighted root mean square of the error estimate; the largest part goes to the report. */
static double error_norm(const double *x, const Work *w, double tolerance, Report *report) {
    double sum = 0.0, largest = -1.0;
    for (int i = 0; i < NX; i++) {
        const double size = fmax(fabs(x[i]), fabs(w->x[i]));
        const double weight = tolerance * (model_variables[FIRST_STATE + i].absolute + size);
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

/* Is it the explicit method's turn? */
static int its_turn(Pace *pace) {
    if (pace->rest <= 0) return 1;
    pace->rest--;
    return 0;
}

static void learn(Pace *pace, int success) {
    int patience = pace->patience;
    if (patience < SHORTEST_REST) patience = SHORTEST_REST;
    if (patience > LONGEST_REST) patience = LONGEST_REST;
    pace->rest = success ? 0 : patience;
    pace->patience = success ? patience - 1 : 2 * patience;
}

LOCAL Report solve(double *x, const double *p, const double *c, const Motion *motion, double length,
                   double tolerance, double smallest, const Between *between, Pace *pace, Work *w) {
    Report report = {SOLVED, 0.0, 0.0, 0, 0.0};
    double tau = 0.0, proposal = pace->step > 0.0 ? pace->step : length;
    int fresh = 0, rejected = 0;
    for (int count = 0; tau < length; count++) {
        /* Equal steps to the end, none larger than the proposal: no tiny last step. */
        const double parts = ceil((length - tau) / proposal * (1.0 - 1e-9));
        const double h = parts > 1.0 ? (length - tau) / parts : length - tau;
        double error = INFINITY, trust = 1.0;
        report.tau = tau;
        report.step = h;
        if (count == MOST_STEPS) {
            report.outcome = TOO_MANY_STEPS;
            return report;
        }
        if (!fresh) {
            motion_value(motion, tau, w->u);
            if (EXPLICIT_FIRST && its_turn(pace)) {
                model_dynamics(x, w->u, p, c, w->f0);
                if (kutta(x, p, c, motion, tau, h, w)) error = error_norm(x, w, tolerance, &report);
                learn(pace, error <= 1.0);
            }
        }
        if (!(error <= 1.0)) {
            if (!fresh) {
                motion_move(motion, tau, w->u);
                motion_slope(motion, tau, w->du);
                model_jacobian(x, w->u, p, c, w->du, w->f0, w->jac, w->ft);
                fresh = 1;
                if (not_finite(w->f0) >= 0) {
                    report.outcome = NOT_FINITE;
                    report.worst = not_finite(w->f0);
                    return report;
                }
            }
            const double diagonal = DIAGONAL / h;
            error = INFINITY;
            model_factorise(&diagonal, w->jac, w->lu, &trust);
            if (trust != 0.0) {
                rosenbrock(x, p, c, motion, tau, h, w);
                error = error_norm(x, w, tolerance, &report);
            }
        }
        if (error <= 1.0) {
            /* Order of the estimate of RODAS is 3, so its error grows with h^4; that of the other with h^3. */
            const double growth = fmin(5.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
            const double next = h * (rejected ? fmin(1.0, growth) : growth);
            /* A step cut short by the end of the interval says nothing against the old proposal. */
            proposal = growth < 5.0 || rejected ? next : fmax(next, proposal);
            memcpy(x, w->x, NX * sizeof *x);
            tau = parts > 1.0 ? tau + h : length;
            fresh = rejected = 0;
            if (between->call) length = between->call(between->owner, tau, length);
        } else {
            proposal = h * (error < DBL_MAX ? fmax(0.2, 0.9 / sqrt(sqrt(error))) : 0.2);
            rejected = 1;
            if (proposal < smallest) {
                report.outcome = trust != 0.0 ? STEP_TOO_SMALL : SINGULAR;
                return report;
            }
        }
    }
    report.tau = tau;
    pace->step = proposal;
    return report;
}
