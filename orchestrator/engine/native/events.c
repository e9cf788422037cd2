/* Events of FMUs inside a communication step. All components step to the first event together, and go through it in one
 * instant (events.py).
 *
 * An FMU that stops early gives the time of its event, for the inputs that it had in this step. They are others in a
 * shorter step, so the step is repeated until it ends where the event is:
 *
 *     event_reached      an FMU has stopped: near enough to the end of the step, or not
 *     event_approached   the next try ends a little after the time at which it stopped
 *     event_missed       a try that has become too short: the next one is longer
 *
 * An FMU that only asks for event mode at the end of its step, and one that holds its inputs over it, give no time. Most
 * of these events are at the end of the step, those of sampled controllers. So the next try is shorter by NEAR of the step;
 * if it meets none, the event is at the end. From the third of equally spaced ones on, the step is divided there at once.
 * Else a very short try follows: an FMU that asks after it, too, from an instant on, is restless: it asks after each step,
 * and its events are at the end of steps. If it does not, the step is bisected between one without the event and one with it.
 */

#include <math.h>
#include <string.h>

#include "engine.h"

enum { NEARLY_ALL = 1, SHORT = 2, MOST_TRIES = 120 }; /* numbers of tries; most: twice those of a bisection to the tolerance */
static const double NEAR = 1e-5;                  /* of a step: an event that is only asked for, and as near to its end, is there */
static const double LATER = 0.01, SHIFT = 0.1;    /* how much later: of the rest of the step; of the last shift of the event */
static const double FURTHER = 16.0;               /* growth of the length by which a try is longer than one that was too short */

/* At the beginning of each try. */
void event_try(Simulation *sim) {
    sim->events.due = sim->events.at_end = sim->events.by_asking = 0;
    for (int32_t k = 0; sim->events.used && k < sim->component_count; k++) sim->components[k].asked = 0;
}

/* An FMU has stopped at a time [s], or asks for event mode at the end of its step; the verdict on its step. */
int event_reached(Simulation *sim, Component *p, double reached, int early) {
    Events *e = &sim->events;
    const int known = early && p->locates, at_beginning = !known && sim->end - e->instant <= e->tolerance;
    p->asked = 1;
    if (e->located && at_beginning && p->restless <= 0) p->restless = e->restless = 1;
    if (sim->component_count == 1 && known && reached > sim->t) sim->end = reached; /* no other is ahead of it */
    const double behind = sim->end - reached, since = known ? reached : sim->t + e->low;
    const int at_announced = fabs(sim->end - p->announced) <= e->tolerance;
    const int nearly = sim->end == e->until && sim->end - sim->t <= e->near;
    const int located = !e->located || at_announced || nearly || sim->end - since <= e->tolerance;
    sim->reached = known || !e->located ? reached : NAN;
    if (behind > e->tolerance || e->restless) return AT_EVENT;
    if (p->restless > 0 && !known) return e->at_end = 1, CONTINUE;
    if (!located) return AT_EVENT;
    e->due = AT_END, e->by_asking |= !known && !at_announced;
    return CONTINUE;
}

/* The part of a step of length h before its last NEAR, and where both end [s]. */
static double nearly_all(Simulation *sim, double h, double end) {
    const double rest = larger(0.5 * sim->events.tolerance, NEAR * h);
    sim->events.near = 1.01 * rest, sim->events.until = end; /* rounding */
    return h - rest;
}

/* Where a step ends that would end at a time [s]: if an event is expected there, a little before, and then there. */
double event_expected(Simulation *sim, double t, double to) {
    const Events *e = &sim->events;
    const int expected = e->located && fabs(e->latest + e->period - to) <= e->tolerance;
    if (!expected || to == e->until || to - t <= 2.0 * e->tolerance) return to;
    return t + nearly_all(sim, to - t, to);
}

