/* FMUs of small systems that are no harvesters, for FMI 2.0 Co-Simulation; not_harvesters.py connects them.
 *
 * Each integrates with Runge-Kutta steps of at most MICRO from the beginning of the communication step on. The GUID
 * names the model. Value references: inputs, outputs, states, derivatives of the states, parameters.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

enum { NU = 2, NY = 3, NX = 3, NP = 5, NM = 3, ORDERS = 3, PAST = 4096 };
enum { U = 0, Y = U + NU, X = Y + NY, DX = X + NX, P = DX + NX, REALS = P + NP };
static const double MICRO = 5e-5, PI = 3.14159265358979323846;

static const char *MODELS[] = {"spring_mass", "mass", "cell", "wave", "pulse", "pwm", "chopper", "coil", "lag", "rectifier",
                               "controller", "pendulum", "delay", "relay", "actuator", "motor", "gear", "heater", "room",
                               "sum", "cubic", "slider", "belt", "ball", "floor", "lorenz_x", "lorenz_yz", "pulser", "regulator"};
enum { SPRING_MASS, MASS, CELL, WAVE, PULSE, PWM, CHOPPER, COIL, LAG, RECTIFIER, CONTROLLER, PENDULUM, DELAY, RELAY, ACTUATOR,
       MOTOR, GEAR, HEATER, ROOM, SUM, CUBIC, SLIDER, BELT, BALL, FLOOR, LORENZ_X, LORENZ_YZ, PULSER, REGULATOR, COUNT };

typedef struct {
    int model;
    double t, r[REALS], slope[NU][ORDERS], memory[NM];
    int filled;
    double times[PAST], values[PAST];
} Fmu;

/* Height, period, share, and whether the input is the height or the share; each period begins with the pulse. */
static double pulse(const double *p, double t, double u) {
    const double phase = t / p[1] + 1e-9, share = p[3] > 0 ? p[2] : u;
    return phase - floor(phase) < share ? (p[3] > 0 ? u * p[0] : p[0]) : 0.0;
}

static int within_period(double t, double period, double share) {
    const double phase = t / period + 1e-9;
    return phase - floor(phase) < share;
}

/* The input of a delay `by` [s] ago */
static double past(const Fmu *m, double t) {
    if (!m->filled || t <= m->times[0]) return 0.0;
    int i = m->filled - 1;
    for (; i > 0 && m->filled - i < PAST - 1 && m->times[i % PAST] > t; i--) {}
    const double t0 = m->times[i % PAST], v0 = m->values[i % PAST];
    if (i + 1 >= m->filled) return v0;
    const double t1 = m->times[(i + 1) % PAST], v1 = m->values[(i + 1) % PAST];
    return t1 > t0 ? v0 + (v1 - v0) * (t - t0) / (t1 - t0) : v1;
}

