/* The co-simulation engine: what its parts share. A step goes through these files:
 *
 *     simulation_loop.c      from communication point to communication point: repeat, record, watch the energy
 *     communication_step.c   one communication step of a master: its passes over the components
 *     coupling_input.c       an input over one step, as a polynomial of time
 *     linear_prediction.c    all inputs over one step, from the interface Jacobian
 *     step_size.c            how long the next step is
 *     algebraic_loop.c       inputs that decide the outputs which feed them
 *     scenario.c, calls.c, threads.c   driven inputs; calls into FMUs; components that step at the same time
 *
 * All arrays belong to Python, which reads the structures from this file, fills them before a run, and takes what is
 * recorded between two calls of simulation_advance. Functions that return an int return CONTINUE or why to end.
 */
#ifndef ENGINE_H
#define ENGINE_H

#include <stddef.h>
#include <stdint.h>

enum { REAL, WHOLE };                                             /* banks of values */
enum { F64, F32, I8, U8, I16, U16, I32, U32, I64, U64, LOGICAL }; /* types of values in an FMU */
enum { ACCESS, LINK, LOOP, PYTHON };                              /* kinds of instructions */
enum { DRIVEN = -1, NO_SLOPE = -1, DEGREE = 3 };
enum { CONTINUE, STOP, DISCARDED, ABORT };                 /* ABORT: something else than a failing FMU */
enum { CALL, STEP, SAVE, RESTORE };                        /* what Python is asked to do */
enum { OUT_OF_RANGE = -1, WITHDRAWN = -3 };                /* as a status: a whole number that the other type
                                    cannot hold; a step is repeated, so that its messages do not count */
enum { SOLVED = 0, SINGULAR = -1, STUCK = -2 };            /* how the solution of an algebraic loop ended */
enum { USABLE, CIRCULAR, BEGUN };                          /* flags of a loop: there is a Jacobian; values that were
                                    carried round did not settle; it has been solved before */
enum { SOLVES, EVALUATIONS };                              /* counts of a loop */
enum { NORM, SHARE, WORST };                               /* residuals of a loop: over the magnitude at first; over
                                    the one now; largest accepted */
enum { OPEN, BY_SCENARIO, LEADING, CLOSED };               /* where an input comes from, see linear_prediction.c */
enum { BLOCK = 8 };                                        /* columns of matrices are filled up to a multiple of it */

/* What to do after a status that is not OK. `where`: the structure of the call; NULL: a step of `component` */
typedef int32_t CheckStatus(const void *where, int32_t component, int32_t status);
/* A call, step, save or restore of a component that C cannot call; index: of the call or of the component */
typedef int32_t CallPython(int32_t what, int32_t index, double t, double h);

typedef struct Access { /* one FMI call that gets or sets a row of variables */
    void *function, *instance;
    const uint32_t *references;
    const int32_t *orders; /* of derivatives; NULL for values */
    void *own, *values;    /* in the FMU's type and in the bank; the same where types agree */
    int32_t count, fmi, type, bank, sets;
} Access;

typedef struct Link { /* values that go from outputs to inputs */
    const int64_t *source, *target;
    const void *factor, *offset; /* NULL where they are 1 and 0 */
    int32_t count, bank;
} Link;

typedef struct Instruction {
    int32_t kind, index; /* index: of a call into Python */
    void *what;
} Instruction;

typedef struct Program {
    int32_t count;
    const Instruction *instructions;
} Program;

typedef struct Derivative { /* a directional derivative of outputs `of` when inputs `by` move along `seed` */
    void *function, *instance; /* NULL: Python makes the call */
    const uint32_t *of, *by;
    double *seed, *into;
    int32_t fmi, outputs, count, index;
} Derivative;

typedef struct LoopMember { /* a component in an algebraic loop; first: places in the loop's u and y */
    Program writers, readers, starters;
    Derivative derivative;
    int32_t trusted; /* the derivative is used, else differences */
    int32_t first, count, first_output, outputs;
} LoopMember;

