/// The table blob: what calibration found, as it travels from host to board and lies in flash.
///
/// A table says, for one axis: the backlash width B(p) and the remaining function c = f(p) on one grid of
/// motor positions p, the coarse kinematics, and the limits within which they may be used. Both functions
/// are linear between nodes and held beyond the grid's ends, on board and host alike. Nothing derived
/// travels: inverses, the range of c and the flat spans are worked out by tl_lookup_load(), so they cannot
/// disagree with f. A table without nodes is the identity: B = 0 and f is the coarse kinematics.
///
/// Blob, format 1 or 2, little-endian, integers in two's complement, no padding:
///
///   offset size  field
///        0    4  magic "TLTB"
///        4    2  format: 1, or 2 where sections follow the nodes (the firmware has a version of its own)
///        6    2  size of the whole blob in bytes: 92 + 8 * nodes, and the sections'
///        8    1  axis, 0..3
///        9    1  kind of axis, tl_axis_kind_t: says what c is (deg, or mm for a translation)
///       10    1  unit of motor positions, tl_unit_t
///       11    1  step_log2: the grid's step is 2^step_log2 Q8 counts, 0..23
///       12    2  nodes: 0, or 2..257
///       14    2  strength, Q15, 0..32768: the share of B that is compensated unless the host says otherwise
///       16    4  nano-units per encoder count, unsigned, > 0 (1 um per count: 1000000 nano-mm)
///       20    4  q0, Q8 counts: position of the first node (0 without nodes)
///       24    4  q_min, Q8 counts: the motor is never sent below it
///       28    4  q_max, Q8 counts: nor above it; all within +-TL_TABLE_POSITION_MAX, as the last node is
///       32    4  coarse c at q_min, deg Q16
///       36    4  coarse c at q_max, deg Q16: the coarse kinematics is the line through the two
///       40    4  speed_max, Q8 counts/s, > 0: of the motor, in all
///       44    4  take-up speed, Q8 counts/s, > 0: added to the feed while backlash is crossed
///       48    4  take-up acceleration, counts/s^2 (Q0), > 0
///       52    4  reversal band, Q8 counts, >= 0: p must turn back by more than it to count as a reversal
///       56    4  least slope of f, deg/count Q28, >= 0; flatter spans are treated as the next field says
///       60    4  flat speed, Q8 counts/s: 0 = refuse a table with flatter spans; > 0 = cross them at this
///                motor speed at most
///       64    4  camera delay t_delay, us, unsigned, at most 2 s
///       68    4  created, seconds since 1970, unsigned
///       72    8  model id: any bytes by which the host knows the model again
///       80    8  instrument that it was made for: its serial, ASCII, padded with 0; all 0: it does not say
///       88  4*n  B, Q8 counts, 0..TL_TABLE_WIDTH_MAX, n = nodes
///   88+4*n  4*n  f, deg Q16
///   88+8*n  ...  format 2: sections, each 2 bytes of id, 2 bytes of the size of what follows, and that
///      end    4  CRC-32 (tl_crc.h) of everything before it
///
/// A section that the reader does not know, or one that comes twice, is an error: a board undoes all that a table says,
/// or refuses it. A table without sections is written as format 1.
///
/// Section 1, several plays: the elements that share B, for a motion that starts gradually. Without it there is one.
///
///   offset size  field
///        0    1  plays: 2..7
///        1    1  period_log2: a period, the width of all, is 2^period_log2 of Y, 8..26
///        2    2  reserved, zero
///        4    4  narrow, Q8 counts: where B(p) is less, there is one play; 0: nowhere
///        8  8*7  for each element its share of B, Q28, rising from 0 or more, below 16, and its share of the motion,
///                Q16, at least 0.05 for the first; zeros beyond `plays`. The shares of the motion sum up to 1, and so
///                do their products with the shares of B
///       64  4*n  Y at the nodes, n = nodes: Y = G(p - B/2) + 1/2 period for the warp G that makes every width a
///                period, G(p + B/2) - G(p - B/2) = 1; strictly rising, within +-2^29; B is taken as `narrow` where it
///                is less
///
/// Further sections, in which the compensator finds what else it is to undo (tl_undo.h). Each is a row of 32-bit words
/// in the order of its list below; at most one of each, in the order of their numbers.
///
/// Section 2, `encoder`: a once-per-turn error of the measured position. The shaft is at x where the encoder reads q,
/// x = q + e(x), e = sine sin a + cosine cos a + sine2 sin 2a + cosine2 cos 2a, a = 2 pi x / period.
/// Section 3, `sides`: unequal sides. Once p has turned towards `side` the motor has to be `late` further ahead, Q8
/// counts at travels of p since then of 0, 1, 2, 3, 4, 6, 8, 12, .. 192, 256 times 2^step_log2 Q8 counts, held beyond:
/// falling, by no more than the travel.
/// Section 4, `speed`: the width grows with it. `extra`, Q8 counts, is added to B at speeds of p of as many times
/// 2^step_log2 Q8 counts/s; the speed comes through a first-order filter of time_us. held: at rest the
/// width stays.
/// Section 5, `late`: lag and creep. p = y + sum gain_i (y - y_i), where y is where the tip is to be and y_i follows it
/// in first order within time_us. A lead by t: gain t / time, t not too much above time.
/// Section 6, `load`: with the load beyond `reference` (mNm Q8) the width grows by `width` (1/mNm, Q24), the angle's
/// distance from `middle` (deg Q16) by `gain` (1/mNm, Q24), and the motor is as if it were `offset` (counts/mNm Q16)
/// further on.
/// Section 7, `joints`: other axes of the board that move the angle. Each: axis + 1 (0: none), its own backlash in Q8
/// counts, deg per count Q28.
/// Section 8, `adapt`: how far from this table a host may move it while it is in use: the offset, Q8 counts, and the
/// width's scale, least and most, Q15.
/// Section 9, `anew`: the sides of section 3, without which it may not be, begin anew after rests: where p has stood
/// still for longer than rest_us, 1 to 10000000, and goes on towards `side`, the motor has to be as far ahead as after
/// a turn there. Without it they begin at turns alone.
/// Section 10, `pressed`: what `sides` and `speed` add goes with the place as B does. Each is taken w times, w =
/// max(0, 1 + share (B(p) / mean - 1)), mean in Q8 counts, 1 or more, and its share in Q16, 0 to 2; 0 where the table
/// has no such section. Such a side is late by w late(d), where d is not the travel of p, but what a motor goes that
/// takes up w late: dd (1 + (1 - w) late'(d)) = |dp| + dB / 2 + late(d) dw. B is nowhere above TL_TABLE_WIDE_MAX means,
/// what is pressed stays within section 3's and 4's range, and with B it leaves a motion of the motor to every p.
/// Section 11, `before`: of section 7, without which it may not be, the axes that move the motor before the play
/// instead of the angle, which section 7 then has by 0: counts for each of their counts, Q20; 0 for the other places.
///
/// Thread model: functions touch only their arguments. Encoding, decoding and checking are for load time:
/// O(nodes), 0.9 ms for the largest table on a 125 MHz Cortex-M0+, no division.
#ifndef TAUTLINE_TL_TABLE_H
#define TAUTLINE_TL_TABLE_H

