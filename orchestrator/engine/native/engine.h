/* The co-simulation engine: structures and functions that its C files share. The files, from the outside in:
 *
 *     simulation_loop.c      the run: communication steps from point to point, repeated steps, recorded rows, energies
 *     communication_step.c   one communication step: jacobi_pass, gauss_seidel_pass, and their repetition (Hermite)
 *     coupling_input.c       one input over a communication step, as a polynomial of time
 *     linear_prediction.c    all inputs over a communication step, predicted from the interface Jacobian
 *     error_propagation.c    the error of all states and outputs, from the errors of the inputs in each step
 *     linear_system.c        the linear system of both
 *     step_size.c            the length of the next adaptive step
 *     algebraic_loop.c       Newton's method for inputs that determine the outputs which feed them
 *     scenario.c             inputs that a scenario drives
 *     events.c               steps that end at the events of FMUs
 *     plant.c                all components in Model Exchange, as one ODE
 *     calls.c                calls into FMUs and into Python
 *     environment.c          the rounding mode and its like, which an FMU may change
 *     threads.c              components that step at the same time
 *
 * Python owns all arrays. c_library.py reads the structures from this file; Python fills them before a run and
 * collects recorded rows between two calls of simulation_advance. A function that returns an int returns CONTINUE or
 * the reason to end the run.
 *
 * orchestrator/lanes/native/machines.cpp compiles the files that step a system for several machines at once, which differ
 * in their numbers only. A Real has one double, and a Mask one truth value, for each of WIDTH machines; `where` chooses
 * between two numbers of each machine.
 */
#ifndef ENGINE_H
#define ENGINE_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifndef WIDTH
#define WIDTH 1
typedef double Real;
typedef int32_t Mask;
enum { NO_MACHINE, EVERY_MACHINE };
static inline int any(Mask machines) { return machines; }
static inline int all(Mask machines) { return machines; }
static inline Mask is_finite(Real a) { return isfinite(a) != 0; }
static inline Real where(Mask machines, Real a, Real b) { return machines ? a : b; }
static inline double machine(Real a, int i) { return (void)i, a; }
static inline int chosen(Mask machines, int i) { return (void)i, machines; }
static inline void remove_machine(Mask *machines, int i) { *machines = 0, (void)i; }
/* Sets the number of machine i of `count` that differ; if count is 1, all machines have it */
static inline void set_machine(Real *a, int i, int count, double value) { *a = value, (void)i, (void)count; }
#endif

enum { REAL, INTEGER, WIDENED };          /* arrays of values; INTEGER: all but Real values; WIDENED: from it to REAL */
enum { F64, F32, I8, U8, I16, U16, I32, U32, I64, U64, LOGICAL }; /* types of values in an FMU */
enum { ACCESS, COPY, LOOP, PYTHON, EXCHANGE };                    /* types of instructions */
enum { SET_TIME, VECTOR, COMPLETED_STEP };                        /* kinds of calls in Model Exchange */
enum { DRIVEN = -1, LINE = 1, DEGREE = 3, POLYNOMIAL = 6 }; /* POLYNOMIAL: Reals of a coupling input from c on */
enum { CONTINUE, STOP, DISCARDED, ABORT, AT_EVENT };       /* verdicts; ABORT: the cause is not an FMU; AT_EVENT: an FMU
                                    has stopped at an event inside the step */
enum { CALL, STEP, SAVE, RESTORE, MASTER, INSTANT, ALONE };        /* requests to Python; also numbers of FMI functions */
enum { WARNING = 1, DISCARD, FATAL = 4 };                  /* statuses of FMI 2.0 and 3.0 */
enum { OUT_OF_RANGE = -1, WITHDRAWN = -3, CHANGED = -5 };  /* further statuses: an integer that the other type cannot
                                    hold; a step that is repeated, so that its messages do not count; an FMU has changed
                                    the floating-point environment, which was restored */
enum { SOLVED = 0, SINGULAR = -1, NOT_CONVERGED = -2, NEEDS_INVERSE = -4 }; /* outcomes for an algebraic loop */
enum { JACOBIAN_VALID, CIRCULAR, INITIALISED };            /* flags of a loop; CIRCULAR: values that were copied along
                                    the connections did not settle */
