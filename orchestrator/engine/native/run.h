/* A run in compiled code: the same as march.py, sweep.py, part.py, signal.py, polynomial.py and driver.py,
 * operation by operation, so that both give the same numbers. Arrays belong to Python, which fills these
 * structures (layout.py) and looks at what is recorded between two blocks.
 */
#ifndef RUN_H
#define RUN_H

#include <stddef.h>
#include <stdint.h>

enum { REAL, WHOLE };                                           /* banks */
enum { F64, F32, I8, U8, I16, U16, I32, U32, I64, U64, LOGICAL }; /* types of values in an FMU */
enum { ACCESS, LINK, LOOP };                                    /* kinds of instructions */
enum { DRIVEN = -1, NO_SLOPE = -1, DEGREE = 3 };
enum { CONTINUE, STOP, DISCARDED };                             /* what to do after a status */

typedef struct { /* one FMI call on a row of variables */
    void *function, *component;
    const uint32_t *references;
    const int32_t *orders; /* of derivatives; NULL for values */
    void *own, *values;    /* in the FMU's type and in the bank; the same where types agree */
    int32_t count, fmi, type, bank, sets;
} Access;

typedef struct { /* values that go from outputs to inputs */
    const int64_t *source, *target;
    const void *factor, *offset; /* NULL where they are 1 and 0 */
    int32_t count, bank;
} Link;

typedef struct {
    int32_t kind;
    const void *what;
} Instruction;

typedef struct {
    int32_t count;
    const Instruction *instructions;
} Program;

typedef struct { /* see member.py */
    Program writers, readers;
    void *derivative, *component;
    const int32_t *trusted; /* whether the derivative is used */
    const uint32_t *of, *by;
    double *seed, *into;
    int32_t fmi, first, count, first_output, outputs;
} Member;

typedef struct { /* see newton.py */
    const Member *members;
    double *u, *y, *g, *residual, *step, *before, *start, *scale, *unit, *seen, *slopes, *matrix, *shares;
    const int64_t *source, *targets, *sources;
    const double *factor, *offset;
    int32_t *rows, *flags;
    int64_t *counts;
    int32_t member_count, count, outputs, sweeps;
} Loop;

typedef struct { /* see foresight.py */
    void *derivative, *component;
    const uint32_t *of, *by;
    double *seed, *into;
    const int32_t *from;
    const int64_t *to;
    const double *factor;
    int32_t fmi, outputs, count, entries;
} Telling;

typedef struct { /* see foresight.py and joined.py */
    Program rates, values;
    const Telling *tellings;
    const int32_t *kinds, *signals; /* of each input; the signal of some is -1: none */
    double *slopes, *k, *kc, *closed, *inverse;
    double *f, *x, *w, *f0, *x0, *w0, *q, *course, *felt, *push, *v, *stages;
    int32_t *rows;
    int32_t telling_count, n, m, wide, broad, through, leads, lag, age, usable;
    double since, last, length;
} Foresight;

typedef struct { /* see signal.py */
    int32_t target, source, maker, slope, degree, wanted, order, free, tied, foreseen, known;
    double factor, offset, scale;
    double value, slope0, value1, slope1, before, chord, bend;
    double foretold, weight, lost, returned;
    double c[DEGREE + 1];
} Signal;

typedef struct { /* see part.py */
    void *component, *do_step, *get_state, *set_state, *state;
    void *event, *terminate, *early, *last; /* where FMI 3.0 tells about a step */
    const uint32_t *flags;                  /* the first three of them; NULL in FMI 2.0 */
    double *clock;                          /* the last communication point, where the step began */
    double busy, even;                      /* even: length of each of its own steps; 0 where that may vary */
    int32_t fmi, final, factor, first, count, revalued, rough, kept, repeated;
    double *values, *derivatives;
    Program writers, reads, newest, tell;
} Part;

typedef struct { /* see drive.py and driver.py */
    int64_t samples, width, row;
    const double *time, *base, *slopes, *anchor;
    const int64_t *columns, *targets, *steady_columns, *steady, *held_columns, *held;
    const double *factor, *offset, *steady_factor, *steady_offset;
    double *coming, *middle;
    const int32_t *signals;
    int32_t count, steady_count, held_count;
    double when;
    Program writers;
} Driver;

