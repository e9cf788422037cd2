/* The implicit methods, for stiff models. They are Rosenbrock methods, linearly implicit: one Jacobian and one LU
   factorisation per step.

       (I / (gamma h) - J) k_i = f(t + alpha_i h, x + sum_j a_ij k_j) + sum_j c_ij / h k_j + g_i h f_t

   Both are L-stable and stiffly accurate: the last two stages are the embedded and the final correction, so the last k
   is the error estimate.

   RODAS: order 4 with an embedded method of order 3, six stages. Coefficients: E. Hairer, G. Wanner, Solving Ordinary
   Differential Equations II, 2nd ed., section IV.7 and program RODAS.

   RODAS3: order 3 with an embedded method of order 2, four stages, of which the first two share f(t, x). A step takes
   half the time of one of RODAS. Coefficients: A. Sandu et al., Atmospheric Environment 31 (1997) 3459. */

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

LOCAL void rodas(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                      double h, Work *w) {
    double(*k)[ROOM(NX)] = w->k;
    const double r = 1.0 / h;
    double at[ROOM(NX)], f[ROOM(NX)], b[ROOM(NX)];
    for (int i = 0; i < NX; i++) b[i] = w->f0[i] + G[0] * h * w->ft[i];
    model_solve(w->lu, b, k[0]);

    for (int i = 0; i < NX; i++) at[i] = x[i] + A[1][0] * k[0][i];
    inputs_update(inputs, tau + ALPHA[1] * h, w->u);
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++) b[i] = f[i] + G[1] * h * w->ft[i] + r * (C[1][0] * k[0][i]);
    model_solve(w->lu, b, k[1]);

    for (int i = 0; i < NX; i++) at[i] = x[i] + A[2][0] * k[0][i] + A[2][1] * k[1][i];
    inputs_update(inputs, tau + ALPHA[2] * h, w->u);
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++) b[i] = f[i] + G[2] * h * w->ft[i] + r * (C[2][0] * k[0][i] + C[2][1] * k[1][i]);
    model_solve(w->lu, b, k[2]);

    for (int i = 0; i < NX; i++) at[i] = x[i] + A[3][0] * k[0][i] + A[3][1] * k[1][i] + A[3][2] * k[2][i];
    inputs_update(inputs, tau + ALPHA[3] * h, w->u);
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++)
        b[i] = f[i] + G[3] * h * w->ft[i] + r * (C[3][0] * k[0][i] + C[3][1] * k[1][i] + C[3][2] * k[2][i]);
    model_solve(w->lu, b, k[3]);

    for (int i = 0; i < NX; i++)
        at[i] = x[i] + A[4][0] * k[0][i] + A[4][1] * k[1][i] + A[4][2] * k[2][i] + A[4][3] * k[3][i];
    inputs_update(inputs, tau + ALPHA[4] * h, w->u);
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++)
        b[i] = f[i] + r * (C[4][0] * k[0][i] + C[4][1] * k[1][i] + C[4][2] * k[2][i] + C[4][3] * k[3][i]);
    model_solve(w->lu, b, k[4]);

    for (int i = 0; i < NX; i++) at[i] += k[4][i]; /* the rows of A are equal but for this one */
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++)
        b[i] = f[i] + r * (C[5][0] * k[0][i] + C[5][1] * k[1][i] + C[5][2] * k[2][i] + C[5][3] * k[3][i] +
                           C[5][4] * k[4][i]);
    model_solve(w->lu, b, k[5]);
    for (int i = 0; i < NX; i++) {
        w->error[i] = k[5][i];
        w->x[i] = at[i] + k[5][i];
    }
}

static const double RODAS3_GAMMA = 0.5;
static const double RODAS3_ALPHA[4] = {0.0, 0.0, 1.0, 1.0};
static const double RODAS3_G[4] = {0.5, 1.5, 0.0, 0.0};
static const double RODAS3_A[4][3] = {{0}, {0.0}, {2.0, 0.0}, {2.0, 0.0, 1.0}};
static const double RODAS3_C[4][3] = {{0}, {4.0}, {1.0, -1.0}, {1.0, -1.0, -8.0 / 3.0}};

LOCAL void rodas3(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                  double h, Work *w) {
    double(*k)[ROOM(NX)] = w->k;
    const double r = 1.0 / h;
    double at[ROOM(NX)], f[ROOM(NX)], b[ROOM(NX)];
    for (int i = 0; i < NX; i++) b[i] = w->f0[i] + RODAS3_G[0] * h * w->ft[i];
    model_solve(w->lu, b, k[0]);

    for (int i = 0; i < NX; i++) b[i] = w->f0[i] + RODAS3_G[1] * h * w->ft[i] + r * (RODAS3_C[1][0] * k[0][i]);
    model_solve(w->lu, b, k[1]);

    for (int i = 0; i < NX; i++) at[i] = x[i] + RODAS3_A[2][0] * k[0][i];
    inputs_update(inputs, tau + RODAS3_ALPHA[2] * h, w->u);
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++) b[i] = f[i] + r * (RODAS3_C[2][0] * k[0][i] + RODAS3_C[2][1] * k[1][i]);
    model_solve(w->lu, b, k[2]);

    for (int i = 0; i < NX; i++) at[i] += k[2][i]; /* the rows of A are equal but for this one */
    model_dynamics(at, w->u, p, c, f);
    for (int i = 0; i < NX; i++)
        b[i] = f[i] + r * (RODAS3_C[3][0] * k[0][i] + RODAS3_C[3][1] * k[1][i] + RODAS3_C[3][2] * k[2][i]);
    model_solve(w->lu, b, k[3]);
    for (int i = 0; i < NX; i++) {
        w->error[i] = k[3][i];
        w->x[i] = at[i] + k[3][i];
    }
}