enum { SOLVES, EVALUATIONS };                              /* counts of a loop */
enum { SCALED, RELATIVE, WORST };                          /* residual norms of a loop: relative to the magnitude at the
                                    start; to the present magnitude; the largest accepted relative one */
enum { MISSING, OLD, RENEWED };                            /* the inverse in Newton's method for a plant */
enum { EXACT = 1, NEAR_EVENT };                            /* see CouplingInput, at_end */
enum { AT_END = 1, AT_BEGINNING };                         /* places of an instant, the latter instead of the step */
enum { PREDICTED, BY_SCENARIO, LEADING, EXTRAPOLATED };    /* sources of an input, see linear_prediction.c */
enum { BLOCK = 8 };                                        /* columns of matrices are padded to a multiple of it */

/* Reports a status that is not OK; returns a verdict. `call`: its structure; NULL: a step of `component` */
typedef int32_t CheckStatus(const void *call, int32_t component, int32_t status);
/* Makes a call, or steps, saves or restores a component, in Python; index: of the call or of the component */
typedef int32_t CallPython(int32_t request, int32_t index, double t, double h);

typedef struct Access { /* one FMI call that gets or sets several variables */
    void *function, *instance;
    const uint32_t *references;
    const int32_t *orders;      /* orders of derivatives; NULL for values */
    void *fmu_values, *values;  /* in the type of the FMU, and in the array of the run; the same if the types agree */
    int32_t *call; /* the call of this instance that is in progress, readable after a crash; 0: none */
    int32_t count, reference_count, fmi, type, array, sets, function_number; /* of values, and of variables */
} Access;

typedef struct ExchangeCall { /* one FMI call in Model Exchange */
    void *function, *instance;
    double *values; /* time; vector; or the results of a completed step: event needed, end of the simulation */
    double *clock;  /* as in Component */
    int32_t *call;  /* as in Access */
    int32_t kind, count, fmi, function_number;
} ExchangeCall;

typedef struct ValueTable { /* values of integers that a mapping of SSP takes off the straight line */
    const int64_t *source, *target, *from, *to;
    int32_t count;
} ValueTable;

typedef struct ConnectionCopy { /* copies values of outputs to the inputs that they feed, of one type */
    const int64_t *source, *target;
    const void *factor, *offset; /* NULL if all factors are 1 and all offsets 0 */
    const ValueTable *table;     /* NULL: none */
    int32_t count, array;
} ConnectionCopy;

typedef struct Instruction {
    int32_t type, index; /* index: of a call into Python */
    void *operand;
} Instruction;

typedef struct Program {
    int32_t count;
    const Instruction *instructions;
} Program;

typedef struct Derivative { /* directional derivative of the unknowns when the knowns change along `seed` */
    void *function, *instance; /* NULL: Python makes the call */
    const uint32_t *unknowns, *knowns;
    double *seed, *result;
    int32_t *call;
    int32_t fmi, unknown_count, known_count, index, function_number;
    int32_t unknown_references, known_references; /* variables, of which each has one value or several */
} Derivative;

typedef struct LoopMember { /* a component in an algebraic loop; first_...: its first index in the loop's u and y */
    Program input_writes, output_reads, input_reads;
    Derivative derivative;
    int32_t uses_derivative; /* else differences */
    int32_t first_input, input_count, first_output, output_count;
} LoopMember;

/* An algebraic loop of n inputs and m outputs: r(u) = u - g(u) = 0, g_i = factor_i y_output(i) + offset_i.
 * magnitude: the largest magnitude of each input so far; initial_magnitude: at the start of a solution;
 * jacobian_scale: the magnitudes that the Jacobian is made for; sensitivity: dy/du, shape (m, n); jacobian: dr/du over
 * the magnitudes, or its triangular factors */
typedef struct AlgebraicLoop {
    LoopMember *members;
    double *u, *y, *g, *residual, *step, *previous, *initial, *initial_magnitude, *jacobian_scale, *magnitude;
    double *sensitivity, *jacobian, *residual_norms;
    const int64_t *output, *input_indices, *output_indices; /* indices: in the array of Real values */
    const double *factor, *offset;
    int32_t *pivots, *flags;
    int64_t *counts;
    int32_t member_count, input_count, output_count;
    int32_t copy_rounds;      /* how often values are copied along the connections before Newton's method */
    int32_t declared;         /* the FMUs declare the dependencies that make the loop */
    int32_t solved_in_passes; /* solved after each pass over the components */
} AlgebraicLoop;

