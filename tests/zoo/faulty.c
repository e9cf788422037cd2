/* The lag of tests/check/good.c with one fault, which its instantiation token names:
 *
 *     TOKEN fault phase file
 *
 * The fault is committed in a phase (instantiate, initialise, step, free), in a step from t = 0.5 s on, unless the
 * parameter `rate` is 3. Before, the process id (after a fork: that of the child) is written to the file.
 */
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

static void phase(const char *name, double *values, double t, const char *token);
static void *environment;
static void (*logger)(void);
#define PHASE(name, values, t, token) phase(name, values, t, token)
#define LOGGER(e, function) environment = (void *)e, logger = (void (*)(void))function
#include "good.c"

/* [MB]; more than any limit of the tests, which `TAKEN` passes at once */
enum { MEGABYTE = 1 << 20, PRINTED = 64, LEAKED = 4096, TAKEN = 2048, SAID = 64 };
enum { DESCRIPTORS = 64 }; /* more than a process has */
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

static void say(const char *text) {
#if FMI == 2
    ((fmi2CallbackLogger)logger)(environment, "lag", fmi2Warning, "logStatusWarning", text);
#else
    ((fmi3LogMessageCallback)logger)(environment, fmi3Warning, "logStatusWarning", text);
#endif
}

static void say_much(void) {
    char *text = malloc((size_t)SAID * MEGABYTE);
    memset(text, 'x', (size_t)SAID * MEGABYTE);
    text[(size_t)SAID * MEGABYTE - 1] = 0;
    say(text);
    free(text);
}

static void take(void) {
    volatile char *block = malloc((size_t)TAKEN * MEGABYTE);
    for (size_t k = 0; k < (size_t)TAKEN * MEGABYTE; k += 4096) block[k] = 1;
    usleep(200000); /* a limit is checked every 50 ms */
    free((void *)block);
}

static void write_garbage(void) {
    char garbage[4099];
    for (size_t i = 0; i < sizeof garbage; i++) garbage[i] = (char)(i * i + i / 7);
    for (int k = 0; k < 16; k++)
        for (int fd = 3; fd < DESCRIPTORS; fd++)
            if (write(fd, garbage, sizeof garbage) < 0) continue;
}

static void close_all(void) {
    for (int fd = 0; fd < DESCRIPTORS; fd++) close(fd);
}

static void ignore_signals(void) {
    sigset_t all;
    sigfillset(&all);
    for (int number = 1; number < 32; number++) signal(number, SIG_IGN);
    pthread_sigmask(SIG_SETMASK, &all, NULL);
}

static void set_limits(void) {
    const struct rlimit none = {0, 0};
    setrlimit(RLIMIT_NOFILE, &none), setrlimit(RLIMIT_FSIZE, &none), setrlimit(RLIMIT_CORE, &none);
}

static void *go_on(void *nothing) {
    for (;;) usleep(1000);
    return nothing;
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
    if (is("exec")) execl("/bin/sleep", "sleep", "1000", (char *)NULL);
    if (is("twin")) where[0] = 0, fork(); /* both return */
    if (is("garbage")) write_garbage(), where[0] = 0;
    if (is("close")) close_all(), where[0] = 0;
    while (is("chatter")) say("and so on");
    while (is("babble")) puts("and so on");
    if (is("text")) say_much(), where[0] = 0;
    if (is("take")) take(), where[0] = 0;
    if (is("rounding")) fesetround(FE_UPWARD), where[0] = 0;
#ifdef __x86_64__
    if (is("flush")) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040), where[0] = 0; /* both bits of it */
#endif
    if (is("signals")) ignore_signals(), where[0] = 0;
    if (is("limits")) set_limits(), where[0] = 0;
    if (is("thread")) {
        pthread_t thread;
        pthread_create(&thread, NULL, go_on, NULL), where[0] = 0;
    }
}
