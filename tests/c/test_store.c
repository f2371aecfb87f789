#include "fake_board.h"

#include "tautline/tl_crc.h"

void setUp(void) {
    fake_new(1);
}
void tearDown(void) {}

static uint8_t blob[3][TL_TABLE_SIZE_MAX];
static uint16_t size;

static void make_tables(void) {
    for (uint32_t i = 0; i < 3; i++) {
        size = fake_table(blob[i], 0, i + 1);
    }
}

// Which of the tables the board has in use, read back as a host does; 0 none.
static uint32_t in_use(void) {
    uint8_t read[TL_TABLE_SIZE_MAX + 1];
    const size_t got = tl_app_table_read(&app, 0, 0, read, sizeof(read));
    if (got == 0) {
        TEST_ASSERT_FALSE(app.axes[0].has_table);
        return 0;
    }
    TEST_ASSERT_TRUE(app.axes[0].has_table);
    TEST_ASSERT_EQUAL(size, got);
    for (uint32_t i = 0; i < 3; i++) {
        if (memcmp(blob[i], read, size) == 0) {
            TEST_ASSERT_EQUAL(i + 1, app.axes[0].tip.lookup.table.created_s); // and the look-up is of that very table
            return i + 1;
        }
    }
    TEST_FAIL_MESSAGE("a mixture");
    return 0;
}

static void restart(void) {
    fake_start(1, TL_WIRE_BOOT_POWER);
}

static void test_the_newest_table_is_used_and_survives_a_restart(void) {
    make_tables();
    TEST_ASSERT_EQUAL(0, in_use());
    for (uint32_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[i], size));
        TEST_ASSERT_EQUAL(i + 1, in_use());
        restart();
        TEST_ASSERT_EQUAL(i + 1, in_use());
        const tl_wire_status_t status = fake_status(0);
        TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NEWEST, status.table);
        TEST_ASSERT_EQUAL(i + 1, status.table_sequence);
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, status.fault);
    }
}

// Before each write the slots hold 0, 1 or 2 tables; the power goes in every flash operation, in every way.
static void test_a_power_cut_at_any_operation_leaves_the_old_or_the_new_table(void) {
    make_tables();
    unsigned old_ones = 0;
    unsigned new_ones = 0;
    for (uint32_t before = 0; before <= 2; before++) {
        for (unsigned pattern = 0; pattern < 4; pattern++) {
            for (uint32_t cut = 1;; cut++) {
                fake_new(1);
                for (uint32_t i = 0; i < before; i++) {
                    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[i], size));
                }
                fake.operations = 0;
                fake.cut_at = cut;
                fake.cut_pattern = pattern;
                const tl_upload_t result = fake_upload(0, blob[before], size);
                if (!fake.dead) {
                    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, result);
                    TEST_ASSERT_EQUAL(1U + 1U + (size + 255U) / 256U + 1U, cut); // erase, blob, header were each cut
                    break;
                }
                TEST_ASSERT_EQUAL(TL_UPLOAD_FLASH, result);
                restart();
                const uint32_t found = in_use();
                TEST_ASSERT_TRUE(found == before || found == before + 1);
                // A torn header of the very first table cannot be told from a damaged one: that is said, not hidden.
                const bool torn = found == 0 && app.tables.in_use[0].state == TL_WIRE_TABLE_BAD;
                TEST_ASSERT_EQUAL(torn ? TL_WIRE_FAULT_TABLE : TL_WIRE_FAULT_NONE, app.axes[0].fault);
                TEST_ASSERT_TRUE(!torn || before == 0);
                old_ones += found == before;
                new_ones += found != before;
                // And the next write succeeds.
                TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[2], size));
                TEST_ASSERT_EQUAL(3, in_use());
                restart();
                TEST_ASSERT_EQUAL(3, in_use());
            }
        }
    }
    TEST_ASSERT_TRUE(old_ones > 80 && new_ones > 2);
}

static void test_a_power_cut_while_clearing_leaves_the_newest_table_or_none(void) {
    make_tables();
    for (unsigned pattern = 0; pattern < 4; pattern++) {
        for (uint32_t cut = 1; cut <= 2; cut++) {
            fake_new(1);
            fake_upload(0, blob[0], size);
            fake_upload(0, blob[1], size);
            fake.operations = 0;
            fake.cut_at = cut;
            fake.cut_pattern = pattern;
            TEST_ASSERT_EQUAL(TL_WIRE_REASON_FLASH, tl_tables_clear(&app.tables, 0));
            restart();
            TEST_ASSERT_TRUE(in_use() == 2 || (cut == 2 && in_use() == 0));
        }
    }
    fake_new(1);
    fake_upload(0, blob[0], size);
    TEST_ASSERT_EQUAL(0, tl_tables_clear(&app.tables, 0));
    restart();
    TEST_ASSERT_EQUAL(0, in_use());
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NONE, fake_status(0).table);
}