static void evaluate(const Fmu *m, double t, const double *x, const double *u, double *dx, double *y) {
    const double *p = m->r + P;
    switch (m->model) {
    case SPRING_MASS: /* mass, spring, coupling */
        y[0] = p[2] * (u[0] - x[0]), y[1] = x[0], y[2] = x[1];
        dx[0] = x[1], dx[1] = (y[0] - p[1] * x[0]) / p[0];
        break;
    case MASS:
        y[0] = x[0], y[1] = x[1];
        dx[0] = x[1], dx[1] = (-p[1] * x[0] - u[0]) / p[0];
        break;
    case CELL: /* resistance, capacitance */
        y[0] = x[0], y[1] = (u[0] - x[0]) / p[0];
        dx[0] = (y[1] - u[1]) / p[1];
        break;
    case WAVE: y[0] = p[0] * sin(2 * PI * p[1] * t + p[2]) + p[3]; break;
    case PULSE: y[0] = t + 1e-12 >= p[1] && t + 1e-12 < p[1] + p[2] ? p[0] : p[3]; break;
    case PWM: y[0] = within_period(t - p[3], p[1], p[2]) ? p[0] : 0.0; break;
    case CHOPPER: y[0] = within_period(t - p[3], p[1], p[2]) ? u[0] : 0.0; break;
    case COIL: y[0] = x[0], dx[0] = (u[0] - p[0] * x[0]) / p[1]; break;
    case LAG: y[0] = x[0], dx[0] = (p[0] * (u[0] - u[1]) - x[0]) / p[1]; break;
    case RECTIFIER: y[0] = x[0], dx[0] = ((u[0] > 0 ? u[0] : 0.0) - p[0] * x[0]) / p[1]; break;
    case CONTROLLER: y[0] = m->memory[0]; break;
    case PENDULUM: y[0] = x[0], dx[0] = x[1], dx[1] = p[0] * u[0] - p[1] * sin(x[0]) - p[2] * x[1]; break;
    case DELAY: y[0] = past(m, t - p[0]); break;
    case RELAY: y[0] = m->memory[0] > 0 ? p[0] : -p[0]; break;
    case ACTUATOR: { /* gain, limit, time constant, set point */
        const double v = p[0] * (p[3] - u[0]);
        y[0] = x[0], dx[0] = ((v > p[1] ? p[1] : v < -p[1] ? -p[1] : v) - x[0]) / p[2];
        break;
    }
    case MOTOR: /* resistance, inductance, constant, inertia; current, speed, angle */
        y[0] = x[2], y[1] = x[1], y[2] = x[0];
        dx[0] = (u[1] - p[0] * x[0] - p[2] * x[1]) / p[1], dx[1] = (p[2] * x[0] - u[0]) / p[3], dx[2] = x[1];
        break;
    case GEAR: { /* gap, stiffness, inertia, damping; angle, speed */
        const double d = u[0] - x[0];
        y[0] = d > p[0] ? p[1] * (d - p[0]) : d < -p[0] ? p[1] * (d + p[0]) : 0.0, y[1] = x[0], y[2] = x[1];
        dx[0] = x[1], dx[1] = (y[0] - p[3] * x[1]) / p[2];
        break;
    }
    case HEATER: /* power, conductance, capacity, low, high */
        y[0] = p[1] * (x[0] - u[0]), y[1] = x[0];
        dx[0] = ((m->memory[0] > 0 ? p[0] : 0.0) - y[0]) / p[2];
        break;
    case ROOM: y[0] = x[0], dx[0] = (u[0] - p[0] * (x[0] - p[2])) / p[1]; break;
    case SUM: y[0] = p[0] * u[0] + p[1] * u[1]; break;
    case CUBIC: y[0] = p[0] * (u[0] + u[1]) - p[1] * pow(u[0] + u[1], 3); break;
    case SLIDER: { /* mass, friction, speed of the belt, smoothing; position, speed */
        const double v = p[2] - x[1];
        y[0] = x[0], y[1] = x[1];
        dx[0] = x[1], dx[1] = (p[1] * tanh(v / p[3]) * (0.6 + 0.4 * exp(-fabs(v) / 0.1)) + u[0]) / p[0];
        break;
    }
    case BELT: y[0] = -p[0] * u[0]; break;
    case BALL: y[0] = x[0], y[1] = x[1], dx[0] = x[1], dx[1] = u[0] / p[0] - 9.81; break;
    case FLOOR: y[0] = u[0] < 0 ? -p[0] * u[0] - p[1] * u[1] : 0.0; break;
    case LORENZ_X: y[0] = x[0], dx[0] = 10.0 * (u[0] - x[0]); break;
    case LORENZ_YZ:
        y[0] = x[0], y[1] = x[1];
        dx[0] = u[0] * (28.0 - x[1]) - x[0], dx[1] = u[0] * x[0] - 8.0 / 3.0 * x[1];
        break;
    case PULSER: y[0] = pulse(p, t, u[0]), dx[0] = -x[0]; break;
    case REGULATOR: y[0] = p[0] * (p[2] - u[0]) + x[0], dx[0] = p[1] * (p[2] - u[0]); break; /* P, I, set point */
    default: break;
    }
}

/* Discrete states, after each of its own steps. */
static void update(Fmu *m, double t, const double *u) {
    const double *p = m->r + P, *x = m->r + X;
    switch (m->model) {
    case CONTROLLER: /* proportional, integral, period, set point */
        if (t + 1e-9 < m->memory[2]) break;
        m->memory[1] += p[1] * p[2] * (p[3] - u[0]), m->memory[0] = p[0] * (p[3] - u[0]) + m->memory[1];
        m->memory[2] += p[2];
        break;
    case RELAY: m->memory[0] = u[0] > p[1] ? -1 : u[0] < -p[1] ? 1 : m->memory[0]; break;
    case HEATER: m->memory[0] = x[0] > p[4] ? -1 : x[0] < p[3] ? 1 : m->memory[0]; break;
    case DELAY:
        if (m->filled && t <= m->times[(m->filled - 1) % PAST]) break;
        m->times[m->filled % PAST] = t, m->values[m->filled++ % PAST] = u[0];
        break;
    default: break;
    }
}

