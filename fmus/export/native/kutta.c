/* Kutta's method of order 3, three stages, with the midpoint rule of order 2 inside:

       k_1 = f(t, x)        k_2 = f(t + h/2, x + h/2 k_1)        k_3 = f(t + h, x - h k_1 + 2 h k_2)

       x(t + h) = x + h (k_1 + 4 k_2 + k_3) / 6        error = h (k_1 - 2 k_2 + k_3) / 6

   An eigenvalue is estimated from the last two stages, lambda = (k_3 - k_2) / (x_3 - x_2). If |lambda h| > 1 the step
   is rejected: the method would soon amplify any error, even that of rounding.
   W. Kutta, Zeitschrift fuer Mathematik und Physik 46 (1901) 435. The method needs no
   Jacobian and no linear system, so a step costs half of one of RODAS or less. For models that are not stiff. */

#include "solver.h"

LOCAL int kutta(const double *x, const double *p, const double *c, const InputPolynomials *inputs, double tau,
                double h, Work *w) {
    const double *k1 = w->f0;
    double change = 0.0, moved = 0.0; /* |k_3 - k_2|^2 and |x_3 - x_2|^2 / h^2, relative to the nominal values */
    double *k2 = w->k[0], *k3 = w->k[1];
    for (int i = 0; i < NX; i++) w->x[i] = x[i] + 0.5 * h * k1[i];
    inputs_update(inputs, tau + 0.5 * h, w->u);
    model_dynamics(w->x, w->u, p, c, k2);
    for (int i = 0; i < NX; i++) w->x[i] = x[i] + h * (2.0 * k2[i] - k1[i]);
    inputs_update(inputs, tau + h, w->u);
    model_dynamics(w->x, w->u, p, c, k3);
    for (int i = 0; i < NX; i++) {
        w->error[i] = h / 6.0 * (k1[i] - 2.0 * k2[i] + k3[i]);
        w->x[i] = x[i] + h * k2[i] + w->error[i];
        const double scale = 1.0 / model_variables[FIRST_STATE + i].nominal;
        const double a = scale * (k3[i] - k2[i]), b = scale * (2.0 * k2[i] - 1.5 * k1[i]);
        change += a * a;
        moved += b * b;
    }
    return change <= moved;
}
