#include "fake_board.h"

#include "tautline/tl_fault_log.h"

enum { OF_SECTOR = 16, PAGES = 32 };
#ifndef CUTS_APART
#define CUTS_APART 1U
#endif

void setUp(void) {
    fake_keeps_log = true;
    fake_new(2);
}
void tearDown(void) {}

static tl_wire_logged_t logged(uint8_t index) {
    const tl_wire_get_logged_t request = {.index = index};
    fake_ask(TL_WIRE_GET_LOGGED, &request);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_LOGGED]);
    return heard[TL_WIRE_LOGGED].logged;
}

static uint32_t count(void) {
    uint32_t found = 0;
    for (uint32_t number = 0; logged((uint8_t)found).number != 0; found++) {
        const tl_wire_logged_t each = logged((uint8_t)found);
        TEST_ASSERT_TRUE(found == 0 || each.number + 1 == number); // newest first, none left out
        number = each.number;
    }
    return found;
}

// A fault whose value is `value`, cleared, and time for it to be written.
static void fault(uint8_t axis, int32_t value) {
    tl_axis_fail(&app.axes[axis], TL_WIRE_FAULT_CURRENT, value, fake.t_us);
    fake_run_ms(1100);
    const tl_wire_clear_fault_t clear = {.axis = axis};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_CLEAR_FAULT, &clear));
    fake_run_ms(2);
}

static void restart(void) {
    fake.t_us = 0;
    fake_start(2, TL_WIRE_BOOT_POWER);
}

static void test_a_fault_is_there_after_the_power_was_off(void) {
    TEST_ASSERT_EQUAL(0, count());
    fake_run_ms(500);
    const tl_us_t when = fake.t_us;
    fault(1, 1234);
    restart();
    fault(0, 77);
    TEST_ASSERT_EQUAL(2, count());
    const tl_wire_logged_t first = logged(1), second = logged(0);
    TEST_ASSERT_EQUAL(1, first.axis);
    TEST_ASSERT_EQUAL(TL_WIRE_FAULT_CURRENT, first.fault);
    TEST_ASSERT_EQUAL(1234, first.value);
    TEST_ASSERT_EQUAL(when, first.t_us);
    TEST_ASSERT_EQUAL(1, first.run);
    TEST_ASSERT_EQUAL(2, first.run_now);
    TEST_ASSERT_EQUAL(77, second.value);
    TEST_ASSERT_EQUAL(2, second.run);
}

static void test_a_fault_that_stays_is_logged_once_and_the_same_again_anew(void) {
    fault(0, 5);
    TEST_ASSERT_EQUAL(1, count());
    fault(0, 5);
    TEST_ASSERT_EQUAL(2, count());
}

// tl_fault_log.h: an entry is a frame in a page of its own, whose rest stays blank.
static void test_an_entry_is_a_frame_alone_in_its_page(void) {
    fault(0, 5);
    static tl_wire_parser_t parser;
    const uint8_t *page = fake.flash + TL_PORT_FLASH_REGION, *rest = page;
    size_t left = TL_PORT_FLASH_PAGE;
    tl_wire_frame_t frame;
    TEST_ASSERT_TRUE(tl_wire_parse(&parser, &rest, &left, &frame));
    TEST_ASSERT_EQUAL(TL_WIRE_LOGGED, frame.type);
    TEST_ASSERT_EQUAL(0, frame.sequence);
    for (; rest < page + TL_PORT_FLASH_PAGE; rest++) {
        TEST_ASSERT_EQUAL_HEX8(0xFF, *rest);
    }
}

static void test_nothing_is_written_while_a_motor_is_on(void) {
    fake_ready();
    TEST_ASSERT_EQUAL(0, fake_enable(1, 1));
    fake_run_ms(2000);
    const uint32_t before = fake.operations;
    tl_axis_fail(&app.axes[0], TL_WIRE_FAULT_STALL, 9, fake.t_us);
    fake_run_ms(3000);
    TEST_ASSERT_EQUAL(before, fake.operations);
    TEST_ASSERT_EQUAL(9, logged(0).value); // but it is told
    TEST_ASSERT_EQUAL(0, fake_enable(1, 0));
    fake_run_ms(1000);
    TEST_ASSERT_EQUAL(before + 2, fake.operations); // the first page of a sector
    TEST_ASSERT_EQUAL(1, count());
}

static void test_a_host_that_makes_faults_wears_no_flash(void) {
    const tl_wire_safe_stop_t stop = {.axis = 0};
    const tl_wire_clear_fault_t clear = {.axis = 0};
    for (uint32_t i = 0; i < 1000; i++) {
        fake_ask(TL_WIRE_SAFE_STOP, &stop);
        fake_run_ms(5);
        fake_ask(TL_WIRE_CLEAR_FAULT, &clear);
        fake_run_ms(5);
    }
    TEST_ASSERT_TRUE(fake.operations <= 12); // ten seconds
}

static void test_the_last_sixteen_at_least_are_kept(void) {
    for (int32_t i = 1; i <= 100; i++) {
        fault(0, i);
        const uint32_t kept = count();
        TEST_ASSERT_TRUE(kept == (uint32_t)i || (kept > OF_SECTOR && kept <= PAGES));
        TEST_ASSERT_EQUAL(i, logged(0).value);
    }
    restart();
    TEST_ASSERT_TRUE(count() >= OF_SECTOR);
    TEST_ASSERT_EQUAL(100, logged(0).value);
}

// The power goes in each operation of 40 faults, in four ways; where cuts lie apart, in each in one way at least.
static void test_a_power_cut_loses_the_fault_that_was_written_or_the_oldest(void) {
    for (unsigned pattern = 0; pattern < 4; pattern++) {
        for (uint32_t cut = 1 + pattern % CUTS_APART; cut < 44; cut += CUTS_APART) {
            fake_new(2);
            fake.cut_at = cut;
            fake.cut_pattern = pattern;
            int32_t value = 0;
            while (!fake.dead) {
                fault(0, ++value);
            }
            restart();
            const uint32_t kept = count();
            const int32_t newest = logged(0).value;
            TEST_ASSERT_TRUE(newest == value || newest == value - 1);
            TEST_ASSERT_TRUE(kept >= OF_SECTOR || (int32_t)kept == newest);
            fault(0, 1000);
            TEST_ASSERT_EQUAL(1000, logged(0).value);
            restart();
            TEST_ASSERT_EQUAL(1000, logged(0).value);
            TEST_ASSERT_EQUAL(newest, kept > 0 ? logged(1).value : 0);
        }
    }
}

static void test_a_board_that_keeps_none_says_so(void) {
    fake_keeps_log = false;
    fake_new(2);
    fault(0, 5);
    TEST_ASSERT_EQUAL(0, count());
    TEST_ASSERT_EQUAL(0, fake.operations);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_fault_is_there_after_the_power_was_off);
    RUN_TEST(test_a_fault_that_stays_is_logged_once_and_the_same_again_anew);
    RUN_TEST(test_an_entry_is_a_frame_alone_in_its_page);
    RUN_TEST(test_nothing_is_written_while_a_motor_is_on);
    RUN_TEST(test_a_host_that_makes_faults_wears_no_flash);
    RUN_TEST(test_the_last_sixteen_at_least_are_kept);
    RUN_TEST(test_a_power_cut_loses_the_fault_that_was_written_or_the_oldest);
    RUN_TEST(test_a_board_that_keeps_none_says_so);
    return UNITY_END();
}
