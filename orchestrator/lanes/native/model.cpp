/* The model of an FMU for LANES machines at once, from the C files in the FMU: sizes.h, model.h, model.c, start.c,
   solver.h, inputs.c, rosenbrock.c and runge_kutta.c, in which double becomes Lanes. Each model is compiled to a
   library of its own.

   The solver is that of the FMU (solver.c). Each machine has its own inner steps, so its results do not depend on the
   others. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "lanes.h"
#include "instance.h"

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
static __attribute__((noinline)) void curve_pieces(Lanes v, const Lanes *t, const Lanes *rows, Piece *result) {
    *result = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    Mask reached = v > t[0];
    for (int i = 0; i < CURVE_POINTS && any(reached); i++) {
        const Mask next = i < CURVE_POINTS - 1 ? reached && v >= t[i + 1] : reached && !reached;
        *result = where(reached && !next, curve_piece(rows, i), *result);
        reached = next;
    }
}

INLINE Lanes value(const Piece &p, Lanes s) { return p.a + s * (p.b + s * (p.c + s * (p.d + s * p.e))); }
INLINE Lanes slope(const Piece &p, Lanes s) { return p.b + s * (2.0 * p.c + s * (3.0 * p.d + s * 4.0 * p.e)); }

/* Value or slope. Most often all machines are below the first piece, or in the same one of those in the middle. */
INLINE Lanes curve(Lanes v, const Lanes *t, Lanes (*at)(const Piece &, Lanes)) {
    if (all(v <= t[0])) return 0.0; /* a command that is NaN has a piece of zeros, and the value NaN */
    int i = 1;
    while (i < CURVE_POINTS - 2 && all(v >= t[i + 1])) i++;
    if (all(v >= t[i] && v < t[i + 1])) {
        const Lanes *row = t + CURVE_ROWS - 4 + 4 * i;
        return at({t[i], row[0], row[1], row[2], row[3], 0.0}, v - t[i]);
    }
    Piece p;
    curve_pieces(v, t, t, &p);
    return at(p, v - p.start);
}

INLINE Lanes opening_curve(Lanes v, const Lanes *t) { return curve(v, t, value); }
INLINE Lanes opening_curve_slope(Lanes v, const Lanes *t) { return curve(v, t, slope); }

static Lanes opening_curve_along(Lanes v, const Lanes *t, Lanes dv, const Lanes *dt) {
    Piece p, change;
    curve_pieces(v, t, t, &p);
    curve_pieces(v, t, dt, &change);
    return slope(p, v - p.start) * (dv - change.start) + value(change, v - p.start);
}

/* ---- the model of the FMU ---------------------------------------------------------------------- */

#undef CONDITION
#define CONDITION Mask
#define double Lanes
#include "initial.c"
#include "model.c"
#include "solver.h"
#include "inputs.c"
#include "rosenbrock.c"
#include "runge_kutta.c"
#undef double

/* Inner steps before a method is tried again, and the next pause; see solver.c. */
typedef struct {
    Lanes left, next;
} Rest;

/* What a rollback restores. */
typedef struct {
    Lanes varying[NUMBER_OF_VARIABLES - FIRST_INPUT], z[ROOM(NZ)], last_set[ROOM(NU)], end_derivative[ROOM(NU)];
    int32_t had_derivatives[ROOM(NU)];
    Lanes step;
    Rest cheap, second;
} Memory;

