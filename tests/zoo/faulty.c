/* The lag of tests/check/good.c with one fault, which its instantiation token names:
 *
 *     TOKEN fault phase file
 *
 * The fault is committed in a phase (instantiate, initialise, step, free), in a step from t = 0.5 s on, unless the
 * parameter `rate` is 3. Before, the process id (after a fork: that of the child) is written to the file.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <fenv.h>
#include <math.h>
#include <pthread.h>
#include <stdint.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <time.h>
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

#ifdef __linux__
enum { LEVELS = 1500 }; /* of folders; Python calls 1000 functions inside each other */

static int is_pipe(int fd, int mode) {
    char link[32], target[8] = {0};
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    return readlink(link, target, 5) == 5 && !strcmp(target, "pipe:") && (fcntl(fd, F_GETFL) & O_ACCMODE) == mode;
}

static void forget_files(void) {
    for (int fd = 0; fd < DESCRIPTORS; fd++) fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    dup2(open("/dev/zero", O_RDONLY), 0);
}

/* What the parent sends to this process gets company. */
static void write_to_inputs(void) {
    char link[32];
    for (int fd = 0; fd < DESCRIPTORS; fd++) {
        if (!is_pipe(fd, O_RDONLY)) continue;
        snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
        if (write(open(link, O_WRONLY | O_NONBLOCK), "AAAAAAAAAAAAAAAA", 16) < 0) continue;
    }
    usleep(500000); /* until it has read that */
}

/* The connection goes nowhere, and nobody sees its end. */
static void divert_outputs(void) {
    for (int fd = 3; fd < DESCRIPTORS; fd++)
        if (is_pipe(fd, O_WRONLY)) dup2(fd, fd + 200), dup2(open("/dev/null", O_WRONLY), fd);
}

static void set_timers(void) {
    struct sigevent event = {.sigev_notify = SIGEV_SIGNAL, .sigev_signo = SIGKILL};
    const struct itimerspec when = {{0, 0}, {1, 0}};
    timer_t timer;
    alarm(1);
    timer_create(CLOCK_MONOTONIC, &event, &timer), timer_settime(timer, 0, &when, NULL);
}

static void nest(void) {
    if (chdir(getenv("TMPDIR"))) return;
    for (int i = 0; i < LEVELS; i++)
        if (mkdir("d", 0755) || chdir("d")) return;
}

/* A process of which no parent and no environment tells whose it is; then this one crashes. */
static void leave_orphan(void) {
    char *const none[] = {NULL}, *const sleeps[] = {"sleep", "1000", NULL};
    if (!fork()) {
        setsid();
        if (fork()) _exit(0);
        note(getpid());
        execve("/bin/sleep", sleeps, none);
        _exit(1);
    }
    usleep(200000);
    raise(SIGSEGV);
}

static uint32_t checksum(uint32_t sum, const void *data, size_t size) {
    for (const unsigned char *c = data; size--; c++) {
        sum ^= *c;
        for (int k = 0; k < 8; k++) sum = sum & 1 ? sum >> 1 ^ 0xEDB88320u : sum >> 1;
    }
    return sum;
}

/* A frame of orchestrator/worker/wire.py with the number that comes next, which is in a shared page. */
static void forge(void) {
    static const char text[] = "[\"failed\", \"all is well\\n\\u001b[2Jharvester: done\"]";
    FILE *maps = fopen("/proc/self/maps", "r");
    unsigned long first, number = 0;
    for (char line[512]; maps && fgets(line, sizeof line, maps);)
        if (strstr(line, "/dev/zero") && sscanf(line, "%lx", &first)) number = *(uint32_t *)first;
    if (maps) fclose(maps);
    const uint32_t parts[] = {(uint32_t)number, sizeof text - 1, 0, 0}, next = (uint32_t)number;
    const uint32_t sum = ~checksum(checksum(~0u, parts, sizeof parts), text, sizeof text - 1);
    char frame[256] = "hvw1";
    memcpy(frame + 4, parts, sizeof parts), memcpy(frame + 20, &sum, 4), memcpy(frame + 24, text, sizeof text - 1);
    memcpy(frame + 23 + sizeof text, "1wvh", 4), memcpy(frame + 27 + sizeof text, &next, 4);
    for (int fd = 3; fd < DESCRIPTORS; fd++)
        if (is_pipe(fd, O_WRONLY) && write(fd, frame, 31 + sizeof text) < 0) continue;
}
#endif

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
    if (is("trap")) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() & ~0x1F80u), where[0] = 0; /* each operation */
#endif
    if (is("signals")) ignore_signals(), where[0] = 0;
    if (is("limits")) set_limits(), where[0] = 0;
#ifdef __linux__
    if (is("files")) forget_files(), where[0] = 0;
    if (is("inputs")) write_to_inputs(), where[0] = 0;
    if (is("divert")) divert_outputs(), where[0] = 0;
    if (is("timers")) set_timers(), where[0] = 0;
    if (is("nest")) nest(), where[0] = 0;
    if (is("orphan")) leave_orphan();
    if (is("forge")) forge(), where[0] = 0;
#endif
    if (is("thread")) {
        pthread_t thread;
        pthread_create(&thread, NULL, go_on, NULL), where[0] = 0;
    }
}
