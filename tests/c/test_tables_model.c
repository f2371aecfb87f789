// Tables and settings as a host sends them and a start finds them: what tl_tables.h, tl_settings.h and the messages for
// tables say, beside what flash holds, which ages and loses its power.
#include "draws.h"
#include "fake_board.h"
#include "slot_model.h"

#include "tautline/tl_settings.h"

#define LIVES    60
#define STEPS    60
#define AXES     2U
#define PARTS    TL_WIRE_PART
#define SETTINGS (TL_WIRE_HEADER_SIZE + TL_WIRE_SIZE_SETTINGS + TL_WIRE_CRC_SIZE)

static tl_table_t read;

void setUp(void) {
    seed = 69314718U;
}
void tearDown(void) {}

static tl_slot_t slot_of(uint8_t axis, unsigned slot) {
    const uint32_t offset = (axis * 2U + slot) * TL_PORT_FLASH_SECTOR;
    return slot_in(fake.flash + offset, offset);
}

// -- what is in use ---------------------------------------------------------------------------------------------------

static struct {
    uint8_t state, reason; // tl_wire_table_t; why the last one was refused
    bool any;
    tl_slot_t slot; // where it is, if it is readable
    bool readable;
    uint32_t created_s; // of the look-up
} m[AXES];

// Of what flash holds the first that is good; the newest where no other may have been newer.
static void loads(uint8_t axis) {
    const tl_slot_t slots[2] = {slot_of(axis, 0), slot_of(axis, 1)};
    const unsigned best = best_of(&slots[0], &slots[1]), first = best == 2U ? 0U : best;
    const uint8_t before = m[axis].reason;
    m[axis].state = TL_WIRE_TABLE_NONE;
    m[axis].readable = m[axis].any = false;
    for (unsigned i = 0; i < 2U && !m[axis].readable; i++) {
        const tl_slot_t *slot = &slots[first ^ i], *other = &slots[first ^ i ^ 1U];
        if (slot->blank) {
            continue;
        }
        const tl_table_reason_t reason =
            slot->whole ? tl_table_decode(fake.flash + slot->blob, slot->size, axis, &read) : TL_TABLE_BAD_CRC;
        m[axis].state = TL_WIRE_TABLE_BAD;
        m[axis].reason = (uint8_t)reason;
        if (reason == TL_TABLE_OK) {
            const uint32_t ahead = slot->sequence - other->sequence;
            const bool newest = other->blank || (other->dated && ahead - 1U < 0x7FFFFFFFU);
            m[axis].state = newest ? TL_WIRE_TABLE_NEWEST : TL_WIRE_TABLE_OLDER;
            m[axis].reason = before;
            m[axis].slot = *slot;
            m[axis].readable = true;
            m[axis].created_s = read.created_s;
        }
    }
}

