/* The length of adaptive communication steps, from the estimated error of the last ones.
 *
 * The error of a step is the deviation of the inputs that the components used from the truth, see input_deviation; e is
 * the largest of them over the tolerance. A step with e <= 1 is accepted. The length of the next one follows from the
 * last two errors by a proportional-integral law (Gustafsson 1991, ACM Trans. Math. Softw. 17(4), 533-554),
 *
 *     h_next = h (1/c)^(0.3/k) (c_before/c)^(0.4/k),      c = e / 0.8^k,
 *
 * where the estimate is proportional to h^k. A step with e > 1 is repeated with a shorter one if the components can go
 * back to its beginning. If they cannot, the step is kept and only the next one is shorter.
 */

#include <math.h>

#include "engine.h"

static const double INTEGRAL = 0.3, PROPORTIONAL = 0.4; /* exponents of the law, times k */
static const double SAFETY = 0.8;                       /* of the step whose error would equal the tolerance */
static const double SHRINK = 0.2, GROW = 2.0;           /* limits of the ratio of two steps */
static const double REPEATED = 0.9;                     /* longest repetition of a rejected step, over its length */
static const double NEARLY = 1.0 - 1e-9;                /* longest step, over the remaining time, that does not take all of it */
static const double TINY = 1e-10, HUGEST = 1e10;        /* limits of c: no error, and one that is not finite */

static double within(double x, double low, double high) { return smaller(larger(x, low), high); }

/* The next step [s] if the next time that has to be hit is `remaining` [s] away. */
double step_size_next(StepSize *p, double remaining) {
    p->unclipped = 0.0;
    if (p->h >= remaining * NEARLY) {
        p->unclipped = p->h;
        return remaining;
    }
    return 2.0 * p->h > remaining ? remaining / 2.0 : p->h;
}

/* Inputs have jumped: the errors before tell nothing, and a step that cannot be repeated has to be short. */
void step_size_begin(StepSize *p) {
    p->error_before = 0.0;
    if (!p->repeats) p->h = smaller(p->h, p->first);
}

/* Decides about a step of length h [s] with the error e, relative to the tolerance; 0: it has to be repeated. */
int32_t step_size_accepts(StepSize *p, double e, double h) {
    const double k = (double)p->power;
    const double c = isfinite(e) ? within(e, TINY, HUGEST) / pow(SAFETY, k) : HUGEST;
    if (!(e <= 1.0) && p->repeats && h > p->smallest) {
        p->h = larger(h * smaller(REPEATED, larger(SHRINK, pow(1.0 / c, 1.0 / k))), p->smallest);
        p->error_before = 0.0;
        return 0;
    }
    double ratio;
    if (p->error_before == 0.0) ratio = pow(1.0 / c, 1.0 / k);
    else ratio = pow(1.0 / c, INTEGRAL / k) * pow(p->error_before / c, PROPORTIONAL / k);
    double next = h * within(ratio, SHRINK, GROW);
    if (e <= 1.0) next = larger(next, p->unclipped);
    p->h = within(next, p->smallest, p->largest);
    p->error_before = c;
    return 1;
}
