/* FMI 2.0: saved states and directional derivatives. A saved state is the bytes of snapshot.c. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2_instance.h"

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetFMUstate", ANY)) return fmi2Error;
    if (!*FMUstate) *FMUstate = malloc(snapshot_size());
    if (!*FMUstate) return fmi2_refuse(self, "out of memory%s", "");
    snapshot_write(&self->core.s, *FMUstate);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    Instance *self = c;
    State restored;
    if (!fmi2_allowed(self, "fmi2SetFMUstate", ANY)) return fmi2Error;
    if (!FMUstate) return fmi2_refuse(self, "there is no saved state%s", "");
    if (!snapshot_read(&self->core, &restored, FMUstate, snapshot_size())) return fmi2Error;
    if (restored.type != self->core.s.type)
        return fmi2_refuse(self, "the saved state is of an instance for %s",
                           fmi2_type_name(restored.type));
    memcpy(&self->core.s, &restored, sizeof restored);
    core_changed(&self->core);
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2FreeFMUstate", ANY)) return fmi2Error;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    Instance *self = c;
    (void)FMUstate;
    if (!fmi2_allowed(self, "fmi2SerializedFMUstateSize", ANY)) return fmi2Error;
    *size = snapshot_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                 size_t size) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2SerializeFMUstate", ANY)) return fmi2Error;
    if (!FMUstate) return fmi2_refuse(self, "there is no saved state%s", "");
    if (size < snapshot_size()) return fmi2_refuse(self, "the memory is too small%s", "");
    memcpy(serializedState, FMUstate, snapshot_size());
    snapshot_seal(serializedState);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *self = c;
    State restored;
    if (!fmi2_allowed(self, "fmi2DeSerializeFMUstate", ANY)) return fmi2Error;
    if (!snapshot_read(&self->core, &restored, serializedState, size)) return fmi2Error;
    *FMUstate = malloc(snapshot_size()); /* what it held on entry is not defined */
    if (!*FMUstate) return fmi2_refuse(self, "out of memory%s", "");
    snapshot_write(&restored, *FMUstate);
    return fmi2OK;
}

/* ---- directional derivatives ------------------------------------------------------------------- */

/* A known is an input or a state; at the start it is an input, a start value or a parameter. */
static int known(const Core *core, fmi2ValueReference vr) {
    if (vr >= NUMBER_OF_VARIABLES) return 0;
    const Kind kind = model_variables[vr].kind;
    if (kind == INPUT || kind == STATE) return 1;
    return core->s.initial ? kind == FIXED || kind == TUNABLE : kind == CALCULATED_STATE;
}

/* An unknown is an output, a derivative or a state. */
static int unknown(fmi2ValueReference vr) {
    if (vr >= NUMBER_OF_VARIABLES) return 0;
    const Kind kind = model_variables[vr].kind;
    return kind != FIXED && kind != TUNABLE && kind != INPUT;
}

static const char *name_of(fmi2ValueReference vr) {
    return vr < NUMBER_OF_VARIABLES ? model_variables[vr].name : "(unknown value reference)";
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetDirectionalDerivative", ANY & ~INSTANTIATED)) return fmi2Error;
    Core *core = &self->core;
    memset(core->direction, 0, sizeof core->direction);
    for (size_t i = 0; i < nKnown; i++) {
        if (!known(core, vKnown_ref[i]))
            return fmi2_refuse(self, "%s is not a known, expected an input or a state", name_of(vKnown_ref[i]));
        core->direction[vKnown_ref[i]] += dvKnown[i];
    }
    core_forward(core);
    for (size_t i = 0; i < nUnknown; i++) {
        const char *name = name_of(vUnknown_ref[i]);
        if (!unknown(vUnknown_ref[i]))
            return fmi2_refuse(self, "%s is not an unknown, expected an output or a derivative", name);
        dvUnknown[i] = core->direction[vUnknown_ref[i]];
        if (!isfinite(dvUnknown[i])) return fmi2_refuse(self, "the derivative of %s is not finite", name);
    }
    return fmi2OK;
}
