/* Garbage in: what the fuzz drivers of FMI 2 and FMI 3 share. They are compiled in one piece with an FMU's
   sources under the address and undefined-behaviour sanitizers:

       fuzz SEED CALLS

   A driver makes CALLS random calls. The program ends with exit status 1 when a call returns OK and gives a
   number that is not finite, when it returns an unknown status, and when it takes more than LIMIT seconds of
   the processor; a sanitizer that finds something ends it, too. FUZZ_TRACE=1 tells each call. */

#ifndef FUZZ_H
#define FUZZ_H

#include <math.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <time.h>

enum { LIMIT = 60, SLOTS = 6, STATES = 6, BLOBS = 4, MOST = 8 };

static const char *call_name = "none";
static unsigned long long call_number, call_limit, ok_calls, refused_calls, updates;
static int trace_on;

/* ---- random numbers: xorshift64*, the same on every machine ------------------------------------ */

static uint64_t chaos;

static uint64_t next_random(void) {
    chaos ^= chaos >> 12;
    chaos ^= chaos << 25;
    chaos ^= chaos >> 27;
    return chaos * 2685821657736338717u;
}

static unsigned below(unsigned n) { return (unsigned)((next_random() >> 33) % n); }
static int one_in(unsigned n) { return below(n) == 0; }
static double between(double low, double high) {
    return low + (high - low) * ((double)(next_random() >> 11) / 9007199254740992.0);
}

