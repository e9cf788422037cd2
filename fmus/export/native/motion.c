#include "motion.h"

#include <string.h>

LOCAL void motion_update(const Motion *motion, double tau, double *u) {
    const double t = tau - motion->origin;
    for (int k = 0; k < motion->count; k++) {
        const int i = motion->moving[k];
        const double *m = motion->coefficients[i];
        u[i] = motion->start[i] + t * (m[0] + t * (m[1] + t * m[2]));
    }
}

LOCAL void motion_value(const Motion *motion, double tau, double *u) {
    memcpy(u, motion->start, NU * sizeof *u);
    motion_update(motion, tau, u);
}

LOCAL void motion_derivative(const Motion *motion, double tau, double *du) {
    const double t = tau - motion->origin;
    memset(du, 0, NU * sizeof *du);
    for (int k = 0; k < motion->count; k++) {
        const int i = motion->moving[k];
        const double *m = motion->coefficients[i];
        du[i] = m[0] + t * (2 * m[1] + t * 3 * m[2]);
    }
}
