/* A unit with clocks of FMI 3.0 for Co-Simulation. Its description says how `tick` ticks.
 *
 *   tick    input clock: count := count + 1, y = s + u, s := s + u; in a countdown or with changing intervals the next
 *           one is `period` (1 + count mod 2) later, at most `most` ticks
 *           an interval and a shift that are asked for are `period` and `delay`, as fractions in 21ths of a second
 *   fired   output clock, at every `every`-th tick, and whenever `come` ticks if `passes`: text = "n<count>", frame = n
 *   come    triggered input clock: got := got + 1, heard = length of the text `word` and last byte of the binary `data`
 *   traps   1: calls of event mode, of clocks and of their variables switch on the traps of floating-point exceptions
 *           2: getters of numbers that belong to clocks round upwards from then on
 *   odd     1: each interval is told as changed; 2: no interval and no shift is written; 3: no interval is known in
 *           initialisation mode; 4: to ask there is an error
 *           5: in an instant an input or a clock that is set again, or after an output of a clock was read, is an error
 *   note    text without a clock: noted = its length
 *
 * A variable that is set or read while its clock does not tick, and a clock that ticks or is asked for its interval in step
 * mode, is an error.
 */
#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"

enum { TICK = 1, FIRED, COME, COUNT = 10, GOT, HEARD, EVERY, PASSES, MOST, NOTED, TRAPS, ODD, U = 20, Y, PERIOD, DELAY, TEXT = 30, WORD, NOTE, FRAME = 40, DATA };
typedef struct {
    int mode, read, set, ticks, comes, count, got, heard, every, passes, most, told, traps, odd; /* mode: 0 before steps, 1 step, 2 event */
    double u, s, period, delay;
    char text[20], word[200], note[200];
    fmi3Byte frame[2], data[200];
    size_t length;
} Unit;

static void trap(const Unit *m) {
#ifdef __x86_64__
    if (m->traps == 1) __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() & ~0x1F80u);
#else
    (void)m;
#endif
}
static void round_up(const Unit *m) {
    trap(m);
    if (m->traps == 2) fesetround(FE_UPWARD);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String n, fmi3String g, fmi3String l, fmi3Boolean v, fmi3Boolean d, fmi3Boolean used,
                                         fmi3Boolean early, const fmi3ValueReference r[], size_t k, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback f, fmi3IntermediateUpdateCallback u) {
    (void)n, (void)g, (void)l, (void)v, (void)d, (void)early, (void)r, (void)k, (void)e, (void)f, (void)u;
    Unit *m = used ? calloc(1, sizeof *m) : NULL;
    if (m) m->every = 1, m->most = 1 << 30, m->period = 0.1;
    return m;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean b, size_t n, const fmi3String s[]) {
    return (void)c, (void)b, (void)n, (void)s, fmi3OK;
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean a, fmi3Float64 b, fmi3Float64 t, fmi3Boolean d, fmi3Float64 e) {
    return (void)a, (void)b, (void)d, (void)e, (void)t, (void)c, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return ((Unit *)c)->mode = 2, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance c) { return trap(c), ((Unit *)c)->mode = 2, fmi3OK; }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return ((Unit *)c)->mode = 1, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return (void)c, fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance c) { return (void)c, fmi3OK; }

static int refuses(Unit *m, int bit) {
    const int again = m->mode == 2 && m->odd == 5 && (m->read || m->set & bit);
    return m->set |= bit, again;
}
static int fired(const Unit *m) { return (m->ticks && m->count % m->every == 0) || (m->comes && m->passes); }

fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock on[]) {
    Unit *m = c;
    trap(m);
    if (m->mode != 2 || n != 1 || !on[0] || refuses(m, 1 << r[0])) return fmi3Error;
    if (r[0] == TICK && !m->ticks++) m->count++, m->told = 0;
    if (r[0] == COME && !m->comes++) m->got++;
    return m->ticks > 1 || m->comes > 1 ? fmi3Error : fmi3OK;
}
fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock on[]) {
    return trap(c), (void)r, (void)n, on[0] = fired(c), ((Unit *)c)->mode == 2 ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 t[], fmi3IntervalQualifier q[]) {
    Unit *m = c;
    (void)r, (void)n;
    if (m->mode == 1 || (m->odd == 4 && !m->mode)) return fmi3Error;
    if (m->odd == 2) return fmi3OK;
    t[0] = m->period * (1 + m->count % 2);
    q[0] = (m->told && m->odd != 1) || m->count >= m->most ? fmi3IntervalUnchanged : fmi3IntervalChanged;
    if (m->odd == 3 && !m->mode) return q[0] = fmi3IntervalNotYetKnown, fmi3OK;
    return m->told = 1, fmi3OK;
}
fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 counts[],
                                   fmi3UInt64 resolutions[], fmi3IntervalQualifier q[]) {
    fmi3Float64 t[1];
    resolutions[0] = 21;
    const fmi3Status status = fmi3GetIntervalDecimal(c, r, n, t, q);
    return counts[0] = (fmi3UInt64)(t[0] * 21 + 0.5), status;
}
/* Before steps only */
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 t[]) {
    const Unit *m = c;
    (void)r, (void)n;
    if (m->odd != 2) t[0] = m->delay;
    return m->mode ? fmi3Error : fmi3OK;
}
fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 counts[], fmi3UInt64 resolutions[]) {
    const Unit *m = c;
    return (void)r, (void)n, counts[0] = (fmi3UInt64)(m->delay * 21 + 0.5), resolutions[0] = 21, m->mode ? fmi3Error : fmi3OK;
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *d, fmi3Boolean *e, fmi3Boolean *f,
                                    fmi3Float64 *t) {
    Unit *m = c;
    if (m->ticks) m->s += m->u;
    m->ticks = m->comes = m->read = m->set = 0, trap(m);
    return (void)t, *a = *b = *d = *e = *f = 0, fmi3OK;
}
fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 y[], size_t k) {
    Unit *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (!(r[i] == COUNT ? m->ticks : r[i] == NOTED || m->comes)) return fmi3Error;
        m->read |= r[i] != NOTED;
        m->heard = (int)strlen(m->word) + (m->length ? m->data[m->length - 1] : 0);
        y[i] = r[i] == COUNT ? m->count : r[i] == GOT ? m->got : r[i] == HEARD ? m->heard : (int)strlen(m->note);
    }
    if (m->ticks || m->comes) round_up(m);
    return fmi3OK;
}
fmi3Status fmi3SetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Int32 y[], size_t k) {
    Unit *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) *(r[i] == EVERY ? &m->every : r[i] == PASSES ? &m->passes : r[i] == TRAPS ? &m->traps : r[i] == ODD ? &m->odd : &m->most) = y[i];
    return fmi3OK;
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 y[], size_t k) {
    Unit *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++)
        if (r[i] == U || r[i] == Y) {
            if (!m->ticks) return fmi3Error;
            m->read |= r[i] == Y;
            y[i] = r[i] == U ? m->u : m->s + m->u;
        } else y[i] = r[i] == DELAY ? m->delay : m->period;
    if (m->ticks) round_up(m);
    return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 y[], size_t k) {
    Unit *m = c;
    (void)k;
    for (size_t i = 0; i < n; i++) {
        if (r[i] == U && m->mode && (!m->ticks || refuses(m, 1 << 4))) return fmi3Error;
        *(r[i] == U ? &m->u : r[i] == DELAY ? &m->delay : &m->period) = y[i];
    }
    return fmi3OK;
}
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3String y[], size_t k) {
    Unit *m = c;
    (void)n, (void)k;
    snprintf(m->text, sizeof m->text, "n%d", m->count);
    m->read |= r[0] == TEXT;
    return y[0] = r[0] == NOTE ? m->note : m->text, r[0] == NOTE || fired(m) ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3String y[], size_t k) {
    Unit *m = c;
    (void)n, (void)k;
    if (r[0] == WORD && refuses(m, 1 << 5)) return fmi3Error;
    snprintf(r[0] == WORD ? m->word : m->note, sizeof m->word, "%s", y[0]);
    return !m->mode || (r[0] == WORD ? m->comes : m->mode == 2) ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, size_t sizes[], fmi3Binary y[], size_t k) {
    Unit *m = c;
    (void)r, (void)n, (void)k;
    m->frame[0] = 0, m->frame[1] = (fmi3Byte)m->count;
    m->read = 1;
    return sizes[0] = 2, y[0] = m->frame, fired(m) ? fmi3OK : fmi3Error;
}
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, const size_t sizes[], const fmi3Binary y[], size_t k) {
    Unit *m = c;
    (void)r, (void)n, (void)k;
    if (refuses(m, 1 << 6)) return fmi3Error;
    m->length = sizes[0] < sizeof m->data ? sizes[0] : sizeof m->data;
    memcpy(m->data, y[0], m->length);
    return !m->mode || m->comes ? fmi3OK : fmi3Error;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    return (void)keep, *last = t + h, *event = *end = *early = 0, ((Unit *)c)->mode == 1 ? fmi3OK : fmi3Error;
}
fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s) {
    return *s = *s ? *s : malloc(sizeof(Unit)), memcpy(*s, c, sizeof(Unit)), fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { return memcpy(c, s, sizeof(Unit)), fmi3OK; }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { return (void)c, free(*s), *s = NULL, fmi3OK; }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState s, size_t *n) { return (void)c, (void)s, *n = sizeof(Unit), fmi3OK; }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState s, fmi3Byte to[], size_t n) { return (void)c, memcpy(to, s, n), fmi3OK; }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte from[], size_t n, fmi3FMUState *s) {
    return (void)c, *s = malloc(n), memcpy(*s, from, n), fmi3OK;
}
