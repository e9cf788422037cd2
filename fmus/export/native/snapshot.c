/* Saved states as bytes, which the same model can restore in this or another process. */

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "core.h"

enum { VERSION = 6 };

typedef struct {
    char magic[8];
    char guid[48];
    unsigned version, size;
    double byte_order; /* 1.0; reads differently on a machine with another byte order */
    uint64_t checksum; /* of the state that follows, or 0 */
} Header;

static Header expected_header(void) {
    Header h;
    memset(&h, 0, sizeof h);
    memcpy(h.magic, "FMUstate", sizeof h.magic);
    memcpy(h.guid, model_guid, sizeof h.guid);
    h.version = VERSION;
    h.size = (unsigned)sizeof(State);
    h.byte_order = 1.0;
    return h;
}

/* FNV-1a; never 0 */
static uint64_t checksum_of(const char *bytes, size_t size) {
    uint64_t sum = 14695981039346656037u;
    for (size_t i = 0; i < size; i++) sum = (sum ^ (unsigned char)bytes[i]) * 1099511628211u;
    return sum | 1u;
}

SHARED size_t snapshot_size(void) { return sizeof(Header) + sizeof(State); }

LOCAL void snapshot_write(const State *state, char *bytes) {
    const Header h = expected_header();
    memcpy(bytes, &h, sizeof h);
    memcpy(bytes + sizeof h, state, sizeof *state);
}

LOCAL int snapshot_read(Core *core, State *state, const char *bytes, size_t size, int verify) {
    Header expected = expected_header(), header;
    memset(&header, 0, sizeof header);
    memcpy(&header, bytes, size < sizeof header ? size : sizeof header);
    expected.checksum = header.checksum;
    if (size >= sizeof header && memcmp(&header, &expected, sizeof header) != 0) {
        header.guid[sizeof header.guid - 1] = '\0';
        core_message(core, ERROR, "the saved state is of GUID \"%s\" version %u, expected \"%s\" version %u",
                     header.guid, header.version, expected.guid, expected.version);
        return 0;
    }
    if (size != snapshot_size()) {
        core_message(core, ERROR, "the saved state has %zu bytes, expected %zu", size, snapshot_size());
        return 0;
    }
    if (verify && header.checksum != checksum_of(bytes + sizeof header, sizeof *state)) {
        core_message(core, ERROR, "the saved state is damaged: its checksum differs");
        return 0;
    }
    memcpy(state, bytes + sizeof header, sizeof *state);
    return 1;
}

LOCAL void snapshot_add_checksum(char *bytes) {
    Header h;
    memcpy(&h, bytes, sizeof h);
    h.checksum = checksum_of(bytes + sizeof h, sizeof(State));
    memcpy(bytes, &h, sizeof h);
}
