/* A pool of threads for jacobi_pass, whose components can step at the same time. */

#include <stdatomic.h>
#include <stdlib.h>

#include "engine.h"

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
typedef HANDLE Thread;
typedef CRITICAL_SECTION Mutex;
typedef CONDITION_VARIABLE Condition;
#define ROUTINE DWORD WINAPI
#define RETURN return 0
static void relax(void) { SwitchToThread(); }
static void prepare(Mutex *m, Condition *s) { InitializeCriticalSection(m), InitializeConditionVariable(s); }
static void lock(Mutex *m) { EnterCriticalSection(m); }
static void unlock(Mutex *m) { LeaveCriticalSection(m); }
static void wait_for(Condition *s, Mutex *m) { SleepConditionVariableCS(s, m, INFINITE); }
static void wake(Condition *s) { WakeAllConditionVariable(s); }
#else
#include <pthread.h>
#include <sched.h>
typedef pthread_t Thread;
typedef pthread_mutex_t Mutex;
typedef pthread_cond_t Condition;
#define ROUTINE void *
#define RETURN return NULL
static void relax(void) { sched_yield(); }
static void prepare(Mutex *m, Condition *s) { pthread_mutex_init(m, NULL), pthread_cond_init(s, NULL); }
static void lock(Mutex *m) { pthread_mutex_lock(m); }
static void unlock(Mutex *m) { pthread_mutex_unlock(m); }
static void wait_for(Condition *s, Mutex *m) { pthread_cond_wait(s, m); }
static void wake(Condition *s) { pthread_cond_broadcast(s); }
#endif

enum { MAX_THREADS = 64, SPINS = 2000 }; /* SPINS: how often a thread reads `round` before it sleeps */

struct Pool {
    Simulation *sim;
    Mutex mutex;
    Condition round_begun;
    Thread threads[MAX_THREADS];
    int count;
    double h;
    atomic_int round, next, unfinished, verdict, ending;
};

/* Step components that no other thread has begun to step. */
static void step_components(Pool *pool) {
    Simulation *sim = pool->sim;
    for (;;) {
        const int i = atomic_fetch_add(&pool->next, 1);
        if (i >= sim->component_count) return;
        double counter = ticks();
        const int verdict = component_advance(sim, sim->order[i], pool->h, &counter);
        int none = CONTINUE;
        if (verdict) atomic_compare_exchange_strong(&pool->verdict, &none, verdict);
        atomic_fetch_sub(&pool->unfinished, 1);
    }
}

static ROUTINE thread_loop(void *argument) {
    Pool *pool = argument;
    int last_round = 0;
    for (;;) {
        for (int spin = 0; spin < SPINS && atomic_load(&pool->round) == last_round; spin++)
            if (spin % 16 == 15) relax();
        if (atomic_load(&pool->round) == last_round) {
            lock(&pool->mutex);
            while (atomic_load(&pool->round) == last_round) wait_for(&pool->round_begun, &pool->mutex);
            unlock(&pool->mutex);
        }
        last_round = atomic_load(&pool->round);
        if (atomic_load(&pool->ending)) RETURN;
        step_components(pool);
    }
}

static void begin_round(Pool *pool) {
    lock(&pool->mutex);
    atomic_fetch_add(&pool->round, 1);
    wake(&pool->round_begun);
    unlock(&pool->mutex);
}

Pool *pool_start(Simulation *sim, int threads) {
    Pool *pool = calloc(1, sizeof *pool);
    if (!pool) return NULL;
    pool->sim = sim;
    atomic_store(&pool->next, sim->component_count); /* no component is left to step before the first round */
    prepare(&pool->mutex, &pool->round_begun);
    for (int i = 0; i < threads - 1 && i < MAX_THREADS; i++) {
#ifdef _WIN32
        pool->threads[i] = CreateThread(NULL, 0, thread_loop, pool, 0, NULL);
        if (!pool->threads[i]) break;
#else
        if (pthread_create(&pool->threads[i], NULL, thread_loop, pool)) break;
#endif
        pool->count++;
    }
    return pool;
}

int pool_step(Pool *pool, double h) {
    pool->h = h;
    atomic_store(&pool->verdict, CONTINUE);
    atomic_store(&pool->unfinished, pool->sim->component_count);
    atomic_store(&pool->next, 0);
    begin_round(pool);
    step_components(pool);
    while (atomic_load(&pool->unfinished) > 0) relax();
    return atomic_load(&pool->verdict);
}

void pool_stop(Pool *pool) {
    if (!pool) return;
    atomic_store(&pool->ending, 1);
    begin_round(pool);
    for (int i = 0; i < pool->count; i++) {
#ifdef _WIN32
        WaitForSingleObject(pool->threads[i], INFINITE);
        CloseHandle(pool->threads[i]);
#else
        pthread_join(pool->threads[i], NULL);
#endif
    }
    free(pool);
}
