/* The inputs between two communication points. */

#ifndef MOTION_H
#define MOTION_H

#include "model.h"

/* Inputs over the step: at[i] + sum over k of slope[i][k] (tau - origin)^(k+1), tau [s] since its start. */
typedef struct {
    double at[ROOM(NU)];
    double slope[ROOM(NU)][3];
    int moving[ROOM(NU)]; /* indices of the `count` inputs with a slope */
    int count;
    double origin;
} Motion;

/* Value of all inputs at tau; of those that move, where the others are there already; slope of all. */
LOCAL void motion_value(const Motion *motion, double tau, double *u);
LOCAL void motion_move(const Motion *motion, double tau, double *u);
LOCAL void motion_slope(const Motion *motion, double tau, double *du);

#endif
