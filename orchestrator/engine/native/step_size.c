/* How long a communication step is, when it follows from an estimate of its error.
 *
 * The estimate of a step says how far the inputs that the components worked with were from the truth, see
 * input_deviation; e is the worst of them over the tolerance. A step with e <= 1 is good. The next one follows from
 * the last two by a proportional-integral law (Gustafsson 1991, ACM Trans. Math. Softw. 17(4), 533-554),
 *
 *     h_next = h (1/c)^(0.3/k) (c_before/c)^(0.4/k),      c = e / 0.8^k,
 *
 * where k is the power of h that the estimate goes with. Where the components can go back, a step with e > 1 is
 * repeated with a shorter one; where they cannot, it stands, and only the next one is shorter.
 */

#include <math.h>

#include "engine.h"

static const double INTEGRAL = 0.3, PROPORTIONAL = 0.4; /* exponents of the law, over k */
static const double SAFETY = 0.8;                       /* of the step at which the error would just do */
static const double SHRINK = 0.2, GROW = 2.0;           /* limits of a change */
static const double REPEATED = 0.9;                     /* at most this much of a step that was not good */
static const double NEARLY = 1.0 - 1e-9;                /* of what is left: a step that long is meant to end there */
static const double TINY = 1e-10, HUGEST = 1e10;        /* limits of c: no error, and one that is not a number */

static double within(double x, double low, double high) { return smaller(larger(x, low), high); }

/* The next step [s] when the next time to hit is `room` [s] away. */
double step_size_next(StepSize *p, double room) {
    p->uncut = 0.0;
    if (p->h >= room * NEARLY) {
        p->uncut = p->h;
        return room;
    }
    return 2.0 * p->h > room ? room / 2.0 : p->h;
}

/* Judges the step of length h [s] with the error e, a share of the tolerance; 0: repeat it. */
int32_t step_size_accepts(StepSize *p, double e, double h) {
    const double k = (double)p->power;
    const double c = isfinite(e) ? within(e, TINY, HUGEST) / pow(SAFETY, k) : HUGEST;
    if (!(e <= 1.0) && p->repeats && h > p->smallest) {
        p->h = larger(h * smaller(REPEATED, larger(SHRINK, pow(1.0 / c, 1.0 / k))), p->smallest);
        p->before = 0.0;
        return 0;
    }
    double change;
    if (p->before == 0.0) change = pow(1.0 / c, 1.0 / k);
    else change = pow(1.0 / c, INTEGRAL / k) * pow(p->before / c, PROPORTIONAL / k);
    double fresh = h * within(change, SHRINK, GROW);
    if (e <= 1.0) fresh = larger(fresh, p->uncut);
    p->h = within(fresh, p->smallest, p->largest);
    p->before = c;
    return 1;
}