#include "tautline/tl_fixed.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

#define TL_TABLE_FORMAT            2U ///< the newest that is read; 1 still is
#define TL_TABLE_FORMAT_PLAIN      1U ///< without sections
#define TL_TABLE_AXES              4U
#define TL_TABLE_NODES_MAX         257U
#define TL_TABLE_STEP_LOG2_MAX     23U
#define TL_TABLE_DELAY_MAX_US      2000000U
#define TL_TABLE_HEADER_SIZE       88U
#define TL_TABLE_SIZE(nodes)       (TL_TABLE_HEADER_SIZE + 8U * (nodes) + 4U) ///< of format 1
#define TL_TABLE_PLAYS_MAX         7U
#define TL_TABLE_PLAYS_SECTION     1U
#define TL_TABLE_PLAYS_SIZE(nodes) (64U + 4U * (nodes)) ///< of the section's content
/// A flash sector has room for more (tl_store.c).
#define TL_TABLE_SIZE_MAX                                                                                              \
    (TL_TABLE_SIZE(TL_TABLE_NODES_MAX) + 4U + TL_TABLE_PLAYS_SIZE(TL_TABLE_NODES_MAX) + TL_TABLE_WORDS_SIZE)
#define TL_TABLE_ANY_AXIS 0xFFU
/// Angles, and where a motor may be, stay within +-TL_TABLE_VALUE_MAX, so that differences never overflow.
#define TL_TABLE_VALUE_MAX ((int32_t)0x3FFFFFFF)
/// Q8 counts: q_min, q_max, the grid's ends (+-2097151 counts), and B (1048575 counts). A position, twice what several
/// plays reach by such a B, and what sections 3 and 4 add to it, sum up to less than 2^31.
#define TL_TABLE_POSITION_MAX     ((int32_t)0x1FFFFFFF)
#define TL_TABLE_WIDTH_MAX        ((int32_t)0x0FFFFFFF)
#define TL_TABLE_CENTRE_MAX       ((int32_t)1 << 29) ///< of Y
#define TL_TABLE_ENCODER_MAX      ((int32_t)1 << 17) ///< of all amplitudes of an encoder's error: 512 counts, Q8
#define TL_TABLE_ADAPT_OFFSET_MAX ((int32_t)1 << 22) ///< Q8 counts: 16384
#define TL_TABLE_WIDE_MAX         8                  ///< B over the mean of section 10