typedef struct JacobianColumn { /* a directional derivative: matrices[to] = factor * result[from] */
    Derivative derivative;
    const int32_t *from;
    const int64_t *to;
    const double *factor;
    int32_t entries;
} JacobianColumn;

/* The linearised components joined by their connections: n states, m inputs; see linear_system.c.
 * n_padded, m_padded: n and m rounded up to a multiple of BLOCK */
typedef struct LinearSystem {
    const JacobianColumn *columns;
    double *matrices, *k, *kc, *closed_loop;
    int32_t *pivots;
    int32_t column_count, n, m, n_padded, m_padded, has_feedthrough, usable;
} LinearSystem;

typedef struct StateSpace { /* views of `matrices` */
    const double *a, *b, *c, *d;
} StateSpace;

typedef struct LinearPrediction { /* see linear_prediction.c */
    LinearSystem system;
    Program rate_reads; /* read the time derivatives of the states into f */
    const int32_t *kinds, *inputs; /* of each input: PREDICTED, ...; its coupling input, or -1: the FMU moves it */
    double *f, *w, *course, *response, *forcing, *v, *stages, *factors;
    int32_t leading_count, valid; /* valid: it is of this communication point */
    double factors_step;
} LinearPrediction;

/* A component of the error propagation. copies: errors of inputs that influence no state, from indices in y to indices
 * in the seed of the derivative */
typedef struct ErrorMember {
    Derivative outputs; /* its outputs, from its states, its inputs that influence a state, and its other inputs */
    const int32_t *from, *to;
    const double *factors;
    int32_t first_state, state_count, first_input, input_count, copy_count;
} ErrorMember;

typedef struct InputStep { /* an input over a step of the master */
    double line[LINE + 1], corner[LINE + 1]; /* constant and slope of the defect, without and with a corner of the source */
    double third, bend;                /* of the source: third derivative / 6, and mean magnitude of the second one */
    double off_source, off_cubic;      /* in the middle: source, and cubic through its ends, less the input */
    int32_t measured;                  /* the source is known in the middle, too */
    int32_t smooth, has_corner;        /* the source has slopes; it may have a corner inside the step */
} InputStep;

typedef struct ErrorInput { /* an input of the error propagation, over the last three steps */
    InputStep before, step, last;
    double usual_bend, usual_slope;     /* largest `bend` and slope of the source before, faded */
    int32_t input, substeps;            /* its coupling input, or -1: no defect; substeps of its component */
} ErrorInput;

/* Errors of n states (e) and of the outputs (y), from the defects of m inputs; see error_propagation.c.
 * defects, shape (m, 2): integral of the defect over the section so far, and its first moment about the start; lengths: of the last three steps [s]; squares, largest: time integral of the square and largest magnitude of each
 * element of y; output_reads: into `values`, whose extremes so far are `lowest` and `highest`; diagonal: of A + B K C at the linearisation before; middle: deviations of the sources from all inputs in
 * the middle of the step; halves: some are measured */
typedef struct ErrorPropagation {
    LinearSystem system;
    const ErrorMember *members;
    ErrorInput *inputs;
    double *e, *stages, *factors, *w, *middle, *defects, *y, *squares, *largest, *lengths, *diagonal;
    double *values, *lowest, *highest;
    Program output_reads;
    double *starts;       /* of the last two steps [s] */
    double *times, *rows; /* evaluations of y since Python has collected them, shapes (capacity,) and (capacity, outputs) */
    int32_t filled, capacity;
    int32_t member_count, output_count, lag, longest_lag, age, sample, since_sample;
    int32_t halves, longest_section, taken; /* steps of a section: at most, and so far */
    double section;                 /* its length so far [s] */
    double factors_step, time, since; /* time of the last evaluation of y from the start, time since then [s] */
} ErrorPropagation;

