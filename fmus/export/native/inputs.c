#include "inputs.h"

#include <string.h>

LOCAL void inputs_update(const InputPolynomials *inputs, double tau, double *u) {
    const double t = tau - inputs->origin;
    for (int k = 0; k < inputs->count; k++) {
        const int i = inputs->moving[k];
        const double *m = inputs->coefficients[i];
        u[i] = inputs->start[i] + t * (m[0] + t * (m[1] + t * m[2]));
    }
}

LOCAL void inputs_value(const InputPolynomials *inputs, double tau, double *u) {
    memcpy(u, inputs->start, NU * sizeof *u);
    inputs_update(inputs, tau, u);
}

LOCAL void inputs_derivative(const InputPolynomials *inputs, double tau, double *du) {
    const double t = tau - inputs->origin;
    memset(du, 0, NU * sizeof *du);
    for (int k = 0; k < inputs->count; k++) {
        const int i = inputs->moving[k];
        const double *m = inputs->coefficients[i];
        du[i] = m[0] + t * (2 * m[1] + t * 3 * m[2]);
    }
}