static void is_in_use(uint8_t axis) {
    const tl_wire_status_t status = fake_status(axis);
    uint8_t bytes[TL_TABLE_SIZE_MAX];
    TEST_ASSERT_EQUAL(m[axis].state, status.table);
    TEST_ASSERT_EQUAL(m[axis].reason, status.table_reason);
    TEST_ASSERT_EQUAL(m[axis].any, app.tables.in_use[axis].any);
    TEST_ASSERT_EQUAL(m[axis].readable, app.axes[axis].has_table);
    TEST_ASSERT_EQUAL(m[axis].readable, app.tables.in_use[axis].readable);
    if (!m[axis].readable) {
        TEST_ASSERT_EQUAL(0, status.table_sequence | status.table_crc);
        TEST_ASSERT_EQUAL(0, tl_app_table_read(&app, axis, 0, bytes, sizeof(bytes)));
        return;
    }
    const uint8_t *blob = fake.flash + m[axis].slot.blob;
    const uint32_t size = m[axis].slot.size, from = (uint32_t)between(0, (int32_t)size + 1);
    const size_t room = once_in(2) ? sizeof(bytes) : (size_t)between(0, 300);
    const size_t expected = from >= size ? 0U : (size - from < room ? size - from : room);
    TEST_ASSERT_EQUAL_HEX32(m[axis].slot.sequence, status.table_sequence);
    TEST_ASSERT_EQUAL_HEX32(blob[size - 4U] | (uint32_t)blob[size - 3U] << 8 | (uint32_t)blob[size - 2U] << 16 |
                                (uint32_t)blob[size - 1U] << 24,
                            status.table_crc);
    TEST_ASSERT_EQUAL(m[axis].created_s, app.axes[axis].tip.lookup.table.created_s);
    TEST_ASSERT_EQUAL(expected, tl_app_table_read(&app, axis, from, bytes, room));
    TEST_ASSERT_TRUE(memcmp(blob + from, bytes, expected) == 0);
    const tl_wire_table_read_t part = {.axis = axis, .offset = (uint16_t)from};
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_TABLE_READ, &part));
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_TABLE_PART]);
    const tl_wire_table_part_t *got = &heard[TL_WIRE_TABLE_PART].table_part;
    const uint32_t count = from >= size ? 0U : (size - from < PARTS ? size - from : PARTS);
    TEST_ASSERT_EQUAL(axis, got->axis);
    TEST_ASSERT_EQUAL(from, got->offset);
    TEST_ASSERT_EQUAL(count, got->count);
    TEST_ASSERT_TRUE(memcmp(blob + from, got->bytes, count) == 0);
    for (uint32_t i = count; i < PARTS; i++) {
        TEST_ASSERT_EQUAL(0, got->bytes[i]);
    }
}

// -- what a host sends ------------------------------------------------------------------------------------------------

static uint8_t blob[TL_TABLE_SIZE_MAX + 300U];

static uint32_t any_blob(uint8_t axis) {
    static const char *const serials[] = {"", "A1", "A2", "12345678", "12345679"};
    static tl_table_t table;
    uint32_t size = fake_table(blob, once_in(12) ? (uint8_t)(axis ^ 1U) : axis, random_u32());
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_table_decode(blob, size, TL_TABLE_ANY_AXIS, &table));
    const char *serial = serials[between(0, 4)];
    memcpy(table.instrument, serial, strlen(serial));
    if (once_in(8)) {
        table.width[7] = -1; // unfit, in a blob that is whole
    }
    size = (uint32_t)tl_table_encode(&table, blob, sizeof(blob));
    if (once_in(10)) {
        blob[between(0, (int32_t)size - 1)] ^= (uint8_t)(1U << between(0, 7));
    }
    return once_in(20) ? (uint32_t)between(0, (int32_t)sizeof(blob)) : size;
}

static bool is_for(const tl_table_t *table, const tl_wire_settings_t *settings) {
    return table->instrument[0] == 0 || settings->instrument[0] == 0 ||
           strncmp(table->instrument, settings->instrument, sizeof(table->instrument)) == 0;
}

static bool all_off(void) {
    return app.axes[0].mode == TL_WIRE_MODE_OFF && app.axes[1].mode == TL_WIRE_MODE_OFF;
}

// The whole of a table that has come: why it is refused, or 0. Where flash fails nothing of the model is known.
static uint8_t stores(uint8_t axis, uint32_t size, bool *kept) {
    *kept = true;
    if (!all_off()) {
        return TL_WIRE_REASON_NOT_OFF;
    }
    if (size == 0U) {
        return TL_WIRE_REASON_TABLE_SIZE;
    }
    tl_table_reason_t reason = tl_table_check_blob(blob, size, axis);
    const bool any = m[axis].any;
    m[axis].any = false;
    if (reason == TL_TABLE_OK) {
        reason = tl_table_decode(blob, size, axis, &read);
        reason = reason == TL_TABLE_OK && !any && !is_for(&read, &app.axes[axis].settings) ? TL_TABLE_BAD_INSTRUMENT
                                                                                           : reason;
        *kept = false; // what was in use is read from flash again, or another one is
    }
    m[axis].reason = (uint8_t)reason;
    return reason == TL_TABLE_OK ? 0U : TL_WIRE_REASON_TABLE_REFUSED;
}

