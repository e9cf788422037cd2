/* A first-order lag as an FMU 2.0 for Model Exchange, by hand, with parameters of every type.

       dx/dt = s n (u - k x)      y = x

   k real, n integer, s = -1 if `flip`, 2 if `mode` is "double", else 1. The integer `fault` chooses what goes wrong. */

#include <stdlib.h>
#include <string.h>

enum { K, U, X, DER_X, Y, REALS };
enum { N, FAULT, INTEGERS };
enum { NONE, NO_DERIVATIVE, NO_STATE, END, EARLY_EXIT };
enum { OK, DISCARD = 2, ERROR };

typedef struct {
    double r[REALS], time;
    int n[INTEGERS], flip;
    char mode[16];
} Model;

typedef struct {
    int needed, terminate, nominals, values, timed;
    double next;
} Event;

static double rate(const Model *m) {
    const double sign = m->flip ? -1.0 : strcmp(m->mode, "double") == 0 ? 2.0 : 1.0;
    return sign * m->n[N] * (m->r[U] - m->r[K] * m->r[X]);
}

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const void *callbacks, int v, int l) {
    (void)name, (void)type, (void)guid, (void)place, (void)callbacks, (void)v, (void)l;
    Model *m = calloc(1, sizeof *m);
    m->r[K] = m->r[X] = m->n[N] = 1;
    return m;
}
void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int a, double b, double start, int d, double e) {
    (void)a, (void)b, (void)d, (void)e;
    ((Model *)c)->time = start;
    return OK;
}
int fmi2EnterInitializationMode(void *c) { return c ? OK : ERROR; }
/* With this fault the input has to be set before. */
int fmi2ExitInitializationMode(void *c) {
    const Model *m = c;
    return m->n[FAULT] == EARLY_EXIT && m->r[U] == 0.0 ? ERROR : OK;
}
int fmi2EnterEventMode(void *c) { return c ? OK : ERROR; }
int fmi2EnterContinuousTimeMode(void *c) { return c ? OK : ERROR; }
int fmi2NewDiscreteStates(void *c, Event *e) {
    const Model *m = c;
    memset(e, 0, sizeof *e);
    e->terminate = m->n[FAULT] == END && m->time >= 0.5;
    e->timed = m->n[FAULT] == END && m->time < 0.5;
    e->next = 0.5;
    return OK;
}
int fmi2SetTime(void *c, double time) {
    ((Model *)c)->time = time;
    return OK;
}
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->r[r[i]] = v[i];
    return OK;
}
int fmi2SetInteger(void *c, const unsigned *r, size_t n, const int *v) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->n[r[i]] = v[i];
    return OK;
}
int fmi2SetBoolean(void *c, const unsigned *r, size_t n, const int *v) {
    (void)r;
    if (n) ((Model *)c)->flip = v[0];
    return OK;
}
int fmi2SetString(void *c, const unsigned *r, size_t n, const char *const *v) {
    (void)r;
    if (n) strncpy(((Model *)c)->mode, v[0], 15);
    return OK;
}
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) {
    const Model *m = c;
    for (size_t i = 0; i < n; i++) v[i] = r[i] == DER_X ? rate(m) : m->r[r[i] == Y ? X : r[i]];
    return OK;
}
int fmi2SetContinuousStates(void *c, const double *x, size_t n) {
    Model *m = c;
    if (m->n[FAULT] == NO_STATE && x[0] < 0.5) return DISCARD;
    memcpy(&m->r[X], x, n * sizeof *x);
    return OK;
}
int fmi2GetDerivatives(void *c, double *dx, size_t n) {
    const Model *m = c;
    if (m->n[FAULT] == NO_DERIVATIVE && m->time > 0.5) return DISCARD;
    if (n) dx[0] = rate(m);
    return OK;
}
