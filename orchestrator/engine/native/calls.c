/* Programs of calls: FMI functions, copies along connections, algebraic loops, and calls into Python. */

#include "engine.h"

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
double seconds(void) {
    LARGE_INTEGER now, rate;
    QueryPerformanceCounter(&now);
    QueryPerformanceFrequency(&rate);
    return (double)now.QuadPart / (double)rate.QuadPart;
}
#else
#include <time.h>
double seconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}
#endif

double ticks(void) {
#if defined(__x86_64__)
    return (double)__builtin_ia32_rdtsc();
#elif defined(__aarch64__)
    uint64_t count;
    __asm__ volatile("mrs %0, cntvct_el0" : "=r"(count));
    return (double)count;
#else
#error "the counter of this processor is not known"
#endif
}

typedef int Values2(void *, const uint32_t *, size_t, void *);
typedef int Values3(void *, const uint32_t *, size_t, void *, size_t);
typedef int Derivatives2(void *, const uint32_t *, size_t, const int32_t *, void *);
typedef int Derivatives3(void *, const uint32_t *, size_t, const int32_t *, void *, size_t);
typedef int Derivative2(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, double *);
typedef int Derivative3(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, size_t,
                        double *, size_t);
typedef int Step2(void *, double, double, int);
typedef int Step3(void *, double, double, _Bool, void *, void *, void *, void *);
typedef int SetTime(void *, double);
typedef int Vector(void *, double *, size_t);
typedef int Completed2(void *, int, int *, int *);
typedef int Completed3(void *, _Bool, _Bool *, _Bool *);
typedef int GetState(void *, void **);
typedef int SetState(void *, void *);

/* Converts values between the array of the run and the FMU, exactly; returns 0 if an integer does not fit. */
#define CONVERT(TYPE)                                                   \
    do {                                                                \
        TYPE *fmu = a->fmu_values;                                      \
        const int is_unsigned = (TYPE)-1 > (TYPE)0;                     \
        if (a->array == REAL) {                                         \
            double *values = a->values;                                 \
            for (int32_t i = 0; i < a->count; i++)                      \
                if (a->sets) fmu[i] = (TYPE)values[i];                  \
                else values[i] = (double)fmu[i];                        \
        } else {                                                        \
            int64_t *values = a->values;                                \
            for (int32_t i = 0; i < a->count; i++) {                    \
                if (a->sets) fmu[i] = (TYPE)values[i];                  \
                else values[i] = (int64_t)fmu[i];                       \
                if ((int64_t)fmu[i] != values[i]) return 0;             \
                if (is_unsigned && values[i] < 0) return 0;             \
            }                                                           \
        }                                                               \
    } while (0)

static int convert(const Access *a) {
    switch (a->type) {
    case F32: CONVERT(float); break;
    case I8: CONVERT(int8_t); break;
    case U8: CONVERT(uint8_t); break;
    case I16: CONVERT(int16_t); break;
    case U16: CONVERT(uint16_t); break;
    case I32: CONVERT(int32_t); break;
    case U32: CONVERT(uint32_t); break;
    case U64: CONVERT(uint64_t); break;
    case LOGICAL:
        for (int32_t i = 0; i < a->count; i++) {
            _Bool *fmu = a->fmu_values;
            int64_t *values = a->values;
            if (a->sets) fmu[i] = values[i] != 0;
            else values[i] = fmu[i];
        }
        break;
    default: break;
    }
    return 1;
}

static int call_fmi(const Access *a) {
    const size_t n = (size_t)a->reference_count, values = (size_t)a->count;
    if (a->orders && a->fmi == 2)
        return ((Derivatives2 *)a->function)(a->instance, a->references, n, a->orders, a->fmu_values);
    if (a->orders) return ((Derivatives3 *)a->function)(a->instance, a->references, n, a->orders, a->fmu_values, values);
    if (a->fmi == 2) return ((Values2 *)a->function)(a->instance, a->references, n, a->fmu_values);
    return ((Values3 *)a->function)(a->instance, a->references, n, a->fmu_values, values);
}

static int access_values(Simulation *sim, const Access *a) {
    const int same = a->fmu_values == a->values;
    if (!same && a->sets && !convert(a)) return sim->check_status(a, 0, OUT_OF_RANGE);
    *a->call = a->function_number;
    const int status = call_fmi(a);
    *a->call = 0;
    if (sim->careful) environment_restore(sim, a, ANY_COMPONENT);
    if (status) {
        const int verdict = sim->check_status(a, 0, status);
        if (verdict) return verdict;
    }
    if (!same && !a->sets && !convert(a)) return sim->check_status(a, 0, OUT_OF_RANGE);
    return CONTINUE;
}

static int call_completed_step(const ExchangeCall *e) {
    int status, event = 0, end = 0;
    _Bool event3 = 0, end3 = 0;
    if (e->fmi == 2) status = ((Completed2 *)e->function)(e->instance, 1, &event, &end);
    else status = ((Completed3 *)e->function)(e->instance, 1, &event3, &end3);
    e->values[0] = event || event3, e->values[1] = end || end3;
    return status;
}

