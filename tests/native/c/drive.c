/* Runs an FMU by a script:

       drive LIBRARY TOKEN SCRIPT OUT [THREADS]

   Each thread runs the whole script with instances of its own and writes to OUT.0, OUT.1 and so on. A call
   that does not return OK ends the program with exit status 1 and the line of the script. Instances have
   numbers I:

       make I cs|me               begin I TIME TOLERANCE     end I
       set I REFERENCE VALUE      get I FIRST COUNT          slopes I FIRST COUNT
       step I LENGTH COUNT        euler I LENGTH COUNT STATES
       along I UNKNOWN KNOWN
       save I                     restore I                  forget I
       write I FILE               read I FILE                at I TIME
       reset I                    free I

   `write` puts the saved state into a file and `read` takes it from there; `at` tells the driver the time. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu.h"

enum { INSTANCES = 128, THREADS = 16, VALUES = 1024, NOT_A_COMMAND = 100 };

typedef struct {
    void *c, *state;
    int co_simulation;
    double time;
} Slot;

typedef struct {
    const char *token, *script;
    FILE *out;
    char path[1024];
    int failed; /* line of the script, 0 if none */
    Slot slots[INSTANCES];
} Run;

typedef int Get(void *c, const unsigned references[], size_t n, double values[]);

static int print(Run *run, Slot *s, Get *get, const char *rest) {
    unsigned first, count, references[VALUES];
    double values[VALUES];
    if (sscanf(rest, "%u %u", &first, &count) != 2 || count > VALUES) return NOT_A_COMMAND;
    for (unsigned i = 0; i < count; i++) references[i] = first + i;
    const int status = get(s->c, references, count, values);
    for (unsigned i = 0; i < count && !status; i++) fprintf(run->out, i ? " %.17g" : "%.17g", values[i]);
    fprintf(run->out, "\n");
    return status;
}

static int derive(Run *run, Slot *s, const char *rest) {
    unsigned unknown, known;
    double value;
    if (sscanf(rest, "%u %u", &unknown, &known) != 2) return NOT_A_COMMAND;
    const int status = fmu_along(s->c, unknown, known, &value);
    if (!status) fprintf(run->out, "%.17g\n", value);
    return status;
}

static int advance(Slot *s, const char *rest) {
    double length;
    int count, status = 0;
    size_t states = 0;
    const int found = sscanf(rest, "%lf %d %zu", &length, &count, &states);
    if (found < 2) return NOT_A_COMMAND;
    const double start = s->time;
    for (int i = 0; i < count && !status; i++) {
        const double time = start + i * length;
        status = found == 3 ? fmu_euler(s->c, time, length, states) : fmu_step(s->c, time, length);
        s->time = start + (i + 1) * length;
    }
    return status;
}

static int write_state(Slot *s, const char *path) {
    size_t size = 0;
    void *state = NULL;
    int status = fmu_save(s->c, &state);
    if (!status) status = fmu_size(s->c, state, &size);
    char *bytes = malloc(size);
    if (!status) status = fmu_pack(s->c, state, bytes, size);
    FILE *file = fopen(path, "wb");
    if (!file || fwrite(bytes, 1, size, file) != size) status = NOT_A_COMMAND;
    if (file) fclose(file);
    free(bytes);
    fmu_forget(s->c, &state);
    return status;
}

static int read_state(Slot *s, const char *path) {
    char bytes[1 << 16];
    void *state = NULL;
    FILE *file = fopen(path, "rb");
    if (!file) return NOT_A_COMMAND;
    const size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    int status = fmu_unpack(s->c, bytes, size, &state);
    if (!status) status = fmu_restore(s->c, state);
    fmu_forget(s->c, &state);
    return status;
}

static int make(Run *run, Slot *s, const char *rest) {
    s->co_simulation = strcmp(rest, "cs") == 0;
    s->c = fmu_make("driven", run->token, s->co_simulation);
    s->state = NULL;
    return s->c ? 0 : NOT_A_COMMAND;
}

