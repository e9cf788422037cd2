/* RODAS, the implicit method: a Rosenbrock method of order 4 with an embedded one of order 3. It is L-stable and
   stiffly accurate, with six stages, one Jacobian and one LU factorisation per step.

       (I / (gamma h) - J) k_i = f(t + alpha_i h, x + sum_j a_ij k_j) + sum_j c_ij / h k_j + g_i h f_t

   The last two stages are the embedded and the final correction, so k_6 is the error estimate.
   Coefficients: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed.,
   section IV.7 and program RODAS. */

#include "solver.h"

enum { STAGES = 6 };

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

LOCAL void rosenbrock(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                      double h, Work *w) {
    for (int s = 0; s < STAGES; s++) {
        if (s == 0) {
            for (int i = 0; i < NX; i++) w->b[i] = w->f0[i];
        } else {
            for (int i = 0; i < NX; i++) w->x[i] = x[i];
            for (int j = 0; j < s; j++)
                for (int i = 0; i < NX; i++) w->x[i] += A[s][j] * w->k[j][i];
            if (s < STAGES - 1) inputs_update(inputs, tau + ALPHA[s] * h, w->u);
            model_dynamics(w->x, w->u, p, c, w->b);
            double sum[ROOM(NX)] = {0.0};
            for (int j = 0; j < s; j++)
                for (int i = 0; i < NX; i++) sum[i] += C[s][j] * w->k[j][i];
            for (int i = 0; i < NX; i++) w->b[i] += sum[i] / h;
        }
        if (inputs->count > 0 && s < 4)
            for (int i = 0; i < NX; i++) w->b[i] += G[s] * h * w->ft[i];
        model_solve(w->lu, w->b, w->k[s]);
    }
    for (int i = 0; i < NX; i++) {
        w->error[i] = w->k[STAGES - 1][i];
        w->x[i] += w->error[i];
    }
}

