/* The floating-point environment of the thread: an FMU that changes it must not change the numbers of another one.
 *
 * The control words are those at the beginning of the run. Reading them takes 30 ns on some processors (AMD EPYC), so that
 * is done at most once per block of steps, and the rounding mode, which FMUs change most, is found by two additions after each
 * step of a component. Where Python steps components, which takes longer, they are read after each call: a trap that an FMU has
 * switched on would end the process in the solver. Flags of past exceptions change no number and are left alone.
 */

#include "engine.h"

/* Rounding, flushing to zero and traps */
static uint64_t control(void) {
#if defined(__x86_64__)
    uint32_t sse;
    uint16_t x87;
    __asm__ volatile("stmxcsr %0" : "=m"(sse));
    __asm__ volatile("fnstcw %0" : "=m"(x87));
    return (uint64_t)(sse & ~0x3Fu) << 16 | x87; /* the last six bits are flags */
#elif defined(__aarch64__)
    uint64_t word;
    __asm__ volatile("mrs %0, fpcr" : "=r"(word));
    return word;
#else
#error "the control words of this processor are not known"
#endif
}

static void set_control(uint64_t words) {
#if defined(__x86_64__)
    const uint32_t sse = (uint32_t)(words >> 16);
    const uint16_t x87 = (uint16_t)words;
    __asm__ volatile("ldmxcsr %0" : : "m"(sse));
    __asm__ volatile("fnclex\n\tfldcw %0" : : "m"(x87)); /* a flag whose trap is switched on would be one now */
#else
    __asm__ volatile("msr fpcr, %0" : : "r"(words));
#endif
}

void environment_restore(Simulation *sim, const void *call, int k) {
    if (control() == sim->control) return;
    set_control(sim->control);
    sim->check_status(call, k, CHANGED);
}

int32_t environment_begin(Simulation *sim) {
    sim->control = control();
    return CONTINUE;
}

int32_t environment_check(Simulation *sim) {
    environment_restore(sim, NULL, ANY_COMPONENT);
    return CONTINUE;
}
