/* The states and outputs of a model over recorded samples, and their derivatives by parameters and by the states
   at the start. Columns: parameters that act, then states, then what fills the last block.

   The solver is that of the FMU. After each step that it accepted, the step is differentiated: slopes.c. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "slopes.h"
#include "solver.h"

#ifdef _WIN32
#define SHOWN __declspec(dllexport)
#else
#define SHOWN __attribute__((visibility("default")))
#endif

#pragma clang fp contract(fast)

enum {
    COLUMNS = NQ + NX,
    BLOCKS = (COLUMNS + WIDTH - 1) / WIDTH,
    DIRECT_BLOCKS = (NQ + WIDTH - 1) / WIDTH, /* the blocks that hold parameters */
    NOT_REQUIRED = TOO_MANY_STEPS + 1,
    OUTPUT_NOT_FINITE
};

typedef struct {
    const double *p, *c, *d;
    const Motion *motion;
    Work work;
    int with; /* derivatives? */
    int steps;
    double tau;         /* where the step starts */
    double x[ROOM(NX)]; /* states there */
    Columns s[ROOM(BLOCKS)][ROOM(NX)];
    Columns direct[STAGES][ROOM(DIRECT_BLOCKS)][ROOM(NX)]; /* zero where nothing is ever written */
} Track;

static void put(double *columns, int stride, const int place[2], double value) {
    const int block = place[1] / WIDTH, lane = place[1] % WIDTH;
    columns[(block * stride + place[0]) * WIDTH + lane] = value;
}

/* All columns of one block over the step. */
static void advance(Track *t, int b, double h, double jac[STAGES][ROOM(NJ)], double bent[STAGES][ROOM(NBENT)]) {
    Columns k[STAGES][ROOM(NX)], at[ROOM(NX)], r[ROOM(NX)];
    Columns *from = t->s[b];
    for (int s = 0; s < STAGES; s++) {
        for (int i = 0; i < NX; i++) {
            Columns point = from[i], right = b < DIRECT_BLOCKS ? t->direct[s][b][i] : (Columns)0.0;
            for (int j = 0; j < s; j++) {
                point += A[s][j] * k[j][i];
                right += C[s][j] / h * k[j][i];
            }
            at[i] = point;
            r[i] = right;
        }
        columns_stage(jac[s], bent[s], t->work.lu, at, from, r, k[s]);
    }
    for (int i = 0; i < NX; i++) from[i] = at[i] + k[STAGES - 1][i];
}

/* After a step that ends at tau. */
static double follow(void *owner, double tau, double length) {
    Track *t = owner;
    t->steps++;
    if (!t->with) return length;
    const double h = tau - t->tau;
    double bends[ROOM(NBENDS)], jac[STAGES][ROOM(NJ)], bent[STAGES][ROOM(NBENT)], direct[ROOM(NDIRECT)];
    double u[ROOM(NU)], du[ROOM(NU)], x[ROOM(NX)];
    Work *w = &t->work;
    motion_slope(t->motion, t->tau, du);
    motion_value(t->motion, t->tau, u);
    slopes_bends(t->x, u, t->p, t->d, bends);
    for (int s = 0; s < STAGES; s++) {
        double h_du[ROOM(NU)];
        for (int i = 0; i < NU; i++) h_du[i] = G[s] * h * du[i];
        for (int i = 0; i < NX; i++) {
            x[i] = t->x[i];
            for (int j = 0; j < s; j++) x[i] += A[s][j] * w->k[j][i];
        }
        motion_move(t->motion, t->tau + ALPHA[s] * h, u);
        slopes_stage(x, u, t->p, t->d, bends, w->k[s], h_du, jac[s], bent[s], direct);
        for (int e = 0; e < NDIRECT; e++) put((double *)t->direct[s], NX, DIRECT[e], direct[e]);
    }
    for (int b = 0; b < BLOCKS; b++) advance(t, b, h, jac, bent);
    for (int i = 0; i < NX; i++) t->x[i] = x[i] + w->k[STAGES - 1][i];
    t->tau = tau;
    return length;
}