static int send_part(uint8_t axis, uint32_t at, uint32_t count) {
    tl_wire_table_write_t part = {.axis = axis, .offset = (uint16_t)at, .count = (uint8_t)count};
    memcpy(part.bytes, blob + at, count);
    return fake_ask(TL_WIRE_TABLE_WRITE, &part);
}

// In parts; some are lost, or come twice. What has come is what lies together from the beginning.
static void uploads(uint8_t axis) {
    const uint32_t size = any_blob(axis), per = once_in(2) ? PARTS : (uint32_t)between(60, (int32_t)PARTS);
    uint32_t come = 0;
    bool sound = true;
    for (uint32_t at = 0; at < size; at += per) {
        const uint32_t count = size - at < per ? size - at : per;
        if (once_in(150)) {
            continue; // lost
        }
        const bool follows = at == 0U || (sound && at == come),
                   fits = count <= TL_TABLE_SIZE_MAX - (at == 0U ? 0U : come);
        sound = follows && fits;
        TEST_ASSERT_EQUAL(sound ? 0 : TL_WIRE_REASON_TABLE_SIZE, send_part(axis, at, count));
        if (!sound) { // nothing goes on, where it was or elsewhere
            TEST_ASSERT_EQUAL(TL_WIRE_REASON_TABLE_SIZE, send_part(axis, come > 0U && once_in(2) ? come : 1U, 1U));
        }
        come = sound ? at + count : 0U;
        if (!sound) {
            break;
        }
    }
    const tl_wire_table_store_t request = {.axis = axis, .size = (uint16_t)(once_in(30) ? come + 1U : size)};
    const bool lost = request.size != come;
    bool kept = true;
    const uint32_t in_use = m[axis].readable ? m[axis].slot.blob : 0U,
                   sequence = m[axis].readable ? m[axis].slot.sequence : 0U;
    app.axes[1].mode = once_in(15) ? TL_WIRE_MODE_HOLD : app.axes[1].mode;
    const uint8_t why = lost ? TL_WIRE_REASON_TABLE_SIZE : stores(axis, come, &kept);
    fake.operations = 0;
    fake.cut_at = once_in(8) ? (uint32_t)between(1, 12) : 0U;
    fake.cut_pattern = (unsigned)between(0, 3);
    const int got = fake_ask(TL_WIRE_TABLE_STORE, &request);
    fake.cut_at = 0;
    app.axes[1].mode = TL_WIRE_MODE_OFF;
    const uint8_t reason = m[axis].reason;
    if (why == 0U && fake.dead) {
        TEST_ASSERT_EQUAL(TL_WIRE_REASON_FLASH, got);
    } else {
        TEST_ASSERT_EQUAL(why, got);
    }
    if (why == 0U && !fake.dead) { // it is there: as the newest, and what was in use still is
        loads(axis);
        TEST_ASSERT_TRUE(m[axis].readable && memcmp(fake.flash + m[axis].slot.blob, blob, size) == 0);
        TEST_ASSERT_TRUE(m[axis].slot.blob != in_use);
        TEST_ASSERT_TRUE(in_use == 0U || m[axis].slot.sequence == sequence + 1U);
        m[axis].state = TL_WIRE_TABLE_NEWEST;
        m[axis].reason = TL_TABLE_OK;
        TEST_ASSERT_TRUE((app.axes[axis].events >> TL_WIRE_EVENT_TABLE & 1U) != 0U);
        app.axes[axis].events = 0;
    } else if (!kept) {
        loads(axis);
        m[axis].reason = reason;
    }
    TEST_ASSERT_EQUAL(0, app.axes[axis].events);
}

static void clears(uint8_t axis) {
    const tl_wire_clear_table_t request = {.axis = axis};
    app.axes[1].mode = once_in(6) ? TL_WIRE_MODE_HOLD : app.axes[1].mode;
    const bool may = all_off();
    const int got = fake_ask(TL_WIRE_CLEAR_TABLE, &request);
    app.axes[1].mode = TL_WIRE_MODE_OFF;
    TEST_ASSERT_EQUAL(may ? 0 : TL_WIRE_REASON_NOT_OFF, got);
    if (may) {
        TEST_ASSERT_TRUE(is_blank(fake.flash + axis * 2U * TL_PORT_FLASH_SECTOR, 2U * TL_PORT_FLASH_SECTOR));
        m[axis].reason = TL_TABLE_OK;
        loads(axis);
    }
}

