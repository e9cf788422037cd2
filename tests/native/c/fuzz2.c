/* Garbage in for FMI 2.0; see fuzz.h. */

#include "scarce.h"

#include SOURCES /* the FMU, in one piece */

#undef malloc
#undef calloc

#define REFERENCES NUMBER_OF_VARIABLES

#include "fuzz.h"

static unsigned long long lines; /* of the log */

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment;
    if (!name || !category || !message || status > fmi2Fatal) fail("a message is incomplete");
    lines += strlen(message) > 0;
}

static void try_make(void) {
    static const fmi2CallbackFunctions ALL_OF_THEM = {logger, NULL, NULL, NULL, NULL}, NONE_OF_THEM = {0};
    Slot *s = &slots[below(SLOTS)];
    if (s->c && !one_in(8)) return;
    start("fmi2FreeInstance");
    fmi2FreeInstance(s->c);
    s->co_simulation = !one_in(3);
    s->time = 0.0;
    const fmi2Type type = one_in(40) ? (fmi2Type)7 : s->co_simulation ? fmi2CoSimulation : fmi2ModelExchange;
    start("fmi2Instantiate");
    s->c = fmi2Instantiate(some_name(), type, some_token(), one_in(2) ? "file:///tmp" : NULL,
                           one_in(40)   ? NULL
                           : one_in(20) ? &NONE_OF_THEM
                                        : &ALL_OF_THEM,
                           (int)below(2), one_in(10));
}

/* Where a step or the initialisation is OK, so are all states and outputs. */
static void check_outputs(void *c) {
    unsigned references[NX + NY + 1];
    double values[NX + NY + 1];
    size_t n = 0;
    for (unsigned r = FIRST_STATE; r < FIRST_DERIVATIVE; r++) references[n++] = r;
    for (unsigned r = FIRST_OUTPUT; r < NUMBER_OF_VARIABLES; r++) references[n++] = r;
    for (size_t i = 0; i < n; i++) values[i] = NAN;
    if (judge((int)fmi2GetReal(c, references, n, values), values, n))
        fail("OK, but a state or output is not");
}

/* ---- the state machine --------------------------------------------------------------------------- */

static void try_set_up(void) {
    Slot *s = slot_in(INSTANTIATED);
    const double at = one_in(4) ? odd_number() : 0.0, stop = one_in(2) ? odd_number() : 1e3;
    start("fmi2SetupExperiment");
    if (judged((int)fmi2SetupExperiment(instance_of(s), (int)below(2), one_in(4) ? odd_number() : 1e-5, at,
                                        one_in(4), stop)) == 0)
        s->time = at;
}