/* One input of a component that changes inside a communication step; all values in the unit of the input */
typedef struct CouplingInput {
    Real value, slope;      /* of the source at the beginning of the step */
    Real value_end, slope_end;
    Real middle;            /* of the source in the middle of the step, if its component is `halved` */
    Real slope_before;      /* at the beginning of the previous step */
    Real chord_before, chord_earlier; /* mean slopes in the previous step and the one before */
    Real scale;             /* magnitude: the nominal value (1 if none is declared), or the largest if larger */
    Real c[DEGREE + 1];     /* coefficients of the polynomial over the step */
    Real expected, weight;  /* value at the end that the past lets expect, and weight of the difference to it */
    const Real *source_slope; /* slope of the source: a slope that its FMU gives, or the value of an output that is the
                                 slope; NULL: computed from values */
    double slope_factor;      /* from the slope of the source to that of the input */
    double factor, offset;    /* from the value of the source to that of the input */
    int32_t target, source;   /* indices in the array of Real values; a driven input has the source -1 */
    int32_t source_component; /* its index, or DRIVEN */
    int32_t fmu_degree;       /* the degree that the FMU can follow: 0 (it holds its input), 1 or 3 */
    int32_t at_end;           /* EXACT: if the FMU follows a lower degree, the end of the step is exact, not the mean;
                                 NEAR_EVENT: while an event is located */
    int32_t requested_degree; /* the degree that the master asks for; 0: the input is only watched */
    int32_t order;            /* order of extrapolation */
    int32_t autonomous;       /* the source has no inputs: its slope may jump, but no further pass changes it */
    int32_t noisy;            /* the source jumps by noise or a resolution, which no shorter step resolves */
    int32_t in_loop;          /* the source is in an algebraic loop: computed when all components have stepped */
    int32_t predicted;        /* linear_prediction.c makes the polynomial */
    int32_t slopes_known;     /* successive points up to the beginning of the step that have a slope: 0, 1 or 2 */
    int32_t next_fed;         /* the next input that the same component feeds, or -1 */
} CouplingInput;

typedef struct Component { /* a running FMU; do_step NULL: Python steps it, saves and restores its state */
    void *instance, *do_step, *get_state, *set_state, *state;
    void *event, *terminate, *early, *last; /* results of a step in FMI 3.0 */
    const uint32_t *flags;                  /* the first three of them; NULL in FMI 2.0 */
    double *clock;                          /* the last communication point, beginning and end of the step */
    int32_t *call;                          /* as in Access */
    double busy;                            /* time in its steps [ticks] */
    int32_t fmi;
    int32_t never_restored;
    int32_t substeps;                   /* its own steps in one communication step */
    int32_t halved;                     /* it takes two of them, and its outputs between them are read */
    int32_t first_input, input_count;   /* its coupling inputs */
    int32_t first_fed;                  /* the first of the coupling inputs that it feeds, or -1 */
    int32_t sets_values;                /* values of the inputs are set, not only derivatives */
    int32_t simplifies_inputs;          /* inputs that outputs depend on have a lower degree than the master asks for */
    int32_t rollback;                   /* its state is saved at the beginning of every step */
    int32_t repeated;                   /* further passes compute it again */
    int32_t events;                     /* it stops at its events, or asks for event mode at the end of a step */
    int32_t locates;                    /* if it stops early, it does at the time of the event; else not before that */
    int32_t asked;                      /* it has stopped in this try */
    double announced;                   /* time of its next event that it has announced [s] */
    int32_t restless;                   /* it asks for event mode after each step, however short; -1: it did */
    Real *values, *derivatives;
    Program input_writes; /* set values and derivatives of its coupling inputs */
    Program output_reads; /* read the outputs that other components use */
    Program held_inputs;  /* set the other inputs to the newest value of their source */
    Program slope_reads;  /* read the slopes of outputs, if the FMU gives them */
} Component;

