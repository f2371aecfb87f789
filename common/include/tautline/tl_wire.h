/// Every message between board and host, and the frame it travels in.
///
/// Each message is one field list below. The C structs, their encoding, and (through the native module) the host's
/// Python view come from these lists; nothing about a message is written down anywhere else.
///
/// A frame on the bulk pipe or the serial line, little-endian, no padding:
///
///     magic u16 | type u8 | header check u8 | payload length u16 | sequence u16 | payload | CRC-32 u32
///
/// The header check (see tl_wire_frame) lets a receiver drop a false header at once; the CRC covers header and payload.
/// Frames are length-prefixed and may start anywhere in a packet: short packets and zero-length packets mean nothing.
/// A receiver that finds garbage looks for the next magic number and loses nothing that was whole.
///
/// Requests carry a sequence of the host's; the reply carries the same one. What a board sends unasked counts in a
/// sequence of its own, so that a gap shows. A request is answered by the reply that its comment names, or by `error`.
/// `set_point` and `marker` are answered only when refused.
///
/// A newer minor version adds messages and appends fields: a receiver takes a longer payload than it knows and ignores
/// the rest, and refuses a shorter one. Anything else raises the major version (also in USB's bcdDevice).
#ifndef TAUTLINE_TL_WIRE_H
#define TAUTLINE_TL_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TL_WIRE_MAJOR            2
#define TL_WIRE_MINOR            5
#define TL_WIRE_USB_VENDOR       0x1209U ///< pid.codes
#define TL_WIRE_USB_PRODUCT      0x0001U ///< its test product: for development, never to be sold under
#define TL_WIRE_USB_MANUFACTURER "tautline"
#define TL_WIRE_SERIAL_BAUD      921600U ///< of a board with a serial port: 8 data bits, no parity, 1 stop bit
#define TL_WIRE_USB_PACKET       64U     ///< of both bulk endpoints, 0x01 and 0x81, of interface 0; interface 1 is DFU

#define TL_WIRE_MAGIC       0x7E54U
#define TL_WIRE_HEADER_SIZE 8U
#define TL_WIRE_CRC_SIZE    4U
#define TL_WIRE_PAYLOAD_MAX 256U
#define TL_WIRE_FRAME_MAX   (TL_WIRE_HEADER_SIZE + TL_WIRE_PAYLOAD_MAX + TL_WIRE_CRC_SIZE)

#define TL_WIRE_AXES_MAX      4U
#define TL_WIRE_ALL_AXES      0xFFU ///< accepted as `axis` by enable (off only), safe_stop, clear_fault, telemetry
#define TL_WIRE_BATCH_SAMPLES 8U    ///< telemetry samples in a frame
#define TL_WIRE_DIVIDER_MAX   60U   ///< of telemetry: its period fits 16 bits of microseconds
#define TL_WIRE_KEY           0x74617574U ///< what reboot and settings ask for, so that no stray byte does either

// Field lists: F(kind, name, doc) is one value, A(kind, name, count, doc) an array. Kinds: u8 u16 u32 u64 i8 i16 i32,
// and text (count bytes, padded with 0). Suffixes as in tl_fixed.h; _q8 counts, _q16 deg, _q12 px, _q15 ratio or duty.

// -- host to board ----------------------------------------------------------------------------------------------

#define TL_WIRE_FIELDS_HELLO(F, A)                                                                                     \
    F(u16, protocol_major, "the host's")                                                                               \
    F(u16, protocol_minor, "the host's")

#define TL_WIRE_FIELDS_PING(F, A) F(u64, host_us, "host's clock, echoed")

#define TL_WIRE_FIELDS_GET_STATUS(F, A) F(u8, axis, "")

#define TL_WIRE_FIELDS_GET_COUNTERS(F, A) F(u8, clear, "1: back to 0 after this reading")

#define TL_WIRE_FIELDS_ENABLE(F, A)                                                                                    \
    F(u8, axis, "or all (off only)")                                                                                   \
    F(u8, on, "1: hold where it is, after a check where one is due; 0: motor off, after coming to rest within limits")

#define TL_WIRE_FIELDS_FOLLOW(F, A)                                                                                    \
    F(u8, axis, "enabled, at rest, referenced")                                                                        \
    F(u8, target, "what set_point's value is: 0 motor position, 1 configuration, through the tables")                  \
    F(u8, compensation, "of a configuration: 0 coarse kinematics alone, 1 and backlash, 2 f_remain and backlash")      \
    F(u32, silence_us, "without a set_point for so long the axis comes to rest and holds; 0: the default, 100 ms")

#define TL_WIRE_FIELDS_SET_POINT(F, A)                                                                                 \
    F(u8, axis, "following")                                                                                           \
    F(i32, value, "counts Q8 or deg Q16, as follow said")                                                              \
    F(u64, at_us, "board time at which it holds, joined by straight lines; 0: a period of the sender from now")

#define TL_WIRE_FIELDS_MOVE(F, A)                                                                                      \
    F(u8, axis, "enabled, referenced, not calibrating")                                                                \
    F(i32, q_q8, "counts: go there within speed and acceleration, then hold")                                          \
    F(i32, speed_q8_s, "counts/s; 0: the limit")                                                                       \
    F(u32, silence_us, "without any message from the host for so long it comes to rest and faults; 0: 1 s")

#define TL_WIRE_FIELDS_JOG(F, A)                                                                                       \
    F(u8, axis, "enabled, at rest; needs no reference")                                                                \
    F(i32, way_q8, "counts from here, at low duty, without regard to position limits; then hold")                      \
    F(i32, speed_q8_s, "counts/s; 0: a tenth of the limit, and never more than half of it")                            \
    F(u32, silence_us, "as move's")

#define TL_WIRE_FIELDS_HOME(F, A)                                                                                      \
    F(u8, axis, "enabled, at rest; needs no reference")                                                                \
    F(i8, direction, "of the mechanical end: -1 or 1")                                                                 \
    F(i32, duty_q15, "drive that may press against the end; 0: the settings' low duty, which is also the most")        \
    F(i32, speed_q8_s, "counts/s; 0: a tenth of the limit, and never more than half of it")                            \
    F(i32, reach_q8, "counts within which the end must be")                                                            \
    F(i32, end_q8, "counts: what the position is there")                                                               \
    F(i32, retreat_q8, "counts to go back from it, then hold")                                                         \
    F(u32, silence_us, "as move's")

