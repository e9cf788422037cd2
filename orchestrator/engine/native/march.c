/* From communication point to communication point; see march.py. */

#include <math.h>
#include <string.h>

#include "run.h"

static int keep(Run *run) {
    memcpy(run->real_kept, run->real, (size_t)run->reals * sizeof *run->real);
    memcpy(run->whole_kept, run->whole, (size_t)run->wholes * sizeof *run->whole);
    for (int32_t k = 0; k < run->part_count; k++) {
        const int verdict = run->parts[k].kept ? keep_part(run, k) : CONTINUE;
        if (verdict) return verdict;
    }
    return CONTINUE;
}

/* Note what the FMUs worked with, before new inputs are set. */
static int stepped(Run *run, double h) {
    Monitor *m = &run->monitor;
    if (!m->count) return CONTINUE;
    const int verdict = carry_out(run, &m->readers);
    if (verdict) return verdict;
    double *first = m->first + (size_t)m->rows * (size_t)m->count;
    double *last = m->last + (size_t)m->rows * (size_t)m->count;
    m->step[m->rows] = h;
    for (int32_t i = 0; i < m->count; i++) {
        const int64_t place = m->places[i];
        first[i] = m->moved[i] ? run->used[place] : run->real[place];
        last[i] = m->moved[i] ? run->used[run->reals + place] : m->seen[m->spread[i]];
    }
    return CONTINUE;
}

/* Note what would have been true. */
static void settled(Run *run) {
    Monitor *m = &run->monitor;
    if (!m->count) return;
    double *truth = m->truth + (size_t)m->rows * (size_t)m->count;
    for (int32_t i = 0; i < m->count; i++) truth[i] = run->real[m->places[i]];
    m->rows++;
}

static void record(Run *run) {
    Recorder *r = &run->recorder;
    double *reals = r->reals + (size_t)r->filled * (size_t)r->count;
    int32_t *wholes = r->wholes + (size_t)r->filled * (size_t)r->whole_count;
    r->time[r->filled] = run->t;
    if (r->places)
        for (int32_t i = 0; i < r->count; i++) reals[i] = run->real[r->places[i]];
    else memcpy(reals, run->real, (size_t)r->count * sizeof *reals);
    for (int32_t i = 0; i < r->whole_count; i++) wholes[i] = run->whole[r->whole_places[i]];
    r->filled++;
}

static int settle(Run *run, double h) {
    int verdict = put(run, run->t + h);
    if (!verdict) verdict = carry_out(run, &run->exchange);
    for (int32_t k = 0; k < run->part_count && !verdict; k++) verdict = carry_out(run, &run->parts[k].tell);
    if (!verdict) arrive_all(run, h, EVERYBODY);
    return verdict;
}

/* Back to the beginning of the step, as if it had not been tried. */
static int go_back(Run *run) {
    run->judge(0, 0, WITHDRAWN);
    memcpy(run->real, run->real_kept, (size_t)run->reals * sizeof *run->real);
    memcpy(run->whole, run->whole_kept, (size_t)run->wholes * sizeof *run->whole);
    for (int32_t k = 0; k < run->part_count; k++) {
        const int verdict = run->parts[k].kept ? restore_part(run, k) : CONTINUE;
        if (verdict) return verdict;
    }
    const int verdict = put(run, run->t);
    return verdict ? verdict : carry_out(run, &run->exchange);
}

/* An FMU did only the first part of a step. */
static int discarded(Run *run, double h) {
    static const double least = 1e-9;
    const double reached = run->reached - run->t;
    const double shorter = least * h < smaller(reached, h - reached) ? reached : 0.5 * h;
    if (!run->goes_back || shorter <= least * run->step) return STOP;
    run->shorter = shorter;
    return go_back(run);
}

/* One step of length h; `stands` tells whether it was good. */
static int one_step(Run *run, double h, int *stands) {
    int passes = 0;
    *stands = 0;
    int verdict = run->keeps ? keep(run) : CONTINUE;
    if (verdict) return verdict;
    verdict = sweep(run, h, &passes);
    if (verdict == DISCARDED) return discarded(run, h);
    if (verdict) return verdict;
    run->all_passes += passes;
    verdict = stepped(run, h);
    if (!verdict) verdict = settle(run, h);
    if (verdict) return verdict;
    if (run->pace) {
        const double e = (run->by_energy ? power_error(run, h) : step_error(run, h)) / run->adaptive;
        if (!pace_good(run->pace, e, h)) return go_back(run);
        run->lost = !isfinite(e);
    }
    for (int32_t i = 0; i < run->signal_count; i++) accept(&run->signals[i], h, run->length);
    if (run->foresight) foresight_accept(run->foresight, h);
    run->older = run->length;
    run->length = h;
    settled(run);
    *stands = 1;
    return CONTINUE;
}

/* One communication step; it may have to be repeated, which is another one. */
static int next(Run *run) {
    const double point = run->start + (double)(run->done + 1) * run->step;
    while (run->event < run->event_count && run->events[run->event] <= run->t) run->event++;
    const double target = run->event < run->event_count ? smaller(point, run->events[run->event]) : point;
    const double room = target - run->t;
    double h = run->pace ? pace_length(run->pace, room) : room;
    int stands;
    if (run->shorter > 0.0) h = smaller(h, run->shorter);
    const int verdict = one_step(run, h, &stands);
    if (verdict) return verdict;
    if (!stands) {
        run->repeated++;
        return CONTINUE;
    }
    run->t = h == room ? target : run->t + h;
    run->shorter = 0.0;
    run->steps++;
    run->shortest = smaller(run->shortest, h);
    run->longest = larger(run->longest, h);
    if (run->t == point) run->done++;
    if (run->t == point || run->free || run->lost) record(run);
    return CONTINUE;
}

void finish(Run *run) {
    pool_stop(run->pool);
    run->pool = NULL;
}

int32_t march(Run *run) {
    if (run->threads > 1 && !run->pool) run->pool = pool_start(run, run->threads);
    const double until = seconds() + run->patience;
    run->lost = 0;
    while (run->done < run->total && run->recorder.filled < run->recorder.room &&
           run->monitor.rows < run->monitor.room) {
        const int verdict = next(run);
        if (verdict) return verdict;
        if (run->lost || seconds() > until) break;
    }
    return CONTINUE;
}
