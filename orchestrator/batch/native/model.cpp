/* The model of an FMU for LANES machines at once, from the C files in the FMU: sizes.h, model.h, model.c, start.c,
   solver.h, inputs.c and rosenbrock.c, in which double becomes Lanes. Each model is compiled to a library of its own.

   The solver is that of the FMU (solver.c, kutta.c) with common inner steps: the largest error of all machines decides
   on their lengths. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "lanes.h"
#include "group.h"

#include "model.h"
#include "start.c"

/* ---- opening curves, as in opening_curve.h of the FMU ------------------------------------------ */

typedef struct { /* one piece of a curve: a + s (b + s (c + s (d + s e))), s = v - start */
    Lanes start, a, b, c, d, e;
} Piece;

/* Piece i of a curve with the coefficients t, which begin with the starts of the pieces. */
static Piece curve_piece(const Lanes *t, int i) {
    const Lanes *first = t + CURVE_POINTS, *row = t + CURVE_ROWS - 4 + 4 * i;
    if (i == CURVE_POINTS - 1) return {t[i], t[CURVE_LAST], 0.0, 0.0, 0.0, 0.0};
    if (i == 0) return {t[0], 0.0, 0.0, first[0], first[1], first[2]};
    return {t[i], row[0], row[1], row[2], row[3], 0.0};
}

static Piece where(Mask condition, const Piece &x, const Piece &y) {
    return {where(condition, x.start, y.start), where(condition, x.a, y.a), where(condition, x.b, y.b),
            where(condition, x.c, y.c), where(condition, x.d, y.d), where(condition, x.e, y.e)};
}

/* The pieces with the coefficients `rows` in which the commands v of the machines are; below the first one: zero. */
static Piece curve_at(Lanes v, const Lanes *t, const Lanes *rows) {
    Piece result = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    Mask reached = v > t[0];
    for (int i = 0; any(reached); i++) {
        const Mask next = i < CURVE_POINTS - 1 ? reached && v >= t[i + 1] : v != v;
        if (any(reached && !next)) result = where(reached && !next, curve_piece(rows, i), result);
        reached = next;
    }
    return result;
}

static Lanes value(const Piece &p, Lanes s) { return p.a + s * (p.b + s * (p.c + s * (p.d + s * p.e))); }
static Lanes slope(const Piece &p, Lanes s) { return p.b + s * (2.0 * p.c + s * (3.0 * p.d + s * 4.0 * p.e)); }

static Lanes opening_curve(Lanes v, const Lanes *t) {
    const Piece p = curve_at(v, t, t);
    return value(p, v - p.start);
}

static Lanes opening_curve_slope(Lanes v, const Lanes *t) {
    const Piece p = curve_at(v, t, t);
    return slope(p, v - p.start);
}

static Lanes opening_curve_along(Lanes v, const Lanes *t, Lanes dv, const Lanes *dt) {
    const Piece p = curve_at(v, t, t), change = curve_at(v, t, dt);
    return slope(p, v - p.start) * (dv - change.start) + value(change, v - p.start);
}

/* ---- the model of the FMU ---------------------------------------------------------------------- */

#define double Lanes
#include "model.c"
#include "solver.h"
#include "inputs.c"
#include "rosenbrock.c"
#undef double

/* What a rollback restores. */
typedef struct {
    Lanes x[ROOM(NX)], u[ROOM(NU)], last_set[ROOM(NU)], end_derivative[ROOM(NU)];
    int32_t had_derivatives[ROOM(NU)];
    double step;
    int32_t pause, next_pause;
} Memory;