static int exchange_call(Simulation *sim, const ExchangeCall *e) {
    int status;
    *e->call = e->function_number;
    if (e->kind == SET_TIME) {
        e->clock[0] = e->values[0];
        status = ((SetTime *)e->function)(e->instance, e->values[0]);
    } else if (e->kind == VECTOR) status = ((Vector *)e->function)(e->instance, e->values, (size_t)e->count);
    else status = call_completed_step(e);
    *e->call = 0;
    environment_restore(sim, e, ANY_COMPONENT);
    return status ? sim->check_status(e, 0, status) : CONTINUE;
}

/* Calls Python, which may call FMUs. */
int python_call(Simulation *sim, int32_t request, int32_t index, double t, double h) {
    const int verdict = sim->call_python(request, index, t, h);
    const int about_component = request == STEP || request == SAVE || request == RESTORE;
    if (sim->careful) environment_restore(sim, NULL, about_component ? index : ANY_COMPONENT);
    return verdict;
}

#define COPY_VALUES(TYPE, TO, FROM)                                                                            \
    do {                                                                                                    \
        TYPE *to = TO;                                                                                      \
        const TYPE *factor = copy->factor, *offset = copy->offset;                                          \
        const int64_t *source = copy->source, *target = copy->target, count = copy->count;                  \
        if (factor)                                                                                         \
            for (int64_t i = 0; i < count; i++) to[target[i]] = (TYPE)FROM[source[i]] * factor[i] + offset[i]; \
        else                                                                                                \
            for (int64_t i = 0; i < count; i++) to[target[i]] = (TYPE)FROM[source[i]];                      \
    } while (0)

static void copy_values(Simulation *sim, const ConnectionCopy *copy) {
    if (copy->array == REAL) COPY_VALUES(double, sim->reals, sim->reals);
    else if (copy->array == WIDENED) COPY_VALUES(double, sim->reals, sim->integers);
    else COPY_VALUES(int64_t, sim->integers, sim->integers);
    const ValueTable *table = copy->table;
    for (int32_t i = 0; table && i < table->count; i++)
        if (sim->integers[table->source[i]] == table->from[i]) sim->integers[table->target[i]] = table->to[i];
}

int execute(Simulation *sim, const Program *program) {
    for (int32_t i = 0; i < program->count; i++) {
        const Instruction *instruction = &program->instructions[i];
        int verdict = CONTINUE;
        if (instruction->type == COPY) copy_values(sim, instruction->operand);
        else if (instruction->type == ACCESS) verdict = access_values(sim, instruction->operand);
        else if (instruction->type == EXCHANGE) verdict = exchange_call(sim, instruction->operand);
        else if (instruction->type == LOOP) verdict = loop_solve(sim, instruction->operand);
        else verdict = python_call(sim, CALL, instruction->index, 0.0, 0.0);
        if (verdict) return verdict;
    }
    return CONTINUE;
}

/* For Python: the environment is restored after each call, so that the FMU that has changed it is named. */
int32_t program_run(Simulation *sim, const Program *program) {
    const int careful = sim->careful;
    sim->careful = 1;
    const int verdict = execute(sim, program);
    sim->careful = careful;
    environment_restore(sim, NULL, ANY_COMPONENT);
    return verdict;
}

int directional_derivative(Simulation *sim, const Derivative *d) {
    const size_t m = (size_t)d->unknown_references, n = (size_t)d->known_references;
    int status;
    if (!d->function) return python_call(sim, CALL, d->index, 0.0, 0.0);
    *d->call = d->function_number;
    if (d->fmi == 2)
        status = ((Derivative2 *)d->function)(d->instance, d->unknowns, m, d->knowns, n, d->seed, d->result);
    else status = ((Derivative3 *)d->function)(d->instance, d->unknowns, m, d->knowns, n, d->seed,
                                               (size_t)d->known_count, d->result, (size_t)d->unknown_count);
    *d->call = 0;
    if (sim->careful) environment_restore(sim, d, ANY_COMPONENT);
    return status ? sim->check_status(d, 0, status) : CONTINUE;
}

int linearise(Simulation *sim, const JacobianColumn *columns, int32_t count, double *matrices) {
    for (int32_t k = 0; k < count; k++) {
        const JacobianColumn *column = &columns[k];
        const int verdict = directional_derivative(sim, &column->derivative);
        if (verdict) return verdict;
        for (int32_t i = 0; i < column->entries; i++)
            matrices[column->to[i]] = column->derivative.result[column->from[i]] * column->factor[i];
    }
    return CONTINUE;
}