#define TL_WIRE_FIELDS_CHECK(F, A) F(u8, axis, "motor off: drives a little either way, as the first enable does")

#define TL_WIRE_FIELDS_STRENGTH(F, A)                                                                                  \
    F(u8, axis, "")                                                                                                    \
    F(i32, strength_q15, "0: no compensation of the lost motion, 32768: all of it")

#define TL_WIRE_FIELDS_ADAPT(F, A)                                                                                     \
    F(u8, axis, "")                                                                                                    \
    F(i32, offset_q8, "counts: the motor pushes as if it were so much further on than its encoder reads")              \
    F(i32, scale_q15, "of B, 32768: as calibrated")                                                                    \
    F(u16, within_ms, "time on the way there; longer where that were more than half a count in 1 ms")

#define TL_WIRE_FIELDS_LOAD(F, A)                                                                                      \
    F(u8, axis, "")                                                                                                    \
    F(i32, load_q8, "mNm")                                                                                             \
    F(u16, within_ms, "as adapt's")

#define TL_WIRE_FIELDS_SET_POSITION(F, A)                                                                              \
    F(u8, axis, "motor off")                                                                                           \
    F(i32, q_q8, "counts: what the present position is from now on: the axis is referenced")

#define TL_WIRE_VALUES_LIMITS(F, A)                                                                                    \
    F(i32, q_low_q8, "counts")                                                                                         \
    F(i32, q_high_q8, "counts")                                                                                        \
    F(i32, speed_q8_s, "counts/s")                                                                                     \
    F(i32, acceleration_q8_s2, "counts/s2")                                                                            \
    F(i32, duty_q15, "most drive, 0 to 32768")                                                                         \
    F(i32, current_ma, "mean over 20 ms above which the axis faults; 0: not watched")                                  \
    F(i32, following_error_q8, "counts between reference and position above which the axis faults")

#define TL_WIRE_FIELDS_LIMITS(F, A)                                                                                    \
    F(u8, axis, "off or holding. In force until the board restarts; within its settings, which no limits widen")       \
    TL_WIRE_VALUES_LIMITS(F, A)

#define TL_WIRE_FIELDS_GET_LIMITS(F, A) F(u8, axis, "")

#define TL_WIRE_GAIN_MAX 32767 ///< of each value of a servo; none is below 0

#define TL_WIRE_VALUES_SERVO(F, A)                                                                                     \
    F(i32, proportional, "duty Q15 per count")                                                                         \
    F(i32, integral, "duty Q15 per count and second")                                                                  \
    F(i32, derivative, "duty Q15 per 1000 counts/s")                                                                   \
    F(i32, feed_forward, "duty Q15 per 1000 counts/s of the reference")                                                \
    F(i32, inertia, "duty Q15 per 100000 counts/s2 of the reference")                                                  \
    F(i32, friction_q15, "duty in the direction of the reference's motion: the dead band")

#define TL_WIRE_FIELDS_SERVO(F, A)                                                                                     \
    F(u8, axis, "motor off. To be tried until the board restarts; the next enable checks motor and encoder")           \
    TL_WIRE_VALUES_SERVO(F, A)

#define TL_WIRE_FIELDS_GET_SERVO(F, A) F(u8, axis, "")

// What belongs to the board, its motor and its instrument. Kept in flash in this very form, without key.
#define TL_WIRE_FIELDS_SETTINGS(F, A)                                                                                  \
    F(u8, axis, "all motors off. In force at once, with the gains; the next enable checks motor and encoder")          \
    F(u32, key, "TL_WIRE_KEY; 0 in an answer")                                                                         \
    TL_WIRE_VALUES_LIMITS(F, A)                                                                                        \
    TL_WIRE_VALUES_SERVO(F, A)                                                                                         \
    F(i32, low_duty_q15, "most drive of check, homing and jog")                                                        \
    F(i32, arrive_q8, "counts within which a move has arrived, 1 or more")                                             \
    F(u16, stall_ms, "driven for so long with the motor still is a stall, 20 to 5000")                                 \
    F(u16, supply_low_mv, "motor supply below it faults a driven axis; 0: not watched")                                \
    A(text, instrument, 8, "serial of the instrument that is mounted; empty: tables of any are taken")                 \
    F(u32, hold_ms, "held for so long without a word of a host the drive sinks to nothing within a second; 0: never")  \
    F(u8, group, "axes of one group go off together where one of them faults, 1 to 4; 0: of none")                     \
    F(u8, estop, "TL_WIRE_ESTOPS: how the stop input is wired; as many axes as have it wired so stop by it")           \
    F(u8, commissioned, "1: motor, range and ends are known; 0: low duty at most, and as slow as that can be followed")

#define TL_WIRE_FIELDS_GET_SETTINGS(F, A) F(u8, axis, "")

#define TL_WIRE_FIELDS_ANY_TABLE(F, A) F(u8, axis, "its next table may be one made for another instrument")

#define TL_WIRE_FIELDS_TELEMETRY(F, A)                                                                                 \
    F(u8, axis, "or all")                                                                                              \
    F(u8, divider, "1: 1 kHz, n: 1 kHz / n up to 60, 0: off. Off after a reset of board or bus")

#define TL_WIRE_FIELDS_MARKER(F, A)                                                                                    \
    F(u8, valid, "0: the frame shows no marker")                                                                       \
    F(u8, other_motion, "1: translation, rotation or the scene moved: the reversal does not count")                    \
    F(u64, arrival_us, "board time at which the frame arrived")                                                        \
    F(i32, u_q12, "px")                                                                                                \
    F(i32, v_q12, "px")                                                                                                \
    F(i32, sigma_q12, "px, one standard deviation per coordinate; 0: unknown")