/* Outputs at a sample, and with `slopes` their derivatives, (NOUT, BLOCKS WIDTH); is all finite? */
static int observe(const Track *t, const double *x, const double *u, double *y, double *slopes) {
    double sum = 0.0;
    slopes_observe(x, u, t->p, t->d, y);
    for (int i = 0; i < NOUT; i++) sum += 0.0 * y[i];
    if (t->with) {
        double y_x[ROOM(NYX)], y_q[ROOM(NYQ)];
        Columns out[ROOM(NOUT)], total = 0.0;
        slopes_observed(x, u, t->p, t->d, y_x, y_q);
        for (int b = 0; b < BLOCKS; b++) {
            columns_observe(y_x, t->s[b], out);
            for (int i = 0; i < NOUT; i++) {
                total += 0.0 * out[i];
                memcpy(slopes + (i * BLOCKS + b) * WIDTH, &out[i], sizeof out[i]);
            }
        }
        for (int e = 0; e < NYQ; e++) {
            slopes[OBSERVED[e][0] * BLOCKS * WIDTH + OBSERVED[e][1]] += y_q[e];
            sum += 0.0 * y_q[e];
        }
        for (int i = 0; i < WIDTH; i++) sum += total[i];
    }
    return sum == 0.0;
}

/* Samples n of time and of inputs, (n, NU), linear between them; x becomes the states at the last sample.
   y (n, NOUT), slopes (n, NOUT, BLOCKS WIDTH) and ends (NX, BLOCKS WIDTH) if `with`.
   told: time reached, number of steps, index of what is to blame. */
SHOWN int refine(int n, const double *time, const double *inputs, double *x, const double *p, double tolerance,
                 int with, double *y, double *slopes, double *ends, double *told) {
    double c[ROOM(NC)], d[ROOM(ND)];
    Motion motion = {.count = 0};
    Track t = {.p = p, .c = c, .d = d, .motion = &motion, .with = with};
    Pace pace = {0};
    const Between between = {follow, &t};
    model_prepare(p, c);
    slopes_prepare(p, d);
    for (int i = 0; i < NX; i++) put((double *)t.s, NX, (int[2]){i, NQ + i}, 1.0);
    for (int k = 0; k < n; k++) {
        const double *u = inputs + k * NU;
        double none[1], require[ROOM(NREQUIRE)];
        told[0] = time[k];
        told[1] = t.steps;
        model_observe(x, u, p, c, none, require);
        for (int i = 0; i < NREQUIRE; i++)
            if (!(require[i] > 0.0)) {
                told[2] = i;
                return NOT_REQUIRED;
            }
        if (!observe(&t, x, u, y + k * NOUT, with ? slopes + (long)k * NOUT * BLOCKS * WIDTH : 0))
            return OUTPUT_NOT_FINITE;
        if (k == n - 1) break;
        const double length = time[k + 1] - time[k];
        motion.count = 0;
        for (int i = 0; i < NU; i++) {
            motion.at[i] = u[i];
            motion.slope[i][0] = (u[NU + i] - u[i]) / length;
            if (motion.slope[i][0] != 0.0) motion.moving[motion.count++] = i;
        }
        memcpy(t.x, x, NX * sizeof *x);
        t.tau = 0.0;
        const Report report = solve(x, p, c, &motion, length, tolerance, fmax(1e-14 * length, DBL_MIN), &between,
                                    &pace, &t.work);
        if (report.outcome != SOLVED) {
            told[0] += report.tau;
            told[2] = report.worst;
            return (int)report.outcome;
        }
    }
    if (with)
        for (int i = 0; i < NX; i++)
            for (int b = 0; b < BLOCKS; b++) memcpy(ends + (i * BLOCKS + b) * WIDTH, &t.s[b][i], sizeof t.s[b][i]);
    return SOLVED;
}