/* Lets an FMU step; returns its status. */
static int do_step(Simulation *sim, int k, double t, double length) {
    Component *p = &sim->components[k];
    int status;
    p->clock[0] = p->clock[1] = t;
    p->clock[2] = t + length;
    *p->call = STEP;
    if (p->fmi == 2) status = ((Step2 *)p->do_step)(p->instance, t, length, p->never_restored);
    else
        status = ((Step3 *)p->do_step)(p->instance, t, length, p->never_restored != 0, p->event, p->terminate,
                                       p->early, p->last);
    *p->call = 0;
    if (!rounds_to_nearest()) environment_restore(sim, NULL, k);
    return status;
}

int component_step(Simulation *sim, int k, Real begin, Real length) {
    Component *p = &sim->components[k];
    const double t = sim->t + begin;
    int verdict = CONTINUE;
    if (!p->do_step) {
        p->clock[0] = p->clock[1] = t;
        p->clock[2] = t + length;
        verdict = python_call(sim, STEP, k, t, length);
        return verdict == AT_EVENT ? event_reached(sim, p, sim->reached, 1) : verdict;
    }
    const int status = do_step(sim, k, t, length);
    if (p->events && status <= WARNING && p->flags && *p->flags) {
        const uint8_t *event = p->event, *terminate = p->terminate, *early = p->early;
        const double reached = *early ? *(const double *)p->last : t + length;
        const int inside = t - length < reached && reached < t + 2.0 * length; /* else Python tells what is wrong */
        if ((*event || *early) && !*terminate && inside) return event_reached(sim, p, reached, *early);
    }
    if (status || (p->flags && *p->flags)) verdict = sim->check_status(0, k, status);
    return verdict == AT_EVENT ? event_reached(sim, p, sim->reached, 1) : verdict;
}

/* A step from which the component goes back: DISCARDED if it is not complete, whatever the reason. */
int component_try(Simulation *sim, int k, double length) {
    Component *p = &sim->components[k];
    if (!p->do_step) {
        const int verdict = component_step(sim, k, 0.0, length);
        return verdict && verdict != ABORT ? DISCARDED : verdict;
    }
    const int status = do_step(sim, k, sim->t, length);
    const uint8_t *terminate = p->terminate, *early = p->early;
    if (status == FATAL) return sim->check_status(0, k, status);
    return status > WARNING || (p->flags && (*terminate || *early)) ? DISCARDED : CONTINUE;
}

int component_save(Simulation *sim, int k) {
    Component *p = &sim->components[k];
    if (!p->do_step) return python_call(sim, SAVE, k, 0.0, 0.0);
    *p->call = SAVE;
    const int status = ((GetState *)p->get_state)(p->instance, &p->state);
    *p->call = 0;
    return status ? sim->check_status(p->get_state, k, status) : CONTINUE;
}

int component_restore(Simulation *sim, int k, Mask machines) {
    (void)machines;
    Component *p = &sim->components[k];
    if (!p->do_step) return python_call(sim, RESTORE, k, 0.0, 0.0);
    *p->call = RESTORE;
    const int status = ((SetState *)p->set_state)(p->instance, p->state);
    *p->call = 0;
    return status ? sim->check_status(p->set_state, k, status) : CONTINUE;
}

/* ---- the values of a run ---------------------------------------------------------------------- */

void set_clocks(Simulation *sim, Real t) {
    for (int32_t k = 0; k < sim->component_count; k++) sim->components[k].clock[0] = t;
}

void machines_move(Simulation *sim, Mask machines) { sim->moving = machines; }

int machines_check(Simulation *sim) { return (void)sim, CONTINUE; } /* recorder.py does */

int values_save(Simulation *sim) {
    memcpy(sim->saved_reals, sim->reals, (size_t)sim->real_count * sizeof *sim->reals);
    memcpy(sim->saved_integers, sim->integers, (size_t)sim->integer_count * sizeof *sim->integers);
    return CONTINUE;
}

int values_restore(Simulation *sim) {
    memcpy(sim->reals, sim->saved_reals, (size_t)sim->real_count * sizeof *sim->reals);
    memcpy(sim->integers, sim->saved_integers, (size_t)sim->integer_count * sizeof *sim->integers);
    return sim->check_status(0, 0, WITHDRAWN);
}

/* Sets inputs again, which may not be part of the state of an FMU. */
int values_set(Simulation *sim) {
    set_clocks(sim, sim->t);
    return exchange_after_reads(sim, sim->t);
}

void record(Simulation *sim) {
    Recorder *r = &sim->recorder;
    r->latest = sim->t;
    double *reals = r->reals + (size_t)r->filled * (size_t)r->real_count;
    int64_t *integers = r->integers + (size_t)r->filled * (size_t)r->integer_count;
    r->time[r->filled] = sim->t;
    const double *from = sim->reals;
    const int64_t *indices = r->real_indices, count = r->real_count;
    if (indices)
        for (int64_t i = 0; i < count; i++) reals[i] = from[indices[i]];
    else memcpy(reals, from, (size_t)count * sizeof *reals);
    for (int32_t i = 0; i < r->integer_count; i++) integers[i] = sim->integers[r->integer_indices[i]];
    r->filled++;
}
