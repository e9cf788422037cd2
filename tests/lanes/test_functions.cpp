/* Functions of arrays, one for each elementary function of lanes.h. */
#include <string.h>
#include "lanes.h"
#define EACH(name, expression)                                                                      \
    extern "C" __attribute__((visibility("default")))                                               \
    void name##_of(const double *x, const double *y, double *out, int count) {                      \
        for (int i = 0; i < count; i++) {                                                           \
            Lanes a, b, r;                                                                          \
            memcpy((void *)&a, x + i * LANES, sizeof a), memcpy((void *)&b, y + i * LANES, sizeof b); \
            r = expression;                                                                         \
            memcpy(out + i * LANES, &r, sizeof r);                                                  \
        }                                                                                           \
    }
EACH(exp, exp(a)) EACH(log, log(a)) EACH(sin, sin(a)) EACH(cos, cos(a)) EACH(tanh, tanh(a))
EACH(quotient, a / b) EACH(exp_above, exp_above(a, -2.0, ::exp(-2.0))) EACH(pow, pow(a, b)) EACH(fmax, fmax(a, b)) EACH(fmin, fmin(a, b))
EACH(where, where(a < b, a)) EACH(both, Lanes(a < b && b != 2.0))