typedef struct Scenario { /* a table of columns over time, linear between the samples, and the inputs that it drives */
    Real evaluated_at;
    Real since; /* time until which jumps have taken place, the beginning of the step [s]; NaN: all have */
    const Real *commands; /* held in place of the columns; NULL: none */
    int64_t samples, width, interval[WIDTH];
    const double *time, *base, *slopes, *anchor;
    const int64_t *columns, *targets, *discrete_columns, *discrete, *integer_columns, *integers;
    const double *factor, *offset, *discrete_factor, *discrete_offset;
    const int64_t *rate_columns, *rates; /* rate inputs of continuous inputs, which get the slope of their column */
    const double *rate_factor;
    const int64_t *integer_factor, *integer_offset;
    const ValueTable *table; /* source: a column; NULL: none */
    const int64_t *passed_columns, *passed; /* inputs of the system that its outputs pass on */
    Real *at_end, *at_midpoint;   /* continuous inputs at the end and at the middle of the step */
    const int32_t *inputs;        /* the coupling inputs of the continuous ones */
    int32_t count, discrete_count, integer_count, rate_count, passed_count;
    Program input_writes;
} Scenario;

typedef struct EnergyMonitor { /* of power bonds: efforts and flows alternate in the arrays */
    const int64_t *indices, *set_indices, *read_indices; /* of the inputs; of the values that were set, and read back */
    const uint8_t *varied; /* by the master; the others are read back */
    const Real *read_values;
    Real *start;                    /* true values at the start of the step */
    Real *used_start, *used_end;    /* values that the FMUs used at both ends of the step */
    Real *sums;                     /* shape (3, bonds): residual, sum of its magnitude, exchanged energy */
    int32_t count;
    Program input_reads;
} EnergyMonitor;

typedef struct Recorder { /* a block of rows; Python collects them between two calls of simulation_advance */
    const int64_t *real_indices, *integer_indices; /* real_indices NULL: all Real values */
    double *time, *reals;
    int64_t *integers;
    int32_t real_count, integer_count, filled, capacity;
    int64_t collected; /* communication points before the block */
    double latest;     /* time of the latest row [s] */
} Recorder;

typedef struct StepSize { /* see step_size.c */
    double h, first, smallest, largest, error_before, unclipped; /* first: the first one */
    int32_t power;   /* power of the step with which the error estimate scales */
    int32_t repeats; /* the components can go back */
} StepSize;

typedef struct PlantMember { /* a component in Model Exchange; first_...: its first index in v of the plant */
    Program writes, reads, rates; /* set the inputs; get the outputs; get the time derivatives of the states */
    int32_t first_input, input_count;
} PlantMember;

/* The components in Model Exchange as one ODE, see plant.c. v, y, external: inputs, outputs, external part of v.
 * Connection i: v[row[i]] = factor[i] y[source[i]] + external[row[i]], by ascending row */
typedef struct Plant {
    const PlantMember *members;
    Program states;     /* set time and states of all components */
    Program starts;     /* get states and inputs of all components */
    Program indicators; /* get all event indicators */
    Program completed;  /* tell the components that a step is completed */
    const int32_t *rows, *sources;
    const double *factors;
    const uint8_t *effective; /* by input: something may depend on it */
    int32_t *stale;           /* by component: an effective input has changed */
    double *time, *v, *y, *external, *expected, *magnitude, *residual, *inverse;
    const double *results; /* of a completed step, shape (member_count, 2) */
    const JacobianColumn *columns;
    double *jacobian; /* d(f, y) / d(x, v) of the unconnected components, row by row */
    double last;      /* largest relative error of an input in the iteration before */
    int32_t member_count, input_count, connection_count, column_count;
    int32_t rounds; /* substitutions that solve the connections, by the declared dependencies; 0: a loop */
    int32_t inverse_state, iterations;
    int32_t requests; /* a component asks for an event or for the end, at a completed step */
} Plant;

/* Events of FMUs, see events.c. low, high: the longest step so far that met none, and the shortest one that met one; 0:
 * none [s]. latest, period: time of the last event that was only asked for, and since the one before [s] */