typedef enum { TL_AXIS_BENDING = 0, TL_AXIS_TRANSLATION = 1, TL_AXIS_ROTATION = 2 } tl_axis_kind_t;
typedef enum { TL_UNIT_MM = 0, TL_UNIT_DEG = 1 } tl_unit_t;

#define TL_TABLE_LAST     16U  ///< node of a small table in a section: its nodes are at
#define TL_TABLE_STEPS    256U ///< 0, 1, 2, 3, 4, 6, 8, 12, .. 192, 256 of its steps
#define TL_TABLE_LATE_MAX 4U
#define TL_TABLE_JOINTS   3U

/// Sections of words: number, name, and their fields or arrays of fields, all int32_t.
#define TL_TABLE_SECTIONS(X)                                                                                           \
    X(2, encoder, TL_TABLE_ENCODER)                                                                                    \
    X(3, sides, TL_TABLE_SIDES)                                                                                        \
    X(4, speed, TL_TABLE_SPEED)                                                                                        \
    X(5, late, TL_TABLE_LATE)                                                                                          \
    X(6, load, TL_TABLE_LOAD)                                                                                          \
    X(7, joints, TL_TABLE_JOINT)                                                                                       \
    X(8, adapt, TL_TABLE_ADAPT)                                                                                        \
    X(9, anew, TL_TABLE_ANEW)                                                                                          \
    X(10, pressed, TL_TABLE_PRESSED)                                                                                   \
    X(11, before, TL_TABLE_BEFORE)

#define TL_TABLE_ENCODER(FIELD, ARRAY) FIELD(period_q12) FIELD(sine) FIELD(cosine) FIELD(sine2) FIELD(cosine2)
#define TL_TABLE_SIDES(FIELD, ARRAY)   FIELD(side) FIELD(step_log2) ARRAY(late, TL_TABLE_LAST + 1U)
#define TL_TABLE_SPEED(FIELD, ARRAY)   FIELD(step_log2) FIELD(time_us) FIELD(held) ARRAY(extra, TL_TABLE_LAST + 1U)
#define TL_TABLE_LATE(FIELD, ARRAY)    ARRAY(gain_q16, TL_TABLE_LATE_MAX) ARRAY(time_us, TL_TABLE_LATE_MAX)
#define TL_TABLE_LOAD(FIELD, ARRAY)    FIELD(reference) FIELD(width) FIELD(gain) FIELD(offset) FIELD(middle)
#define TL_TABLE_JOINT(FIELD, ARRAY)                                                                                   \
    ARRAY(axis, TL_TABLE_JOINTS) ARRAY(play, TL_TABLE_JOINTS) ARRAY(slope, TL_TABLE_JOINTS)
#define TL_TABLE_ADAPT(FIELD, ARRAY)   FIELD(offset) FIELD(width_least_q15) FIELD(width_most_q15)
#define TL_TABLE_ANEW(FIELD, ARRAY)    FIELD(rest_us)
#define TL_TABLE_PRESSED(FIELD, ARRAY) FIELD(mean) FIELD(sides_q16) FIELD(speed_q16)
#define TL_TABLE_BEFORE(FIELD, ARRAY)  ARRAY(slope_q20, TL_TABLE_JOINTS)

