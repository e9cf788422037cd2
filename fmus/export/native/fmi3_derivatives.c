/* FMI 3.0: directional and adjoint derivatives. */

#include <math.h>
#include <string.h>

#include "fmi3.h"

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                        size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                        const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                        size_t nSensitivity) {
    CALL(ANY & ~INSTANTIATED,
         scalars(instance, nKnowns, nSeed) && scalars(instance, nUnknowns, nSensitivity)
             ? values_directional(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity)
             : ERROR);
}

/* Replaces the weights of the unknowns in core->direction by those of the knowns. */
static void reverse(Core *core, int starting) {
    const State *s = &core->s;
    double *w = core->direction, *wdx = w + FIRST_DERIVATIVE, *wy = w + FIRST_OUTPUT;
    double wx[ROOM(NX)], wu[ROOM(NU)];
    core_start(core);
    if (starting) {
        double wp[ROOM(NP)];
        model_start_reverse(s->x, s->u, s->p, core->c, w + FIRST_STATE, wdx, wy, wx, wu, wp);
        memcpy(w + FIRST_PARAMETER, wp, NP * sizeof *wp);
    } else {
        model_reverse(s->x, s->u, s->p, core->c, wdx, wy, wx, wu);
        for (int i = 0; i < NX; i++) wx[i] += w[FIRST_STATE + i];
    }
    memcpy(w + FIRST_STATE, wx, NX * sizeof *wx);
    memcpy(w + FIRST_INPUT, wu, NU * sizeof *wu);
}

static Status adjoint(Instance *self, const unsigned unknown[], size_t n_unknown, const unsigned known[],
                      size_t n_known, const double seed[], double result[]) {
    Core *core = &self->core;
    if (!valid_array(self, unknown, n_unknown) || !valid_array(self, seed, n_unknown)) return ERROR;
    if (!valid_array(self, known, n_known) || !valid_array(self, result, n_known)) return ERROR;
    memset(core->direction, 0, sizeof core->direction);
    for (size_t i = 0; i < n_unknown; i++) {
        if (!is_unknown(self, unknown[i])) return ERROR;
        core->direction[unknown[i]] += seed[i];
    }
    reverse(core, is_starting(self));
    for (size_t i = 0; i < n_known; i++) {
        result[i] = 0.0;
        if (is_time(self, known[i])) continue; /* no variable depends on the time */
        if (!is_known(self, known[i])) return ERROR;
        result[i] = core->direction[known[i]];
        if (!isfinite(result[i])) return refuse(self, "the adjoint derivative is not finite");
    }
    return OK;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity) {
    CALL(ANY & ~INSTANTIATED,
         scalars(instance, nUnknowns, nSeed) && scalars(instance, nKnowns, nSensitivity)
             ? adjoint(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity)
             : ERROR);
}
