/* The equations of the models in models.h, and what goes wrong in FAILS and QUIRK. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "models.h"

int instances = 0, saved = 0;

enum Model named(const char *guid) {
    static const char *guids[] = {"nobody", "mass_a", "mass_b", "source", "gain", "fails",
                                  "types",  "spring", "wide",   "drift",  "glide", "quirk", "bent", "pulses"};
    for (int model = MASS_A; model < MODELS; model++)
        if (!strcmp(guid, guids[model])) return model;
    return NOBODY;
}

enum Status complain(Instance *m, enum Status status, const char *what, double value) {
    char text[2 * LENGTH];
    if (status >= FAILED) m->mode = BROKEN;
    snprintf(text, sizeof text, "%s: %g", what, value);
    if (m->logging) m->say(m, status, status == WARNED ? "logStatusWarning" : "logStatusError", text);
    return status;
}

void begin(Instance *m, enum Model model, const char *name, const char *resources) {
    m->model = model;
    strncpy(m->name, name, LENGTH - 1);
    switch (model) {
    case MASS_A:
        m->r[A_V] = 100, m->r[A_MASS] = 1, m->r[A_SPRING] = 10, m->r[A_COUPLING] = 100, m->i[M_HIGHEST] = ORDERS;
        break;
    case MASS_B: m->r[B_V] = -100, m->r[B_MASS] = 1, m->r[B_SPRING] = 1000, m->i[M_HIGHEST] = ORDERS; break;
    case SPRING: m->r[K_STIFFNESS] = 100; break;
    case SOURCE: m->r[S_AMPLITUDE] = 1, m->r[S_OMEGA] = 1; break;
    case GAIN: m->r[G_FACTOR] = 1; break;
    case BENT: m->r[C_FACTOR] = 1; break;
    case FAILS: m->r[F_WHEN] = 1e9; break;
    case QUIRK: m->r[Q_GAIN] = 1, m->r[Q_WHEN] = 1e9, m->i[Q_HIGHEST] = ORDERS, m->i[Q_MUTE] = -1; break;
    case TYPES: m->r[T_GAIN] = 1; strcpy(m->s[T_LABEL], "nobody"); break;
    case WIDE: m->i[W_SIZE] = 3; break;
    default: break;
    }
    strncpy(m->s[T_RESOURCES], resources ? resources : "", LENGTH - 1);
    instances++;
}

enum Status move(Instance *m, enum Mode from, enum Mode to) {
    if (m->mode != from) return complain(m, FAILED, "call out of order in mode", m->mode);
    m->mode = to;
    return GOOD;
}

static int first_state(const Instance *);
static int states(const Instance *);
static void rates(const Instance *, double tau, const double *x, double *dx);

void outputs(Instance *m) {
    double *r = m->r;
    long long *i = m->i;
    if (states(m)) rates(m, 0, r + first_state(m), r + RATES);
    switch (m->model) {
    case MASS_A: r[A_FORCE] = r[A_COUPLING] * (r[A_X2] - r[A_X]); break;
    case SPRING: r[K_FORCE] = r[K_STIFFNESS] * r[K_STRETCH]; break;
    case SOURCE:
        r[S_Y] = r[S_OFFSET] + r[S_AMPLITUDE] * sin(r[S_OMEGA] * m->time);
        r[S_Y] += r[S_RAMP] * fmax(m->time - r[S_BEND], 0);
        break;
    case PULSES: {
        const double rest = fmod(m->time - r[J_BEGIN] + 1e-12, r[J_PERIOD]);
        r[J_Y] = rest >= 0 && rest < r[J_WIDTH] ? r[J_HEIGHT] : 0;
        break;
    }
    case GAIN: r[G_Y] = r[G_FACTOR] * r[G_U] + r[G_OFFSET]; break;
    case BENT: r[C_Y] = r[C_W] + r[C_FACTOR] * r[C_U] + r[C_BEND] * r[C_U] * r[C_U]; break;
    case TYPES:
        r[T_OUT] = r[T_GAIN] * r[T_IN];
        i[T_INT_OUT] = i[T_INT] + 1, i[T_BOOL_OUT] = !i[T_BOOL], i[T_ENUM_OUT] = i[T_ENUM], i[T_ALIVE] = instances;
        snprintf(m->s[T_ECHO], LENGTH, "hello %.40s", m->s[T_LABEL]);
        break;
    case WIDE:
        r[1] = r[0];
        for (int k = 0; k < W_PAIRS; k++) i[2 * k + 1] = i[2 * k];
        i[W_SIZE_OUT] = i[W_SIZE];
        break;
    default: break;
    }
}

/* the input that is the rate of the one with value reference 0 */
static double rate(const Instance *m) {
    static const int place[MODELS] = {[MASS_A] = A_RATE, [MASS_B] = B_RATE, [DRIFT] = D_RATE, [QUIRK] = Q_RATE};
    return place[m->model] ? m->r[place[m->model]] : 0;
}

