/* Small co-simulation models for tests of the orchestrator, behind FMI 2.0 (fmi2.c) and FMI 3.0 (fmi3.c).
 *
 * The GUID (instantiation token) tells which model an instance is. Variables of a family (real, whole, text)
 * are numbered from 0 in the order in which they are listed at each model; models.py lists the same
 * variables for modelDescription.xml. A call out of order and a step beyond the stop time are errors, without
 * any tolerance; so is a step that does not start at the FMU's own time, but for the rounding of a sum of steps.
 * QUIRK has what FMUs from elsewhere have: trouble in any call, steps that it does in part, steps that must be
 * of one length to the last bit.
 */
#include <stddef.h>

enum { REALS = 16, INTEGERS = 20, STRINGS = 4, LENGTH = 256, STATES = 2, ORDERS = 3 };
enum Model {
    NOBODY, MASS_A, MASS_B, SOURCE, GAIN, FAILS, TYPES, SPRING, WIDE, DRIFT, GLIDE, QUIRK, BENT, PULSES, MODELS
};
enum Mode { INSTANTIATED, CONFIGURING, INITIALIZING, READY, BROKEN, TERMINATED };
enum Status { GOOD, WARNED, DISCARDED, FAILED, DEAD }; /* as in FMI 2.0 and 3.0 */
enum Failure { NONE, WARNING, DISCARD, FAULT, FATAL, NOT_A_NUMBER, ENOUGH, EARLY, EVENT, TALK, CRASH };
enum Call { ANYWHERE = -1, STEP, GET, SET, SAVE, RESTORE, SLOPE, CURVE }; /* where QUIRK goes wrong */

enum { RATES = REALS - STATES }; /* the last reals of each model are the time derivatives of its states */
enum { A_X2, A_FORCE, A_X, A_V, A_MASS, A_SPRING, A_COUPLING, A_RATE }; /* MASS_A: x'' = (-k x + F) / m */
enum { B_FORCE, B_X, B_V, B_MASS, B_SPRING, B_RATE };                   /* MASS_B: x'' = (-k x - F) / m */
enum { M_HIGHEST, M_LATE }; /* both: order of input derivatives they take; no slopes before the first step */
enum { K_V, K_FORCE, K_STRETCH, K_STIFFNESS };                 /* SPRING: stretch' = v, force = k stretch */
/* SOURCE: y = offset + amplitude sin(omega t) + ramp max(t - bend, 0); tells its slope if it has a ramp */
enum { S_Y, S_AMPLITUDE, S_OMEGA, S_OFFSET, S_RAMP, S_BEND };
enum { J_Y, J_HEIGHT, J_PERIOD, J_BEGIN, J_WIDTH };             /* PULSES: y = height for a part of each period */
enum { G_U, G_Y, G_FACTOR, G_OFFSET };                          /* GAIN: y = factor u + offset */
enum { C_U, C_W, C_Y, C_FACTOR, C_BEND };                       /* BENT: y = w + factor u + bend u^2 */
enum { F_U, F_Y, F_WHEN };                                      /* FAILS: y' = u, fails once t >= when */
enum { F_HOW };
enum { T_IN, T_OUT, T_GAIN }; /* TYPES: every output follows its input */
enum { T_INT, T_INT_OUT, T_BOOL, T_BOOL_OUT, T_ENUM, T_ENUM_OUT, T_ALIVE };
enum { T_LABEL, T_ECHO, T_RESOURCES };
enum { D_U, D_RATE, D_Y };                     /* DRIFT: y' = u, where u moves at its rate */
enum { L_X, L_V, L_A, L_Y };                   /* GLIDE: y' = x, where x moves at v, and v at a */
enum { Q_U, Q_Y, Q_GAIN, Q_PUSH, Q_WHEN, Q_LONGEST, Q_RATE }; /* QUIRK: y' = gain u + push, u may move at its rate */
enum { Q_HOW, Q_WHERE, Q_HIGHEST, Q_EVEN, Q_MUTE, Q_STRICT }; /* Q_STRICT: FMI 2.0, 4.2.4 to the letter */
enum { W_PAIRS = 7, W_SIZE = 2 * W_PAIRS, W_SIZE_OUT }; /* WIDE: outputs follow inputs of all widths */

typedef struct Instance Instance;
struct Instance {
    enum Model model;
    enum Mode mode;
    char name[LENGTH];
    int logging;
    void (*say)(Instance *, enum Status, const char *category, const char *text);
    double time, stop, length; /* length of the first step */
    double final;              /* the master promised to restore no state before this time */
    int stop_defined;
    int touched; /* inputs were set since the last step */
    double r[REALS];
    double slope[REALS][ORDERS]; /* derivatives of inputs, for the next step only */
    double trend;                /* slope that the first input had where the last step ended */
    long long i[INTEGERS];       /* integers, enumerations and booleans */
    char s[STRINGS][LENGTH];
};

extern int instances; /* alive; read through TYPES' integer "alive" */
extern int saved;     /* states that were not given back; QUIRK tells them when it is freed */

enum Model named(const char *guid);                 /* NOBODY if there is none */
void begin(Instance *, enum Model, const char *name, const char *resources);
enum Status complain(Instance *, enum Status, const char *what, double value);
enum Status move(Instance *, enum Mode from, enum Mode to);
void outputs(Instance *);
int derivative(const Instance *, int reference, double *value); /* of an output; 0 if it has none */
double gain(const Instance *, int output, int input);           /* partial derivative */
enum Status advance(Instance *, double t, double h);
enum Status restore(Instance *, const Instance *state);
enum Failure trouble(const Instance *, double t); /* what goes wrong with a step from t on */
enum Status odd(Instance *, enum Call);           /* what a call returns, however well it goes */
void farewell(Instance *);