static void ages(uint8_t axis) {
    uint8_t *slot = fake.flash + (axis * 2U + (uint32_t)between(0, 1)) * TL_PORT_FLASH_SECTOR;
    slot[once_in(2) ? between(0, 19) : between(256, 1000)] ^= (uint8_t)(1U << between(0, 7));
}

static void starts(void) {
    fake_start(AXES, TL_WIRE_BOOT_POWER);
    for (uint8_t i = 0; i < AXES; i++) {
        m[i].reason = TL_TABLE_OK;
        loads(i);
        const bool bad = m[i].state == TL_WIRE_TABLE_BAD;
        TEST_ASSERT_EQUAL(bad ? TL_WIRE_FAULT_TABLE : TL_WIRE_FAULT_NONE, app.axes[i].fault);
        TEST_ASSERT_EQUAL(bad ? 1U << TL_WIRE_EVENT_FAULT : 0U, app.axes[i].events);
        app.axes[i].events = 0;
    }
}

static void test_tables_through_their_lives(void) {
    static const char *const serials[] = {"", "A1", "12345678"};
    for (uint32_t life = 0; life < LIVES; life++) {
        fake_new(AXES);
        memset(m, 0, sizeof(m));
        for (uint32_t step = 0; step < STEPS; step++) {
            const uint8_t axis = (uint8_t)between(0, 1);
            for (uint8_t i = 0; i < AXES; i++) {
                const char *serial = serials[between(0, 2)];
                memset(app.axes[i].settings.instrument, 0, 8);
                memcpy(app.axes[i].settings.instrument, serial, strlen(serial));
            }
            const int32_t what = between(0, 19);
            if (what < 12) {
                uploads(axis);
            } else if (what == 12) {
                clears(axis);
            } else if (what < 15) {
                const tl_wire_any_table_t any = {.axis = axis};
                TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_ANY_TABLE, &any));
                m[axis].any = true;
            } else {
                ages(axis);
                starts();
            }
            if (fake.dead) {
                starts();
            }
            is_in_use(0);
            is_in_use(1);
        }
    }
}

static void test_parts_have_an_axis_and_a_size(void) {
    fake_new(AXES);
    const tl_wire_table_store_t store = {.axis = AXES};
    const tl_wire_table_read_t part = {.axis = AXES};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, fake_ask(TL_WIRE_TABLE_STORE, &store));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, fake_ask(TL_WIRE_TABLE_READ, &part));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, send_part(AXES, 0, 10));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, send_part(0, 0, 0));
    tl_wire_table_write_t more = {.axis = 0, .count = PARTS + 1U};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, fake_ask(TL_WIRE_TABLE_WRITE, &more));
    more.count = PARTS;
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TABLE_WRITE, &more));
}

// -- settings ---------------------------------------------------------------------------------------------------------

// What settings of firmware before each protocol lack at their end (tl_settings.c): commissioned; group and estop, too;
// hold_ms, too.
static const uint32_t lacks[] = {0, 1, 3, 7};

static tl_wire_settings_t any_settings(uint8_t axis) {
    tl_wire_settings_t own = tl_axis_default_settings(&fake_port, axis);
    own.q_low_q8 = once_in(2) ? own.q_low_q8 : between(-9000, -1) * TL_COUNT_ONE;
    own.q_high_q8 = once_in(2) ? own.q_high_q8 : between(1, 9000) * TL_COUNT_ONE;
    own.stall_ms = (uint16_t)between(20, 5000);
    own.hold_ms = (uint32_t)between(0, 1000);
    own.group = (uint8_t)between(0, 4);
    own.commissioned = (uint8_t)between(0, 1);
    own.proportional = once_in(10) ? -1 : between(0, 900); // which cannot be
    return own;
}

