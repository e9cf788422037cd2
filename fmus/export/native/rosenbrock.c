/* RODAS: a linearly implicit Runge-Kutta method of order 4 with an embedded one of order 3,
   L-stable and stiffly accurate, six stages, one Jacobian and one LU factorisation per step.

       (I / (gamma h) - J) k_i = f(t + alpha_i h, x + sum_j a_ij k_j) + sum_j c_ij / h k_j + g_i h f_t

   The last two stages are the embedded and the final correction, so k_6 is the error estimate.
   Coefficients: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed.,
   section IV.7 and program RODAS. */

#include "rosenbrock.h"

#include <float.h>
#include <math.h>

enum { STAGES = 6, MOST_STEPS = 1000000 };

static const double GAMMA = 0.25;
static const double ALPHA[STAGES] = {0.0, 0.386, 0.21, 0.63, 1.0, 1.0};
static const double G[STAGES] = {0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0};
static const double A[STAGES][STAGES - 1] = {
    {0},
    {1.544},
    {0.9466785280815826, 0.2557011698983284},
    {3.314825187068521, 2.896124015972201, 0.9986419139977817},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0},
};
static const double C[STAGES][STAGES - 1] = {
    {0},
    {-5.6688},
    {-2.430093356833875, -0.2063599157091915},
    {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
    {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160},
    {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054},
};

LOCAL void motion_value(const Motion *motion, double tau, double *u) {
    const double t = tau - motion->origin;
    for (int i = 0; i < NU; i++) {
        const double *m = motion->coefficient[i];
        u[i] = m[0] + t * (m[1] + t * (m[2] + t * m[3]));
    }
}

LOCAL void motion_slope(const Motion *motion, double tau, double *du) {
    const double t = tau - motion->origin;
    for (int i = 0; i < NU; i++) {
        const double *m = motion->coefficient[i];
        du[i] = m[1] + t * (2 * m[2] + t * 3 * m[3]);
    }
}

/* All stages of one step of size h from x at tau; the new states are then x->x + k_6 in w->x. */
static void stages(const double *x, const double *p, const double *c, const Motion *motion, double tau,
                   double h, Work *w) {
    for (int s = 0; s < STAGES; s++) {
        if (s == 0) {
            for (int i = 0; i < NX; i++) w->b[i] = w->f0[i];
        } else {
            for (int i = 0; i < NX; i++) w->x[i] = x[i];
            for (int j = 0; j < s; j++)
                for (int i = 0; i < NX; i++) w->x[i] += A[s][j] * w->k[j][i];
            if (motion->moving && s < STAGES - 1) motion_value(motion, tau + ALPHA[s] * h, w->u);
            model_dynamics(w->x, w->u, p, c, w->b);
            double sum[ROOM(NX)] = {0.0};
            for (int j = 0; j < s; j++)
                for (int i = 0; i < NX; i++) sum[i] += C[s][j] * w->k[j][i];
            for (int i = 0; i < NX; i++) w->b[i] += sum[i] / h;
        }
        if (motion->moving && s < 4)
            for (int i = 0; i < NX; i++) w->b[i] += G[s] * h * w->ft[i];
        model_solve(w->lu, w->b, w->k[s]);
    }
    for (int i = 0; i < NX; i++) w->x[i] += w->k[STAGES - 1][i];
}

/* Weighted root mean square of the error estimate; the largest part goes to the report. */
static double error_norm(const double *x, const Work *w, double tolerance, Report *report) {
    double sum = 0.0, largest = -1.0;
    for (int i = 0; i < NX; i++) {
        const double size = fmax(fabs(x[i]), fabs(w->x[i]));
        const double weight = tolerance * (model_variables[FIRST_STATE + i].nominal + size);
        const double part = fabs(w->k[STAGES - 1][i]) / weight;
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

LOCAL Report rosenbrock(double *x, const double *p, const double *c, const Motion *motion, double length,
                        double tolerance, double smallest, const Between *between, double *step, Work *w) {
    Report report = {SOLVED, 0.0, 0.0, 0, 0.0};
    double tau = 0.0, proposal = *step > 0.0 ? *step : length;
    int fresh = 0, rejected = 0;
    for (int count = 0; tau < length; count++) {
        /* Equal steps to the end, none larger than the proposal: no tiny last step. */
        const double parts = ceil((length - tau) / proposal * (1.0 - 1e-9));
        const double h = parts > 1.0 ? (length - tau) / parts : length - tau;
        report.tau = tau;
        report.step = h;
        if (count == MOST_STEPS) {
            report.outcome = TOO_MANY_STEPS;
            return report;
        }
        if (!fresh) {
            motion_value(motion, tau, w->u);
            motion_slope(motion, tau, w->du);
            model_jacobian(x, w->u, p, c, w->du, w->f0, w->jac, w->ft);
            fresh = 1;
            if (not_finite(w->f0) >= 0) {
                report.outcome = NOT_FINITE;
                report.worst = not_finite(w->f0);
                return report;
            }
        }
        const double diagonal = 1.0 / (GAMMA * h);
        double error = INFINITY, trust;
        model_factorise(&diagonal, w->jac, w->lu, &trust);
        if (trust != 0.0) {
            stages(x, p, c, motion, tau, h, w);
            error = error_norm(x, w, tolerance, &report);
        }
        if (error <= 1.0) {
            /* Order of the estimate is 3, so the error grows with h^4. */
            const double growth = fmin(5.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
            const double next = h * (rejected ? fmin(1.0, growth) : growth);
            /* A step cut short by the end of the interval says nothing against the old proposal. */
            proposal = growth < 5.0 || rejected ? next : fmax(next, proposal);
            for (int i = 0; i < NX; i++) x[i] = w->x[i];
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
    *step = proposal;
    return report;
}