#define TL_WIRE_FIELDS_MOTION_START(F, A)                                                                              \
    F(u8, axis, "enabled, at rest, referenced")                                                                        \
    F(u8, cycles, "turning points of a pass, 1 to 100")                                                                \
    F(i32, low_q8, "counts: the range to cover")                                                                       \
    F(i32, high_q8, "counts")                                                                                          \
    A(i32, speed_q8_s, 4, "counts/s, measuring speeds, one pass up and one down each; 0 ends the list")                \
    F(i32, transit_q8_s, "counts/s of moves that measure nothing")                                                     \
    F(i32, acceleration_q8_s2, "counts/s2")                                                                            \
    F(i32, approach_q8, "counts at measuring speed on the envelope before each turn")                                  \
    F(i32, stroke_max_q8, "counts: a reversal without an onset ends here; more than any backlash")                     \
    F(u32, host_timeout_us, "without a marker message for so long the host is lost; not 0")                            \
    F(u32, delay_us, "nominal time from scene to arrival of a frame")                                                  \
    F(u32, guard_us, "its uncertainty; this and the following: 0 is tl_onset.h's default")                             \
    F(u32, lost_us, "a marker away for longer spoils the reversal")                                                    \
    F(u32, timeout_us, "longest time from a turn to its onset")                                                        \
    F(i32, turn_q8, "counts of retreat that are a turn")                                                               \
    F(i32, sigma_wanted_q8, "counts: an onset as good as this is finished")                                            \
    F(i32, sigma_usable_q8, "counts: one worse than this is not used")                                                 \
    F(i32, noise_q12, "px of marker noise where a sample states none")                                                 \
    F(u32, curvature, "relative change of the image's slope, 1/2^20 for a count")                                      \
    F(u16, threshold_q4, "likelihood ratio that confirms")                                                             \
    F(u8, frames_min, "fewest on the level and after the knot")                                                        \
    F(u8, frames_max, "after the knot that end a reversal in any case")

#define TL_WIRE_FIELDS_MOTION_STOP(F, A) F(u8, axis, "")
#define TL_WIRE_FIELDS_SAFE_STOP(F, A)   F(u8, axis, "or all: motor off at once, compensation off, from any state")
#define TL_WIRE_FIELDS_CLEAR_FAULT(F, A) F(u8, axis, "or all")

#define TL_WIRE_FIELDS_CLEAR_TABLE(F, A) F(u8, axis, "all motors off; both slots are erased, the axis is identity")

#define TL_WIRE_FIELDS_REBOOT(F, A)                                                                                    \
    F(u32, key, "TL_WIRE_KEY")                                                                                         \
    F(u8, bootloader, "1: into the chip's boot loader, to be given new firmware")

#define TL_WIRE_PART 192 ///< bytes of a table in one message

#define TL_WIRE_FIELDS_TABLE_WRITE(F, A)                                                                               \
    F(u8, axis, "")                                                                                                    \
    F(u8, count, "bytes of it that are the table's, 1 to 192")                                                         \
    F(u16, offset, "of the first; 0 begins anew, each part follows the one before")                                    \
    A(u8, bytes, 192, "of the blob of tl_table.h")

#define TL_WIRE_FIELDS_TABLE_STORE(F, A)                                                                               \
    F(u8, axis, "all motors off")                                                                                      \
    F(u16, size, "of the whole table: as many bytes as were written")

#define TL_WIRE_FIELDS_TABLE_READ(F, A)                                                                                \
    F(u8, axis, "")                                                                                                    \
    F(u16, offset, "")

#define TL_WIRE_FIELDS_GET_FIRMWARE(F, A) F(u8, reserved, "0")

#define TL_WIRE_FIELDS_GET_LOGGED(F, A) F(u8, index, "0: the newest fault")

#define TL_WIRE_FIELDS_ANY_FIRMWARE(F, A) F(u32, key, "TL_WIRE_KEY; the next firmware may be older than what runs")

// -- board to host ----------------------------------------------------------------------------------------------

#define TL_WIRE_FIELDS_LOGGED(F, A)                                                                                    \
    F(u32, number, "rises by one with each fault that is logged; 0: there are not as many")                            \
    F(u32, run, "of the start in which it came: counts those in which something was logged")                           \
    F(u32, run_now, "the present one's")                                                                               \
    F(u8, axis, "")                                                                                                    \
    F(u8, fault, "TL_WIRE_FAULTS")                                                                                     \
    F(i32, value, "what was measured: a status' fault_value")                                                          \
    F(u64, t_us, "since that start")                                                                                   \
    F(i32, q_q8, "counts: where the axis was soon after")

// Not sent by itself: the first page of an image in an update file is the frame of this message, then zeros.
#define TL_WIRE_IMAGE_SIGNED (TL_WIRE_SIZE_IMAGE - 64U) ///< bytes of its payload that the signature is over
#define TL_WIRE_FIELDS_IMAGE(F, A)                                                                                     \
    F(u8, format, "1")                                                                                                 \
    F(u8, slot, "that it is linked for, 0 or 1; 255: any")                                                             \
    A(u8, version, 3, "major, minor, patch")                                                                           \
    F(u8, protocol_major, "that it speaks")                                                                            \
    F(u8, protocol_minor, "")                                                                                          \
    A(text, port, 16, "the board that it is for: an identity's port, with fewer axes than 4 -N")                       \
    F(u32, size, "bytes of the image, which follows the page; a multiple of 256")                                      \
    A(u8, hash, 32, "BLAKE2b-256 of the image")                                                                        \
    A(u8, signature, 64, "EdDSA over Curve25519 with BLAKE2b, of all before it")

#define TL_WIRE_FIELDS_FIRMWARE(F, A)                                                                                  \
    F(u8, state, "TL_WIRE_FIRMWARES: what runs")                                                                       \
    F(u8, slot, "that it runs from, 0 or 1; 255: of none, and the board takes no update")                              \
    A(u8, version, 3, "that runs")                                                                                     \
    F(u8, other_state, "TL_WIRE_FIRMWARES: what the other slot holds, where an update goes")                           \
    A(u8, other_version, 3, "")                                                                                        \
    F(u8, refused, "TL_WIRE_UPDATES: why the last update was")                                                         \
    F(u32, room, "bytes that an image may have")                                                                       \
    A(u8, key, 32, "public key with which updates have to be signed")