typedef struct {
    Instance shared;
    Lanes values[ROOM(NUMBER_OF_VARIABLES)], slopes[ROOM(NUMBER_OF_VARIABLES)];
    Lanes start[ROOM(NX)], last_set[ROOM(NU)], end_derivative[ROOM(NU)], derivatives[ROOM(NU)][3];
    Mask alive;
    Lanes c[ROOM(NC)], require[ROOM(NREQUIRE)];
    int32_t has_derivatives[ROOM(NU)], had_derivatives[ROOM(NU)];
    int32_t pause, next_pause; /* inner steps before the explicit method is tried again, see solver.c */
    Failure failures[LANES];
    InputPolynomials inputs;
    Work work;
    Memory saved;
} Own;

static Own *own(Instance *self) { return (Own *)self; }
static Lanes *parameters(Own *s) { return s->values + FIRST_PARAMETER; }
static Lanes *inputs_of(Own *s) { return s->values + FIRST_INPUT; }
static Lanes *states(Own *s) { return s->values + FIRST_STATE; }
static Lanes *derivatives(Own *s) { return s->values + FIRST_DERIVATIVE; }
static Lanes *outputs(Own *s) { return s->values + FIRST_OUTPUT; }

static Instance *create(void *memory, double tolerance) {
    Own *s = (Own *)memory;
    memset((void *)s, 0, sizeof *s);
    Instance *shared = &s->shared;
    shared->values = s->values, shared->start = s->start, shared->slopes = s->slopes, shared->last_set = s->last_set;
    shared->derivatives = s->derivatives[0], shared->has_derivatives = s->has_derivatives;
    shared->failures = s->failures, shared->alive = &s->alive;
    s->alive = Lanes(0.0) == 0.0;
    shared->tolerance = tolerance > 0.0 ? tolerance : DEFAULT_TOLERANCE;
    for (int i = 0; i < NUMBER_OF_VARIABLES; i++) s->values[i] = model_start_values[i];
    for (int i = 0; i < NU; i++) s->last_set[i] = inputs_of(s)[i];
    for (int i = 0; i < NX; i++) s->start[i] = states(s)[i];
    return shared;
}

static void prepare(Instance *self) { model_prepare(parameters(own(self)), own(self)->c); }

static void start(Instance *self) {
    Own *s = own(self);
    model_start(s->start, inputs_of(s), parameters(s), s->c, states(s));
}

static void outputs_now(Instance *self) {
    Own *s = own(self);
    model_observe(states(s), inputs_of(s), parameters(s), s->c, outputs(s), s->require);
}

static void derivatives_now(Instance *self) {
    Own *s = own(self);
    model_dynamics(states(s), inputs_of(s), parameters(s), s->c, derivatives(s));
}

/* Time derivative of an input at the current time, as core_input_derivative. */
static Lanes input_derivative(const Own *s, int i) {
    if (s->has_derivatives[i]) return s->derivatives[i][0];
    const int rate = model_variables[FIRST_INPUT + i].rate;
    return rate < 0 || s->had_derivatives[i] ? s->end_derivative[i] : s->values[FIRST_INPUT + rate];
}

static void slopes_now(Instance *self) {
    Own *s = own(self);
    Lanes direction[ROOM(NU)], ignored[ROOM(NX)];
    derivatives_now(self);
    for (int i = 0; i < NU; i++) direction[i] = input_derivative(s, i);
    for (int i = 0; i < NX; i++) s->slopes[FIRST_STATE + i] = derivatives(s)[i];
    model_forward(states(s), inputs_of(s), parameters(s), s->c, derivatives(s), direction, ignored,
                  s->slopes + FIRST_OUTPUT);
}

/* ---- inputs over a step, as in core.c ---------------------------------------------------------- */

static void input_derivatives(const Own *s, int input, Lanes *result) {
    result[0] = result[1] = result[2] = 0.0;
    for (int order = 0, i = input; order < 3 && i >= 0; order++) {
        if (s->has_derivatives[i]) {
            for (int k = 0; order < 3; k++, order++) result[order] = s->derivatives[i][k];
            return;
        }
        i = model_variables[FIRST_INPUT + i].rate;
        if (i >= 0) result[order] = s->last_set[i];
    }
}