/* the input with value reference 0 at time tau after the start of the step */
static double input(const Instance *m, double tau) {
    if (rate(m) != 0) return m->r[0] + tau * rate(m);
    if (m->model == GLIDE) return m->r[L_X] + tau * (m->r[L_V] + tau / 2 * m->r[L_A]);
    return m->r[0] + tau * (m->slope[0][0] + tau * (m->slope[0][1] / 2 + tau * m->slope[0][2] / 6));
}

static int first_state(const Instance *m) {
    static const int first[MODELS] = {[MASS_A] = A_X, [MASS_B] = B_X, [FAILS] = F_Y, [SPRING] = K_STRETCH,
                                      [DRIFT] = D_Y, [GLIDE] = L_Y, [QUIRK] = Q_Y};
    return first[m->model];
}

static int states(const Instance *m) {
    static const int count[MODELS] = {[MASS_A] = 2, [MASS_B] = 2, [FAILS] = 1, [SPRING] = 1,
                                      [DRIFT] = 1, [GLIDE] = 1, [QUIRK] = 1};
    return count[m->model];
}

static void rates(const Instance *m, double tau, const double *x, double *dx) {
    double u = input(m, tau);
    switch (m->model) {
    case MASS_A:
        dx[0] = x[1];
        dx[1] = (-m->r[A_SPRING] * x[0] + m->r[A_COUPLING] * (u - x[0])) / m->r[A_MASS];
        break;
    case MASS_B:
        dx[0] = x[1];
        dx[1] = (-m->r[B_SPRING] * x[0] - u) / m->r[B_MASS];
        break;
    case QUIRK: dx[0] = m->r[Q_GAIN] * u + m->r[Q_PUSH]; break;
    default: dx[0] = u; break;
    }
}

int derivative(const Instance *m, int reference, double *value) {
    double dx[STATES] = {0};
    if ((m->model == MASS_A || m->model == MASS_B) && m->i[M_LATE] && m->time == 0) {
        *value = NAN; /* as FMUs do that estimate slopes from their last step */
        return 1;
    }
    if (m->model == MASS_A && reference == A_FORCE) {
        double moves = rate(m) != 0 ? rate(m) : m->slope[0][0] != 0 ? m->slope[0][0] : m->trend;
        *value = m->r[A_COUPLING] * (moves - m->r[A_V]);
        return 1;
    }
    if (m->model == SOURCE && reference == S_Y && m->r[S_RAMP] != 0) {
        *value = m->r[S_AMPLITUDE] * m->r[S_OMEGA] * cos(m->r[S_OMEGA] * m->time);
        *value += m->time < m->r[S_BEND] ? 0 : m->r[S_RAMP];
        return 1;
    }
    int state = reference - first_state(m);
    if (state < 0 || state >= states(m) || (m->model == QUIRK && m->i[Q_MUTE] == reference)) return 0;
    rates(m, 0, m->r + first_state(m), dx);
    *value = dx[state];
    return 1;
}

static double mass_gain(const Instance *m, int unknown, int known) {
    const int a = m->model == MASS_A, x = a ? A_X : B_X, v = a ? A_V : B_V, u = 0;
    const double coupling = a ? m->r[A_COUPLING] : 0, spring = coupling + m->r[a ? A_SPRING : B_SPRING];
    if (unknown == RATES) return known == v;
    if (unknown == RATES + 1) {
        const double force = known == x ? -spring : known == u ? (a ? coupling : -1) : 0;
        return force / m->r[a ? A_MASS : B_MASS];
    }
    if (a && unknown == A_FORCE) return known == x ? -coupling : known == u ? coupling : 0;
    return unknown == known;
}

double gain(const Instance *m, int output, int input) {
    if (m->model == MASS_A || m->model == MASS_B) return mass_gain(m, output, input);
    if (m->model == BENT && output == C_Y) {
        double slopes[] = {m->r[C_FACTOR] + 2 * m->r[C_BEND] * m->r[C_U], 1, 0, m->r[C_U], m->r[C_U] * m->r[C_U]};
        return slopes[input];
    }
    if (m->model != GAIN || output != G_Y) return NAN;
    return input == G_U ? m->r[G_FACTOR] : input == G_FACTOR ? m->r[G_U] : 1;
}

