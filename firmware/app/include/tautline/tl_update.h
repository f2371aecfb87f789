/// New firmware from the host, into the slot that does not run. The task alone.
///
/// A file is one image or several, each a page that says what it is (the frame of tl_wire.h's `image`) and then its
/// bytes; the board takes the one that is linked for its free slot and passes over the others. Before anything is
/// erased the page's signature is checked with the key that is built in; when all has come the hash of what flash then
/// holds; and only then the slot counts. It runs from the next start on, on trial (tl_boot.h) until a host has said
/// hello to it and control steps have gone on for a while: what cannot be talked to cannot be replaced either.
#ifndef TAUTLINE_TL_UPDATE_H
#define TAUTLINE_TL_UPDATE_H

#include "tautline/tl_axis.h"
#include "tautline/tl_boot.h"

typedef struct {
    const tl_port_t *port;
    const tl_axis_t *axes;
    uint8_t version[3]; ///< that runs
    uint8_t refused;    ///< tl_wire_update_t: why the last one was
    bool any;           ///< the next one may be older
    bool heard;         ///< a host has said hello
    bool trial;         ///< what runs is on trial
    uint8_t stage;
    uint32_t come;              ///< bytes of the file
    uint32_t next;              ///< of the file, where the next page of an image begins
    uint32_t size;              ///< of the image that is taken
    uint8_t hash[32];           ///< that it has to have
    uint8_t head[TL_BOOT_PAGE]; ///< its page
    tl_us_t started_us;
} tl_update_t;

/// `version`: of the firmware that is built in, where the slot that runs does not say.
void tl_update_init(tl_update_t *update, const tl_port_t *port, const tl_axis_t *axes, const uint8_t version[3]);

/// A page of the file; offset 0 begins anew, each follows the one before. A tl_wire_update_t: 0 is done. May erase, and
/// check a signature: as long as the port's `check_ms` says.
uint8_t tl_update_data(tl_update_t *update, uint32_t offset, const uint8_t *bytes, size_t size);

/// The file is there: the image is checked and counts from now on.
uint8_t tl_update_end(tl_update_t *update);

void tl_update_abort(tl_update_t *update);

/// Whether one is under way.
bool tl_update_is_coming(const tl_update_t *update);

/// Once a millisecond: confirms what runs, or gives it up where no host has talked to it for a minute.
void tl_update_task(tl_update_t *update, tl_us_t now_us);

void tl_update_tell(const tl_update_t *update, tl_wire_firmware_t *out);

#endif