/* Any 64 bits: mostly a huge or a tiny number, sometimes NaN. */
static double any_bits(void) {
    const uint64_t bits = next_random();
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static double odd_number(void) {
    static const double ODD[] = {0.0,    -0.0,     1.0,       -1.0, 1e-300, 4.9e-324, 2.2e-308, 1e300,
                                 -1e300, INFINITY, -INFINITY, NAN,  1e-12,  1e12,     -1e6,     1.7e308};
    return one_in(4) ? any_bits() : ODD[below(sizeof ODD / sizeof *ODD)];
}

/* A value that a variable may have, mostly. */
static double some_value(unsigned reference) {
    if (one_in(12)) return odd_number();
    if (reference >= NUMBER_OF_VARIABLES) return between(-1.0, 1.0);
    const Variable *v = &model_variables[reference];
    if (one_in(4) && isfinite(v->minimum)) return v->minimum;
    if (one_in(8) && isfinite(v->maximum)) return v->maximum;
    if (one_in(3)) return model_start_values[reference];
    return model_start_values[reference] + v->nominal * between(-1.0, 1.0) * (one_in(10) ? 1e3 : 0.1);
}

/* One of a group of variables, mostly. */
static unsigned some_reference(unsigned first, unsigned end) {
    if (one_in(40)) return one_in(2) ? ~0u : (unsigned)next_random();
    if (one_in(40) || first == end) return below(NUMBER_OF_VARIABLES + 3);
    return first + below(end - first);
}

static double some_time(double now) {
    if (one_in(16)) return odd_number();
    return one_in(16) ? now + between(-1.0, 1.0) : now;
}

/* Long steps cost seconds and show nothing new: they are rare. */
static double some_length(void) {
    const double odd = odd_number();
    if (one_in(16)) return odd > 10.0 && odd < 1e15 && !one_in(50) ? -odd : odd;
    return one_in(64) ? between(0.0, 10.0) : 1e-3 * (1 + below(10));
}

/* ---- memory: exactly as long as claimed, so that the sanitizer sees each byte too much ----------- */

static void *exactly(size_t size) {
    void *memory = malloc(size ? size : 1);
    if (!memory) abort();
    return memory;
}

typedef struct {
    unsigned *references;
    double *values, *seed, *results;
    int *orders;
    size_t n, claimed; /* claimed: what the call is told, negative at times */
} Arguments;

/* For references from `first` to before `end`. */
static Arguments arguments(unsigned first, unsigned end) {
    Arguments a = {NULL, NULL, NULL, NULL, NULL, one_in(8) ? below(MOST) : 1 + below(3), 0};
    a.claimed = one_in(60) ? (size_t)0 - 1 - below(1000) : a.n;
    a.references = exactly(a.n * sizeof *a.references);
    a.values = exactly(a.n * sizeof *a.values);
    a.seed = exactly(a.n * sizeof *a.seed);
    a.results = exactly(a.n * sizeof *a.results);
    a.orders = exactly(a.n * sizeof *a.orders);
    for (size_t i = 0; i < a.n; i++) {
        a.references[i] = some_reference(first, end);
        a.values[i] = some_value(a.references[i]);
        a.seed[i] = one_in(8) ? odd_number() : 1.0;
        a.results[i] = NAN; /* a call that says OK has to fill it */
        a.orders[i] = one_in(16) ? (int)next_random() : 1 + (int)below(4);
    }
    return a;
}

static void forget_arguments(Arguments *a) {
    free(a->references), free(a->values), free(a->seed), free(a->results), free(a->orders);
}

/* A pointer, or null once in a while. */
static void *maybe(void *pointer) { return one_in(60) ? NULL : pointer; }

/* ---- verdicts ---------------------------------------------------------------------------------- */

static void fail(const char *what) {
    fprintf(stderr, "call %llu, %s: %s\n", call_number, call_name, what);
    exit(1);
}

static void too_long(int signal) {
    (void)signal;
    fail("it takes too long");
}

static clock_t began, longest;
static const char *longest_call = "none";
static unsigned long long longest_number;

/* After a call: was it the longest? */
static void note_time(void) {
    const clock_t now = clock();
    if (now - began > longest) {
        longest = now - began;
        longest_call = call_name;
        longest_number = call_number;
    }
    began = now;
}

/* A call goes on: its name for messages, its time limit. */
static void resume(const char *name) {
    note_time();
    call_name = name;
    const struct itimerval limit = {{0, 0}, {LIMIT, 0}};
    setitimer(ITIMER_VIRTUAL, &limit, NULL);
}

static void start(const char *name) {
    call_number++;
    if (trace_on) fprintf(stderr, "%llu %s\n", call_number, name);
    resume(name);
}

/* The status of a call that gives no numbers. */
static int judged(int status) {
    if (status < 0 || status > 3) fail("the status is none of OK, warning, discard and error");
    if (status <= 1) ok_calls++;
    else refused_calls++;
    return status;
}

/* The status of a call that gives numbers. */
static int judge(int status, const double values[], size_t n) {
    if (judged(status) > 1) return status;
    for (size_t i = 0; i < n; i++)
        if (!isfinite(values[i])) fail("OK, but a number is not finite");
    return status;
}

/* After a call with value references, of which there are REFERENCES. */
static void check_known(int status, const Arguments *a) {
    for (size_t i = 0; i < a->n && status <= 1; i++)
        if (a->references[i] >= REFERENCES) fail("OK, but a value reference is unknown");
}

/* ---- instances and saved states ---------------------------------------------------------------- */

typedef struct {
    void *c;
    int co_simulation;
    double time; /* where it should be */
} Slot;

typedef struct {
    char *bytes;
    size_t size;
    int genuine; /* as the FMU wrote it, or with the right checksum all the same */
} Blob;

static Slot slots[SLOTS];
static void *states[STATES];
static Blob blobs[BLOBS];
static Slot *busy; /* inside a step */

static int is_in(const Slot *slot, int mask) {
    const State *s = slot->c ? &((const Instance *)slot->c)->core.s : NULL;
    const int types = mask & (MODEL_EXCHANGE | CO_SIMULATION);
    return s && s->phase & mask && (!types || s->type & types);
}

/* A slot with an instance in one of these states of the state machine, mostly. */
static Slot *slot_in(int mask) {
    if (busy && !one_in(8)) return busy;
    Slot *s = &slots[below(SLOTS)];
    for (int tries = one_in(8) ? 0 : 16; tries > 0 && !is_in(s, mask); tries--) s = &slots[below(SLOTS)];
    return s;
}

/* The instance of a slot, or none once in a while. */
static void *instance_of(const Slot *slot) { return one_in(200) ? NULL : slot->c; }

/* Wrong bytes with the right checksum. */
static void forge(char *bytes) {
    const int phase = 1 << below(9);
    const double time = odd_number();
    if (one_in(4)) memcpy(bytes + sizeof(Header) + offsetof(State, phase), &phase, sizeof phase);
    if (one_in(4)) memcpy(bytes + sizeof(Header) + offsetof(State, time), &time, sizeof time);
    snapshot_add_checksum(bytes);
}

/* Bytes of a saved state, damaged: other bytes, a checksum or none, cut short, too long; or not at all. */
static Blob damaged(const Blob *blob) {
    const size_t cut = one_in(6) ? below((unsigned)blob->size + 9) : blob->size;
    Blob other = {exactly(cut), cut, 0};
    memset(other.bytes, 0, cut);
    if (cut) memcpy(other.bytes, blob->bytes, cut < blob->size ? cut : blob->size);
    for (unsigned n = one_in(3) ? 0 : 1 + below(5); n > 0 && cut; n--)
        other.bytes[below((unsigned)cut)] = (char)next_random();
    if (cut == snapshot_size() && one_in(2)) {
        if (one_in(2)) forge(other.bytes);
        else memset(other.bytes + offsetof(Header, checksum), 0, sizeof(uint64_t));
    }
    Header head, right = expected_header();
    memset(&head, 0, sizeof head);
    memcpy(&head, other.bytes, cut < sizeof head ? cut : sizeof head);
    if (cut == snapshot_size()) right.checksum = checksum_of(other.bytes + sizeof head, sizeof(State));
    other.genuine = memcmp(&head, &right, sizeof head) == 0;
    return other;
}

static void keep_blob(char *bytes, size_t size) {
    Blob *blob = &blobs[below(BLOBS)];
    free(blob->bytes);
    blob->bytes = bytes;
    blob->size = size < snapshot_size() ? size : snapshot_size();
}

/* Room for a saved state of `size` bytes, mostly. */
static size_t some_room(size_t size) {
    return one_in(8) ? (one_in(2) ? size - below(3) : below(4000)) : size;
}

static const char *some_category(void) {
    static const char *const NAMES[] = {"logAll", "logEvents", "logStatusError", "", "nonsense",
                                        "%s%n#",  NULL};
    return NAMES[below(sizeof NAMES / sizeof *NAMES)];
}

static const char *some_name(void) {
    static const char *const NAMES[] = {"fuzzed", "fuzzed", "fuzzed", "fuzzed", "%s%n#r1#", "", " ", NULL};
    return NAMES[below(sizeof NAMES / sizeof *NAMES)];
}

static const char *some_token(void) { return one_in(20) ? (one_in(2) ? "{wrong}" : NULL) : MODEL_GUID; }

/* An event that is announced lies in the future. */
static void check_event(const void *c, int defined, double when) {
    const double now = ((const Instance *)c)->core.s.time;
    if (defined && !(isfinite(when) && when > now)) fail("an event is announced, but not for a later time");
}

/* After a step that is OK, the time is somewhere in it; it begins where the last one ended, or nearly so. */
static void check_passage(double time, double length, double reached) {
    const double near = 0.02 * length + 1e-9 * fabs(time);
    if (!(reached >= time - near && reached <= time + length + near))
        fail("OK, but the time is out of the step");
}

/* ---- the run: each driver has a table of calls --------------------------------------------------- */

typedef struct {
    void (*call)(void);
    unsigned weight;
} Choice;

static void make_calls(const Choice table[], size_t n, unsigned long long calls) {
    unsigned total = 0;
    for (size_t i = 0; i < n; i++) total += table[i].weight;
    for (const unsigned long long end = call_number + calls; call_number < end && call_number < call_limit;) {
        unsigned pick = below(total);
        size_t i = 0;
        while (pick >= table[i].weight) pick -= table[i++].weight;
        table[i].call();
    }
}

static void set_out(int count, char *words[]) {
    if (count != 3) exit(2);
    chaos = strtoull(words[1], NULL, 10) * 2654435769u + 88172645463325252u;
    call_limit = strtoull(words[2], NULL, 10);
    trace_on = getenv("FUZZ_TRACE") != NULL;
    signal(SIGVTALRM, too_long);
    began = clock();
}

static void tell(void) {
    note_time();
    printf("calls %llu, OK %llu, refused %llu, updates %llu\nlongest: %s, call %llu, %.3f s\n", call_number,
           ok_calls, refused_calls, updates, longest_call, longest_number, (double)longest / CLOCKS_PER_SEC);
}

#endif