static void refresh(Fmu *m) { evaluate(m, m->t, m->r + X, m->r + U, m->r + DX, m->r + Y); }

static void inputs_at(const Fmu *m, const double *u0, double s, double *u) {
    for (int i = 0; i < NU; i++)
        u[i] = u0[i] + s * (m->slope[i][0] + s * (m->slope[i][1] / 2 + s * m->slope[i][2] / 6));
}

static void step(Fmu *m, double h) {
    double u0[NU], u[NU], k[4][NX] = {{0}}, y[NY], x[NX];
    const int n = (int)ceil(h / MICRO - 1e-9);
    const double d = h / n, begin = m->t;
    memcpy(u0, m->r + U, sizeof u0);
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < 4; i++) {
            const double s = d * (j + (i + 1) / 2 / 2.0);
            for (int l = 0; l < NX; l++)
                x[l] = m->r[X + l] + (i ? d * ((i + 1) / 2 / 2.0) * k[i - 1][l] : 0.0);
            inputs_at(m, u0, s, u);
            evaluate(m, begin + s, x, u, k[i], y);
        }
        for (int l = 0; l < NX; l++) m->r[X + l] += d / 6 * (k[0][l] + 2 * k[1][l] + 2 * k[2][l] + k[3][l]);
        inputs_at(m, u0, d * (j + 1), u);
        update(m, m->t = begin + d * (j + 1), u);
    }
    m->t = begin + h;
    memcpy(m->r + U, u, sizeof u);
    memset(m->slope, 0, sizeof m->slope);
}

/* ---- FMI */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *call, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name, (void)type, (void)resources, (void)call, (void)visible, (void)logging;
    for (int i = 0; i < COUNT; i++)
        if (!strcmp(guid, MODELS[i])) {
            Fmu *m = calloc(1, sizeof *m);
            m->model = i;
            return m;
        }
    return NULL;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean has_stop, fmi2Real stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((Fmu *)c)->t = start;
    return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Fmu *m = c;
    m->memory[0] = m->model == CONTROLLER ? 0 : 1;
    return fmi2OK;
}
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Fmu *m = c;
    update(m, m->t, m->r + U);
    return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return (void)c, fmi2Error; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return (void)c, (void)on, (void)n, (void)categories, fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Fmu *m = c;
    refresh(m);
    for (size_t k = 0; k < n; k++) value[k] = m->r[vr[k]];
    return fmi2OK;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) ((Fmu *)c)->r[vr[k]] = value[k];
    return fmi2OK;
}
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    for (size_t k = 0; k < n; k++) ((Fmu *)c)->slope[vr[k] - U][order[k] - 1] = value[k];
    return fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[]) {
    Fmu *m = c;
    const double d = 1e-7;
    double y[2][NY] = {{0}}, x[NX], rates[NX];
    (void)order;
    refresh(m);
    for (int i = 0; i < 2; i++) {
        for (int l = 0; l < NX; l++) x[l] = m->r[X + l] + i * d * m->r[DX + l];
        evaluate(m, m->t + i * d, x, m->r + U, rates, y[i]);
    }
    for (size_t k = 0; k < n; k++) value[k] = (y[1][vr[k] - Y] - y[0][vr[k] - Y]) / d;
    return fmi2OK;
}
fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t rows,
                                        const fmi2ValueReference knowns[], size_t columns, const fmi2Real seed[],
                                        fmi2Real sensitivity[]) {
    Fmu *m = c, at[2];
    double largest = 0.0;
    for (size_t k = 0; k < columns; k++) largest = fmax(largest, fabs(seed[k]));
    const double d = largest > 0.0 ? 1e-6 / largest : 1.0;
    for (int i = 0; i < 2; i++) {
        memcpy(&at[i], m, offsetof(Fmu, filled));
        at[i].filled = 0;
        for (size_t k = 0; k < columns; k++) at[i].r[knowns[k]] += (2 * i - 1) * d * seed[k];
        refresh(&at[i]);
    }
    for (size_t k = 0; k < rows; k++) sensitivity[k] = (at[1].r[unknowns[k]] - at[0].r[unknowns[k]]) / (2 * d);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean no_rollback) {
    Fmu *m = c;
    (void)no_rollback;
    m->t = t;
    step(m, h);
    return fmi2OK;
}
fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!*state) *state = malloc(sizeof(Fmu));
    memcpy(*state, c, sizeof(Fmu));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    memcpy(c, state, sizeof(Fmu));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* ---- the truth: each system as one, by Runge-Kutta steps of 10 us, within which a source is what it is in the middle */