#define TL_WIRE_FIELDS_IDENTITY(F, A)                                                                                  \
    F(u16, protocol_major, "")                                                                                         \
    F(u16, protocol_minor, "")                                                                                         \
    A(u8, firmware, 3, "version: major, minor, patch")                                                                 \
    F(u8, axes, "1 to 4")                                                                                              \
    F(u16, table_version, "format of the table blob that it reads")                                                    \
    F(u16, table_nodes_max, "")                                                                                        \
    F(u32, control_hz, "")                                                                                             \
    F(u64, t_us, "board time")                                                                                         \
    F(u8, boot, "why it started: TL_WIRE_BOOTS")                                                                       \
    F(u16, driver_ma, "at which its motor drivers limit the current by themselves: the most that limits may say")      \
    A(text, port, 16, "which board: desktop, rp2040")                                                                  \
    A(text, serial, 32, "")                                                                                            \
    A(text, build, 32, "")

#define TL_WIRE_FIELDS_PONG(F, A)                                                                                      \
    F(u64, host_us, "as the ping's")                                                                                   \
    F(u64, t_us, "board time")

#define TL_WIRE_FIELDS_STATUS(F, A)                                                                                    \
    F(u8, axis, "")                                                                                                    \
    F(u8, mode, "TL_WIRE_MODES")                                                                                       \
    F(u8, fault, "TL_WIRE_FAULTS; stays until cleared")                                                                \
    F(u8, table, "TL_WIRE_TABLES")                                                                                     \
    F(u8, table_reason, "why the last table was refused: tl_table.h's reason, 0 none")                                 \
    F(u16, flags, "TL_WIRE_FLAGS")                                                                                     \
    F(u32, table_sequence, "rises by one with each table stored; 0: none")                                             \
    F(u32, table_crc, "CRC-32 that ends the blob in use, of all before it")                                            \
    F(u64, t_us, "")                                                                                                   \
    F(u64, fault_us, "when the fault came")                                                                            \
    F(i32, q_q8, "counts, measured")                                                                                   \
    F(i32, q_ref_q8, "counts, reference")                                                                              \
    F(i32, c_ref_q16, "deg, demanded")                                                                                 \
    F(i32, c_est_q16, "deg, estimated from q by the play operator and f_remain")                                       \
    F(i32, duty_q15, "")                                                                                               \
    F(i32, current_ma, "")                                                                                             \
    F(i32, strength_q15, "")                                                                                           \
    F(u16, supply_mv, "of the motors; 0: not measured")                                                                \
    F(u8, settings, "TL_WIRE_STORES")                                                                                  \
    F(i32, fault_value, "what was measured when the fault came, in the unit that its text names; else 0")

#define TL_WIRE_FIELDS_COUNTERS(F, A)                                                                                  \
    F(u64, t_us, "")                                                                                                   \
    F(u32, frames_in, "whole frames received")                                                                         \
    F(u32, bytes_bad, "received bytes that belong to no whole frame")                                                  \
    F(u32, requests_refused, "answered by error")                                                                      \
    F(u32, frames_out, "handed to USB")                                                                                \
    F(u32, replies_dropped, "no room: the host did not read")                                                          \
    F(u32, telemetry_dropped, "samples that found no room")                                                            \
    F(u32, onsets_dropped, "no room")                                                                                  \
    F(u32, events_dropped, "no room")                                                                                  \
    F(u32, set_points, "accepted")                                                                                     \
    F(u32, set_points_late, "their time had passed: taken at once")                                                    \
    F(u32, set_points_dropped, "queue full, or refused")                                                               \
    F(u32, markers, "accepted")                                                                                        \
    F(u32, markers_dropped, "out of order, from the future or older than the encoder history")                         \
    F(u32, silences, "senders that went silent")                                                                       \
    F(u32, overruns, "control steps that were late")                                                                   \
    F(u32, bus_losses, "times that a host left the bus, or was lost")

#define TL_WIRE_FIELDS_TABLE_PART(F, A)                                                                                \
    F(u8, axis, "")                                                                                                    \
    F(u8, count, "bytes that are the table's; fewer than 192 is the end")                                              \
    F(u16, offset, "of the first")                                                                                     \
    A(u8, bytes, 192, "of the blob in use")

#define TL_WIRE_FIELDS_BATCH(F, A)                                                                                     \
    F(u8, axis, "")                                                                                                    \
    F(u8, count, "samples filled, the others are 0")                                                                   \
    F(u16, period_us, "")                                                                                              \
    F(u16, supply_mv, "of the motors; 0: not measured")                                                                \
    F(u64, t_us, "of the first sample")                                                                                \
    A(i32, q_q8, 8, "counts")                                                                                          \
    A(i32, q_ref_q8, 8, "counts")                                                                                      \
    A(i32, p_q8, 8, "counts: the play's centre coordinate, estimated")                                                 \
    A(i32, c_ref_q16, 8, "deg")                                                                                        \
    A(i32, c_est_q16, 8, "deg")                                                                                        \
    A(i16, duty_q15, 8, "32768 is shown as 32767")                                                                     \
    A(u16, flags, 8, "TL_WIRE_FLAGS")

#define TL_WIRE_FIELDS_ONSET(F, A)                                                                                     \
    F(u8, axis, "")                                                                                                    \
    F(i8, direction, "sign of dq after the turn")                                                                      \
    F(u8, reason, "tl_onset_reason_t; 0: it counts")                                                                   \
    F(u16, index, "counts reversals from the motion's start")                                                          \
    F(u16, frames, "valid samples between the turn and the end of the reversal")                                       \
    F(u64, turn_us, "when the motor turned")                                                                           \
    F(u64, start_us, "scene time at which the image began to move; turn_us where it did not")                          \
    F(i32, q1_q8, "counts: where the motor turned. This and the following: 2147483647 is not measured")                \
    F(i32, q2_q8, "counts: where the image began to move")                                                             \
    F(i32, width_q8, "counts, |q2 - q1|; a lower bound where no start was seen")                                       \
    F(i32, sigma_q8, "counts, of the width")                                                                           \
    F(i32, stop_q8, "counts beyond q1, along the approach, at which the image stopped")                                \
    F(i32, sigma_stop_q8, "counts")                                                                                    \
    F(i32, speed_stop_q8_s, "counts/s on the approach")                                                                \
    F(i32, speed_start_q8_s, "counts/s across the start")                                                              \
    F(i32, slope_q12, "px for 256 counts of motor, after the start")                                                   \
    F(i32, noise_q12, "px, as measured so far")