/* Chooses the next try after a step of length h with an event inside; an event at its beginning needs no step. */
int event_approached(Simulation *sim, double h, int *goes_back) {
    Events *e = &sim->events;
    const double time = sim->reached - sim->t, shift = SHIFT * fabs(time - e->before);
    *goes_back = sim->rollback, e->near = 0.0;
    if (e->restless) { /* the whole step again */
        e->restless = 0, e->low = e->high = sim->shorter = 0.0;
        return CONTINUE;
    }
    if (time <= 0.0) {
        e->due = AT_BEGINNING, sim->shorter = 0.0;
        return CONTINUE;
    }
    if (!sim->rollback || ++e->tries > MOST_TRIES) return python_call(sim, INSTANT, -1, sim->t, h);
    double later = LATER * (h - time);
    if (e->high > 0.0 && shift < later) later = shift;
    const double next = time + larger(later, 0.5 * e->tolerance);
    e->high = h, e->before = time, e->margin = time == time ? e->tolerance : h;
    if (h - e->low <= e->tolerance && e->low > 0.0) sim->shorter = e->low; /* an FMU that is behind */
    else if (time == time) sim->shorter = e->low < next && next < h ? next : 0.5 * (e->low + h);
    else if (e->tries == NEARLY_ALL && h > 2.0 * e->tolerance) sim->shorter = nearly_all(sim, h, sim->end);
    else sim->shorter = e->tries == SHORT ? 0.5 * e->tolerance : 0.5 * (e->low + h);
    return CONTINUE;
}

/* After a step of length h without an event: is there one in a longer try, which comes next? */
int event_missed(Simulation *sim, double h) {
    Events *e = &sim->events;
    if (e->due || !(h < e->high) || e->high - h <= larger(e->tolerance, e->near)) {
        for (int32_t k = 0; k < sim->component_count; k++)
            if (sim->components[k].restless > 0 && !sim->components[k].asked) sim->components[k].restless = -1;
        return 0;
    }
    e->low = h, e->margin *= FURTHER;
    sim->shorter = smaller(h + e->margin, 0.5 * (h + e->high));
    return 1;
}

/* Is a value another one? NaN stays NaN. */
static int differs(double now, double before) { return now != before && (now == now || before == before); }

/* Have signals that are not continuous changed since the last instant? */
static int values_changed(const Simulation *sim) {
    const Events *e = &sim->events;
    int changed = 0;
    for (int32_t i = 0; i < e->real_count; i++) changed |= differs(sim->reals[e->real_targets[i]], e->reals[i]);
    for (int32_t i = 0; i < e->integer_count; i++) changed |= sim->integers[e->integer_targets[i]] != e->integers[i];
    return changed;
}

/* Is there an instant at the end of the step? By an FMU, a time event, or a signal that is not continuous. */
int event_due(const Simulation *sim) {
    const Events *e = &sim->events;
    return e->due || e->at_end || (e->used && sim->t >= e->next - e->tolerance) || values_changed(sim);
}

/* For Python: exchanges all values in an instant. */
int32_t event_exchange(Simulation *sim, double t) {
    const int verdict = simulation_exchange(sim, t);
    event_values(sim);
    environment_restore(sim, NULL, ANY_COMPONENT);
    return verdict;
}

/* Stores the values of signals that are not continuous, and lists those that have changed. */
void event_values(Simulation *sim) {
    Events *e = &sim->events;
    e->changed = 0;
    for (int32_t i = 0; i < e->real_count; i++) {
        const double now = sim->reals[e->real_targets[i]];
        if (differs(now, e->reals[i])) e->changes[e->changed++] = i;
        e->reals[i] = now;
    }
    for (int32_t i = 0; i < e->integer_count; i++) {
        const int64_t now = sim->integers[e->integer_targets[i]];
        if (now != e->integers[i]) e->changes[e->changed++] = e->real_count + i;
        e->integers[i] = now;
    }
}

/* Takes all FMUs with event mode through the events of this time. */
int event_instant(Simulation *sim) {
    Events *e = &sim->events;
    const int verdict = e->used ? python_call(sim, INSTANT, 0, sim->t, 0.0) : CONTINUE;
    event_values(sim);
    if (e->by_asking) e->period = sim->t - e->latest, e->latest = sim->t;
    e->due = e->tries = e->by_asking = 0, e->low = e->high = e->near = 0.0, e->instant = sim->t;
    return verdict;
}
