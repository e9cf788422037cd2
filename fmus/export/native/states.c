/* FMU states: get, set, free and serialise; each is a block of memory with the bytes of snapshot.c. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

/* Allocates memory for a saved state if `*state` is null; 0 and a message if that fails. */
static int allocate(Instance *self, void **state) {
    if (!valid_array(self, state, 1)) return 0;
    if (!*state) *state = malloc(snapshot_size());
    if (*state) return 1;
    refuse(self, "out of memory");
    return 0;
}

Status states_get(Instance *self, void **state) {
    if (!allocate(self, state)) return ERROR;
    if (self->core.s.start_fixed) core_start(&self->core);
    snapshot_write(&self->core.s, *state);
    return OK;
}

Status states_set(Instance *self, const void *state) {
    State restored;
    if (!state) return refuse(self, "there is no saved state");
    if (!snapshot_read(&self->core, &restored, state, snapshot_size(), 0)) return ERROR;
    if (restored.type != self->core.s.type)
        return refuse(self, "the saved state is of an instance for %s",
                      restored.type == CO_SIMULATION ? "co-simulation" : "model exchange");
    if (!(restored.phase & ANY & ~INSIDE_STEP) || !isfinite(restored.time))
        return refuse(self, "the saved state does not belong to this model");
    memcpy(&self->core.s, &restored, sizeof restored);
    core_invalidate(&self->core);
    self->core.start_valid = restored.start_fixed;
    exchange_keep_inputs(self);
    return OK;
}

Status states_serialize(Instance *self, const void *state, char bytes[], size_t size) {
    if (!state) return refuse(self, "there is no saved state");
    if (!valid_array(self, bytes, 1)) return ERROR;
    if (size < snapshot_size()) return refuse(self, "the memory is too small");
    memcpy(bytes, state, snapshot_size());
    snapshot_add_checksum(bytes);
    return OK;
}

Status states_deserialize(Instance *self, const char bytes[], size_t size, void **state) {
    State restored;
    if (!valid_array(self, bytes, size ? size : 1) || !valid_array(self, state, 1)) return ERROR;
    *state = NULL; /* undefined on entry */
    if (!snapshot_read(&self->core, &restored, bytes, size, 1)) return ERROR;
    if (!allocate(self, state)) return ERROR;
    snapshot_write(&restored, *state);
    return OK;
}

Status states_free(void **state) {
    if (state) {
        free(*state);
        *state = NULL;
    }
    return OK;
}