/* An algebraic loop of n inputs and m outputs: r(u) = u - g(u) = 0, g_i = factor_i y_source(i) + offset_i.
 * seen: magnitudes of the inputs, largest so far; unit: those that the Jacobian is made for; scale: at the start of
 * a solution. slopes: dy/du, shape (m, n); matrix: dr/du over the magnitudes, or its triangular factors */
typedef struct AlgebraicLoop {
    LoopMember *members;
    double *u, *y, *g, *residual, *step, *before, *start, *scale, *unit, *seen, *slopes, *matrix, *shares;
    const int64_t *source, *targets, *sources; /* targets, sources: places of inputs and outputs in the bank */
    const double *factor, *offset;
    int32_t *rows, *flags;
    int64_t *counts;
    int32_t member_count, count, outputs;
    int32_t rounds;           /* how often values are carried round before Newton's method */
    int32_t declared;         /* the FMUs say that it is a loop */
    int32_t solved_in_passes; /* it is one: solved after each pass over the components */
} AlgebraicLoop;

typedef struct SlopeColumn { /* a directional derivative, and where it belongs: slopes[to] = factor * into[from] */
    Derivative derivative;
    const int32_t *from;
    const int64_t *to;
    const double *factor;
    int32_t entries;
} SlopeColumn;

/* The linearised components joined by their connections: n states, m inputs; see linear_prediction.c.
 * wide, broad: n and m filled up to a multiple of BLOCK */
typedef struct LinearPrediction {
    Program rates, values; /* read the time derivatives of the states into f, the states into x */
    const SlopeColumn *columns;
    const int32_t *kinds, *inputs; /* of each input; the coupling input of some is -1: the FMU moves it */
    double *slopes, *k, *kc, *closed, *inverse;
    double *f, *x, *w, *f0, *x0, *w0, *q, *course, *felt, *push, *v, *stages;
    int32_t *rows;
    int32_t column_count, n, m, wide, broad, through, leads, lag, age, usable;
    double since, last, length;
} LinearPrediction;

/* One input of a component that moves inside a communication step; everything in the unit of the input */
typedef struct CouplingInput {
    int32_t target, source;   /* places in the bank of Real values; a driven input has the source -1 */
    int32_t source_component; /* that computes it, or DRIVEN */
    int32_t slope_index;      /* among the slopes that FMUs give, or NO_SLOPE: it follows from values */
    int32_t degree;           /* what the FMU can follow: 0 (it holds its input), 1 or 3 */
    int32_t wanted;           /* highest degree that the master makes; 0: the input is only watched */
    int32_t order;            /* of extrapolation */
    int32_t autonomous;       /* the source has no inputs: it may have corners, but no pass changes it */
    int32_t in_loop;          /* the source is in an algebraic loop: known when all components have stepped */
    int32_t predicted;        /* linear_prediction.c makes the polynomial */
    int32_t known;            /* how far back the past is known: extrapolation of at most this order */
    double factor, offset;    /* from the value of the source to that of the input */
    double scale;             /* magnitude: the nominal value (1 if none is declared), or the largest if larger */
    double value, slope;      /* of the source at the beginning of the step */
    double value_end, slope_end;
    double slope_before, chord_before, bend_before; /* over the steps before: slope at the beginning, mean slope,
                                                       divided difference of second order */
    double expected, weight;  /* what the past let expect of the end, and the weight of the difference to it */
    double lost, correction;  /* mean of the source less mean of the input over the last step; what is given back */
    double c[DEGREE + 1];     /* coefficients of the polynomial over the step */
} CouplingInput;

