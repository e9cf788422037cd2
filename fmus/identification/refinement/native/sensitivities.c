/* States and outputs of a model over recorded samples, and their forward sensitivities with respect to
   parameters and initial states. Columns: dynamic parameters, then states, then padding to a whole block.

   The solver is that of the FMU. Each step is differentiated after the solver has accepted it: sens.c. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "sens.h"
#include "solver.h"

#ifdef _WIN32
#define EXPORTED __declspec(dllexport)
#else
#define EXPORTED __attribute__((visibility("default")))
#endif

enum {
    COLUMNS = NQ + NX,
    BLOCKS = (COLUMNS + WIDTH - 1) / WIDTH,
    PARAMETER_BLOCKS = (NQ + WIDTH - 1) / WIDTH,
    NOT_REQUIRED = TOO_MANY_STEPS + 1,
    OUTPUT_NOT_FINITE
};

typedef struct {
    const double *p, *d;
    const InputPolynomials *inputs;
    Work work;
    int sensitivities; /* whether to compute them */
    int steps;
    double tau;         /* start of the step */
    double x[ROOM(NX)]; /* states at the start of the step */
    Columns dx[ROOM(BLOCKS)][ROOM(NX)];
    Columns f_q[STAGES][ROOM(PARAMETER_BLOCKS)][ROOM(NX)]; /* zero outside the pattern F_Q */
} Trajectory;

static void put(double *columns, int rows, const int entry[2], double value) {
    const int block = entry[1] / WIDTH, lane = entry[1] % WIDTH;
    columns[(block * rows + entry[0]) * WIDTH + lane] = value;
}

/* All columns of block b over the step. */
static void advance(Trajectory *t, int b, double h, double jac[STAGES][ROOM(NJ)],
                    double product[STAGES][ROOM(NPRODUCT)]) {
    Columns dk[STAGES][ROOM(NX)], dX[ROOM(NX)], r[ROOM(NX)];
    Columns *dx = t->dx[b];
    for (int s = 0; s < STAGES; s++) {
        for (int i = 0; i < NX; i++) {
            Columns stage = dx[i], right = b < PARAMETER_BLOCKS ? t->f_q[s][b][i] : (Columns)0.0;
            for (int j = 0; j < s; j++) {
                stage += A[s][j] * dk[j][i];
                right += C[s][j] / h * dk[j][i];
            }
            dX[i] = stage;
            r[i] = right;
        }
        sens_stage_columns(jac[s], product[s], t->work.lu, dX, dx, r, dk[s]);
    }
    for (int i = 0; i < NX; i++) dx[i] = dX[i] + dk[STAGES - 1][i];
}

/* Called by the solver after each accepted step, which ends at tau. */
static double after_step(void *owner, double tau, double length) {
    Trajectory *t = owner;
    t->steps++;
    if (!t->sensitivities) return length;
    const double h = tau - t->tau;
    double hessian[ROOM(NHESSIAN)], jac[STAGES][ROOM(NJ)], product[STAGES][ROOM(NPRODUCT)], f_q[ROOM(NF_Q)];
    double u[ROOM(NU)], du[ROOM(NU)], x[ROOM(NX)];
    Work *w = &t->work;
    inputs_derivative(t->inputs, t->tau, du);
    inputs_value(t->inputs, t->tau, u);
    sens_hessian(t->x, u, t->p, t->d, hessian);
    for (int s = 0; s < STAGES; s++) {
        double h_du[ROOM(NU)];
        for (int i = 0; i < NU; i++) h_du[i] = G[s] * h * du[i];
        for (int i = 0; i < NX; i++) {
            x[i] = t->x[i];
            for (int j = 0; j < s; j++) x[i] += A[s][j] * w->k[j][i];
        }
        inputs_update(t->inputs, t->tau + ALPHA[s] * h, u);
        sens_stage(x, u, t->p, t->d, hessian, w->k[s], h_du, jac[s], product[s], f_q);
        for (int e = 0; e < NF_Q; e++) put((double *)t->f_q[s], NX, F_Q[e], f_q[e]);
    }
    for (int b = 0; b < BLOCKS; b++) advance(t, b, h, jac, product);
    for (int i = 0; i < NX; i++) t->x[i] = x[i] + w->k[STAGES - 1][i];
    t->tau = tau;
    return length;
}

/* Outputs at a sample, and their sensitivities dy, (NOUT, BLOCKS WIDTH), if asked for; returns whether all of
   them are finite. */