typedef struct Events {
    const int64_t *real_targets, *integer_targets; /* connected or driven inputs that are not continuous, and influence a state */
    double *reals;                                 /* their values at the last instant */
    int64_t *integers;
    int32_t *changes; /* places among them, the Reals first, of those that have changed since the last exchange in an instant */
    int32_t real_count, integer_count, changed; /* changed: their number */
    int32_t used;     /* FMUs are in event mode at instants, through Python */
    int32_t present;  /* used, or there are such inputs; else no step looks for events */
    int32_t located;  /* all components can go back, so that a step is repeated to its first event */
    int32_t divides;  /* steps end at announced events and ticks */
    int32_t due;      /* there is an instant: AT_END, AT_BEGINNING; 0: none */
    int32_t by_asking; /* of an FMU that has asked for it, without a time */
    int32_t restless; /* an FMU has been found to be restless: the step is repeated */
    int32_t at_end;   /* also where the step is accepted for other reasons only: of a restless FMU */
    int32_t ends;     /* an FMU has requested the end of the run in an instant */
    int32_t tries;    /* of the present step */
    double next;      /* the next time event that an FMU has announced [s] */
    double tolerance; /* of the time of an event [s] */
    double low, high, margin, before; /* before: time after which an FMU stopped in the last try [s] */
    double instant, latest, period;   /* instant: time of the last one [s] */
    double near, until; /* length of a last part of a step, and its end: an event is asked for there only [s] */
} Events;

typedef struct LookedAt { /* an output that is known at communication points only, see looks.c */
    double value, change, rate; /* at the last point; its change in the last step; the rate of the step before [1/s] */
    double lowest, highest;
    double jump;   /* the largest change in a step that those around it do not have */
    double late;   /* sum of these changes, each by the length of its step */
    double hidden; /* sum of what looks found outside of the values at both points around them */
    int64_t index; /* in the array of Real values */
} LookedAt;

typedef struct Looks { /* at the outputs of a component */
    Program reads;  /* get the outputs into `inside` */
    double *inside; /* values of the last look */
    LookedAt *at;
    double phase; /* of the last look: a part of the step */
    int64_t count, next; /* looks that were compared; step of the next one */
    int32_t component, outputs;
    int32_t goes_back; /* the component can step to a time inside the step, and back */
    int32_t looked;    /* in the present step */
} Looks;

typedef struct Pool Pool;

typedef struct Simulation {
    Real t, end;                /* time, and that of the end of the present step [s] */
    Real length, length_before; /* of the last two steps; 0: none [s] */
    Real shortest, longest;
    Mask alive;    /* machines that have not failed */
    Mask moving;   /* those that take the present step */
    Mask computed; /* those that compute the present pass */
    Real *reals, *saved_reals;
    Real *input_ends; /* shape (2, real_count): coupling inputs at both ends of the step */
    int64_t *integers, *saved_integers;
    int64_t real_count, integer_count;
    Program first_reads; /* of outputs that depend on no input directly, before inputs are set: FMI 2.0, 4.2.4 */
    Program exchange;
    AlgebraicLoop **loops;
    Component *components;
    CouplingInput *inputs;
    int32_t loop_count, component_count, input_count;
    int32_t initial_rounds; /* rounds until slopes that depend on slopes of inputs are computed */
    Scenario *scenario;           /* NULL without one */
    LinearPrediction *prediction; /* NULL if the plan has none */
    ErrorPropagation *errors;     /* NULL if the error is not estimated */
    Looks *looks;
    int32_t look_count;
    EnergyMonitor energy;
    Recorder recorder;
    Events events;
    /* the plan of the master */
    const int32_t *order; /* indices of the components in the order in which they step */
    uint8_t *has_stepped; /* in this pass, by component */
    int32_t degree, sequential, passes, in_python; /* in_python: a function of Python takes the components over a step */
    int32_t parallel; /* only components with events use new outputs of those before them */
    double tolerance;
    /* the loop over steps */
    StepSize *step_size; /* of each machine; NULL: all steps are equal */
    double error_tolerance;
    int32_t free;      /* every communication point is recorded */
    int32_t saves;     /* states are saved at the beginning of each step, if the FMUs can */
    int32_t rollback;  /* all components can go back, so that a shorter step can be tried */
    int32_t diverged;  /* a step was accepted although its error is not finite */
    int32_t careful;   /* the floating-point environment is restored after each call, see environment.c */
    const double *divided; /* communication points between those of equal steps */
    int64_t divided_count, next_divided[WIDTH];
    double start, step, shorter, patience;
    double pause; /* simulation_advance returns there, or where it is beyond it [s] */
    double spent, counted; /* time in all calls of simulation_advance, in [s] and in ticks */
    double tick;           /* their ratio; 0 before the first call */
    int64_t total, done, steps, all_passes, repeated;
    Pool *pool; /* threads that step components; NULL: one component after the other */
    int32_t threads;
    CheckStatus *check_status;
    CallPython *call_python;
    uint64_t control; /* words of the floating-point environment at the beginning of the run */
    double reached; /* time that an FMU reached in a discarded step */
} Simulation;