static void plan_inputs(Own *s) {
    InputPolynomials *inputs = &s->inputs;
    inputs->origin = 0.0;
    inputs->count = 0;
    memcpy((void *)inputs->start, s->last_set, NU * sizeof *s->last_set);
    for (int i = 0; i < NU; i++) {
        if (!s->has_derivatives[i] && model_variables[FIRST_INPUT + i].rate < 0) continue;
        Lanes *m = inputs->coefficients[i];
        input_derivatives(s, i, m);
        if (all(m[0] == 0.0 && m[1] == 0.0 && m[2] == 0.0)) continue;
        m[1] *= 1.0 / 2.0;
        m[2] *= 1.0 / 6.0;
        inputs->moving[inputs->count++] = i;
    }
}

/* ---- the solver -------------------------------------------------------------------------------- */

enum { MOST_INNER_STEPS = 1000000, SHORTEST_PAUSE = 8, LONGEST_PAUSE = 1024 };

/* The machine has failed: the reason is stored, and it is left out from now on. */
static void fail(Own *s, Mask failed, int kind, int index, Lanes value, Lanes derivative, double step, double time) {
    failed = failed && s->alive;
    for (int i = 0; i < LANES; i++)
        if (failed.bits[i]) s->failures[i] = {kind, 0, index, 0, value[i], derivative[i], step, time};
    s->alive = s->alive && !failed;
}