static double jump_at(double t, double begin, double end) { return t > begin && t < end; }
static double duty(double t, double period, double on) { return fmod(t, period) < on; }
static double sgn(double v) { return (v > 0) - (v < 0); }

typedef struct { double switched, integral, level, next, delayed[8000]; long n; } Discrete;

/* dx of system k; t: of the stage, middle: of the step */
static void joined(int k, double t, double middle, const double *x, const Discrete *d, double *dx) {
    double f;
    switch (k) {
    case 0: case 1: case 2: { /* oscillators, mass ratio 1000, 0.001, 1 */
        const double ratio = k == 0 ? 1000 : k == 1 ? 0.001 : 1;
        f = 100 * (x[2] - x[0]);
        dx[0] = x[1], dx[1] = f - 10 * x[0], dx[2] = x[3], dx[3] = (-f - 50 * x[2]) / ratio;
        break;
    }
    case 3:
        f = 5 * sin(2 * PI * 2 * t);
        dx[0] = ((f - x[0]) / 1 - (x[0] - x[1]) / 2) / 0.01, dx[1] = ((x[0] - x[1]) / 2 - (x[1] - x[2]) / 1) / 2e-4;
        dx[2] = (x[1] - x[2]) / 1 / 0.05;
        break;
    case 4: case 5: dx[0] = x[1], dx[1] = 4 * d->level - 9 * sin(x[0]) - 2 * x[1]; break;
    case 6: dx[0] = (2 * (1 - d->level) - x[0]) / 0.2; break;
    case 7: dx[0] = (3 * d->switched - x[0]) / 0.5; break;
    case 8: f = 20 * (1 - x[0]); dx[1] = ((f > 2 ? 2 : f < -2 ? -2 : f) - x[1]) / 0.05, dx[0] = (x[1] - x[0]) / 0.3; break;
    case 9: {
        const double lag = x[2] - x[3], torque = fabs(lag) > 0.05 ? 40 * (lag - sgn(lag) * 0.05) : 0;
        dx[0] = (12 * sin(2 * PI * 0.7 * t) - 1 * x[0] - 0.1 * x[1]) / 0.01, dx[1] = (0.1 * x[0] - torque) / 0.02;
        dx[2] = x[1], dx[3] = x[4], dx[4] = (torque - 0.05 * x[4]) / 0.03;
        break;
    }
    case 10:
        f = 4 * (x[0] - x[1]);
        dx[0] = ((d->switched > 0 ? 60 : 0) - f) / 2, dx[1] = (f - 0.4 * (x[1] - 15)) / 50;
        break;
    case 11: /* a = 0.5 b + w, b = -0.8 a + 0.3 z */
        f = sin(2 * PI * 1.5 * t);
        dx[0] = ((f + 0.15 * x[0]) / 1.4 - x[0]) / 0.1;
        break;
    case 12: { /* a = b + w, b = -0.5 (a + z) - 0.3 (a + z)^3 */
        double a = 0, w = sin(2 * PI * 1.5 * t);
        for (int i = 0; i < 60; i++) {
            const double s = a + x[0];
            a -= (a - w + 0.5 * s + 0.3 * s * s * s) / (1.5 + 0.9 * s * s);
        }
        dx[0] = (0.3 * a - x[0]) / 0.1;
        break;
    }
    case 13:
        f = 0.5 - x[1];
        dx[0] = x[1], dx[1] = 8 * tanh(f / 0.02) * (0.6 + 0.4 * exp(-fabs(f) / 0.1)) - 60 * x[0];
        break;
    case 14: dx[0] = x[1], dx[1] = (x[0] < 0 ? -2e5 * x[0] - 40 * x[1] : 0) / 1.0 - 9.81; break;
    case 15: dx[0] = (10 * jump_at(middle, 3.1415, 3.1423) - 2 * x[0]) / 0.05; break;
    case 16: case 18: f = 10 * sin(2 * PI * (k == 16 ? 500 : 60) * t + 0.3); dx[0] = ((f > 0 ? f : 0) - 2 * x[0]) / 0.05; break;
    case 17: dx[0] = 10 * (x[1] - x[0]), dx[1] = x[0] * (28 - x[2]) - x[1], dx[2] = x[0] * x[1] - 8.0 / 3 * x[2]; break;
    case 19: case 24: case 25: case 26: dx[0] = (24 * duty(middle, 0.005, 0.0015) - 2 * x[0]) / 0.05; break;
    /* further sources */
    case 20: dx[0] = (24 * duty(middle, 0.00618, 0.00124) - 2 * x[0]) / 0.05; break;
    case 21: dx[0] = (10 * jump_at(middle, 1.7, 1.7003) - 2 * x[0]) / 0.05; break;
    case 22: dx[0] = (24 * x[1] * duty(middle, 0.005, 0.0015) - 2 * x[0]) / 0.05, dx[1] = (1 - x[1]) / 0.3; break;
    case 23: /* a tone of 50 Hz and a pulse */
        f = 5 * sin(2 * PI * 50 * t) + 20 * jump_at(middle, 0.9, 0.9008);
        dx[0] = (f - 2 * x[0]) / 0.05;
        break;
    case 27: f = 10 * sin(2 * PI * 1000.0 / 3 * t + 1); dx[0] = ((f > 0 ? f : 0) - 2 * x[0]) / 0.05; break;
    case 28: dx[0] = (24 * duty(middle, 0.01, 0.0002) - 2 * x[0]) / 0.05; break;
    default: break;
    }
}