static void integrate(Instance *m, double length) {
    int n = states(m), count = (int)ceil(length / 2.5e-4 - 1e-9);
    double *x = m->r + first_state(m), k[4][STATES], y[STATES], h = length / count;
    for (int step = 0; n && step < count; step++) {
        double tau = step * h;
        rates(m, tau, x, k[0]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h / 2 * k[0][j];
        rates(m, tau + h / 2, y, k[1]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h / 2 * k[1][j];
        rates(m, tau + h / 2, y, k[2]);
        for (int j = 0; j < n; j++) y[j] = x[j] + h * k[2][j];
        rates(m, tau + h, y, k[3]);
        for (int j = 0; j < n; j++) x[j] += h / 6 * (k[0][j] + 2 * k[1][j] + 2 * k[2][j] + k[3][j]);
    }
}

enum Failure trouble(const Instance *m, double t) {
    if (m->model == FAILS && t >= m->r[F_WHEN]) return (enum Failure)m->i[F_HOW];
    if (m->model == QUIRK && t >= m->r[Q_WHEN] && m->i[Q_WHERE] <= STEP) return (enum Failure)m->i[Q_HOW];
    return NONE;
}

static enum Status misbehave(Instance *m, enum Failure how) {
    const double y = m->r[F_Y]; /* QUIRK has its output there, too */
    switch (how) {
    case WARNING: return complain(m, WARNED, "the oil is warm at", y);
    case DISCARD: return DISCARDED;
    case FAULT: return complain(m, FAILED, "the pump broke, y is", y);
    case FATAL: return complain(m, DEAD, "the house burnt down, y is", y);
    case NOT_A_NUMBER: m->r[F_Y] = NAN; return GOOD;
    case TALK: return complain(m, GOOD, "by the way, y is", y);
    case CRASH: abort();
    default: return GOOD;
    }
}

enum Status odd(Instance *m, enum Call call) {
    const int here = m->i[Q_WHERE] == (long long)call || m->i[Q_WHERE] == ANYWHERE;
    if (m->model != QUIRK || m->mode != READY || m->time < m->r[Q_WHEN] || !here) return GOOD;
    return misbehave(m, (enum Failure)m->i[Q_HOW]);
}

void farewell(Instance *m) {
    if (m->model != QUIRK) return;
    complain(m, GOOD, m->mode == TERMINATED ? "terminated and freed, states left" : "freed, states left", saved);
}

/* An error where a step does not start at the FMU's time, or has another length than the first one. */
static enum Status uneven(Instance *m, double t, double h) {
    const int even = m->model == QUIRK && m->i[Q_EVEN];
    if (m->length == 0) m->length = h;
    if (even && h != m->length) return complain(m, FAILED, "the step is longer than the first by", h - m->length);
    /* the sum of equal steps is not to the last bit where the steps are */
    if (fabs(t - m->time) > 1e-9 * m->length + 4e-16 * fabs(t))
        return complain(m, FAILED, "the step does not start at the FMU's time", m->time);
    return GOOD;
}

enum Status advance(Instance *m, double t, double h) {
    if (m->mode != READY) return complain(m, FAILED, "step in mode", m->mode);
    enum Status status = uneven(m, t, h);
    if (status > WARNED) return status;
    if (m->stop_defined && t + h > m->stop) return complain(m, FAILED, "step beyond the stop time", m->stop);
    status = misbehave(m, trouble(m, m->time));
    if (status > WARNED) return status;
    const int whole = m->model != QUIRK || m->r[Q_LONGEST] == 0 || h <= m->r[Q_LONGEST] * (1 + 1e-9);
    if (!whole) h = m->r[Q_LONGEST];
    integrate(m, h);
    m->r[0] = m->model == SOURCE ? m->r[0] : input(m, h);
    if (m->model == GLIDE) m->r[L_V] += h * m->r[L_A];
    m->trend = m->slope[0][0] + h * (m->slope[0][1] + h / 2 * m->slope[0][2]);
    memset(m->slope, 0, sizeof m->slope);
    m->time = t + h, m->touched = 0;
    return whole ? status : DISCARDED;
}

enum Status restore(Instance *m, const Instance *state) {
    const double final = m->final; /* a promise holds in the restored state, too */
    if (state->time < final) return complain(m, FAILED, "restored to a time before the promised", final);
    *m = *state;
    m->final = final;
    return GOOD;
}