#define TL_WIRE_FIELDS_PROGRESS(F, A)                                                                                  \
    F(u8, axis, "")                                                                                                    \
    F(u8, state, "TL_WIRE_MOTIONS")                                                                                    \
    F(u16, permille, "1000: complete")                                                                                 \
    F(u16, reversals, "finished so far")                                                                               \
    F(u64, t_us, "")

#define TL_WIRE_FIELDS_EVENT(F, A)                                                                                     \
    F(u8, axis, "")                                                                                                    \
    F(u8, event, "TL_WIRE_EVENTS")                                                                                     \
    F(u8, fault, "TL_WIRE_FAULTS")                                                                                     \
    F(u8, mode, "TL_WIRE_MODES, after it")                                                                             \
    F(u64, t_us, "")

#define TL_WIRE_FIELDS_ACK(F, A) F(u8, request, "type of the request that was done")

#define TL_WIRE_FIELDS_ERROR(F, A)                                                                                     \
    F(u8, request, "type of the request that was refused")                                                             \
    F(u8, reason, "TL_WIRE_REASONS")

// -- M(code, NAME, name, doc) -----------------------------------------------------------------------------------

#define TL_WIRE_MESSAGES(M)                                                                                            \
    M(0x01, HELLO, hello, "-> identity; answered whatever the version")                                                \
    M(0x02, PING, ping, "-> pong")                                                                                     \
    M(0x03, GET_STATUS, get_status, "-> status")                                                                       \
    M(0x04, GET_COUNTERS, get_counters, "-> counters")                                                                 \
    M(0x05, ENABLE, enable, "-> ack")                                                                                  \
    M(0x06, FOLLOW, follow, "-> ack")                                                                                  \
    M(0x07, SET_POINT, set_point, "no answer unless refused")                                                          \
    M(0x08, MOVE, move, "-> ack; an event when it is there")                                                           \
    M(0x09, STRENGTH, strength, "-> ack")                                                                              \
    M(0x0A, SET_POSITION, set_position, "-> ack")                                                                      \
    M(0x0B, LIMITS, limits, "-> ack; as an answer: get_limits'")                                                       \
    M(0x0C, GET_LIMITS, get_limits, "-> limits")                                                                       \
    M(0x0D, SERVO, servo, "-> ack; as an answer: get_servo's")                                                         \
    M(0x0E, GET_SERVO, get_servo, "-> servo")                                                                          \
    M(0x0F, TELEMETRY, telemetry, "-> ack, then batch")                                                                \
    M(0x10, MARKER, marker, "no answer unless refused")                                                                \
    M(0x11, MOTION_START, motion_start, "-> ack, then onset and progress")                                             \
    M(0x12, MOTION_STOP, motion_stop, "-> ack; comes to rest within limits, then holds")                               \
    M(0x13, SAFE_STOP, safe_stop, "-> ack")                                                                            \
    M(0x14, CLEAR_FAULT, clear_fault, "-> ack")                                                                        \
    M(0x15, CLEAR_TABLE, clear_table, "-> ack")                                                                        \
    M(0x16, REBOOT, reboot, "-> ack, then the board is gone from the bus")                                             \
    M(0x17, SETTINGS, settings, "-> ack; as an answer: get_settings'")                                                 \
    M(0x18, GET_SETTINGS, get_settings, "-> settings")                                                                 \
    M(0x19, HOME, home, "-> ack; an event when it is there, then referenced")                                          \
    M(0x1A, JOG, jog, "-> ack; an event when it is there")                                                             \
    M(0x1B, CHECK, check, "-> ack; an event when motor and encoder agree, then it holds")                              \
    M(0x1C, ANY_TABLE, any_table, "-> ack")                                                                            \
    M(0x1D, ADAPT, adapt, "-> ack; moves the table in use, as far as the table allows, until the host is lost")        \
    M(0x1E, LOAD, load, "-> ack; the load that tables with a load section go by; at first that of the calibration")    \
    M(0x20, TABLE_WRITE, table_write, "-> ack; a part of a table, kept until the last one has come")                   \
    M(0x21, TABLE_STORE, table_store, "-> ack: the parts are checked, stored and used, as DFU does")                   \
    M(0x22, TABLE_READ, table_read, "-> table_part, of the table in use")                                              \
    M(0x23, GET_FIRMWARE, get_firmware, "-> firmware")                                                                 \
    M(0x24, ANY_FIRMWARE, any_firmware, "-> ack")                                                                      \
    M(0x25, GET_LOGGED, get_logged, "-> logged")                                                                       \
    M(0x80, ACK, ack, "")                                                                                              \
    M(0x81, ERROR, error, "")                                                                                          \
    M(0x82, IDENTITY, identity, "")                                                                                    \
    M(0x83, PONG, pong, "")                                                                                            \
    M(0x84, STATUS, status, "")                                                                                        \
    M(0x85, COUNTERS, counters, "")                                                                                    \
    M(0x88, TABLE_PART, table_part, "as an answer: table_read's")                                                      \
    M(0x89, FIRMWARE, firmware, "")                                                                                    \
    M(0x8A, IMAGE, image, "the head of an update file")                                                                \
    M(0x8B, LOGGED, logged, "a fault out of the board's log in flash")                                                 \
    M(0x90, BATCH, batch, "unasked: telemetry of one axis")                                                            \
    M(0x91, ONSET, onset, "unasked: one reversal, during a calibration motion")                                        \
    M(0x92, PROGRESS, progress, "unasked: after each reversal and at the end of the motion")                           \
    M(0x93, EVENT, event, "unasked")

/// Those that a later minor version added, or made longer: S(name, minor).
#define TL_WIRE_SINCE(S)                                                                                               \
    S(adapt, 1)                                                                                                        \
    S(load, 1)                                                                                                         \
    S(settings, 4)                                                                                                     \
    S(get_settings, 4)                                                                                                 \
    S(get_firmware, 5)                                                                                                 \
    S(any_firmware, 5)                                                                                                 \
    S(get_logged, 5)

