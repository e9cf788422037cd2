/* FMI 2.0: saved states and directional derivatives. A saved state is the bytes of snapshot.c. */

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
                           restored.type == fmi2CoSimulation ? "co-simulation" : "model exchange");
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
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    Instance *self = c;
    State restored;
    if (!fmi2_allowed(self, "fmi2DeSerializeFMUstate", ANY)) return fmi2Error;
    if (!snapshot_read(&self->core, &restored, serializedState, size)) return fmi2Error;
    if (!*FMUstate) *FMUstate = malloc(snapshot_size());
    if (!*FMUstate) return fmi2_refuse(self, "out of memory%s", "");
    snapshot_write(&restored, *FMUstate);
    return fmi2OK;
}

/* ---- directional derivatives ------------------------------------------------------------------- */

/* Puts one seed in its place; 0 if the variable is not a known: an input or a state. */
static int seed(Core *core, fmi2ValueReference vr, double value) {
    if (vr >= NUMBER_OF_VARIABLES) return 0;
    const Kind kind = model_variables[vr].kind;
    if (kind == INPUT) core->vu[vr - FIRST_INPUT] = value;
    else if (kind == STATE || (kind == CALCULATED_STATE && !core->s.initial))
        core->vx[vr - FIRST_STATE] = value;
    else return 0;
    return 1;
}

/* Reads one result; 0 if the variable is not an unknown: an output, a derivative or a state. */
static int harvest(const Core *core, fmi2ValueReference vr, double *value) {
    if (vr < FIRST_STATE || vr >= NUMBER_OF_VARIABLES) return 0;
    if (vr < FIRST_DERIVATIVE) *value = core->vx[vr - FIRST_STATE];
    else if (vr < FIRST_OUTPUT) *value = core->vdx[vr - FIRST_DERIVATIVE];
    else *value = core->vy[vr - FIRST_OUTPUT];
    return 1;
}

static const char *name_of(fmi2ValueReference vr) {
    return vr < NUMBER_OF_VARIABLES ? model_variables[vr].name : "(unknown value reference)";
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                        size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[]) {
    Instance *self = c;
    if (!fmi2_allowed(self, "fmi2GetDirectionalDerivative", ANY & ~INSTANTIATED)) return fmi2Error;
    memset(self->core.vx, 0, sizeof self->core.vx);
    memset(self->core.vu, 0, sizeof self->core.vu);
    for (size_t i = 0; i < nKnown; i++)
        if (!seed(&self->core, vKnown_ref[i], dvKnown[i]))
            return fmi2_refuse(self, "%s is not a known, expected an input or a state", name_of(vKnown_ref[i]));
    core_forward(&self->core);
    for (size_t i = 0; i < nUnknown; i++)
        if (!harvest(&self->core, vUnknown_ref[i], &dvUnknown[i]))
            return fmi2_refuse(self, "%s is not an unknown, expected an output or a derivative",
                               name_of(vUnknown_ref[i]));
    return fmi2OK;
}