#define TL_TABLE_FIELD(name)        int32_t name;
#define TL_TABLE_ARRAY(name, count) int32_t name[count];
#define TL_TABLE_SECTION(number, name, FIELDS)                                                                         \
    typedef struct {                                                                                                   \
        FIELDS(TL_TABLE_FIELD, TL_TABLE_ARRAY)                                                                         \
    } tl_table_##name##_t;
TL_TABLE_SECTIONS(TL_TABLE_SECTION)
#define TL_TABLE_NUMBER(number, name, FIELDS) TL_TABLE_HAS_##name = 1 << (number),
enum { TL_TABLE_SECTIONS(TL_TABLE_NUMBER) };
#define TL_TABLE_BYTES(number, name, FIELDS) +4U + sizeof(tl_table_##name##_t)
#define TL_TABLE_WORDS_SIZE                  (0U TL_TABLE_SECTIONS(TL_TABLE_BYTES)) ///< of all these sections

/// Why a table is refused: name, and the text that board and host show.
#define TL_TABLE_REASONS(X)                                                                                            \
    X(SHORT, "the blob is shorter than a table's header")                                                              \
    X(MAGIC, "not a table: the magic number is missing")                                                               \
    X(FORMAT, "the table has another format version: flash matching firmware or write the table again")                \
    X(SIZE, "the size in the header is not the blob's size")                                                           \
    X(CRC, "the CRC-32 does not match: the table was damaged on its way")                                              \
    X(RESERVED, "the instrument's serial is no text, or the grid of a table without nodes is not zero")                \
    X(AXIS, "the table is for another axis, or for none that exists")                                                  \
    X(KIND, "the kind of axis is not bending, translation or rotation")                                                \
    X(UNIT, "the unit is not mm or deg")                                                                               \
    X(SCALE, "the scale is zero units per count")                                                                      \
    X(NODES, "a table has no node (identity) or 2 to 257 nodes")                                                       \
    X(STEP, "the grid step is not 2^0 to 2^23 Q8 counts")                                                              \
    X(RANGE, "the motor range is empty or reaches beyond the grid")                                                    \
    X(SATURATES,                                                                                                       \
      "too large to compute with: a position of more than 2097151 counts, a width of more than 1048575, or an angle "  \
      "of 16384 deg or more")                                                                                          \
    X(STRENGTH, "the strength is not between 0 and 1")                                                                 \
    X(LIMITS, "a speed, acceleration, band or slope limit is out of its range")                                        \
    X(DELAY, "the camera delay is more than 2 s")                                                                      \
    X(COARSE, "the coarse kinematics is flat or falls where f rises: check the sign of its gain")                      \
    X(WIDTH_NEGATIVE, "a backlash width is negative")                                                                  \
    X(WIDTH_STEEP, "the backlash width changes by 2 or more per unit of motion (|B'| >= 2): no unique inverse")        \
    X(NOT_MONOTONE, "f_remain is not strictly rising or strictly falling")                                             \
    X(SECTION,                                                                                                         \
      "a section of the table is unknown, cut off or comes twice: flash newer firmware or write the table again")      \
    X(PLAYS,                                                                                                           \
      "the elements of the play: 2 to 7, shares that rise and sum up to 1, the first at least 0.05 of the motion")     \
    X(WARP, "the warp of the elements does not rise, or does not make every width one")                                \
    X(FLAT, "f_remain is flatter somewhere than the stated least slope, and no flat speed is given to cross it")       \
    X(INSTRUMENT,                                                                                                      \
      "the table was made for another instrument than the board's settings name: flash that one's, or --force")        \
    X(ENCODER, "the encoder's error is too large for its period: its slope may be 1/2 at most")                        \
    X(SIDES, "what unequal sides add must fall with the travel, by no more than it")                                   \
    X(SPEED, "what the speed adds to the width is out of its range")                                                   \
    X(LATE, "a time or gain of lag and creep is out of its range")                                                     \
    X(LOAD, "what the load changes is out of its range")                                                               \
    X(JOINTS, "another axis that moves the angle does not exist, or moves it too much")                                \
    X(ADAPT, "the limits of what may change in use are out of their range")                                            \
    X(ANEW, "unequal sides may begin anew after rests of 1 us to 10 s, and where the table has such sides alone")      \
    X(PRESSED,                                                                                                         \
      "what goes with the place as the width does: shares of 0 to 2 of what the table adds, within its range, and no " \
      "width above 8 times its mean")                                                                                  \
    X(BEFORE, "an axis that moves the motor before the play has to be one that the table names, and must not move "    \
              "the angle as well")