typedef struct Component { /* a running FMU; do_step NULL: Python steps it, saves and restores its state */
    void *instance, *do_step, *get_state, *set_state, *state;
    void *event, *terminate, *early, *last; /* where FMI 3.0 reports about a step */
    const uint32_t *flags;                  /* the first three of them; NULL in FMI 2.0 */
    double *clock;                          /* the last communication point, where the step began */
    double busy;                            /* time in its steps [s] */
    double even;                            /* length of each of its own steps; 0 where that may vary */
    int32_t fmi;
    int32_t final;       /* no step will be repeated */
    int32_t factor;      /* its own steps in one communication step */
    int32_t first, count; /* its coupling inputs */
    int32_t sets_values; /* not only derivatives of the inputs are set */
    int32_t rough;       /* some inputs cannot follow the polynomial that is wanted */
    int32_t rollback;    /* its state is saved at the beginning of every step */
    int32_t repeated;    /* further passes compute it again */
    double *values, *derivatives;
    Program input_writes; /* values and derivatives */
    Program output_reads; /* outputs that others use */
    Program held_inputs;  /* inputs that cannot move get the newest value of their source */
    Program slope_reads;  /* slopes of outputs, where the FMU gives them */
} Component;

typedef struct Scenario { /* a table of columns over time, linear in between, and the inputs that it drives */
    int64_t samples, width, row;
    const double *time, *base, *slopes, *anchor;
    const int64_t *columns, *targets, *steady_columns, *steady, *held_columns, *held;
    const double *factor, *offset, *steady_factor, *steady_offset;
    double *coming, *middle; /* at the end and at the middle of the step */
    const int32_t *inputs;
    int32_t count, steady_count, held_count;
    double when;
    Program writers;
} Scenario;

typedef struct EnergyMonitor { /* of power bonds: efforts and flows alternate in the arrays */
    const int64_t *places, *spread;
    const uint8_t *moved;
    const double *seen;
    double *start, *first, *last; /* true at the start of the step; what the FMUs worked with at both its ends */
    double *sums;                 /* shape (3, bonds): residual, without cancelling, exchanged energy */
    int32_t count;
    Program readers;
} EnergyMonitor;

typedef struct Recorder { /* a block of rows; Python takes them between two calls of simulation_advance */
    const int64_t *places, *whole_places;
    double *time, *reals;
    int32_t *wholes;
    int32_t count, whole_count, filled, room;
} Recorder;

typedef struct StepSize { /* see step_size.c */
    double h, smallest, largest, before, uncut;
    int32_t power;   /* of the step, that the estimate of its error goes with */
    int32_t repeats; /* the components can go back */
} StepSize;

typedef struct Pool Pool;

typedef struct Simulation {
    double *real, *real_saved, *slopes;
    double *used; /* shape (2, reals): what moving inputs were at both ends of the step */
    int32_t *whole, *whole_saved;
    int64_t reals, wholes;
    Program exchange;
    AlgebraicLoop **loops;
    Component *components;
    CouplingInput *inputs;
    int32_t loop_count, component_count, input_count;
    int32_t rounds_at_start; /* until slopes that depend on slopes of inputs are known */
    Scenario *scenario;           /* NULL without one */
    LinearPrediction *prediction; /* NULL where the plan wants none */
    EnergyMonitor energy;
    Recorder recorder;
    /* the plan of the master */
    const int32_t *order; /* in which the components step, by number */
    uint8_t *has_stepped; /* in this pass */
    int32_t degree, sequential, passes, corrected;
    double tolerance;
    const int32_t *bonds; /* of each the coupling inputs of effort and flow */
    int32_t bond_count;
    /* the loop over steps */
    StepSize *step_size; /* NULL: all steps are equal */
    double error_tolerance;
    int32_t by_energy; /* the tolerance is one of power */
    int32_t free;      /* every communication point is recorded */
    int32_t saves;     /* the beginning of each step is saved, as far as the FMUs can */
    int32_t rollback;  /* all of it is, so that a shorter step can be tried */
    int32_t diverged;  /* a step without a finite error stands */
    const double *events;
    int64_t event_count, event;
    double start, step, t, length, length_before, shorter, shortest, longest, patience;
    int64_t total, done, steps, all_passes, repeated;
    Pool *pool; /* threads that step components; NULL: one after the other */
    int32_t threads;
    CheckStatus *check_status;
    CallPython *call_python;
    double reached; /* how far an FMU came in a discarded step */
} Simulation;