/* Weighted root mean square of the error estimate of each machine; `worst`: the state with its largest part. */
static Lanes error_norm(const Own *s, Lanes *worst) {
    Lanes sum = 0.0, most = -1.0;
    for (int i = 0; i < NX; i++) {
        const Lanes magnitude = fmax(fabs(s->values[FIRST_STATE + i]), fabs(s->work.x[i]));
        const Lanes weight = s->shared.tolerance * (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        const Lanes part = fabs(s->work.error[i]) / weight;
        sum += part * part;
        *worst = where(part <= most, *worst, (double)i);
        most = where(part <= most, most, part);
    }
    return sqrt(sum / (double)ROOM(NX));
}

/* Kutta's method, see kutta.c; infinite for machines for which it is unstable. */
static Lanes kutta(Own *s, double tau, double h, Lanes *worst) {
    Work *w = &s->work;
    const Lanes *x = states(s), *p = parameters(s), *k1 = w->f0;
    Lanes change = 0.0, moved = 0.0, *k2 = w->k[0], *k3 = w->k[1];
    for (int i = 0; i < NX; i++) w->x[i] = x[i] + 0.5 * h * k1[i];
    inputs_update(&s->inputs, tau + 0.5 * h, w->u);
    model_dynamics(w->x, w->u, p, s->c, k2);
    for (int i = 0; i < NX; i++) w->x[i] = x[i] + h * (2.0 * k2[i] - k1[i]);
    inputs_update(&s->inputs, tau + h, w->u);
    model_dynamics(w->x, w->u, p, s->c, k3);
    for (int i = 0; i < NX; i++) {
        w->error[i] = h / 6.0 * (k1[i] - 2.0 * k2[i] + k3[i]);
        w->x[i] = x[i] + h * k2[i] + w->error[i];
        const double scale = 1.0 / model_variables[FIRST_STATE + i].nominal;
        const Lanes a = scale * (k3[i] - k2[i]), b = scale * (2.0 * k2[i] - 1.5 * k1[i]);
        change += a * a;
        moved += b * b;
    }
    return where(change <= moved, error_norm(s, worst), INFINITY);
}

/* The largest error of the machines that have not failed; infinite if it is not a number. */
static double largest_error(const Own *s, Lanes error) {
    return largest(where(s->alive, where(error <= DBL_MAX, error, INFINITY), 0.0));
}

static void update_pause(Own *s, bool success) {
    int pause = s->next_pause;
    if (pause < SHORTEST_PAUSE) pause = SHORTEST_PAUSE;
    if (pause > LONGEST_PAUSE) pause = LONGEST_PAUSE;
    s->pause = success ? 0 : pause;
    s->next_pause = success ? pause - 1 : 2 * pause;
}

static void fail_state(Own *s, Mask failed, int kind, Lanes worst, double step, double tau) {
    for (int i = 0; i < NX; i++)
        fail(s, failed && worst == (double)i, kind, FIRST_STATE + i, states(s)[i], s->work.f0[i], step, tau);
}

/* Linearises at tau; machines whose derivatives are not finite fail. */
static void linearise(Own *s, double tau) {
    Work *w = &s->work;
    inputs_update(&s->inputs, tau, w->u);
    inputs_derivative(&s->inputs, tau, w->du);
    model_jacobian(states(s), w->u, parameters(s), s->c, w->du, w->f0, w->jac, w->ft);
    Lanes sum = 0.0, worst = 0.0;
    for (int i = 0; i < NX; i++) sum += w->f0[i] - w->f0[i];
    if (!any(s->alive && sum != 0.0)) return;
    for (int i = NX - 1; i >= 0; i--) worst = where(finite(w->f0[i]), worst, (double)i);
    fail_state(s, sum != 0.0, DERIVATIVE_NOT_FINITE, worst, 0.0, tau);
}

/* One inner step of the implicit method; its error, infinite for machines whose linear system is not solved accurately
   enough. */
static Lanes implicit_step(Own *s, double tau, double h, Lanes *accurate, Lanes *worst) {
    Work *w = &s->work;
    const Lanes diagonal = 4.0 / h; /* 1 / gamma of RODAS */
    model_factorise(&diagonal, w->jac, w->lu, accurate);
    rosenbrock(states(s), parameters(s), s->c, &s->inputs, tau, h, w);
    return where(*accurate != 0.0, error_norm(s, worst), INFINITY);
}

/* Advances the states by `length` [s], see solver.c. */
static void solve(Own *s, double length) {
    Work *w = &s->work;
    const double minimum = fmax(1e-14 * length, DBL_MIN);
    double tau = 0.0, proposal = s->shared.step > 0.0 ? s->shared.step : length;
    bool linearised = false, rejected = false;
    for (int count = 0; tau < length && any(s->alive); count++) {
        const double parts = ceil((length - tau) / proposal * (1.0 - 1e-9));
        const double h = parts > 1.0 ? (length - tau) / parts : length - tau;
        Lanes errors = 0.0, accurate = 1.0, worst = 0.0;
        double error = INFINITY;
        if (!linearised) {
            inputs_value(&s->inputs, tau, w->u);
            if (EXPLICIT_FIRST && (s->pause <= 0 || s->pause-- <= 0)) {
                model_dynamics(states(s), w->u, parameters(s), s->c, w->f0);
                error = largest_error(s, kutta(s, tau, h, &worst));
                update_pause(s, error <= 1.0);
            }
        }
        if (!(error <= 1.0)) {
            if (!linearised) linearise(s, tau);
            linearised = true;
            errors = implicit_step(s, tau, h, &accurate, &worst);
            error = largest_error(s, errors);
        }
        if (error <= 1.0) {
            const double growth = fmin(5.0, 0.9 / sqrt(sqrt(fmax(error, 1e-8))));
            const double next = h * (rejected ? fmin(1.0, growth) : growth);
            proposal = growth < 5.0 || rejected ? next : fmax(next, proposal);
            memcpy((void *)states(s), w->x, NX * sizeof *w->x);
            tau = parts > 1.0 ? tau + h : length;
            linearised = rejected = false;
            s->shared.inner_steps++;
        } else {
            const double shorter = h * (error < DBL_MAX ? fmax(0.2, 0.9 / sqrt(sqrt(error))) : 0.2);
            const Mask bad = !(errors <= 1.0);
            proposal = shorter;
            rejected = true;
            if (shorter < minimum || count == MOST_INNER_STEPS) {
                const int kind = shorter < minimum ? TOLERANCE_NOT_REACHED : TOO_MANY_INNER_STEPS;
                fail_state(s, bad && accurate == 0.0, SINGULAR_SYSTEM, worst, h, tau);
                fail_state(s, bad, kind, worst, h, tau);
                proposal = length - tau;
                count = 0;
            }
        }
    }
    s->shared.step = proposal;
}

/* ---- a communication step ---------------------------------------------------------------------- */

static void check(Instance *self, double time) {
    Own *s = own(self);
    Lanes sum = 0.0;
    for (int i = 0; i < NX; i++) sum += states(s)[i] - states(s)[i];
    for (int i = 0; i < NY; i++) sum += outputs(s)[i] - outputs(s)[i];
    Mask bad = sum != 0.0;
    for (int i = 0; i < NREQUIRE; i++) bad = bad || !(s->require[i] > 0.0);
    if (!any(bad && s->alive)) return;
    for (int i = 0; i < NX; i++)
        fail(s, !finite(states(s)[i]), VALUE_NOT_FINITE, FIRST_STATE + i, states(s)[i], 0.0, 0.0, time);
    for (int i = 0; i < NREQUIRE; i++)
        fail(s, !(s->require[i] > 0.0), REQUIREMENT_VIOLATED, i, s->require[i], 0.0, 0.0, time);
    for (int i = 0; i < NY; i++)
        fail(s, !finite(outputs(s)[i]), VALUE_NOT_FINITE, FIRST_OUTPUT + i, outputs(s)[i], 0.0, 0.0, time);
}

static void step(Instance *self, double length) {
    Own *s = own(self);
    plan_inputs(s);
    if (NX > 0) solve(s, length);
    inputs_value(&s->inputs, length, inputs_of(s));
    inputs_derivative(&s->inputs, length, s->end_derivative);
    memcpy(s->had_derivatives, s->has_derivatives, sizeof s->had_derivatives);
    memset(s->has_derivatives, 0, sizeof s->has_derivatives);
    outputs_now(self);
    check(self, length);
}

static void save(Instance *self) {
    Own *s = own(self);
    Memory *m = &s->saved;
    memcpy((void *)m->x, states(s), NX * sizeof *m->x);
    memcpy((void *)m->u, inputs_of(s), NU * sizeof *m->u);
    memcpy((void *)m->last_set, s->last_set, sizeof m->last_set);
    memcpy((void *)m->end_derivative, s->end_derivative, sizeof m->end_derivative);
    memcpy(m->had_derivatives, s->had_derivatives, sizeof m->had_derivatives);
    m->step = self->step, m->pause = s->pause, m->next_pause = s->next_pause;
}

static void restore(Instance *self) {
    Own *s = own(self);
    const Memory *m = &s->saved;
    memcpy((void *)states(s), m->x, NX * sizeof *m->x);
    memcpy((void *)inputs_of(s), m->u, NU * sizeof *m->u);
    memcpy((void *)s->last_set, m->last_set, sizeof m->last_set);
    memcpy((void *)s->end_derivative, m->end_derivative, sizeof m->end_derivative);
    memcpy(s->had_derivatives, m->had_derivatives, sizeof m->had_derivatives);
    memset(s->has_derivatives, 0, sizeof s->has_derivatives);
    self->step = m->step, s->pause = m->pause, s->next_pause = m->next_pause;
}

static const char *requirement(int32_t i) { return model_statements[i]; }

static const Model MODEL = {
    sizeof(Own), LANES, NP, NU, NX, NY, NREQUIRE, create, prepare, start, outputs_now, derivatives_now, slopes_now,
    save, restore, step, check, requirement};

#ifdef _WIN32
extern "C" __declspec(dllexport) const Model *lane_model(void) { return &MODEL; }
#else
extern "C" __attribute__((visibility("default"))) const Model *lane_model(void) { return &MODEL; }
#endif