// -- codes: C(code, NAME, text) ---------------------------------------------------------------------------------

#define TL_WIRE_REASONS(C)                                                                                             \
    C(1, UNKNOWN_TYPE, "this firmware does not know the message: flash newer firmware")                                \
    C(2, SHORT, "the message is too short: host and board speak different versions")                                   \
    C(3, AXIS, "the board has no such axis")                                                                           \
    C(4, RANGE, "a value is out of its range")                                                                         \
    C(5, FAULT, "the axis has a fault: read its status, then clear the fault")                                         \
    C(6, OFF, "the axis is off: enable it first")                                                                      \
    C(7, NOT_OFF, "the axis is enabled: switch it off first")                                                          \
    C(8, BUSY, "the axis is moving: wait until it rests, or stop it")                                                  \
    C(9, NOT_FOLLOWING, "the axis does not follow set-points: send follow first")                                      \
    C(10, QUEUE_FULL, "more set-points ahead of time than the board holds")                                            \
    C(11, NO_TABLE, "the axis has no table: flash one first")                                                          \
    C(12, FLASH, "the flash could not be written")                                                                     \
    C(13, KEY, "wrong key")                                                                                            \
    C(14, MOTION_RANGE, "calibration motion: low + stroke_max + 2 approach must be below high")                        \
    C(15, MOTION_SPEED, "calibration motion: 1 to 4 speeds, each 1/4 count/s or more and at most transit")             \
    C(16, MOTION_ACCELERATION, "calibration motion: the acceleration is too small to stop within the range")           \
    C(17, MOTION_STROKE, "calibration motion: approach must be a count or more, stroke_max above it")                  \
    C(18, MOTION_CYCLES, "calibration motion: 1 to 100 cycles")                                                        \
    C(19, MOTION_RATE, "calibration motion: transit is too fast for the control rate")                                 \
    C(20, ONSET, "calibration motion: a setting of the onset detector is out of its range")                            \
    C(21, NOT_CALIBRATING, "no calibration motion is under way")                                                       \
    C(22, NOT_REFERENCED, "the axis does not know its position: home it, or say where it stands")                      \
    C(23, BEYOND_SETTINGS, "wider than the settings stored on the board: change those, or ask for less")               \
    C(24, BEYOND_TABLE, "further from the calibrated table than it allows: calibrate again, or flash wider limits")    \
    C(25, GROUP, "another axis of its group has a fault: see to that one, and clear it, first")                        \
    C(26, ESTOP, "the stop input is still active: release the stop button, then clear again")                          \
    C(30, TABLE_SIZE, "the table is too long, or its parts are not in order: send it again")                           \
    C(31, TABLE_REFUSED, "the table was refused: the axis' status says why")                                           \
    C(32, SESSION, "the board has restarted: say hello first")

// Each says what to do; a number in brackets is what fault_value holds.
#define TL_WIRE_FAULTS(C)                                                                                              \
    C(0, NONE, "none")                                                                                                 \
    C(1, FOLLOWING, "the motor did not follow (by counts): free it, check its supply and the encoder's plug")          \
    C(2, CURRENT, "motor current over its limit (mA): free the motor, or raise the limit in the settings")             \
    C(3, HOST_LOST, "the host was lost during a motion: start it again")                                               \
    C(4, TABLE, "no valid table in either slot, though one was stored: flash it again")                                \
    C(5, OVERRUN, "control steps came late (by us): report it with the board's counters")                              \
    C(6, WATCHDOG, "the firmware hung and was restarted by the watchdog: report it")                                   \
    C(7, STOPPED, "stopped by safe_stop")                                                                              \
    C(8, ENCODER, "the encoder jumped (by counts): check its plug and screen, then home the axis")                     \
    C(9, EDGES, "encoder edges were lost (at counts/s): go slower, or check its plug and screen, then home the axis")  \
    C(10, STALL, "driven, and the motor stood still (at duty 1/32768): free it, check the encoder, or raise limits")   \
    C(11, DRIVER, "the motor driver reports over-current, heat or low voltage: check motor wires for a short")         \
    C(12, SUPPLY, "the motors' supply is too low (mV): check power supply and fuse")                                   \
    C(13, OSCILLATION, "the drive swung between its limits: lower the servo gains")                                    \
    C(14, REVERSED, "motor and encoder count against each other (by counts): swap the motor's two wires")              \
    C(15, SCALE, "the motor turned at another speed than the gains say (counts/s): check encoder and feed_forward")    \
    C(16, UNMOVED, "at low drive the encoder saw no motion: check motor and encoder plugs, supply, and what blocks")   \
    C(17, NO_END, "no end was found within the reach (counts gone): check the direction, or allow more reach")         \
    C(18, SETTINGS, "the settings in flash are damaged: commission the axis again")                                    \
    C(19, GROUP, "another axis of its group has a fault (axis): see to that one, then clear both")                     \
    C(20, ESTOP, "stopped by the stop input: release the stop button, or say how it is wired, then clear the fault")

#define TL_WIRE_MODES(C)                                                                                               \
    C(0, OFF, "motor off")                                                                                             \
    C(1, HOLD, "holds its position")                                                                                   \
    C(2, MOVE, "moves to a position")                                                                                  \
    C(3, FOLLOW_MOTOR, "follows motor positions")                                                                      \
    C(4, FOLLOW_TIP, "follows configurations through the tables")                                                      \
    C(5, CALIBRATE, "calibration motion")                                                                              \
    C(6, STOPPING, "comes to rest, then holds")                                                                        \
    C(7, STOPPING_OFF, "comes to rest, then switches off")                                                             \
    C(8, CHECK, "checks motor and encoder at low drive, then holds")                                                   \
    C(9, HOME, "looks for a mechanical end at low drive, then holds")

#define TL_WIRE_STORES(C)                                                                                              \
    C(0, DEFAULT, "never stored: the port's defaults")                                                                 \
    C(1, NEWEST, "the newest stored ones")                                                                             \
    C(2, OLDER, "those before: the newest are damaged")                                                                \
    C(3, BAD, "none of those stored is whole: the port's defaults")

#define TL_WIRE_ESTOPS(C)                                                                                              \
    C(0, CLOSED, "closed, or low, is a stop: a contact that closes. Nothing wired is none")                            \
    C(1, OPEN, "open, or high, is a stop: a contact that opens. A broken wire stops, too")

