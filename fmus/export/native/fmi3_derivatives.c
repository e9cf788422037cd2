/* FMI 3.0: directional derivatives. There are no adjoint ones. */

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

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[],
                                    size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                    const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                    size_t nSensitivity) {
    (void)unknowns, (void)nUnknowns, (void)knowns, (void)nKnowns;
    (void)seed, (void)nSeed, (void)sensitivity, (void)nSensitivity;
    CALL(ANY, refuse(instance, "the model has no adjoint derivatives, expected directional ones"));
}
