/* The explicit methods, for models that are not stiff. They need no Jacobian and no linear system.

   Kutta's method of order 3, three stages, with the midpoint rule of order 2 inside:

       k_1 = f(t, x)        k_2 = f(t + h/2, x + h/2 k_1)        k_3 = f(t + h, x - h k_1 + 2 h k_2)

       x(t + h) = x + h (k_1 + 4 k_2 + k_3) / 6        error = h (k_1 - 2 k_2 + k_3) / 6

   W. Kutta, Zeitschrift fuer Mathematik und Physik 46 (1901) 435.

   The method of Cash and Karp, six stages, with solutions of order 5, 4 and 3. J. R. Cash, A. H. Karp, ACM Transactions
   on Mathematical Software 16(3) (1990) 201.

   An eigenvalue is estimated from the last two stages, lambda = (k_j - k_i) / (x_j - x_i). If |lambda h| is too large
   the step is rejected: the method would soon amplify any error, even that of rounding. */

#include "solver.h"

/* Largest |lambda h|. On the negative real axis the methods are stable up to 2.5 and 3.7. */
static const double KUTTA_LIMIT = 1.0, CASH_KARP_LIMIT = 3.0;

static const double CK_NODES[6] = {0.0, 0.2, 0.3, 0.6, 1.0, 0.875};
static const double CK_STAGES[6][5] = {
    {0},
    {0.2},
    {0.075, 0.225},
    {0.3, -0.9, 1.2},
    {-11.0 / 54.0, 2.5, -70.0 / 27.0, 35.0 / 27.0},
    {1631.0 / 55296.0, 175.0 / 512.0, 575.0 / 13824.0, 44275.0 / 110592.0, 253.0 / 4096.0},
};
static const double CK_ORDER_5[6] = {37.0 / 378.0, 0.0, 250.0 / 621.0, 125.0 / 594.0, 0.0, 512.0 / 1771.0};
static const double CK_ORDER_4[6] = {2825.0 / 27648.0,  0.0, 18575.0 / 48384.0, 13525.0 / 55296.0,
                                     277.0 / 14336.0, 0.25};
static const double CK_ORDER_3[6] = {19.0 / 54.0, 0.0, -10.0 / 27.0, 55.0 / 54.0, 0.0, 0.0};

/* 1 if |lambda h| is within the limit, where df = lambda dx: differences between two stages. */
static CONDITION is_stable(const double *df, const double *dx, double h, double limit) {
    double sum_f = 0.0, sum_x = 0.0;
    for (int i = 0; i < NX; i++) {
        const double scale = 1.0 / model_variables[FIRST_STATE + i].nominal;
        sum_f += scale * df[i] * (scale * df[i]);
        sum_x += scale * dx[i] * (scale * dx[i]);
    }
    return h * h * sum_f <= limit * limit * sum_x;
}

LOCAL CONDITION kutta(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                      double h, Work *w) {
    const double *k1 = w->f0;
    double *k2 = w->k[0], *k3 = w->k[1], at[ROOM(NX)], df[ROOM(NX)], dx[ROOM(NX)];
    for (int i = 0; i < NX; i++) at[i] = x[i] + 0.5 * h * k1[i];
    inputs_update(inputs, tau + 0.5 * h, w->u);
    model_dynamics(at, w->u, p, c, k2);
    for (int i = 0; i < NX; i++) at[i] = x[i] + h * (2.0 * k2[i] - k1[i]);
    inputs_update(inputs, tau + h, w->u);
    model_dynamics(at, w->u, p, c, k3);
    for (int i = 0; i < NX; i++) {
        w->error[i] = h / 6.0 * (k1[i] - 2.0 * k2[i] + k3[i]);
        w->x[i] = x[i] + h * k2[i] + w->error[i];
        df[i] = k3[i] - k2[i];
        dx[i] = h * (2.0 * k2[i] - 1.5 * k1[i]);
    }
    return is_stable(df, dx, h, KUTTA_LIMIT);
}

LOCAL CONDITION cash_karp(const double *x, const double *p, const double *c, const InputPolynomials *inputs,
                          double tau, double h, Work *w) {
    const double *k1 = w->f0;
    double *k2 = w->k[0], *k3 = w->k[1], *k4 = w->k[2], *k5 = w->k[3], *k6 = w->k[4];
    double at[ROOM(NX)], df[ROOM(NX)], dx[ROOM(NX)];
    for (int i = 0; i < NX; i++) at[i] = x[i] + h * (CK_STAGES[1][0] * k1[i]);
    inputs_update(inputs, tau + CK_NODES[1] * h, w->u);
    model_dynamics(at, w->u, p, c, k2);
    for (int i = 0; i < NX; i++) at[i] = x[i] + h * (CK_STAGES[2][0] * k1[i] + CK_STAGES[2][1] * k2[i]);
    inputs_update(inputs, tau + CK_NODES[2] * h, w->u);
    model_dynamics(at, w->u, p, c, k3);
    for (int i = 0; i < NX; i++)
        at[i] = x[i] + h * (CK_STAGES[3][0] * k1[i] + CK_STAGES[3][1] * k2[i] + CK_STAGES[3][2] * k3[i]);
    inputs_update(inputs, tau + CK_NODES[3] * h, w->u);
    model_dynamics(at, w->u, p, c, k4);
    for (int i = 0; i < NX; i++)
        at[i] = x[i] + h * (CK_STAGES[4][0] * k1[i] + CK_STAGES[4][1] * k2[i] + CK_STAGES[4][2] * k3[i] +
                            CK_STAGES[4][3] * k4[i]);
    inputs_update(inputs, tau + CK_NODES[4] * h, w->u);
    model_dynamics(at, w->u, p, c, k5);
    for (int i = 0; i < NX; i++) {
        const double last = at[i];
        at[i] = x[i] + h * (CK_STAGES[5][0] * k1[i] + CK_STAGES[5][1] * k2[i] + CK_STAGES[5][2] * k3[i] +
                            CK_STAGES[5][3] * k4[i] + CK_STAGES[5][4] * k5[i]);
        dx[i] = at[i] - last;
    }
    inputs_update(inputs, tau + CK_NODES[5] * h, w->u);
    model_dynamics(at, w->u, p, c, k6);
    for (int i = 0; i < NX; i++) {
        const double fifth =
            CK_ORDER_5[0] * k1[i] + CK_ORDER_5[2] * k3[i] + CK_ORDER_5[3] * k4[i] + CK_ORDER_5[5] * k6[i];
        const double fourth = CK_ORDER_4[0] * k1[i] + CK_ORDER_4[2] * k3[i] + CK_ORDER_4[3] * k4[i] +
                              CK_ORDER_4[4] * k5[i] + CK_ORDER_4[5] * k6[i];
        const double third = CK_ORDER_3[0] * k1[i] + CK_ORDER_3[2] * k3[i] + CK_ORDER_3[3] * k4[i];
        w->x[i] = x[i] + h * fifth;
        w->error[i] = h * (fifth - fourth);
        w->b[i] = h * (fifth - third);
        df[i] = k6[i] - k5[i];
    }
    return is_stable(df, dx, h, CASH_KARP_LIMIT);
}
