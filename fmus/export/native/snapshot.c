/* Saved states as bytes, to be restored in this or another process by the same model. */

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "core.h"

enum { VERSION = 5 };

typedef struct {
    char magic[8];
    char guid[48];
    unsigned version, size;
    double one;    /* tells another byte order */
    uint64_t seal; /* check sum of the state behind it, or 0 */
} Header;

static Header header(void) {
    Header h;
    memset(&h, 0, sizeof h);
    memcpy(h.magic, "FMUstate", sizeof h.magic);
    memcpy(h.guid, MODEL_GUID, sizeof MODEL_GUID);
    h.version = VERSION;
    h.size = (unsigned)sizeof(State);
    h.one = 1.0;
    return h;
}

/* FNV-1a; never 0 */
static uint64_t check_sum(const char *bytes, size_t size) {
    uint64_t sum = 14695981039346656037u;
    for (size_t i = 0; i < size; i++) sum = (sum ^ (unsigned char)bytes[i]) * 1099511628211u;
    return sum | 1u;
}

LOCAL size_t snapshot_size(void) { return sizeof(Header) + sizeof(State); }

LOCAL void snapshot_write(const State *state, char *bytes) {
    const Header h = header();
    memcpy(bytes, &h, sizeof h);
    memcpy(bytes + sizeof h, state, sizeof *state);
}

LOCAL int snapshot_read(Core *core, State *state, const char *bytes, size_t size, int sealed) {
    Header expected = header(), found;
    memset(&found, 0, sizeof found);
    memcpy(&found, bytes, size < sizeof found ? size : sizeof found);
    expected.seal = found.seal;
    if (size >= sizeof found && memcmp(&found, &expected, sizeof found) != 0) {
        found.guid[sizeof found.guid - 1] = '\0';
        core_message(core, ERROR, "the saved state is of GUID \"%s\" version %u, expected \"%s\" version %u",
                     found.guid, found.version, expected.guid, expected.version);
        return 0;
    }
    if (size != snapshot_size()) {
        core_message(core, ERROR, "the saved state has %zu bytes, expected %zu", size, snapshot_size());
        return 0;
    }
    if (sealed && found.seal != check_sum(bytes + sizeof found, sizeof *state)) {
        core_message(core, ERROR, "the saved state is damaged: its check sum differs");
        return 0;
    }
    memcpy(state, bytes + sizeof found, sizeof *state);
    return 1;
}

LOCAL void snapshot_seal(char *bytes) {
    Header h;
    memcpy(&h, bytes, sizeof h);
    h.seal = check_sum(bytes + sizeof h, sizeof(State));
    memcpy(bytes, &h, sizeof h);
}