// Any bit of the newest slot flipped: the board uses it if the bit does not matter, else the one before, and says so.
static void test_a_flipped_bit_falls_back_to_the_older_table(void) {
    make_tables();
    fake_upload(0, blob[0], size);
    fake_upload(0, blob[1], size);
    const uint32_t start = app.tables.in_use[0].blob - TL_PORT_FLASH_PAGE;
    uint32_t older = 0;
    for (uint32_t bit = 0; bit < 8U * TL_PORT_FLASH_SECTOR; bit += 13U) {
        const uint32_t byte = bit / 8U;
        fake.flash[start + byte] ^= (uint8_t)(1U << (bit % 8U));
        restart();
        const bool matters = byte < 20U || (byte >= 256U && byte < 256U + size);
        TEST_ASSERT_EQUAL(matters ? 1 : 2, in_use());
        TEST_ASSERT_EQUAL(matters ? TL_WIRE_TABLE_OLDER : TL_WIRE_TABLE_NEWEST, app.tables.in_use[0].state);
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, app.axes[0].fault);
        older += matters;
        fake.flash[start + byte] ^= (uint8_t)(1U << (bit % 8U));
    }
    TEST_ASSERT_TRUE(older > 800);
}

static void test_both_damaged_is_a_fault_that_can_be_cleared(void) {
    make_tables();
    fake_upload(0, blob[0], size);
    fake_upload(0, blob[1], size);
    fake.flash[300] ^= 1U;
    fake.flash[TL_PORT_FLASH_SECTOR + 300] ^= 1U;
    restart();
    TEST_ASSERT_EQUAL(0, in_use());
    tl_wire_status_t status = fake_status(0);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_TABLE, status.fault);
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_BAD, status.table);
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, status.table_reason);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FAULT, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[2], size)); // a new table mends it
    restart();
    TEST_ASSERT_EQUAL(3, in_use());
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
}

static void test_sequence_numbers_may_wrap(void) {
    make_tables();
    fake_upload(0, blob[0], size);
    // Rewrite the header as if it were the 2^32 - 1st table.
    uint8_t *page = fake.flash;
    page[4] = page[5] = page[6] = page[7] = 0xFF;
    const uint32_t crc = tl_store_slot(&fake_port, 0, 0).whole ? 0U : 1U;
    TEST_ASSERT_EQUAL(1, crc); // the header's CRC noticed
    const uint32_t right = tl_crc32(0, page, 16);
    for (unsigned i = 0; i < 4; i++) {
        page[16 + i] = (uint8_t)(right >> (8U * i));
    }
    restart();
    TEST_ASSERT_EQUAL_HEX32(0xFFFFFFFFU, fake_status(0).table_sequence);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[1], size));
    restart();
    TEST_ASSERT_EQUAL(2, in_use());
    TEST_ASSERT_EQUAL(0, fake_status(0).table_sequence);
}

static void test_uploads_that_cannot_be_are_refused_and_change_nothing(void) {
    make_tables();
    fake_upload(0, blob[0], size);
    const uint32_t operations = fake.operations;
    TEST_ASSERT_EQUAL(TL_UPLOAD_AXIS, fake_upload(1, blob[1], size));
    TEST_ASSERT_EQUAL(TL_UPLOAD_SIZE, tl_app_table_end(&app, 0));                    // nothing was sent
    TEST_ASSERT_EQUAL(TL_UPLOAD_SIZE, tl_app_table_data(&app, 0, 256, blob[1], 10)); // not from the start
    static uint8_t zeros[5000];
    TEST_ASSERT_EQUAL(TL_UPLOAD_SIZE, fake_upload(0, zeros, sizeof(zeros)));
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, zeros, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_MAGIC, fake_status(0).table_reason);
    fake_table(blob[2], 1, 3);
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, blob[2], size)); // for another axis
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_AXIS, fake_status(0).table_reason);
    tl_app_table_data(&app, 0, 0, blob[1], 256); // broken off, then another host begins anew
    tl_app_bus(&app, false);
    tl_app_bus(&app, true);
    TEST_ASSERT_EQUAL(TL_UPLOAD_SIZE, tl_app_table_end(&app, 0));
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_UPLOAD_NOT_OFF, fake_upload(0, blob[1], size));
    TEST_ASSERT_EQUAL(operations, fake.operations);
    TEST_ASSERT_EQUAL(1, in_use());
}

