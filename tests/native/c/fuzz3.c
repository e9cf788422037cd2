/* Garbage in for FMI 3.0; see fuzz.h. Inside steps, too: there the callback makes random calls. */

#include "scarce.h"

#include SOURCES /* the FMU, in one piece */

#undef malloc
#undef calloc

#define REFERENCES (NUMBER_OF_VARIABLES + 1) /* and the time */

#include "fuzz.h"

static unsigned long long lines; /* of the log */

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                   fmi3String message) {
    (void)environment;
    if (!category || !message || status > fmi3Fatal) fail("a message is incomplete");
    lines += strlen(message) > 0;
}

/* ---- inside a step --------------------------------------------------------------------------------- */

static void make_random_calls(unsigned n);
static int left; /* updates of a step in which to make calls: some steps have very many */

static void inside(fmi3InstanceEnvironment environment, fmi3Float64 time, fmi3Boolean set, fmi3Boolean get,
                   fmi3Boolean finished, fmi3Boolean may_stop, fmi3Boolean *stop, fmi3Float64 *when) {
    Slot *before = busy;
    const char *name = call_name;
    (void)set, (void)get, (void)finished;
    if (!isfinite(time)) fail("the time of an intermediate update is not finite");
    updates++;
    if (left > 0 && !before) {
        left--;
        busy = environment;
        make_random_calls(1 + below(3));
        busy = before;
        resume(name);
    }
    *stop = may_stop ? one_in(4) : one_in(40);
    *when = one_in(2) ? time : one_in(2) ? odd_number() : time + 1e-4;
}

static void try_make(void) {
    Slot *s = &slots[below(SLOTS)];
    const fmi3ValueReference wanted[] = {some_reference(0, FIRST_DERIVATIVE),
                                         some_reference(0, FIRST_DERIVATIVE)};
    if (s->c && (s == busy || !one_in(8))) return;
    start("fmi3FreeInstance");
    fmi3FreeInstance(s->c);
    s->co_simulation = !one_in(3);
    s->time = 0.0;
    const fmi3LogMessageCallback log = one_in(20) ? NULL : logger;
    start("fmi3Instantiate");
    if (one_in(40))
        s->c = fmi3InstantiateScheduledExecution(some_name(), some_token(), NULL, 0, 0, s, log, NULL, NULL,
                                                 NULL);
    else if (s->co_simulation)
        s->c = fmi3InstantiateCoSimulation(some_name(), some_token(), one_in(2) ? "/tmp/" : NULL, one_in(2),
                                           one_in(10), one_in(3), one_in(2), one_in(2) ? wanted : NULL,
                                           below(3), s, log, one_in(2) ? inside : NULL);
    else s->c = fmi3InstantiateModelExchange(some_name(), some_token(), NULL, one_in(2), one_in(10), s, log);
}

/* An instance that is freed inside its own step must not be pulled away from under it. */
static void try_free_inside(void) {
    if (!busy || !one_in(4)) return;
    start("fmi3FreeInstance inside a step");
    fmi3FreeInstance(busy->c);
}

/* Where a step or the initialisation is OK, so are all states and outputs. */
static void check_outputs(void *c) {
    unsigned references[NX + NY + 1];
    double values[NX + NY + 1];
    size_t n = 0;
    for (unsigned r = FIRST_STATE; r < FIRST_DERIVATIVE; r++) references[n++] = r;
    for (unsigned r = FIRST_OUTPUT; r < NUMBER_OF_VARIABLES; r++) references[n++] = r;
    for (size_t i = 0; i < n; i++) values[i] = NAN;
    if (judge((int)fmi3GetFloat64(c, references, n, values, n), values, n))
        fail("OK, but a state or output is not");
}

/* ---- the state machine --------------------------------------------------------------------------- */

