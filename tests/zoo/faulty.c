/* The lag of tests/check/good.c with one fault, which its instantiation token names:
 *
 *     TOKEN fault phase file
 *
 * The fault is committed in a phase (instantiate, initialise, step, free), in a step from t = 0.5 s on, unless the
 * parameter `rate` is 3. Before, the process id (after a fork: that of the child) is written to the file.
 */
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void phase(const char *name, double *values, double t, const char *token);
#define PHASE(name, values, t, token) phase(name, values, t, token)
#include "good.c"

enum { MEGABYTE = 1 << 20, PRINTED = 64, LEAKED = 4096 }; /* [MB]; more than any limit of the tests */
static const double BEGIN = 0.5 - 1e-9;                   /* [s]; steps do not add up exactly */
static char fault[16], where[16], file[512];
static volatile int zero = 0;

static void note(int pid) {
    FILE *out = fopen(file, "w");
    if (!out) return;
    fprintf(out, "%d\n", pid);
    fclose(out);
}

static int recurse(volatile char *caller) {
    volatile char frame[4096];
    frame[0] = (char)(caller[0] + 1);
    return recurse(frame) + frame[0];
}

static void sleep_for_ever(void) {
    for (;;) sleep(1000);
}

static void leak(void) {
    for (int i = 0; i < LEAKED / 16; i++) {
        volatile char *block = malloc(16 * MEGABYTE);
        for (int k = 0; block && k < 16 * MEGABYTE; k += 4096) block[k] = 1; /* a page is taken when it is written */
        usleep(5000); /* a limit that is checked every 10 ms is passed by 30 MB at most */
    }
    sleep_for_ever();
}

static void print(void) {
    char line[1024];
    memset(line, 'x', sizeof line);
    line[sizeof line - 1] = '\n';
    for (int i = 0; i < PRINTED * 1024; i++) fwrite(line, 1, sizeof line, stdout);
    fflush(stdout);
}

static void leave_child(int own_session) {
    int child = fork();
    if (child) {
        note(child);
        return;
    }
    if (own_session) setsid();
    sleep_for_ever();
}

static int is(const char *name) { return !strcmp(fault, name); }

static void phase(const char *name, double *values, double t, const char *token) {
    if (token) sscanf(token + strlen(TOKEN), " %15s %15s %511[^\n]", fault, where, file);
    if (strcmp(where, name) || values[RATE] == 3 || (!strcmp(name, "step") && t < BEGIN)) return;
    if (!strcmp(fault, "none")) return;
    note(getpid());
    if (is("exit_0")) exit(0);
    if (is("exit_7")) exit(7);
    if (is("quick_exit_7")) _exit(7);
    if (is("segfault")) *(volatile int *)(intptr_t)zero = 1;
    if (is("abort")) abort();
    if (is("divide")) zero = 1 / zero, raise(SIGFPE); /* ARM does not trap a division by zero */
    if (is("overflow")) zero = recurse((volatile char *)name);
    while (is("spin")) zero = 0;
    if (is("sleep")) sleep_for_ever();
    if (is("fork")) leave_child(0), where[0] = 0;
    if (is("daemon")) leave_child(1), where[0] = 0;
    if (is("leak")) leak();
    if (is("print")) print(), where[0] = 0;
    if (is("nan")) values[X] = NAN;
}