typedef struct {
    Instance shared;
    Lanes values[ROOM(NUMBER_OF_VARIABLES)], slopes[ROOM(NUMBER_OF_VARIABLES)];
    Lanes start[ROOM(NX)], last_set[ROOM(NU)], end_derivative[ROOM(NU)], derivatives[ROOM(NU)][3];
    Mask alive;
    Lanes c[ROOM(NC)], z[ROOM(NZ)], require[ROOM(NREQUIRE)];
    Lanes held[ROOM(NU)]; /* the inputs of which c is */
    int32_t has_derivatives[ROOM(NU)], had_derivatives[ROOM(NU)];
    Lanes step;         /* proposal for the next inner step [s]; 0: none */
    Rest cheap, second; /* of the method that is tried first, and of that of Cash and Karp */
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

static void prepare(Instance *self) {
    Own *s = own(self);
    memcpy((void *)s->held, inputs_of(s), sizeof s->held);
    model_prepare(s->held, parameters(s), s->c);
}

/* Computes c again if a held input has changed, as core_set. Returns whether. */
static int prepare_again(Own *s) {
    for (int i = 0; i < NU; i++)
        if (model_variables[FIRST_INPUT + i].held && any(inputs_of(s)[i] != s->held[i])) {
            prepare(&s->shared);
            return 1;
        }
    return 0;
}

static void start(Instance *self) {
    Own *s = own(self);
    prepare_again(s);
    model_start(s->start, inputs_of(s), parameters(s), s->c, states(s));
}

static void blend(Lanes *to, const Lanes *from, int count, Mask machines) {
    for (int i = 0; i < count; i++) to[i] = where(machines, from[i], to[i]);
}

/* The outputs that depend on the inputs. */
static void outputs_again(Instance *self, Mask machines) {
    Own *s = own(self);
    Lanes others[ROOM(NY)];
    const int some = !all(machines);
    if (some) memcpy((void *)others, outputs(s), NY * sizeof *others);
    if (prepare_again(s)) model_observe_states(states(s), parameters(s), s->c, outputs(s), s->z);
    model_observe(states(s), inputs_of(s), parameters(s), s->c, s->z, outputs(s));
    if (some) blend(outputs(s), others, NY, !machines);
}

static void outputs_now(Instance *self) {
    Own *s = own(self);
    prepare_again(s);
    model_observe_states(states(s), parameters(s), s->c, outputs(s), s->z);
    model_observe(states(s), inputs_of(s), parameters(s), s->c, s->z, outputs(s));
}

static void derivatives_now(Instance *self) {
    Own *s = own(self);
    if (prepare_again(s)) model_observe_states(states(s), parameters(s), s->c, outputs(s), s->z);
    model_derivatives(states(s), inputs_of(s), parameters(s), s->c, s->z, derivatives(s));
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
        if (model_variables[FIRST_INPUT + i].held) continue;
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

enum { MOST_INNER_STEPS = 1000000, LONGEST_PAUSE = 16 };

/* As in solver.c. */
static const double LOOSE = 1e-5, RODAS3_FACTOR = 3.0, ORDER_4_FACTOR = 15.0, ORDER_3_FACTOR = 0.01;

/* Machines have failed: the reason is stored, and they are left out from now on. */
static void fail(Own *s, Mask failed, int kind, int index, Lanes value, Lanes derivative, Lanes step, Lanes time) {
    failed = failed && s->alive;
    for (int i = 0; i < LANES; i++)
        if (failed.bits[i]) s->failures[i] = {kind, 0, index, 0, value[i], derivative[i], step[i], time[i]};
    s->alive = s->alive && !failed;
}

/* Weighted root mean square of an error of the new states, in units of the tolerance. */
static Lanes norm(const Own *s, const Lanes *error) {
    Lanes sum = 0.0;
    for (int i = 0; i < NX; i++) {
        const Lanes magnitude = fmax(fabs(s->values[FIRST_STATE + i]), fabs(s->work.x[i]));
        const Lanes part = error[i] / (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        sum += part * part;
    }
    return sqrt(sum / (double)ROOM(NX)) / s->shared.tolerance;
}

/* The state with the largest error of the last step that was tried. */
static Lanes worst_state(const Own *s) {
    Lanes largest = -1.0, worst = 0.0;
    for (int i = 0; i < NX; i++) {
        const Lanes magnitude = fmax(fabs(s->values[FIRST_STATE + i]), fabs(s->work.x[i]));
        const Lanes part = fabs(s->work.error[i]) / (model_variables[FIRST_STATE + i].absolute_scale + magnitude);
        const Mask larger = !(part <= largest) && largest == largest;
        worst = where(larger, (double)i, worst);
        largest = where(larger, part, largest);
    }
    return worst;
}

/* Machines in which the method is to be tried now. */
static Mask due(Rest *rest, Mask machines) {
    const Mask now = machines && rest->left <= 0.0;
    rest->left = where(machines && !now, rest->left - 1.0, rest->left);
    return now;
}

static void update_rest(Rest *rest, Mask tried, Mask success) {
    const Lanes pause = fmin(fmax(rest->next, 1.0), (double)LONGEST_PAUSE);
    rest->left = where(tried, where(success, 0.0, pause), rest->left);
    rest->next = where(tried, where(success, pause - 1.0, 2.0 * pause), rest->next);
}

/* One inner step of all machines, each of its own size. */
typedef struct {
    Lanes tau, h;    /* start and size [s] */
    Lanes error;     /* in units of the tolerance */
    Lanes accurate;  /* 0: the linear system was singular */
    Mask cheap;      /* the method that is tried first has succeeded */
    Mask linearised; /* w->jac and w->ft are those at tau */
} Step;

/* Stores the error of a method and, where it is small enough, the new states. */
static Mask finish(Own *s, Step *step, Mask tried, Lanes error) {
    const Mask success = tried && error <= 1.0;
    step->error = where(tried, error, step->error);
    for (int i = 0; i < NX; i++) states(s)[i] = where(success, s->work.x[i], states(s)[i]);
    return success;
}

/* Tries the explicit methods where they do not pause; returns where they succeeded. */
static Mask explicit_step(Own *s, Step *step, Mask machines) {
    Work *w = &s->work;
    const Lanes *x = states(s), *p = parameters(s);
    if (any(machines && step->tau > 0.0)) {
        Lanes f[ROOM(NX)];
        model_dynamics(x, w->u, p, s->c, f);
        for (int i = 0; i < NX; i++) w->f0[i] = where(machines && step->tau > 0.0, f[i], w->f0[i]);
    }
    const Mask first = due(&s->cheap, machines);
    if (any(first)) {
        const Mask stable = kutta(x, p, s->c, &s->inputs, step->tau, step->h, w);
        step->cheap = finish(s, step, first, where(stable, norm(s, w->error), INFINITY));
        update_rest(&s->cheap, first, step->cheap);
    }
    const Mask second = due(&s->second, machines && !step->cheap);
    if (!any(second)) return step->cheap;
    const Mask stable = cash_karp(x, p, s->c, &s->inputs, step->tau, step->h, w);
    const Lanes error = fmax(ORDER_4_FACTOR * norm(s, w->error), ORDER_3_FACTOR * norm(s, w->b));
    const Mask success = finish(s, step, second, where(stable, error, INFINITY));
    update_rest(&s->second, second, stable);
    return step->cheap || success;
}

static void fail_state(Own *s, Mask failed, int kind, Lanes worst, Lanes step, Lanes tau) {
    for (int i = 0; i < NX; i++)
        fail(s, failed && worst == (double)i, kind, FIRST_STATE + i, states(s)[i], s->work.f0[i], step, tau);
}

/* Linearises at tau; machines whose derivatives are not finite fail. */
static void linearise(Own *s, Step *step, Mask machines) {
    Work *w = &s->work;
    inputs_update(&s->inputs, step->tau, w->u);
    inputs_derivative(&s->inputs, step->tau, w->du);
    model_jacobian(states(s), w->u, parameters(s), s->c, w->du, w->f0, w->jac, w->ft);
    step->linearised = step->linearised || machines;
    Lanes sum = 0.0, worst = 0.0;
    for (int i = 0; i < NX; i++) sum += w->f0[i] - w->f0[i];
    const Mask bad = machines && s->alive && sum != 0.0;
    if (!any(bad)) return;
    for (int i = NX - 1; i >= 0; i--) worst = where(finite(w->f0[i]), worst, (double)i);
    fail_state(s, bad, DERIVATIVE_NOT_FINITE, worst, 0.0, step->tau);
}

typedef void Rosenbrock(const Lanes *x, const Lanes *p, const Lanes *c, const InputPolynomials *inputs, Lanes tau,
                        Lanes h, Work *w);

/* Error of a step of an implicit method with this gamma; infinite where the linear system is singular. */
static Lanes implicit_error(Own *s, Step *step, Rosenbrock *method, Lanes gamma) {
    const Lanes diagonal = 1.0 / (gamma * step->h);
    model_factorise(&diagonal, s->work.jac, s->work.lu, &step->accurate);
    method(states(s), parameters(s), s->c, &s->inputs, step->tau, step->h, &s->work);
    return where(step->accurate != 0.0, norm(s, s->work.error), INFINITY);
}

/* Tries the implicit methods; returns where they succeeded. */
static Mask implicit_step(Own *s, Step *step, Mask machines, Lanes length) {
    const Mask fresh = machines && !step->linearised;
    if (any(fresh)) linearise(s, step, fresh);
    if (!EXPLICIT_FIRST && s->shared.tolerance >= LOOSE) {
        const Mask first = due(&s->cheap, fresh && s->alive && step->h == length);
        if (any(first)) {
            step->cheap = finish(s, step, first, RODAS3_FACTOR * implicit_error(s, step, rodas3, RODAS3_GAMMA));
            update_rest(&s->cheap, first, step->cheap);
        }
    }
    const Mask rest = machines && !step->cheap;
    if (!any(rest)) return step->cheap;
    return step->cheap || finish(s, step, rest, implicit_error(s, step, rodas, GAMMA));
}

/* The proposal for the step after an accepted one. */
static Lanes next_step(const Step *step, Lanes proposal, Mask rejected) {
    const Lanes most = where(rejected, 1.0, 5.0);
    const Lanes growth = fmin(most, 0.9 / sqrt(sqrt(fmax(step->error, 1e-8)))), next = step->h * growth;
    return where(step->cheap || growth == 5.0, fmax(next, proposal), next);
}

/* Advances the states of machines by `length` [s], as solver.c: each machine by its own inner steps. */
static void solve(Own *s, Lanes length, Mask machines) {
    const Lanes minimum = fmax(1e-14 * length, DBL_MIN);
    const Mask none = machines && !machines;
    Lanes proposal = where(s->step > 0.0, s->step, length);
    Step step = {where(machines, 0.0, length), length, INFINITY, 1.0, none, none};
    Mask rejected = none;
    for (int count = 0;; count++) {
        const Mask active = s->alive && step.tau < length;
        if (!any(active)) break;
        const Lanes rest = length - step.tau, ratio = rest / proposal * (1.0 - 1e-9);
        const Lanes parts = where(ratio > 1.0, ceil(ratio), 1.0);
        step.h = where(active, rest, length); /* any for machines that are done or have failed */
        if (any(active && parts > 1.0)) step.h = where(active && parts > 1.0, rest / parts, step.h);
        step.error = INFINITY, step.accurate = 1.0, step.cheap = none;
        inputs_value(&s->inputs, step.tau, s->work.u);
        Mask accepted = none;
        if (EXPLICIT_FIRST) accepted = explicit_step(s, &step, active && !step.linearised);
        if (any(active && !accepted)) accepted = accepted || implicit_step(s, &step, active && !accepted, length);
        const Mask repeat = active && !accepted;
        Lanes shorter = step.h;
        if (any(repeat)) shorter *= where(step.error < DBL_MAX, fmax(0.9 / sqrt(sqrt(step.error)), 0.2), 0.2);
        const Lanes next = next_step(&step, proposal, rejected);
        proposal = where(accepted, next, where(repeat, shorter, proposal));
        step.tau = where(accepted, where(parts > 1.0, step.tau + step.h, length), step.tau);
        step.linearised = step.linearised && !accepted;
        rejected = repeat || (rejected && !accepted);
        s->shared.inner_steps++;
        const Mask tiny = repeat && shorter < minimum;
        if (!any(tiny) && count < MOST_INNER_STEPS) continue;
        const Lanes worst = worst_state(s);
        fail_state(s, tiny && step.accurate == 0.0, SINGULAR_SYSTEM, worst, step.h, step.tau);
        fail_state(s, tiny, TOLERANCE_NOT_REACHED, worst, step.h, step.tau);
        if (count >= MOST_INNER_STEPS)
            fail_state(s, step.tau < length, TOO_MANY_INNER_STEPS, worst, step.h, step.tau);
    }
    s->step = proposal;
}

/* ---- a communication step ---------------------------------------------------------------------- */

static void check(Instance *self, Lanes time) {
    Own *s = own(self);
    model_require(states(s), inputs_of(s), parameters(s), s->c, s->z, s->require);
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

static void step(Instance *self, Lanes length, Mask machines) {
    Own *s = own(self);
    if (prepare_again(s)) model_observe_states(states(s), parameters(s), s->c, outputs(s), s->z);
    plan_inputs(s);
    if (EXPLICIT_FIRST)
        model_derivatives(states(s), s->last_set, parameters(s), s->c, s->z, s->work.f0);
    if (NX > 0) solve(s, length, machines);
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
    memcpy((void *)m->varying, inputs_of(s), sizeof m->varying);
    memcpy((void *)m->z, s->z, sizeof m->z);
    memcpy((void *)m->last_set, s->last_set, sizeof m->last_set);
    memcpy((void *)m->end_derivative, s->end_derivative, sizeof m->end_derivative);
    memcpy(m->had_derivatives, s->had_derivatives, sizeof m->had_derivatives);
    m->step = s->step, m->cheap = s->cheap, m->second = s->second;
}

static void restore(Instance *self, Mask machines) {
    Own *s = own(self);
    const Memory *m = &s->saved;
    blend(inputs_of(s), m->varying, NUMBER_OF_VARIABLES - FIRST_INPUT, machines);
    blend(s->z, m->z, NZ, machines);
    blend(s->last_set, m->last_set, NU, machines);
    blend(s->end_derivative, m->end_derivative, NU, machines);
    memcpy(s->had_derivatives, m->had_derivatives, sizeof m->had_derivatives);
    memset(s->has_derivatives, 0, sizeof s->has_derivatives);
    blend(&s->step, &m->step, 1, machines);
    blend(&s->cheap.left, &m->cheap.left, 2, machines);
    blend(&s->second.left, &m->second.left, 2, machines);
}

static void adopt(Instance *self, const Instance *other, Mask machines) {
    Own *s = own(self);
    const Own *from = (const Own *)other;
    blend(s->values, from->values, NUMBER_OF_VARIABLES, machines);
    blend(s->slopes, from->slopes, NUMBER_OF_VARIABLES, machines);
    blend(s->start, from->start, NX, machines);
    blend(s->last_set, from->last_set, NU, machines);
    blend(s->end_derivative, from->end_derivative, NU, machines);
    blend(s->c, from->c, NC, machines);
    blend(s->z, from->z, NZ, machines);
    blend(&s->step, &from->step, 1, machines);
    blend(&s->cheap.left, &from->cheap.left, 2, machines);
    blend(&s->second.left, &from->second.left, 2, machines);
}

static const char *requirement(int32_t i) { return model_statements[i]; }

static const Model MODEL = {
    sizeof(Own), LANES, NP, NU, NX, NY, NREQUIRE, create, prepare, start, outputs_now, outputs_again, derivatives_now,
    slopes_now, save, restore, step, check, adopt, requirement};

#ifdef _WIN32
extern "C" __declspec(dllexport) const Model *lane_model(void) { return &MODEL; }
#else
extern "C" __attribute__((visibility("default"))) const Model *lane_model(void) { return &MODEL; }
#endif