/* Maximum and minimum as Python computes them with NaN, and the worse of two errors */
#define COMPARING(Number)                                                                 \
    static inline Number larger(Number a, Number b) { return where(b > a, b, a); }        \
    static inline Number smaller(Number a, Number b) { return where(b < a, b, a); }       \
    static inline Number worse(Number a, Number b) { return where(b <= a || a != a, a, b); }
COMPARING(Real)
#if WIDTH > 1
COMPARING(double)
#endif

/* The slope of the source in the unit of the input; 0 if it is computed from values */
static inline Real source_slope(const CouplingInput *s) {
    return s->source_slope ? *s->source_slope * s->slope_factor : 0.0;
}

#if WIDTH > 1
#define EXPORT
#elif defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* calls.c; machines.cpp for several machines */
int execute(Simulation *, const Program *);
EXPORT int32_t program_run(Simulation *, const Program *);
int python_call(Simulation *, int32_t request, int32_t index, double t, double h);
int component_step(Simulation *, int k, Real begin, Real length); /* begin: [s] after the start of the step */
int component_try(Simulation *, int k, double length);
int component_save(Simulation *, int k);
int component_restore(Simulation *, int k, Mask);
void set_clocks(Simulation *, Real t);
void machines_move(Simulation *, Mask); /* those that take the next step */
int machines_check(Simulation *);       /* at the start */
int values_save(Simulation *);
int values_restore(Simulation *);
int values_set(Simulation *);
void record(Simulation *);
int directional_derivative(Simulation *, const Derivative *);
int linearise(Simulation *, const JacobianColumn *, int32_t count, double *matrices);
double seconds(void);
double ticks(void); /* of a counter with a constant rate, cheaper to read than a clock */

/* environment.c; the call, if it is not NULL, or the component k may have changed it */
enum { ANY_COMPONENT = -1 };
void environment_restore(Simulation *, const void *call, int k);
EXPORT int32_t environment_begin(Simulation *);
EXPORT int32_t environment_check(Simulation *);
static inline int rounds_to_nearest(void) {
    static const volatile double one = 1.0, little = 0x1p-60;
    return one + little == one && one - little == one;
}

/* algebraic_loop.c */
EXPORT int32_t loop_solve(Simulation *, AlgebraicLoop *);
EXPORT int32_t loop_factorise(double *a, int32_t *pivots, int32_t n);
EXPORT void loop_substitute(const double *a, const int32_t *pivots, double *b, int32_t n);

/* linear_prediction.c */
int predict_inputs(Simulation *, Real h);
EXPORT void prediction_prepare(LinearPrediction *, double h);
EXPORT void prediction_solve(const LinearPrediction *);

/* linear_system.c */
static inline void vector_zero(double *values, int32_t n) { memset(values, 0, (size_t)n * sizeof *values); }
static inline void vector_copy(double *to, const double *from, int32_t n) {
    memcpy(to, from, (size_t)n * sizeof *to);
}
void matrix_add_product(const double *matrix, const double *by, double *to, int32_t columns, int32_t n_padded);
void matrix_identity_minus(double *a, const double *matrix, double factor, int32_t n, int32_t n_padded);
EXPORT int32_t matrix_invert(double *a, int32_t *pivots, int32_t n, int32_t n_padded);
EXPORT int32_t matrix_factorise(double *a, int32_t *pivots, int32_t n, int32_t n_padded);
EXPORT void matrix_solve(const double *a, const int32_t *pivots, double *b, int32_t n, int32_t n_padded);
StateSpace state_space(const LinearSystem *);
int linear_system_evaluate(Simulation *, const LinearSystem *);
EXPORT void linear_system_join(LinearSystem *);
void linear_system_respond(const LinearSystem *, const double *w, double *response);

/* error_propagation.c */
int error_begin(Simulation *);
void error_jump(ErrorPropagation *);
EXPORT int32_t error_propagate(Simulation *, Real h);
EXPORT void error_advance(ErrorPropagation *, double h);