// A slot's blob: the frames of all four axes, each without its last `less` bytes.
static uint32_t frames_of(const tl_wire_settings_t *of, uint32_t less, uint8_t *out) {
    const uint32_t size = SETTINGS - less;
    uint8_t frame[SETTINGS];
    for (uint32_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        tl_wire_frame(frame, TL_WIRE_SETTINGS, 0, &of[i]);
        memcpy(out + i * size, frame, size);
    }
    return size * TL_WIRE_AXES_MAX;
}

typedef struct {
    bool blank, dated, sound;
    tl_wire_settings_t of[TL_WIRE_AXES_MAX];
} stored_t;

static void is_stored(uint32_t slot, uint32_t sequence, stored_t *s) {
    static const uint32_t sizes[] = {0, 1, 3, 7, 2, 4, 8};
    uint8_t *bytes = fake.flash + (TL_STORE_SETTINGS * 2U + slot) * TL_PORT_FLASH_SECTOR;
    memset(bytes, 0xFF, TL_PORT_FLASH_SECTOR);
    *s = (stored_t){.blank = once_in(5)};
    if (s->blank) {
        return;
    }
    const uint32_t which = (uint32_t)between(0, once_in(4) ? 6 : 3), less = sizes[which],
                   wrong = (uint32_t)between(0, 15);
    s->dated = s->sound = true;
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) {
        s->of[i] = any_settings(i);
        if (wrong == i) {
            s->of[i].axis = (uint8_t)(i ^ 1U);
        }
        s->sound = s->sound && (i >= AXES || (s->of[i].proportional >= 0 && s->of[i].axis == i));
    }
    uint32_t size = frames_of(s->of, less, bytes + TL_PORT_FLASH_PAGE);
    s->sound = s->sound && which < 4U;
    for (uint8_t i = 0; i < TL_WIRE_AXES_MAX; i++) { // what they lack is as it is by default
        const tl_wire_settings_t by_default = tl_axis_default_settings(&fake_port, i);
        tl_wire_settings_t *of = &s->of[i];
        const bool ranged = of->q_low_q8 != by_default.q_low_q8 || of->q_high_q8 != by_default.q_high_q8;
        of->commissioned = less >= lacks[1] ? (uint8_t)ranged : of->commissioned;
        of->group = less >= lacks[2] ? 0U : of->group;
        of->hold_ms = less >= lacks[3] ? by_default.hold_ms : of->hold_ms;
    }
    if (wrong == 5U) {
        size += 1U; // no share of each axis
        s->sound = false;
    } else if (wrong == 6U) {
        bytes[TL_PORT_FLASH_PAGE + (size / 4U) * (uint32_t)between(0, 1) + 2U] = TL_WIRE_PING; // another message
        s->sound = false;
    }
    memcpy(bytes, "SLOT", 4);
    set_word(bytes, 1, sequence);
    set_word(bytes, 2, size);
    set_word(bytes, 3, crc_of(bytes + TL_PORT_FLASH_PAGE, size));
    set_word(bytes, 4, crc_of(bytes, 16));
    if (wrong == 7U) {
        bytes[17] ^= 1U;
        s->dated = s->sound = false;
    } else if (wrong == 8U) {
        bytes[300] ^= 1U;
        s->sound = false;
    }
}

static void are_in_force(const tl_wire_settings_t *of) {
    for (uint8_t i = 0; i < AXES; i++) {
        uint8_t frames[2][SETTINGS];
        tl_wire_frame(frames[0], TL_WIRE_SETTINGS, 0, &of[i]);
        tl_wire_frame(frames[1], TL_WIRE_SETTINGS, 0, &app.axes[i].settings);
        TEST_ASSERT_EQUAL_MEMORY(frames[0], frames[1], SETTINGS);
    }
}

