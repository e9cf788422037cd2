/* How long a communication step is; see pace.py. */

#include <math.h>

#include "run.h"

static const double INTEGRAL = 0.3, PROPORTIONAL = 0.4, SAFETY = 0.8, SHRINK = 0.2, GROW = 2.0, REPEATED = 0.9,
                    NEARLY = 1.0 - 1e-9, TINY = 1e-10, HUGEST = 1e10;

static double within(double x, double low, double high) { return smaller(larger(x, low), high); }

double pace_length(Pace *p, double room) {
    p->uncut = 0.0;
    if (p->h >= room * NEARLY) {
        p->uncut = p->h;
        return room;
    }
    return 2.0 * p->h > room ? room / 2.0 : p->h;
}

int pace_good(Pace *p, double e, double h) {
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