#define TL_WIRE_TABLES(C)                                                                                              \
    C(0, NONE, "none: identity")                                                                                       \
    C(1, NEWEST, "the newest stored one")                                                                              \
    C(2, OLDER, "the one before: the newest is damaged")                                                               \
    C(3, BAD, "none of those stored is valid")

#define TL_WIRE_FIRMWARES(C)                                                                                           \
    C(0, NONE, "no firmware that counts")                                                                              \
    C(1, CONFIRMED, "firmware that a host has talked to")                                                              \
    C(2, TRIAL, "new firmware, on trial until a host has talked to it")                                                \
    C(3, FAILED, "firmware that did not come up, or that no host talked to in its trial")

#define TL_WIRE_UPDATES(C)                                                                                             \
    C(0, NONE, "none was refused")                                                                                     \
    C(1, NO_SLOT, "this board takes no update over USB: flash it as the first time")                                   \
    C(2, DAMAGED, "the file is damaged or cut short: get it again")                                                    \
    C(3, PORT, "the file is for another board, or for another number of axes")                                         \
    C(4, LINKED, "the file holds no image for the slot that is free: send the whole file")                             \
    C(5, OLDER, "the file is older than the firmware that runs: taut update --force takes it all the same")            \
    C(6, SIGNATURE, "the file is not signed with the key that this board trusts")                                      \
    C(7, HASH, "what arrived is not what was signed: send it again")                                                   \
    C(8, FLASH, "the flash could not be written: send it again, or the flash is worn")                                 \
    C(9, SIZE, "the image is larger than its slot")                                                                    \
    C(10, NOT_OFF, "a motor is on: firmware is loaded with every motor off")                                           \
    C(11, TRIAL, "the firmware that runs is itself on trial: wait two seconds, then send again")

#define TL_WIRE_FLAGS(C)                                                                                               \
    C(0x0001, ENABLED, "the motor is driven")                                                                          \
    C(0x0002, AT_REST, "the reference rests")                                                                          \
    C(0x0004, FAULT, "faulted")                                                                                        \
    C(0x0008, SATURATED_RANGE, "the command is beyond the tables or the position limits: held at the end")             \
    C(0x0010, SATURATED_SPEED, "the command is faster than the limits")                                                \
    C(0x0020, SATURATED_DUTY, "the drive is at its limit")                                                             \
    C(0x0040, TAKE_UP, "crossing the backlash")                                                                        \
    C(0x0080, COMPENSATING, "tables in use")                                                                           \
    C(0x0100, SILENT, "the last sender went silent")                                                                   \
    C(0x0200, REFERENCED, "the position is known")                                                                     \
    C(0x0400, CHECKED, "motor and encoder agree in sign and scale")                                                    \
    C(0x0800, DRIVER_FAULT, "the motor driver reports a fault (nFAULT)")                                               \
    C(0x1000, ESTOP, "the stop input is active")                                                                       \
    C(0x2000, COMMISSIONED, "of a status alone: commissioned, so that it is driven at more than low duty")

#define TL_WIRE_MOTIONS(C)                                                                                             \
    C(0, IDLE, "never started")                                                                                        \
    C(1, RUNNING, "running")                                                                                           \
    C(2, STOPPING, "on its way to rest")                                                                               \
    C(3, COMPLETE, "complete")                                                                                         \
    C(4, STOPPED, "stopped by the host")                                                                               \
    C(5, HOST_LOST, "ended: no frames came")                                                                           \
    C(6, FAILED, "ended by a fault")

#define TL_WIRE_EVENTS(C)                                                                                              \
    C(1, FAULT, "a fault came")                                                                                        \
    C(2, ARRIVED, "a move has arrived")                                                                                \
    C(3, SILENT, "the sender went silent: the axis comes to rest")                                                     \
    C(4, RESTED, "the axis has come to rest")                                                                          \
    C(5, TABLE, "a new table is in use")                                                                               \
    C(6, HOMED, "the end was found: the axis is referenced")                                                           \
    C(7, CHECKED, "motor and encoder agree")

#define TL_WIRE_BOOTS(C)                                                                                               \
    C(0, POWER, "power on")                                                                                            \
    C(1, REQUEST, "asked to")                                                                                          \
    C(2, WATCHDOG, "watchdog")

// -- what follows from the lists --------------------------------------------------------------------------------

typedef uint8_t tl_wire_u8_t;
typedef uint16_t tl_wire_u16_t;
typedef uint32_t tl_wire_u32_t;
typedef uint64_t tl_wire_u64_t;
typedef int8_t tl_wire_i8_t;
typedef int16_t tl_wire_i16_t;
typedef int32_t tl_wire_i32_t;
typedef char tl_wire_text_t;

#define TL_WIRE_F_(kind, name, doc)        tl_wire_##kind##_t name;
#define TL_WIRE_A_(kind, name, count, doc) tl_wire_##kind##_t name[count];
#define TL_WIRE_STRUCT_(code, NAME, name, doc)                                                                         \
    typedef struct {                                                                                                   \
        TL_WIRE_FIELDS_##NAME(TL_WIRE_F_, TL_WIRE_A_)                                                                  \
    } tl_wire_##name##_t;
TL_WIRE_MESSAGES(TL_WIRE_STRUCT_)

#define TL_WIRE_MEMBER_(code, NAME, name, doc) tl_wire_##name##_t name;
typedef union {
    TL_WIRE_MESSAGES(TL_WIRE_MEMBER_)
} tl_wire_message_t;

#define TL_WIRE_TYPE_(code, NAME, name, doc) TL_WIRE_##NAME = (code),
typedef enum { TL_WIRE_MESSAGES(TL_WIRE_TYPE_) } tl_wire_type_t;

#define TL_WIRE_SIZE_F_(kind, name, doc)        +sizeof(tl_wire_##kind##_t)
#define TL_WIRE_SIZE_A_(kind, name, count, doc) +(count) * sizeof(tl_wire_##kind##_t)
#define TL_WIRE_SIZE_(code, NAME, name, doc)                                                                           \
    TL_WIRE_SIZE_##NAME = 0U TL_WIRE_FIELDS_##NAME(TL_WIRE_SIZE_F_, TL_WIRE_SIZE_A_),