static void test_a_start_finds_the_newest_settings_that_are_whole(void) {
    uint32_t seen[4] = {0};
    fake_new(AXES);
    for (uint32_t i = 0; i < 2000U; i++) {
        static stored_t s[2];
        const uint32_t sequence = once_in(2) ? 0xFFFFFFFFU : 7U;
        const unsigned newer = (unsigned)between(0, 1);
        is_stored(0, sequence + (newer == 0U ? 1U : 0U), &s[0]);
        is_stored(1, sequence + newer, &s[1]);
        fake_start(AXES, TL_WIRE_BOOT_POWER);
        const tl_slot_t slots[2] = {slot_of(TL_STORE_SETTINGS, 0), slot_of(TL_STORE_SETTINGS, 1)};
        const unsigned best = best_of(&slots[0], &slots[1]), first = best == 2U ? 0U : best, second = first ^ 1U;
        uint8_t state = s[0].blank && s[1].blank ? TL_WIRE_STORE_DEFAULT : TL_WIRE_STORE_BAD;
        tl_wire_settings_t expected[AXES] = {tl_axis_default_settings(&fake_port, 0),
                                             tl_axis_default_settings(&fake_port, 1)};
        if (s[first].sound) { // the other one may have been newer where nobody knows its age
            state = s[second].blank || s[second].dated ? TL_WIRE_STORE_NEWEST : TL_WIRE_STORE_OLDER;
            memcpy(expected, s[first].of, sizeof(expected));
        } else if (s[second].sound) {
            state = TL_WIRE_STORE_OLDER;
            memcpy(expected, s[second].of, sizeof(expected));
        }
        TEST_ASSERT_EQUAL(state, app.settings);
        TEST_ASSERT_EQUAL(state == TL_WIRE_STORE_BAD ? TL_WIRE_FAULT_SETTINGS : TL_WIRE_FAULT_NONE, app.axes[1].fault);
        are_in_force(expected);
        seen[state]++;
    }
    TEST_ASSERT_TRUE(seen[0] > 20U && seen[1] > 200U && seen[2] > 200U && seen[3] > 200U);
}

static void test_settings_are_stored_for_all_axes(void) {
    fake_new(AXES);
    uint8_t expected[TL_TABLE_SIZE_MAX];
    for (uint32_t i = 0; i < 300U; i++) {
        const uint8_t axis = (uint8_t)between(0, 1);
        tl_wire_settings_t own = any_settings(axis), of[TL_WIRE_AXES_MAX];
        own.key = once_in(8) ? 5U : TL_WIRE_KEY;
        for (uint8_t k = 0; k < TL_WIRE_AXES_MAX; k++) {
            of[k] = k < AXES ? app.axes[k].settings : tl_axis_default_settings(&fake_port, k);
        }
        const bool may = own.key == TL_WIRE_KEY && own.proportional >= 0;
        fake.sticks = once_in(10);
        const uint8_t before = app.settings;
        const int got = fake_ask(TL_WIRE_SETTINGS, &own);
        const bool stored = may && got == 0;
        TEST_ASSERT_TRUE(
            stored ||
            got == (own.key != TL_WIRE_KEY ? TL_WIRE_REASON_KEY : (may ? TL_WIRE_REASON_FLASH : TL_WIRE_REASON_RANGE)));
        TEST_ASSERT_TRUE(stored || fake.sticks || !may);
        TEST_ASSERT_EQUAL(stored ? TL_WIRE_STORE_NEWEST : before, app.settings);
        if (stored) {
            own.key = 0;
            of[axis] = own;
            const tl_slot_t slots[2] = {slot_of(TL_STORE_SETTINGS, 0), slot_of(TL_STORE_SETTINGS, 1)};
            const tl_slot_t *slot = &slots[best_of(&slots[0], &slots[1])];
            TEST_ASSERT_EQUAL(frames_of(of, 0, expected), slot->size);
            TEST_ASSERT_EQUAL_MEMORY(expected, fake.flash + slot->blob, slot->size);
        }
        are_in_force(of);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_tables_through_their_lives);
    RUN_TEST(test_parts_have_an_axis_and_a_size);
    RUN_TEST(test_a_start_finds_the_newest_settings_that_are_whole);
    RUN_TEST(test_settings_are_stored_for_all_axes);
    return UNITY_END();
}