/* max and min of Python, where numbers that are not a number are concerned; and the worse of two errors */
static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double smaller(double a, double b) { return b < a ? b : a; }
static inline double worse(double a, double b) { return b <= a || a != a ? a : b; }

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* calls.c */
int carry_out(Simulation *, const Program *);
int component_step(Simulation *, int k, double t, double h);
int component_save(Simulation *, int k);
int component_restore(Simulation *, int k);
int directional_derivative(Simulation *, const Derivative *);
double seconds(void);

/* algebraic_loop.c */
EXPORT int32_t loop_solve(Simulation *, AlgebraicLoop *);
EXPORT int32_t loop_factorise(double *a, int32_t *rows, int32_t n);
EXPORT void loop_substitute(const double *a, const int32_t *rows, double *b, int32_t n);

/* linear_prediction.c */
int predict_inputs(Simulation *, double h);
void prediction_accept(LinearPrediction *, double h);
EXPORT void prediction_join(LinearPrediction *);
EXPORT void prediction_find_drift(const LinearPrediction *);
EXPORT void prediction_prepare(LinearPrediction *, double h);
EXPORT void prediction_solve(const LinearPrediction *);
EXPORT int32_t prediction_invert(double *a, int32_t *rows, int32_t n, int32_t wide);

/* coupling_input.c */
EXPORT void input_begin(CouplingInput *, double value, double slope);
EXPORT void input_drive(CouplingInput *, double middle, double value_end, double h);
EXPORT void input_extrapolate(CouplingInput *, double h, double length);
EXPORT void input_take_prediction(CouplingInput *, double v1, double v2, double v3, double h);
EXPORT void input_end_at_source(CouplingInput *, double h);
EXPORT void input_interpolate(CouplingInput *, int32_t degree, double h, double length);
EXPORT void input_correct(CouplingInput *, double h, double length);
EXPORT void input_arrive(CouplingInput *, double value, double slope, double h, double length, double before);
EXPORT void input_accept(CouplingInput *, double h, double length);
EXPORT double input_mismatch(const CouplingInput *, double h);
EXPORT double input_deviation(const CouplingInput *, double h, int32_t repeated);
EXPORT double input_mean_error(const CouplingInput *, double h);
EXPORT double input_magnitude(const CouplingInput *);
EXPORT double input_share(const CouplingInput *, double deviation);
EXPORT void polynomial_shift(const double c[], double by, double shifted[]);
EXPORT void polynomial_project(double c[], int32_t degree, double h);
EXPORT double polynomial_mean(const double c[], double h);
EXPORT double polynomial_value(const double c[], double s);
EXPORT double polynomial_slope(const double c[], double s);

/* scenario.c */
void scenario_look(Scenario *, double t);
int scenario_set(Simulation *, double t);

/* communication_step.c */
int communication_step(Simulation *, double h, int *passes);
int component_give(Simulation *, Component *, double begin, double length, int last);
int component_advance(Simulation *, int k, double h, double *clock);
void inputs_arrive(Simulation *, double h, int component);
double step_error(const Simulation *, double h);
double power_error(const Simulation *, double h);
enum { EVERY_COMPONENT = -2 };

/* threads.c: as many threads, the caller's among them */
Pool *pool_start(Simulation *, int threads);
int pool_step(Pool *, double h);
void pool_stop(Pool *);

/* step_size.c */
EXPORT double step_size_next(StepSize *, double room);
EXPORT int32_t step_size_accepts(StepSize *, double error, double h);

/* simulation_loop.c: from the start, a block of steps at a time; CONTINUE when there is more to do or all is done */
EXPORT int32_t simulation_exchange(Simulation *, double t);
EXPORT int32_t simulation_begin(Simulation *);
EXPORT int32_t simulation_advance(Simulation *);
EXPORT int32_t simulation_close(Simulation *);

#endif