enum { TL_WIRE_MESSAGES(TL_WIRE_SIZE_) }; ///< bytes of payload

#define TL_WIRE_CODES_(LIST, list, CODE)          typedef enum { TL_WIRE_##LIST(CODE) } tl_wire_##list##_t;
#define TL_WIRE_REASON_(code, NAME, text)         TL_WIRE_REASON_##NAME = (code),
#define TL_WIRE_FAULT_(code, NAME, text)          TL_WIRE_FAULT_##NAME = (code),
#define TL_WIRE_MODE_(code, NAME, text)           TL_WIRE_MODE_##NAME = (code),
#define TL_WIRE_TABLE_(code, NAME, text)          TL_WIRE_TABLE_##NAME = (code),
#define TL_WIRE_FLAG_(code, NAME, text)           TL_WIRE_FLAG_##NAME = (code),
#define TL_WIRE_MOTION_(code, NAME, text)         TL_WIRE_MOTION_##NAME = (code),
#define TL_WIRE_EVENT_(code, NAME, text)          TL_WIRE_EVENT_##NAME = (code),
#define TL_WIRE_BOOT_(code, NAME, text)           TL_WIRE_BOOT_##NAME = (code),
#define TL_WIRE_STORE_(code, NAME, text)          TL_WIRE_STORE_##NAME = (code),
#define TL_WIRE_ESTOP_(code, NAME, text)          TL_WIRE_ESTOP_##NAME = (code),
#define TL_WIRE_FIRMWARE_STATE_(code, NAME, text) TL_WIRE_FIRMWARE_STATE_##NAME = (code),
#define TL_WIRE_UPDATE_(code, NAME, text)         TL_WIRE_UPDATE_##NAME = (code),
TL_WIRE_CODES_(REASONS, reason, TL_WIRE_REASON_)
TL_WIRE_CODES_(FAULTS, fault, TL_WIRE_FAULT_)
TL_WIRE_CODES_(MODES, mode, TL_WIRE_MODE_)
TL_WIRE_CODES_(TABLES, table, TL_WIRE_TABLE_)
TL_WIRE_CODES_(FLAGS, flag, TL_WIRE_FLAG_)
TL_WIRE_CODES_(MOTIONS, motion, TL_WIRE_MOTION_)
TL_WIRE_CODES_(EVENTS, event_code, TL_WIRE_EVENT_)
TL_WIRE_CODES_(BOOTS, boot, TL_WIRE_BOOT_)
TL_WIRE_CODES_(STORES, store, TL_WIRE_STORE_)
TL_WIRE_CODES_(ESTOPS, estop, TL_WIRE_ESTOP_)
TL_WIRE_CODES_(FIRMWARES, firmware_state, TL_WIRE_FIRMWARE_STATE_)
TL_WIRE_CODES_(UPDATES, update, TL_WIRE_UPDATE_)

/// Whether a list has this code: tl_wire_is_fault() and so on. A code given twice does not compile.
#define TL_WIRE_CASE_(code, NAME, text) case (code):
#define TL_WIRE_IS_(LIST, name)                                                                                        \
    static inline bool tl_wire_is_##name(uint32_t code) {                                                              \
        switch (code) {                                                                                                \
            TL_WIRE_##LIST(TL_WIRE_CASE_) return true;                                                                 \
        default:                                                                                                       \
            return false;                                                                                              \
        }                                                                                                              \
    }
TL_WIRE_IS_(REASONS, reason)
TL_WIRE_IS_(FAULTS, fault)
TL_WIRE_IS_(MODES, mode)
TL_WIRE_IS_(TABLES, table)
TL_WIRE_IS_(FLAGS, flag)
TL_WIRE_IS_(MOTIONS, motion)
TL_WIRE_IS_(EVENTS, event_code)
TL_WIRE_IS_(BOOTS, boot)
TL_WIRE_IS_(STORES, store)
TL_WIRE_IS_(ESTOPS, estop)
TL_WIRE_IS_(FIRMWARES, firmware_state)
TL_WIRE_IS_(UPDATES, update)

/// Bytes of payload of a message of this type, 0 where the type is unknown. O(1).
size_t tl_wire_size(uint8_t type);

/// Writes a whole frame into `out` (room for TL_WIRE_FRAME_MAX) and returns its size; `message` is the struct of
/// `type`. Returns 0, having written nothing, where the type is unknown. O(size), about 25 cycles a byte on a
/// Cortex-M0+.
size_t tl_wire_frame(uint8_t *out, uint8_t type, uint16_t sequence, const void *message);

/// Reads a payload of `size` bytes into the struct of `type`; false (nothing written) where it is unknown or too short.
bool tl_wire_decode(uint8_t type, const uint8_t *payload, size_t size, void *message);

typedef struct {
    uint8_t type;
    uint16_t sequence;
    uint16_t size;          ///< of the payload
    const uint8_t *payload; ///< in the parser's buffer: valid until the next call
} tl_wire_frame_t;

/// Finds frames in a stream of bytes. All zero is a parser that has seen nothing.
typedef struct {
    uint16_t fill;
    uint16_t consumed;  ///< bytes of the frame returned last, dropped on the next call
    uint32_t bytes_bad; ///< bytes that belonged to no whole frame, wraps
    uint8_t buffer[TL_WIRE_FRAME_MAX];
} tl_wire_parser_t;

/// Takes bytes from *data (advancing it and *size) until a frame is whole: true and *frame, else false and *size is 0.
/// Call until it returns false. Unknown types and longer payloads than known are returned too. O(size) plus at most
/// TL_WIRE_FRAME_MAX bytes of rescanning per false frame.
bool tl_wire_parse(tl_wire_parser_t *parser, const uint8_t **data, size_t *size, tl_wire_frame_t *frame);

/// Gives up the frame that is being waited for, whose rest does not come: what its beginning took with it may be whole,
/// and is found by the next tl_wire_parse(), new bytes or not. False: nothing was being waited for.
bool tl_wire_skip(tl_wire_parser_t *parser);

#ifdef __cplusplus
}
#endif

#endif