typedef struct { /* see energy.py */
    const int64_t *places, *spread;
    const uint8_t *moved;
    const double *seen;
    double *step, *first, *last, *truth;
    int32_t count, rows, room;
    Program readers;
} Monitor;

typedef struct { /* see recorder.py */
    const int64_t *places, *whole_places;
    double *time, *reals;
    int32_t *wholes;
    int32_t count, whole_count, filled, room;
} Recorder;

typedef struct { /* see pace.py */
    double h, smallest, largest, before, uncut;
    int32_t power, repeats;
} Pace;

typedef struct Pool Pool;
typedef struct Run Run;
struct Run {
    double *real, *real_kept, *used, *slopes;
    int32_t *whole, *whole_kept;
    int64_t reals, wholes;
    Program exchange, tied;
    Part *parts;
    Signal *signals;
    int32_t part_count, signal_count;
    Driver *driver; /* NULL without a scenario */
    Foresight *foresight; /* NULL where the plan wants none */
    Monitor monitor;
    Recorder recorder;
    /* the plan */
    const int32_t *turns;
    uint8_t *stepped;
    int32_t degree, sequential, passes, corrected;
    double tolerance;
    const int32_t *bonds; /* of each the signals of effort and flow */
    int32_t bond_count;
    /* the march */
    Pace *pace; /* NULL: all steps are equal */
    double adaptive;
    int32_t by_energy, free, keeps, goes_back, lost;
    const double *events;
    int64_t event_count, event;
    double start, step, t, length, older, shorter, shortest, longest, patience;
    int64_t total, done, steps, all_passes, repeated;
    /* threads that step components; NULL: one after the other */
    Pool *pool;
    int32_t threads;
    /* the judge of every status that is not OK; says what to do */
    int32_t (*judge)(const void *access, int32_t part, int32_t status);
    double reached;
};

enum { WITHDRAWN = -3 }; /* as a status: the step is repeated, so what the FMUs said in it does not count */

/* max and min of Python, where numbers that are none are concerned; and the worse of two errors */
static inline double larger(double a, double b) { return b > a ? b : a; }
static inline double smaller(double a, double b) { return b < a ? b : a; }
static inline double worse(double a, double b) { return b <= a || a != a ? a : b; }

/* calls.c: 0 or what `judge` said */
int carry_out(Run *, const Program *);
int step_part(Run *, int k, double t, double h);
int keep_part(Run *, int k);
int restore_part(Run *, int k);
int derivative_along(const void *function, void *component, int fmi, const uint32_t *of, size_t outputs,
                     const uint32_t *by, size_t count, const double *seed, double *into);
double seconds(void);

/* loop.c: 0 or what `judge` said */
int solve_loop(Run *, const Loop *);

/* foresight.c: 0 or what `judge` said */
int foretell(Run *, double h);
void foresight_accept(Foresight *, double h);

/* signal.c */
void drive(Signal *, double middle, double value1, double h);
void predict(Signal *, double h, double step);
void foresee(Signal *, double v1, double v2, double v3, double h);
void hit(Signal *, double h);
void interpolate(Signal *, int degree, double h, double step);
void give_back(Signal *, double h, double step);
void arrive(Signal *, double value, double slope, double h, double step, double older);
void accept(Signal *, double h, double step);
double magnitude(const Signal *);
double share(const Signal *, double deviation);
double miss(const Signal *, double h);
double deviation(const Signal *, double h, int repeated);
double defect(const Signal *, double h);
void shift(const double c[], double by, double shifted[]);
void project(double c[], int degree, double h);
double value_at(const double c[], double s);
double slope_at(const double c[], double s);

/* driver.c */
void look(Driver *, double t);
int put(Run *, double t);

/* sweep.c */
int advance_part(Run *, int k, double h, double *clock);
int sweep(Run *, double h, int *passes);
double step_error(const Run *, double h);
double power_error(const Run *, double h);
void arrive_all(Run *, double h, int maker);
enum { EVERYBODY = -2 };

/* threads.c: as many threads, the caller's among them */
Pool *pool_start(Run *, int threads);
int pool_step(Pool *, double h);
void pool_stop(Pool *);

/* pace.c */
double pace_length(Pace *, double room);
int pace_good(Pace *, double e, double h);

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* march.c: one block; CONTINUE when there is more to do or all is done */
EXPORT int32_t march(Run *);
EXPORT void finish(Run *);

#endif