#define ENTER(name, function, mask)                                                                          \
    static void name(void) {                                                                                 \
        start(#function);                                                                                    \
        judged((int)function(instance_of(slot_in(mask))));                                                   \
    }
ENTER(try_enter_initialization, fmi2EnterInitializationMode, INSTANTIATED)
ENTER(try_terminate, fmi2Terminate, SIMULATING)
ENTER(try_enter_event_mode, fmi2EnterEventMode, MODEL_EXCHANGE | CONTINUOUS_TIME)
ENTER(try_enter_continuous_time, fmi2EnterContinuousTimeMode, EVENT_MODE)
ENTER(try_cancel_step, fmi2CancelStep, CO_SIMULATION | ANY)

static void try_exit_initialization(void) {
    const Slot *s = slot_in(INITIALIZATION);
    start("fmi2ExitInitializationMode");
    if (judged((int)fmi2ExitInitializationMode(instance_of(s))) == 0) check_outputs(s->c);
}

static void try_reset(void) {
    Slot *s = slot_in(ANY);
    start("fmi2Reset");
    if (judged((int)fmi2Reset(instance_of(s))) == 0) s->time = 0.0;
}

static void try_new_discrete_states(void) {
    fmi2EventInfo info;
    const Slot *s = slot_in(EVENT_MODE);
    start("fmi2NewDiscreteStates");
    if (judged((int)fmi2NewDiscreteStates(instance_of(s), maybe(&info))) == 0)
        check_event(s->c, info.nextEventTimeDefined, info.nextEventTime);
}

static void try_completed_step(void) {
    fmi2Boolean event, end;
    start("fmi2CompletedIntegratorStep");
    judged((int)fmi2CompletedIntegratorStep(instance_of(slot_in(CONTINUOUS_TIME)), (int)below(2),
                                            maybe(&event), maybe(&end)));
}

static void try_set_log(void) {
    fmi2String names[3] = {some_category(), some_category(), some_category()};
    start("fmi2SetDebugLogging");
    judged((int)fmi2SetDebugLogging(instance_of(slot_in(ANY)), one_in(20), one_in(40) ? (size_t)-1 : below(4),
                                    one_in(40) ? NULL : names));
}

/* ---- values -------------------------------------------------------------------------------------- */

static void try_get_real(void) {
    Arguments a = arguments(0, NUMBER_OF_VARIABLES);
    start("fmi2GetReal");
    const int status =
        judge((int)fmi2GetReal(instance_of(slot_in(ANY)), maybe(a.references), a.claimed, maybe(a.results)),
              a.results, a.n);
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_set_real(void) {
    Arguments a = arguments(0, FIRST_DERIVATIVE);
    start("fmi2SetReal");
    const int status = judged((int)fmi2SetReal(instance_of(slot_in(INITIALIZATION | SIMULATING)),
                                               maybe(a.references), a.claimed, maybe(a.values)));
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_directional(void) {
    Arguments known = arguments(0, FIRST_DERIVATIVE), unknown = arguments(FIRST_STATE, NUMBER_OF_VARIABLES);
    start("fmi2GetDirectionalDerivative");
    const int status = judge(
        (int)fmi2GetDirectionalDerivative(instance_of(slot_in(INITIALIZATION | SIMULATING)),
                                          maybe(unknown.references), unknown.claimed, maybe(known.references),
                                          known.claimed, maybe(known.seed), maybe(unknown.results)),
        unknown.results, unknown.n);
    check_known(status, &known);
    check_known(status, &unknown);
    forget_arguments(&known);
    forget_arguments(&unknown);
}

static void try_input_derivatives(void) {
    Arguments a = arguments(FIRST_INPUT, FIRST_STATE);
    start("fmi2SetRealInputDerivatives");
    const int status = judged(
        (int)fmi2SetRealInputDerivatives(instance_of(slot_in(CO_SIMULATION | STEP_MODE)), maybe(a.references),
                                         a.claimed, maybe(a.orders), maybe(a.values)));
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_output_derivatives(void) {
    Arguments a = arguments(FIRST_OUTPUT, NUMBER_OF_VARIABLES);
    start("fmi2GetRealOutputDerivatives");
    const int status = judge(
        (int)fmi2GetRealOutputDerivatives(instance_of(slot_in(CO_SIMULATION | STEP_MODE)),
                                          maybe(a.references), a.claimed, maybe(a.orders), maybe(a.results)),
        a.results, a.n);
    check_known(status, &a);
    forget_arguments(&a);
}

static void try_other_types(void) {
    Arguments a = arguments(0, NUMBER_OF_VARIABLES);
    fmi2String texts[MOST];
    void *c = instance_of(slot_in(ANY));
    start("fmi2 functions of other types");
    judged((int)fmi2GetInteger(c, a.references, a.claimed, a.orders));
    judged((int)fmi2SetInteger(c, a.references, a.claimed, a.orders));
    judged((int)fmi2GetBoolean(c, a.references, a.claimed, a.orders));
    judged((int)fmi2SetBoolean(c, a.references, a.claimed, a.orders));
    judged((int)fmi2GetString(c, a.references, a.claimed, texts));
    judged((int)fmi2SetString(c, a.references, a.claimed, texts));
    forget_arguments(&a);
}

/* ---- saved states -------------------------------------------------------------------------------- */

static void try_get_state(void) {
    start("fmi2GetFMUstate");
    judged((int)fmi2GetFMUstate(instance_of(slot_in(ANY)), maybe(&states[below(STATES)])));
}

/* Of whatever instance. */
static void try_set_state(void) {
    Slot *s = slot_in(ANY);
    start("fmi2SetFMUstate");
    if (judged((int)fmi2SetFMUstate(instance_of(s), states[below(STATES)])) == 0 && s->co_simulation)
        fmi2GetRealStatus(s->c, fmi2LastSuccessfulTime, &s->time);
}

static void try_free_state(void) {
    start("fmi2FreeFMUstate");
    judged((int)fmi2FreeFMUstate(instance_of(slot_in(ANY)), maybe(&states[below(STATES)])));
}

static void try_pack(void) {
    void *state = states[below(STATES)], *c = instance_of(slot_in(ANY));
    size_t size = 0;
    start("fmi2SerializeFMUstate");
    if (judged((int)fmi2SerializedFMUstateSize(c, state, maybe(&size)))) size = 64;
    size = some_room(size);
    char *bytes = exactly(size);
    if (judged((int)fmi2SerializeFMUstate(c, state, maybe(bytes), size)) == 0) keep_blob(bytes, size);
    else free(bytes);
}

static void try_unpack(void) {
    const Blob *blob = &blobs[below(BLOBS)];
    if (!blob->bytes) return;
    Blob other = damaged(blob);
    Slot *s = slot_in(ANY);
    void *state = NULL;
    start("fmi2DeSerializeFMUstate");
    const int status = judged((int)fmi2DeSerializeFMUstate(
        instance_of(s), maybe(other.bytes), one_in(60) ? (size_t)-1 : other.size, maybe(&state)));
    if (status == 0 && !other.genuine) fail("damaged bytes are accepted");
    if (status == 0) judged((int)fmi2SetFMUstate(s->c, state));
    fmi2FreeFMUstate(s->c, &state);
    free(other.bytes);
}

/* ---- model exchange ------------------------------------------------------------------------------ */

static size_t some_size(void) { return one_in(20) ? (one_in(2) ? (size_t)-1 : below(MOST)) : (size_t)NX; }

static void try_set_time(void) {
    Slot *s = slot_in(MODEL_EXCHANGE | CONTINUOUS_TIME);
    start("fmi2SetTime");
    judged((int)fmi2SetTime(instance_of(s), one_in(8) ? odd_number() : s->time + 0.01));
}

static void try_set_states(void) {
    double *x = exactly(NX * sizeof *x);
    for (unsigned i = 0; i < NX; i++) x[i] = some_value(FIRST_STATE + i);
    start("fmi2SetContinuousStates");
    judged((int)fmi2SetContinuousStates(instance_of(slot_in(CONTINUOUS_TIME)), maybe(x), some_size()));
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
VECTOR(try_get_states, fmi2GetContinuousStates, MODEL_EXCHANGE | SIMULATING)
VECTOR(try_get_derivatives, fmi2GetDerivatives, MODEL_EXCHANGE | SIMULATING)
VECTOR(try_get_nominals, fmi2GetNominalsOfContinuousStates, MODEL_EXCHANGE | ANY)

static void try_get_indicators(void) {
    double value = 0.0;
    start("fmi2GetEventIndicators");
    judged((int)fmi2GetEventIndicators(instance_of(slot_in(MODEL_EXCHANGE | SIMULATING)), maybe(&value),
                                       one_in(2) ? 0 : below(3)));
}

/* ---- co-simulation ------------------------------------------------------------------------------- */

static void try_step(void) {
    Slot *s = slot_in(CO_SIMULATION | STEP_MODE);
    const double time = some_time(s->time), length = some_length();
    start("fmi2DoStep");
    if (judged((int)fmi2DoStep(instance_of(s), time, length, (int)below(2))) > 1) return;
    judge((int)fmi2GetRealStatus(s->c, fmi2LastSuccessfulTime, &s->time), &s->time, 1);
    check_outputs(s->c);
    check_passage(time, length, s->time);
}

static void try_get_status(void) {
    void *c = instance_of(slot_in(CO_SIMULATION | STEP_MODE | STEP_FAILED));
    const fmi2StatusKind kind = (fmi2StatusKind)below(6);
    fmi2Status status = fmi2OK;
    fmi2Real time = NAN;
    fmi2Integer number = 0;
    fmi2Boolean flag = 0;
    fmi2String text = NULL;
    start("fmi2GetStatus");
    judged((int)fmi2GetStatus(c, kind, maybe(&status)));
    judge((int)fmi2GetRealStatus(c, kind, maybe(&time)), &time, 1);
    judged((int)fmi2GetIntegerStatus(c, kind, maybe(&number)));
    judged((int)fmi2GetBooleanStatus(c, kind, maybe(&flag)));
    judged((int)fmi2GetStringStatus(c, kind, maybe(&text)));
}

static const Choice TABLE[] = {
    {try_make, 10},
    {try_set_up, 8},
    {try_enter_initialization, 12},
    {try_exit_initialization, 12},
    {try_terminate, 1},
    {try_reset, 3},
    {try_enter_event_mode, 4},
    {try_enter_continuous_time, 8},
    {try_new_discrete_states, 4},
    {try_completed_step, 4},
    {try_set_log, 2},
    {try_get_real, 20},
    {try_set_real, 20},
    {try_directional, 15},
    {try_input_derivatives, 5},
    {try_output_derivatives, 8},
    {try_other_types, 1},
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
    {try_get_indicators, 1},
    {try_cancel_step, 1},
    {try_step, 25},
    {try_get_status, 2},
};

int main(int count, char *words[]) {
    set_out(count, words);
    if (strcmp(fmi2GetVersion(), "2.0") || !fmi2GetTypesPlatform()) fail("the version is not 2.0");
    make_calls(TABLE, sizeof TABLE / sizeof *TABLE, call_limit);
    void *last = NULL; /* there is memory at the second try */
    while (!last) last = fmi2Instantiate("last", fmi2CoSimulation, MODEL_GUID, NULL, NULL, 0, 0);
    for (int i = 0; i < STATES; i++) fmi2FreeFMUstate(last, &states[i]);
    fmi2FreeInstance(last);
    for (int i = 0; i < SLOTS; i++) fmi2FreeInstance(slots[i].c);
    for (int i = 0; i < BLOBS; i++) free(blobs[i].bytes);
    tell();
    return lines == 0;
}
