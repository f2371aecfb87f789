/// What the app needs of a board: one const table of functions and a context that each gets back.
///
/// The app is two threads of execution. The *control step*, tl_app_control(), runs at `control_hz` from a timer
/// interrupt; the *task*, tl_app_task() with tl_usb_task() or tl_serial_task(), runs in the main loop and is
/// interrupted by it. A port with one thread (the desktop) calls both in turn. Functions say who calls them.
///
/// What a port's build has to do besides:
/// - tl_usb.c (ports with USB): compile it against its TinyUSB with CFG_TUSB_MCU, and link with
///   -Wl,--wrap=dcd_event_handler; TinyUSB also wants tusb_time_millis_api() where it knows no such board. On an RP2040
///   --wrap=dcd_edpt_clear_stall,--wrap=dcd_edpt_xfer, too (port/rp2040/usb_halt.h).
/// - tl_serial.c (ports with a serial port): nothing; give tl_serial_init() a tl_serial_t.
/// - TL_FAST_SECTION where code memory is slow (tl_fast.h), TL_APP_QUEUE and TL_APP_AXES where RAM is short
///   (tl_outbox.h, tl_state.h), and TL_AXIS_TICKS_MIN=control_hz / 1000 where the rate is fixed, so that the control
///   path has no division (tl_axis.h).
#ifndef TAUTLINE_TL_PORT_H
#define TAUTLINE_TL_PORT_H

#include <stddef.h>

#include "tautline/tl_fixed.h"
#include "tautline/tl_wire.h"

#define TL_PORT_FLASH_SECTOR 4096U ///< bytes that an erase sets to 0xFF
#define TL_PORT_FLASH_REGION                                                                                           \
    (2U * (TL_WIRE_AXES_MAX + 1U) * TL_PORT_FLASH_SECTOR) ///< bytes that the app keeps things in
#define TL_PORT_FLASH_LOG  (2U * TL_PORT_FLASH_SECTOR)    ///< bytes behind them for the fault log, where one is kept
#define TL_PORT_FLASH_PAGE 256U                           ///< bytes that a program writes; it only clears bits

/// What a board needs to take new firmware over USB: two slots of flash (tl_boot.h), and a loader that chose one.
typedef struct {
    const uint8_t *key; ///< public key, 32 bytes, with which updates are signed
    uint32_t room;      ///< bytes of a slot
    uint8_t slot;       ///< that runs
    bool trial;         ///< it is on trial
    bool failed;        ///< the other one is, and a watchdog has ended its trial
    uint16_t check_ms;  ///< that `is_signed` takes

    /// Reads from a slot. Task.
    void (*read)(void *context, uint8_t slot, uint32_t offset, uint8_t *out, size_t size);
    /// As flash_erase and flash_program, of a slot. Task, with every motor off.
    bool (*erase)(void *context, uint8_t slot, uint32_t offset);
    bool (*program)(void *context, uint8_t slot, uint32_t offset, const uint8_t *page);
    /// Whether the signature (64 bytes) is the key's, of a message. Task, with every motor off.
    bool (*is_signed)(void *context, const uint8_t *signature, const uint8_t *message, size_t size);
    /// BLAKE2b-256 of the first `size` bytes of a slot's image. Task, with every motor off.
    void (*hash)(void *context, uint8_t slot, uint32_t size, uint8_t *out);
    /// The trial is over: what runs is confirmed (true); or it is given up: the board restarts into the other slot.
    void (*trial_ends)(void *context, bool confirmed);
} tl_port_update_t;

typedef struct {
    void *context;
    const char *name;   ///< "desktop", "rp2040"; at most 15 characters, lives for ever
    const char *serial; ///< USB serial number, at most 31 characters of A-Z a-z 0-9 -, lives for ever
    uint8_t axes;       ///< 1 to TL_APP_AXES
    uint8_t boot;       ///< tl_wire_boot_t: why it started
    bool keeps_log;     ///< its flash has TL_PORT_FLASH_LOG bytes behind the region
    uint32_t
        control_hz; ///< 1000, 2000, 4000, 5000, 8000 or 10000: a period is whole microseconds, a millisecond periods

    uint16_t driver_ma;     ///< at which the motor drivers limit the current by themselves; 0: not known
    uint16_t supply_low_mv; ///< of the motors, below which they should not be driven: the default; 0: none

    /// Microseconds since the start, never falls. Both threads.
    tl_us_t (*time_us)(void *context);
    /// Quadrature counts since the start, wraps; control step.
    int32_t (*encoder)(void *context, uint8_t axis);
    /// Whether edges of an encoder were lost since the last call: its count is off from then on. Task.
    bool (*edges_lost)(void *context, uint8_t axis);
    /// Drive of the H-bridge, held until the next call: 0 shorts the motor (it brakes). Both threads, under the lock.
    void (*drive)(void *context, uint8_t axis, tl_duty_q15_t duty);
    /// Motor current, mA, the latest sample (a port may sample one axis a step); control step.
    int32_t (*current_ma)(void *context, uint8_t axis);

    /// Supply of the motors, mV, the latest sample. Control step. NULL: not measured.
    uint16_t (*supply_mv)(void *context);
    /// Whether the motor driver of an axis reports a fault (nFAULT). Control step. NULL: it cannot.
    bool (*driver_fault)(void *context, uint8_t axis);
    /// Whether the input for a stop button is closed: low, and high by a pull-up where nothing is wired. Control step.
    /// NULL: there is none.
    bool (*estop_closed)(void *context);

    /// Reads from the region for tables and settings, TL_PORT_FLASH_REGION bytes, at any offset within it. Task.
    void (*flash_read)(void *context, uint32_t offset, uint8_t *out, size_t size);
    /// `offset` from the region's start, a multiple of the sector or page. Task, with every motor off; may take 0.4 s,
    /// during which the control step may stand still. `page` is in RAM: the flash chip is out of reach meanwhile.
    /// False: not done, the content is undefined.
    bool (*flash_erase)(void *context, uint32_t offset);
    bool (*flash_program)(void *context, uint32_t offset, const uint8_t *page);

    /// To be called by the task at least every 0.2 s (0.6 s around a flash operation), or the board restarts.
    void (*watchdog_feed)(void *context);
    /// Keeps the control step out, until unlock gets what lock returned. Task.
    uint32_t (*lock)(void *context);
    void (*unlock)(void *context, uint32_t state);
    /// Restarts the board soon after the call, into the chip's boot loader where asked. Task.
    void (*reboot)(void *context, bool bootloader);

    const tl_port_update_t *update; ///< NULL: new firmware does not come over USB
} tl_port_t;

#endif