static int observe(const Trajectory *t, const double *x, const double *u, double *y, double *dy) {
    double sum = 0.0; /* of products with zero, which are NaN for what is not finite */
    sens_outputs(x, u, t->p, t->d, y);
    for (int i = 0; i < NOUT; i++) sum += 0.0 * y[i];
    if (t->sensitivities) {
        double y_x[ROOM(NY_X)], y_q[ROOM(NY_Q)];
        Columns columns[ROOM(NOUT)], column_sum = 0.0;
        sens_output_jacobians(x, u, t->p, t->d, y_x, y_q);
        for (int b = 0; b < BLOCKS; b++) {
            sens_output_columns(y_x, t->dx[b], columns);
            for (int i = 0; i < NOUT; i++) {
                column_sum += 0.0 * columns[i];
                memcpy(dy + (i * BLOCKS + b) * WIDTH, &columns[i], sizeof columns[i]);
            }
        }
        for (int e = 0; e < NY_Q; e++) {
            dy[Y_Q[e][0] * BLOCKS * WIDTH + Y_Q[e][1]] += y_q[e];
            sum += 0.0 * y_q[e];
        }
        for (int i = 0; i < WIDTH; i++) sum += column_sum[i];
    }
    return sum == 0.0;
}

/* Simulates from the states x over n samples of time and inputs, (n, NU), with inputs linear between them.

   x        becomes the states at the last sample
   y        outputs, (n, NOUT)
   dy, dx   sensitivities of the outputs, (n, NOUT, BLOCKS WIDTH), and of the last states, (NX, BLOCKS WIDTH),
            written if `sensitivities`
   report   time reached, number of steps, index of the state or requirement that failed

   Returns an Outcome, NOT_REQUIRED or OUTPUT_NOT_FINITE. */
EXPORTED int simulate(int n, const double *time, const double *input_samples, double *x, const double *p,
                      double tolerance, int sensitivities, double *y, double *dy, double *dx, double *report) {
    double c[ROOM(NC)], d[ROOM(ND)];
    InputPolynomials inputs = {.count = 0};
    Trajectory t = {.p = p, .d = d, .inputs = &inputs, .sensitivities = sensitivities};
    StepMemory memory = {0};
    const StepCallback callback = {after_step, &t, 1};
    sens_prepare(p, d);
    for (int i = 0; i < NX; i++) put((double *)t.dx, NX, (int[2]){i, NQ + i}, 1.0);
    for (int k = 0; k < n; k++) {
        const double *u = input_samples + k * NU;
        double none[1], z[ROOM(NZ)], require[ROOM(NREQUIRE)];
        report[0] = time[k];
        report[1] = t.steps;
        model_prepare(u, p, c);
        model_observe_states(x, p, c, none, z);
        model_require(x, u, p, c, z, require);
        for (int i = 0; i < NREQUIRE; i++)
            if (!(require[i] > 0.0)) {
                report[2] = i;
                return NOT_REQUIRED;
            }
        if (!observe(&t, x, u, y + k * NOUT, sensitivities ? dy + (long)k * NOUT * BLOCKS * WIDTH : 0))
            return OUTPUT_NOT_FINITE;
        if (k == n - 1) break;
        const double length = time[k + 1] - time[k];
        inputs.count = 0;
        for (int i = 0; i < NU; i++) {
            inputs.start[i] = u[i];
            inputs.coefficients[i][0] = model_variables[FIRST_INPUT + i].held ? 0.0 : (u[NU + i] - u[i]) / length;
            if (inputs.coefficients[i][0] != 0.0) inputs.moving[inputs.count++] = i;
        }
        memcpy(t.x, x, NX * sizeof *x);
        t.tau = 0.0;
        const double smallest = fmax(1e-14 * length, DBL_MIN);
        const Report solution = solve(x, p, c, &inputs, length, tolerance, smallest, &callback, &memory, &t.work);
        if (solution.outcome != SOLVED) {
            report[0] += solution.tau;
            report[2] = solution.worst;
            return (int)solution.outcome;
        }
    }
    if (sensitivities)
        for (int i = 0; i < NX; i++)
            for (int b = 0; b < BLOCKS; b++)
                memcpy(dx + (i * BLOCKS + b) * WIDTH, &t.dx[b][i], sizeof t.dx[b][i]);
    return SOLVED;
}