#define TL_TABLE_REASON_NAME(name, text) TL_TABLE_BAD_##name,
typedef enum { TL_TABLE_OK = 0, TL_TABLE_REASONS(TL_TABLE_REASON_NAME) TL_TABLE_REASON_COUNT } tl_table_reason_t;

/// A blob's content. Memory: 3.5 kB; fields as in the layout above.
typedef struct {
    uint8_t axis;
    uint8_t kind; ///< tl_axis_kind_t
    uint8_t unit; ///< tl_unit_t
    uint8_t step_log2;
    uint16_t nodes;
    uint16_t strength_q15;
    uint32_t nano_units_per_count;
    tl_count_q8_t q0;
    tl_count_q8_t q_min;
    tl_count_q8_t q_max;
    tl_deg_q16_t coarse_c_min; ///< at q_min
    tl_deg_q16_t coarse_c_max; ///< at q_max
    int32_t speed_max_q8;      ///< counts/s
    int32_t takeup_speed_q8;   ///< counts/s
    int32_t takeup_accel;      ///< counts/s^2
    tl_count_q8_t band;
    int32_t slope_min_q28; ///< deg/count
    int32_t flat_speed_q8; ///< counts/s
    uint32_t delay_us;
    uint32_t created_s;
    uint8_t model_id[8];
    char instrument[8];                      ///< not terminated where all are used
    tl_count_q8_t width[TL_TABLE_NODES_MAX]; ///< B
    tl_deg_q16_t angle[TL_TABLE_NODES_MAX];  ///< f
    uint8_t plays;                           ///< 0: one, and what follows says nothing
    uint8_t period_log2;
    tl_count_q8_t narrow;
    uint32_t play_width_q28[TL_TABLE_PLAYS_MAX];
    uint32_t play_weight_q16[TL_TABLE_PLAYS_MAX];
    int32_t centre[TL_TABLE_NODES_MAX]; ///< Y
    uint32_t has;                       ///< TL_TABLE_HAS_..: the sections that follow; what it has not is zero
#define TL_TABLE_MEMBER(number, name, FIELDS) tl_table_##name##_t name;
    TL_TABLE_SECTIONS(TL_TABLE_MEMBER)
#undef TL_TABLE_MEMBER
} tl_table_t;

/// The first thing found that makes a table's content unfit, or
/// TL_TABLE_OK. `axis`: the one that it must be for, or TL_TABLE_ANY_AXIS.
tl_table_reason_t tl_table_check(const tl_table_t *table, uint8_t axis);

/// Writes the blob; returns its size, or 0 if `capacity` is too small or nodes > TL_TABLE_NODES_MAX.
/// Content is not checked, so that tests can make bad blobs. `blob` may have any alignment.
size_t tl_table_encode(const tl_table_t *table, uint8_t *blob, size_t capacity);

/// Whether a blob has come as it was made, and for that axis: format, size, CRC. Its content is not looked at.
tl_table_reason_t tl_table_check_blob(const uint8_t *blob, size_t size, uint8_t axis);

/// Reads and checks a blob of `size` bytes from anywhere (flash included). On any reason but TL_TABLE_OK the
/// content of `table` is unspecified and must not be used. Safe on any bytes.
tl_table_reason_t tl_table_decode(const uint8_t *blob, size_t size, uint8_t axis, tl_table_t *table);

/// The change of f (deg Q16) across a span of the grid below which it is flatter than the stated least slope. O(1).
uint32_t tl_table_flat_below(const tl_table_t *table);

/// A sentence for a person; never NULL, lives for ever.
const char *tl_table_reason_text(tl_table_reason_t reason);

#ifdef __cplusplus
}
#endif

#endif
