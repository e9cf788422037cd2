/* Components that step at the same time, for masters where none waits for another. */

#include <stdatomic.h>
#include <stdlib.h>

#include "engine.h"

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
typedef HANDLE Thread;
typedef CRITICAL_SECTION Mutex;
typedef CONDITION_VARIABLE Signalled;
#define ROUTINE DWORD WINAPI
#define RETURN return 0
static void relax(void) { SwitchToThread(); }
static void prepare(Mutex *m, Signalled *s) { InitializeCriticalSection(m), InitializeConditionVariable(s); }
static void lock(Mutex *m) { EnterCriticalSection(m); }
static void unlock(Mutex *m) { LeaveCriticalSection(m); }
static void sleep_on(Signalled *s, Mutex *m) { SleepConditionVariableCS(s, m, INFINITE); }
static void wake(Signalled *s) { WakeAllConditionVariable(s); }
#else
#include <pthread.h>
#include <sched.h>
typedef pthread_t Thread;
typedef pthread_mutex_t Mutex;
typedef pthread_cond_t Signalled;
#define ROUTINE void *
#define RETURN return NULL
static void relax(void) { sched_yield(); }
static void prepare(Mutex *m, Signalled *s) { pthread_mutex_init(m, NULL), pthread_cond_init(s, NULL); }
static void lock(Mutex *m) { pthread_mutex_lock(m); }
static void unlock(Mutex *m) { pthread_mutex_unlock(m); }
static void sleep_on(Signalled *s, Mutex *m) { pthread_cond_wait(s, m); }
static void wake(Signalled *s) { pthread_cond_broadcast(s); }
#endif

enum { MOST = 64, PATIENT = 2000 }; /* threads; looks at a flag before a thread sleeps */

struct Pool {
    Simulation *sim;
    Mutex mutex;
    Signalled news;
    Thread threads[MOST];
    int count;
    double h;
    atomic_int round, next, left, verdict, ending;
};

/* Step components that nobody else has taken yet. */
static void work(Pool *pool) {
    Simulation *sim = pool->sim;
    for (;;) {
        const int i = atomic_fetch_add(&pool->next, 1);
        if (i >= sim->component_count) return;
        double clock = seconds();
        const int verdict = component_advance(sim, sim->order[i], pool->h, &clock);
        int none = CONTINUE;
        if (verdict) atomic_compare_exchange_strong(&pool->verdict, &none, verdict);
        atomic_fetch_sub(&pool->left, 1);
    }
}

static ROUTINE loop(void *given) {
    Pool *pool = given;
    int seen = 0;
    for (;;) {
        for (int look = 0; look < PATIENT && atomic_load(&pool->round) == seen; look++)
            if (look % 16 == 15) relax();
        if (atomic_load(&pool->round) == seen) {
            lock(&pool->mutex);
            while (atomic_load(&pool->round) == seen) sleep_on(&pool->news, &pool->mutex);
            unlock(&pool->mutex);
        }
        seen = atomic_load(&pool->round);
        if (atomic_load(&pool->ending)) RETURN;
        work(pool);
    }
}

static void announce(Pool *pool) {
    lock(&pool->mutex);
    atomic_fetch_add(&pool->round, 1);
    wake(&pool->news);
    unlock(&pool->mutex);
}

Pool *pool_start(Simulation *sim, int threads) {
    Pool *pool = calloc(1, sizeof *pool);
    if (!pool) return NULL;
    pool->sim = sim;
    atomic_store(&pool->next, sim->component_count); /* nothing to do yet */
    prepare(&pool->mutex, &pool->news);
    for (int i = 0; i < threads - 1 && i < MOST; i++) {
#ifdef _WIN32
        pool->threads[i] = CreateThread(NULL, 0, loop, pool, 0, NULL);
        if (!pool->threads[i]) break;
#else
        if (pthread_create(&pool->threads[i], NULL, loop, pool)) break;
#endif
        pool->count++;
    }
    return pool;
}

int pool_step(Pool *pool, double h) {
    pool->h = h;
    atomic_store(&pool->verdict, CONTINUE);
    atomic_store(&pool->left, pool->sim->component_count);
    atomic_store(&pool->next, 0);
    announce(pool);
    work(pool);
    while (atomic_load(&pool->left) > 0) relax();
    return atomic_load(&pool->verdict);
}

void pool_stop(Pool *pool) {
    if (!pool) return;
    atomic_store(&pool->ending, 1);
    announce(pool);
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