/* coupling_input.c */
EXPORT void input_begin(CouplingInput *, Real value, Real slope);
EXPORT void input_drive(CouplingInput *, Real middle, Real value_end, Real h);
EXPORT void input_extrapolate(CouplingInput *, Real h, Real length);
EXPORT void input_predict(CouplingInput *, Real v1, Real v2, Real v3, Real h);
EXPORT void input_end_at_source(CouplingInput *, Real h);
EXPORT void input_interpolate(CouplingInput *, int32_t degree, Real h, Real length);
EXPORT void input_set_end(CouplingInput *, Real value, Real slope, Real h, Real length, Real before);
EXPORT void input_true_course(const CouplingInput *, Real h, Real c[]);
EXPORT void input_accept(CouplingInput *, Real h);
EXPORT void input_replace(CouplingInput *, const CouplingInput *by, Mask);
EXPORT void input_replace_polynomial(CouplingInput *, const Real by[], Mask);
EXPORT Real input_mismatch(const CouplingInput *, Real h);
EXPORT Real input_deviation(const CouplingInput *, Real h, int32_t repeated);
EXPORT Real input_magnitude(const CouplingInput *);
EXPORT Real input_relative(const CouplingInput *, Real deviation);
EXPORT void polynomial_shift(const Real c[], Real by, Real shifted[]);
EXPORT void polynomial_project(Real c[], int32_t degree, Real h);
EXPORT Real polynomial_mean(const Real c[], Real h);
EXPORT Real polynomial_value(const Real c[], Real s);
EXPORT Real polynomial_slope(const Real c[], Real s);

/* scenario.c */
void scenario_evaluate(Scenario *, Real t);
void scenario_set_continuous(Scenario *, Real t, Real *values);
int scenario_set_inputs(Simulation *, Real t);
int scenario_differs(Simulation *);
Mask scenario_jumps(Scenario *, Real t, Mask);

/* communication_step.c */
int communication_step(Simulation *, Real h, int *passes);
int component_set_inputs(Simulation *, Component *, Real begin, Real length, int last);
int component_advance(Simulation *, int k, Real h, double *counter);
void set_source_ends(Simulation *, Real h);
Real step_error(const Simulation *, Real h);

/* looks.c */
int looks_take(Simulation *, double h);
void looks_compare(Simulation *, double h);
void looks_begin(Simulation *);

/* events.c */
void event_try(Simulation *);
int event_reached(Simulation *, Component *, double reached, int early);
int event_approached(Simulation *, double h, int *goes_back);
int event_missed(Simulation *, double h);
double event_expected(Simulation *, double t, double to);
int event_due(const Simulation *);
EXPORT int32_t event_exchange(Simulation *, double t);
int event_instant(Simulation *);
void event_values(Simulation *);

/* threads.c; `threads` includes the caller's */
Pool *pool_start(Simulation *, int threads);
int pool_step(Pool *, Real h);
void pool_stop(Pool *);

/* plant.c */
EXPORT int32_t plant_start(Simulation *, Plant *);
EXPORT int32_t plant_settle(Simulation *, Plant *);
EXPORT int32_t plant_connect(Simulation *, Plant *);
EXPORT int32_t plant_iterate(Simulation *, Plant *);
EXPORT int32_t plant_evaluate(Simulation *, Plant *, int32_t member, int32_t with_states);
EXPORT int32_t plant_jacobian(Simulation *, Plant *);
EXPORT int32_t plant_indicators(Simulation *, Plant *);
EXPORT int32_t plant_completed_step(Simulation *, Plant *);

/* step_size.c */
void step_size_begin(StepSize *);
EXPORT double step_size_next(StepSize *, double remaining);
EXPORT int32_t step_size_accepts(StepSize *, double error, double h);

/* simulation_loop.c; simulation_advance returns CONTINUE also at the end of the run */
int exchange_after_reads(Simulation *, Real t);
EXPORT int32_t simulation_exchange(Simulation *, Real t);
EXPORT int32_t simulation_begin(Simulation *);
EXPORT int32_t simulation_resume(Simulation *);
EXPORT int32_t simulation_advance(Simulation *);
EXPORT int32_t simulation_close(Simulation *);

#endif