static void decide(int k, double t, const double *x, Discrete *d, double h) {
    d->n++;
    if (k == 4 || k == 5) {
        if (t + 1e-9 < d->next) return;
        d->integral += 3 * 0.025 * (0.5 - x[0]), d->level = 1.5 * (0.5 - x[0]) + d->integral, d->next += 0.025;
    }
    if (k == 6) { /* what the state was 50 ms ago, in the middle of the step that follows */
        const long back = (long)(0.05 / h + 0.5);
        d->delayed[d->n % back] = x[0];
        d->level = d->n > back ? 0.5 * (d->delayed[(d->n + 1) % back] + d->delayed[(d->n + 2) % back]) : 0.0;
    }
    if (k == 7) d->switched = x[0] > 0.8 ? -1 : x[0] < -0.8 ? 1 : d->switched;
    if (k == 10) d->switched = x[0] > 40 ? -1 : x[0] < 35 ? 1 : d->switched;
}

/* Writes the state `watched` of system k at each step of h [s]; x: at the start */
void solve(int k, double *x, int watched, double h, int rows, double *out) {
    static const double C[] = {0, 0.5, 0.5, 1};
    Discrete d = {.switched = 1};
    memset(d.delayed, 0, sizeof d.delayed);
    double a[4][16] = {{0}}, z[16] = {0};
    for (int n = 0; n < rows; n++) {
        const double t = n * h;
        out[n] = x[watched];
        decide(k, t, x, &d, h);
        for (int i = 0; i < 4; i++) {
            for (int l = 0; l < 6; l++) z[l] = x[l] + (i ? h * C[i] * a[i - 1][l] : 0.0);
            joined(k, t + C[i] * h, t + 0.5 * h, z, &d, a[i]);
        }
        for (int l = 0; l < 6; l++) x[l] += h / 6 * (a[0][l] + 2 * a[1][l] + 2 * a[2][l] + a[3][l]);
    }
}

/* A regulator, a pulser and a coil as one; out: share or height of the pulses, and the current, at `rows` points, `steps`
 * Euler steps of h [s] apart */
void loop(const double *regulator, const double *pulser, const double *coil, double h, int steps, int rows, double *out) {
    double sum = 0.0, current = 0.0;
    for (int n = 0; n < rows; n++) {
        for (int i = 0; i <= steps; i++) {
            const double error = regulator[2] - current, u = regulator[0] * error + sum;
            if (!i) out[2 * n] = u, out[2 * n + 1] = current;
            if (i == steps) break;
            sum += h * regulator[1] * error;
            current += h * (pulse(pulser, h * ((double)n * steps + i + 0.5), u) - coil[0] * current) / coil[1];
        }
    }
}