// The newer slot holds a whole blob that this firmware refuses: the older one is in use, and stays until the next is
// whole, wherever the power goes.
static void test_the_table_in_use_stays_where_the_newer_one_was_refused(void) {
    make_tables();
    static uint8_t foreign[TL_TABLE_SIZE_MAX];
    for (uint32_t cut = 1;; cut++) {
        fake_new(1);
        TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[0], size));
        const uint16_t other = fake_table(foreign, 1, 9);
        TEST_ASSERT_TRUE(tl_store_write(&fake_port, 0, 0U, foreign, other));
        restart();
        TEST_ASSERT_EQUAL(1, in_use());
        TEST_ASSERT_EQUAL(TL_WIRE_TABLE_OLDER, fake_status(0).table);
        fake.operations = 0;
        fake.cut_at = cut;
        fake.cut_pattern = 2;
        const tl_upload_t result = fake_upload(0, blob[1], size);
        TEST_ASSERT_EQUAL(fake.dead ? TL_UPLOAD_FLASH : TL_UPLOAD_OK, result);
        const bool whole = !fake.dead;
        restart();
        TEST_ASSERT_EQUAL(whole ? 2 : 1, in_use());
        TEST_ASSERT_EQUAL(TL_WIRE_FAULT_NONE, fake_status(0).fault);
        if (whole) {
            TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NEWEST, fake_status(0).table);
            break;
        }
    }
}

// Flash that has lost the table in use: what comes damaged, or for another axis, leaves it at work; what is refused for
// its content cannot, and the status says so.
static void test_a_damaged_upload_leaves_the_table_in_use_though_flash_has_lost_it(void) {
    make_tables();
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[0], size));
    fake.flash[app.tables.in_use[0].blob + 100U] ^= 1U;
    static uint8_t bad[TL_TABLE_SIZE_MAX];
    memcpy(bad, blob[1], size);
    bad[200] ^= 1U;
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, bad, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, fake_status(0).table_reason);
    fake_table(bad, 1, 2);
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, bad, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_AXIS, fake_status(0).table_reason);
    TEST_ASSERT_TRUE(app.axes[0].has_table);
    TEST_ASSERT_EQUAL(1, app.axes[0].tip.lookup.table.created_s);
    static tl_table_t steep;
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_table_decode(blob[1], size, 0, &steep));
    steep.width[5] = steep.width[4] + 4 * 16384;
    tl_table_encode(&steep, bad, sizeof(bad));
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, bad, size));
    TEST_ASSERT_FALSE(app.axes[0].has_table);
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_BAD, fake_status(0).table);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[2], size));
    TEST_ASSERT_EQUAL(3, in_use());
}

// Flash that is worn out says nothing of it.
static void test_what_flash_did_not_take_is_told_and_the_table_in_use_stays(void) {
    make_tables();
    const tl_wire_clear_table_t clear = {.axis = 0};
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[0], size));
    fake.sticks = true;
    TEST_ASSERT_EQUAL(TL_UPLOAD_FLASH, fake_upload(0, blob[1], size));
    TEST_ASSERT_EQUAL(1, in_use());
    fake.sticks = false;
    fake.keeps = true;
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_FLASH, fake_ask(TL_WIRE_CLEAR_TABLE, &clear));
    TEST_ASSERT_EQUAL(1, in_use());
    fake.keeps = false;
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob[1], size));
    TEST_ASSERT_EQUAL(2, in_use());
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_newest_table_is_used_and_survives_a_restart);
    RUN_TEST(test_a_power_cut_at_any_operation_leaves_the_old_or_the_new_table);
    RUN_TEST(test_a_power_cut_while_clearing_leaves_the_newest_table_or_none);
    RUN_TEST(test_a_flipped_bit_falls_back_to_the_older_table);
    RUN_TEST(test_both_damaged_is_a_fault_that_can_be_cleared);
    RUN_TEST(test_sequence_numbers_may_wrap);
    RUN_TEST(test_uploads_that_cannot_be_are_refused_and_change_nothing);
    RUN_TEST(test_the_table_in_use_stays_where_the_newer_one_was_refused);
    RUN_TEST(test_a_damaged_upload_leaves_the_table_in_use_though_flash_has_lost_it);
    RUN_TEST(test_what_flash_did_not_take_is_told_and_the_table_in_use_stays);
    return UNITY_END();
}