static int begin(Slot *s, const char *rest) {
    double tolerance;
    if (sscanf(rest, "%lf %lf", &s->time, &tolerance) != 2) return NOT_A_COMMAND;
    return fmu_begin(s->c, s->time, tolerance);
}

static int set(Slot *s, const char *rest) {
    unsigned reference;
    double value;
    return sscanf(rest, "%u %lf", &reference, &value) == 2 ? fmu_set(s->c, reference, value) : NOT_A_COMMAND;
}

static int end(Slot *s) {
    fmu_free(s->c);
    s->c = NULL;
    return 0;
}

/* One command to one instance; `rest` is what follows its number. */
static int command(Run *run, const char *word, Slot *s, const char *rest) {
#define IS(name) (strcmp(word, name) == 0)
    if (IS("set")) return set(s, rest);
    if (IS("get")) return print(run, s, fmu_get, rest);
    if (IS("slopes")) return print(run, s, fmu_slopes, rest);
    if (IS("step") || IS("euler")) return advance(s, rest);
    if (IS("along")) return derive(run, s, rest);
    if (IS("save")) return fmu_save(s->c, &s->state);
    if (IS("restore")) return fmu_restore(s->c, s->state);
    if (IS("forget")) return fmu_forget(s->c, &s->state);
    if (IS("write")) return write_state(s, rest);
    if (IS("read")) return read_state(s, rest);
    if (IS("at")) return sscanf(rest, "%lf", &s->time) == 1 ? 0 : NOT_A_COMMAND;
    if (IS("make")) return make(run, s, rest);
    if (IS("begin")) return begin(s, rest);
    if (IS("end")) return fmu_end(s->c, s->co_simulation);
    if (IS("reset")) return fmu_reset(s->c);
    if (IS("free")) return end(s);
    return NOT_A_COMMAND;
}

static void *interpret(void *argument) {
    Run *run = argument;
    const char *next = run->script;
    for (int number = 1; *next; number++) {
        char line[1024], word[16];
        unsigned instance;
        int used = 0;
        const size_t length = strcspn(next, "\n");
        if (length >= sizeof line) abort();
        memcpy(line, next, length);
        line[length] = '\0';
        next += length + (next[length] == '\n');
        if (sscanf(line, "%15s %u %n", word, &instance, &used) != 2 || instance >= INSTANCES) abort();
        const int status = command(run, word, &run->slots[instance], line + used);
        if (status) {
            fprintf(stderr, "line %d: %s: status %d\n", number, line, status);
            run->failed = number;
            break;
        }
    }
    fclose(run->out);
    return NULL;
}

static char *text_of(const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) abort();
    const long size = ftell(file);
    char *text = calloc((size_t)size + 1, 1);
    rewind(file);
    if (!text || fread(text, 1, (size_t)size, file) != (size_t)size) abort();
    fclose(file);
    return text;
}

#ifdef _WIN32
static void run_all(Run *runs, int n) {
    for (int i = 0; i < n; i++) interpret(&runs[i]);
}
#else
#include <pthread.h>

static void run_all(Run *runs, int n) {
    pthread_t threads[THREADS];
    for (int i = 1; i < n; i++)
        if (pthread_create(&threads[i], NULL, interpret, &runs[i])) abort();
    interpret(&runs[0]);
    for (int i = 1; i < n; i++) pthread_join(threads[i], NULL);
}
#endif

int main(int count, char *arguments[]) {
    static Run runs[THREADS];
    const int n = count == 6 ? atoi(arguments[5]) : 1;
    if (count < 5 || n < 1 || n > THREADS) return 2;
    char *script = text_of(arguments[3]);
    fmu_load(arguments[1]);
    for (int i = 0; i < n; i++) {
        runs[i].token = arguments[2];
        runs[i].script = script;
        snprintf(runs[i].path, sizeof runs[i].path, "%s.%d", arguments[4], i);
        runs[i].out = fopen(runs[i].path, "wb");
        if (!runs[i].out) return 2;
    }
    run_all(runs, n);
    fmu_unload();
    free(script);
    for (int i = 0; i < n; i++)
        if (runs[i].failed) return 1;
    return 0;
}