static void try_enter_initialization(void) {
    Slot *s = slot_in(INSTANTIATED);
    const double at = one_in(8) ? odd_number() : 0.0, stop = one_in(4) ? odd_number() : 1e3;
    start("fmi3EnterInitializationMode");
    if (judged((int)fmi3EnterInitializationMode(instance_of(s), one_in(2), one_in(8) ? odd_number() : 1e-5,
                                                at, one_in(4), stop)) == 0)
        s->time = at;
}

#define ENTER(name, function, mask)                                                                          \
    static void name(void) {                                                                                 \
        start(#function);                                                                                    \
        judged((int)function(instance_of(slot_in(mask))));                                                   \
    }
ENTER(try_terminate, fmi3Terminate, SIMULATING)
ENTER(try_enter_event_mode, fmi3EnterEventMode, CONTINUOUS_TIME | STEP_MODE)
ENTER(try_enter_continuous_time, fmi3EnterContinuousTimeMode, MODEL_EXCHANGE | EVENT_MODE)
ENTER(try_enter_step_mode, fmi3EnterStepMode, CO_SIMULATION | EVENT_MODE)
ENTER(try_evaluate, fmi3EvaluateDiscreteStates, EVENT_MODE)
ENTER(try_enter_configuration, fmi3EnterConfigurationMode, ANY)
ENTER(try_exit_configuration, fmi3ExitConfigurationMode, ANY)

static void try_exit_initialization(void) {
    const Slot *s = slot_in(INITIALIZATION);
    start("fmi3ExitInitializationMode");
    if (judged((int)fmi3ExitInitializationMode(instance_of(s))) == 0) check_outputs(s->c);
}

static void try_reset(void) {
    Slot *s = slot_in(ANY);
    start("fmi3Reset");
    if (judged((int)fmi3Reset(instance_of(s))) == 0) s->time = 0.0;
}

static void try_update_discrete_states(void) {
    fmi3Boolean flags[5];
    double when = NAN;
    const Slot *s = slot_in(EVENT_MODE);
    start("fmi3UpdateDiscreteStates");
    if (judge((int)fmi3UpdateDiscreteStates(instance_of(s), maybe(flags), maybe(flags + 1), maybe(flags + 2),
                                            maybe(flags + 3), maybe(flags + 4), maybe(&when)),
              &when, 1) == 0)
        check_event(s->c, flags[4], when);
}

static void try_completed_step(void) {
    fmi3Boolean event, end;
    start("fmi3CompletedIntegratorStep");
    judged((int)fmi3CompletedIntegratorStep(instance_of(slot_in(CONTINUOUS_TIME)), one_in(2), maybe(&event),
                                            maybe(&end)));
}

static void try_set_log(void) {
    fmi3String names[3] = {some_category(), some_category(), some_category()};
    start("fmi3SetDebugLogging");
    judged((int)fmi3SetDebugLogging(instance_of(slot_in(ANY)), one_in(20), one_in(40) ? (size_t)-1 : below(4),
                                    one_in(40) ? NULL : names));
}

/* ---- values -------------------------------------------------------------------------------------- */

/* As many values as references, mostly. */
static size_t count_of(const Arguments *a) { return one_in(40) ? a->claimed + below(3) - 1 : a->claimed; }

static void try_get_float(void) {
    Arguments a = arguments(0, NUMBER_OF_VARIABLES);
    start("fmi3GetFloat64");
    const int status = judge((int)fmi3GetFloat64(instance_of(slot_in(ANY)), maybe(a.references), a.claimed,
                                                 maybe(a.results), count_of(&a)),
                             a.results, a.n);
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_set_float(void) {
    Arguments a = arguments(0, FIRST_DERIVATIVE);
    start("fmi3SetFloat64");
    const int status =
        judged((int)fmi3SetFloat64(instance_of(slot_in(INITIALIZATION | SIMULATING)), maybe(a.references),
                                   a.claimed, maybe(a.values), count_of(&a)));
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_directional(void) {
    Arguments known = arguments(0, FIRST_DERIVATIVE), unknown = arguments(FIRST_STATE, NUMBER_OF_VARIABLES);
    start("fmi3GetDirectionalDerivative");
    const int status = judge((int)fmi3GetDirectionalDerivative(
                                 instance_of(slot_in(INITIALIZATION | SIMULATING)), maybe(unknown.references),
                                 unknown.claimed, maybe(known.references), known.claimed, maybe(known.seed),
                                 count_of(&known), maybe(unknown.results), count_of(&unknown)),
                             unknown.results, unknown.n);
    check_known(status, &known);
    check_known(status, &unknown);
    forget_arguments(&known);
    forget_arguments(&unknown);
}

static void try_output_derivatives(void) {
    Arguments a = arguments(FIRST_OUTPUT, NUMBER_OF_VARIABLES);
    start("fmi3GetOutputDerivatives");
    const int status =
        judge((int)fmi3GetOutputDerivatives(instance_of(slot_in(CO_SIMULATION | EVENT_MODE | STEP_MODE)),
                                            maybe(a.references), a.claimed, maybe(a.orders), maybe(a.results),
                                            count_of(&a)),
              a.results, a.n);
    check_known(status, &a);
    forget_arguments(&a);
}

#define OTHER(type)                                                                                          \
    {                                                                                                        \
        fmi3##type values[MOST] = {0};                                                                       \
        judged((int)fmi3Get##type(c, a.references, a.claimed, values, a.claimed));                           \
        judged((int)fmi3Set##type(c, a.references, a.claimed, values, a.claimed));                           \
    }

static void try_other_types(void) {
    Arguments a = arguments(0, NUMBER_OF_VARIABLES);
    void *c = instance_of(slot_in(ANY));
    size_t sizes[MOST] = {0};
    fmi3Binary binaries[MOST] = {0};
    start("fmi3 functions of other types");
    OTHER(Float32)
    OTHER(Int8)
    OTHER(UInt8)
    OTHER(Int16)
    OTHER(UInt16)
    OTHER(Int32)
    OTHER(UInt32)
    OTHER(Int64)
    OTHER(UInt64)
    OTHER(Boolean)
    OTHER(String)
    judged((int)fmi3GetBinary(c, a.references, a.claimed, sizes, binaries, a.claimed));
    judged((int)fmi3SetBinary(c, a.references, a.claimed, sizes, binaries, a.claimed));
    forget_arguments(&a);
}

static void try_clocks(void) {
    Arguments a = arguments(0, NUMBER_OF_VARIABLES);
    void *c = instance_of(slot_in(ANY));
    fmi3Clock ticks[MOST] = {0};
    fmi3UInt64 counters[MOST] = {0}, resolutions[MOST] = {0};
    fmi3IntervalQualifier qualifiers[MOST];
    size_t n = 0;
    start("fmi3 functions of clocks");
    judged((int)fmi3GetClock(c, a.references, a.claimed, ticks));
    judged((int)fmi3SetClock(c, a.references, a.claimed, ticks));
    judged((int)fmi3GetIntervalDecimal(c, a.references, a.claimed, a.results, qualifiers));
    judged((int)fmi3GetIntervalFraction(c, a.references, a.claimed, counters, resolutions, qualifiers));
    judged((int)fmi3GetShiftDecimal(c, a.references, a.claimed, a.results));
    judged((int)fmi3GetShiftFraction(c, a.references, a.claimed, counters, resolutions));
    judged((int)fmi3SetIntervalDecimal(c, a.references, a.claimed, a.values));
    judged((int)fmi3SetIntervalFraction(c, a.references, a.claimed, counters, resolutions));
    judged((int)fmi3SetShiftDecimal(c, a.references, a.claimed, a.values));
    judged((int)fmi3SetShiftFraction(c, a.references, a.claimed, counters, resolutions));
    judged((int)fmi3ActivateModelPartition(c, some_reference(0, FIRST_DERIVATIVE), odd_number()));
    judged((int)fmi3GetNumberOfVariableDependencies(c, some_reference(0, FIRST_DERIVATIVE), &n));
    judged((int)fmi3GetVariableDependencies(c, some_reference(0, FIRST_DERIVATIVE), NULL, a.references, NULL,
                                            NULL, a.claimed));
    forget_arguments(&a);
}

/* ---- saved states -------------------------------------------------------------------------------- */

static void try_get_state(void) {
    start("fmi3GetFMUState");
    judged((int)fmi3GetFMUState(instance_of(slot_in(ANY)), maybe(&states[below(STATES)])));
}

/* The time of an instance as the standard's independent variable. */
static void read_time(Slot *s) {
    const fmi3ValueReference reference = NUMBER_OF_VARIABLES;
    if (s->c) judge((int)fmi3GetFloat64(s->c, &reference, 1, &s->time, 1), &s->time, 1);
}

/* Of whatever instance. */
static void try_set_state(void) {
    Slot *s = slot_in(ANY);
    start("fmi3SetFMUState");
    if (judged((int)fmi3SetFMUState(instance_of(s), states[below(STATES)])) == 0) read_time(s);
}

static void try_free_state(void) {
    start("fmi3FreeFMUState");
    judged((int)fmi3FreeFMUState(instance_of(slot_in(ANY)), maybe(&states[below(STATES)])));
}

static void try_pack(void) {
    void *state = states[below(STATES)], *c = instance_of(slot_in(ANY));
    size_t size = 0;
    start("fmi3SerializeFMUState");
    if (judged((int)fmi3SerializedFMUStateSize(c, state, maybe(&size)))) size = 64;
    size = some_room(size);
    char *bytes = exactly(size);
    if (judged((int)fmi3SerializeFMUState(c, state, maybe(bytes), size)) == 0) keep_blob(bytes, size);
    else free(bytes);
}

static void try_unpack(void) {
    const Blob *blob = &blobs[below(BLOBS)];
    if (!blob->bytes) return;
    Blob other = damaged(blob);
    Slot *s = slot_in(ANY);
    void *state = NULL;
    start("fmi3DeserializeFMUState");
    const int status = judged((int)fmi3DeserializeFMUState(
        instance_of(s), maybe(other.bytes), one_in(60) ? (size_t)-1 : other.size, maybe(&state)));
    if (status == 0 && !other.genuine) fail("damaged bytes are accepted");
    if (status == 0) judged((int)fmi3SetFMUState(s->c, state));
    fmi3FreeFMUState(s->c, &state);
    free(other.bytes);
}

/* ---- model exchange ------------------------------------------------------------------------------ */

static size_t some_size(void) { return one_in(20) ? (one_in(2) ? (size_t)-1 : below(MOST)) : (size_t)NX; }

static void try_set_time(void) {
    Slot *s = slot_in(MODEL_EXCHANGE | CONTINUOUS_TIME);
    start("fmi3SetTime");
    judged((int)fmi3SetTime(instance_of(s), one_in(8) ? odd_number() : s->time + 0.01));
}

static void try_set_states(void) {
    double *x = exactly(NX * sizeof *x);
    for (unsigned i = 0; i < NX; i++) x[i] = some_value(FIRST_STATE + i);
    start("fmi3SetContinuousStates");
    judged((int)fmi3SetContinuousStates(instance_of(slot_in(CONTINUOUS_TIME)), maybe(x), some_size()));
    free(x);
}

#define VECTOR(name, function, mask)                                                                         \
    static void name(void) {                                                                                 \
        double *values = exactly(NX * sizeof *values);                                                       \
        for (int i = 0; i < NX; i++) values[i] = NAN;                                                        \
        start(#function);                                                                                    \
        judge((int)function(instance_of(slot_in(mask)), maybe(values), some_size()), values, NX);            \
        free(values);                                                                                        \
    }
VECTOR(try_get_states, fmi3GetContinuousStates, MODEL_EXCHANGE | SIMULATING)
VECTOR(try_get_derivatives, fmi3GetContinuousStateDerivatives, MODEL_EXCHANGE | SIMULATING)
VECTOR(try_get_nominals, fmi3GetNominalsOfContinuousStates, MODEL_EXCHANGE | ANY)

static void try_get_numbers(void) {
    double value = 0.0;
    size_t n = 0;
    start("fmi3GetEventIndicators");
    judged((int)fmi3GetEventIndicators(instance_of(slot_in(MODEL_EXCHANGE | SIMULATING)), maybe(&value),
                                       one_in(2) ? 0 : below(3)));
    judged((int)fmi3GetNumberOfEventIndicators(instance_of(slot_in(MODEL_EXCHANGE | SIMULATING)), maybe(&n)));
    judged(
        (int)fmi3GetNumberOfContinuousStates(instance_of(slot_in(MODEL_EXCHANGE | SIMULATING)), maybe(&n)));
}

/* ---- co-simulation ------------------------------------------------------------------------------- */

static void try_step(void) {
    Slot *s = slot_in(CO_SIMULATION | STEP_MODE);
    const double time = some_time(s->time), length = some_length();
    fmi3Boolean event = 0, end = 0, early = 0;
    double reached = NAN;
    left = busy ? left : 8;
    start("fmi3DoStep");
    if (judge((int)fmi3DoStep(instance_of(s), time, length, one_in(2), maybe(&event), maybe(&end),
                              maybe(&early), maybe(&reached)),
              &reached, 1) > 1)
        return;
    s->time = reached;
    check_outputs(s->c);
    check_passage(time, length, reached);
}

static const Choice TABLE[] = {
    {try_make, 10},
    {try_free_inside, 4},
    {try_enter_initialization, 12},
    {try_exit_initialization, 12},
    {try_terminate, 1},
    {try_reset, 3},
    {try_enter_event_mode, 4},
    {try_enter_continuous_time, 8},
    {try_enter_step_mode, 6},
    {try_evaluate, 1},
    {try_enter_configuration, 1},
    {try_exit_configuration, 1},
    {try_update_discrete_states, 4},
    {try_completed_step, 4},
    {try_set_log, 2},
    {try_get_float, 20},
    {try_set_float, 20},
    {try_directional, 12},
    {try_output_derivatives, 8},
    {try_other_types, 1},
    {try_clocks, 1},
    {try_get_state, 6},
    {try_set_state, 6},
    {try_free_state, 2},
    {try_pack, 6},
    {try_unpack, 6},
    {try_set_time, 4},
    {try_set_states, 8},
    {try_get_states, 5},
    {try_get_derivatives, 8},
    {try_get_nominals, 1},
    {try_get_numbers, 1},
    {try_step, 25},
};

static void make_random_calls(unsigned n) { make_calls(TABLE, sizeof TABLE / sizeof *TABLE, n); }

int main(int count, char *words[]) {
    set_out(count, words);
    if (strncmp(fmi3GetVersion(), "3.0", 3)) fail("the version is not 3.0");
    make_calls(TABLE, sizeof TABLE / sizeof *TABLE, call_limit);
    void *last = NULL; /* there is memory at the second try */
    while (!last) last = fmi3InstantiateModelExchange("last", MODEL_GUID, NULL, 0, 0, NULL, NULL);
    for (int i = 0; i < STATES; i++) fmi3FreeFMUState(last, &states[i]);
    fmi3FreeInstance(last);
    for (int i = 0; i < SLOTS; i++) fmi3FreeInstance(slots[i].c);
    for (int i = 0; i < BLOBS; i++) free(blobs[i].bytes);
    tell();
    return lines == 0 || updates == 0;
}
