// Tables that are moved while an axis follows: no jump above a count, never further than they say, and the calibrated
// one again when the host is lost, the power is cut or another table comes.
#include "fake_board.h"

#include <math.h>

#define OFFSET 200 // counts

void setUp(void) {
    fake_new(2);
    fake_ready();
}
void tearDown(void) {}

static uint16_t movable(uint8_t *blob, uint32_t variant) {
    static tl_table_t table;
    const uint16_t size = fake_table(blob, 0, variant);
    TEST_ASSERT_EQUAL(TL_TABLE_OK, tl_table_decode(blob, size, 0, &table));
    table.has |= TL_TABLE_HAS_adapt;
    table.adapt = (tl_table_adapt_t){
        .offset = OFFSET * TL_COUNT_ONE, .width_least_q15 = TL_RATIO_ONE / 2, .width_most_q15 = TL_RATIO_ONE * 3 / 2};
    return (uint16_t)tl_table_encode(&table, blob, TL_TABLE_SIZE_MAX);
}

static void use_table(uint32_t variant) {
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = movable(blob, variant);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
}

static int adapt(int32_t offset, int32_t scale_q15, uint16_t within_ms) {
    const tl_wire_adapt_t request = {
        .axis = 0, .offset_q8 = offset * TL_COUNT_ONE, .scale_q15 = scale_q15, .within_ms = within_ms};
    return fake_ask(TL_WIRE_ADAPT, &request);
}

static void begin(void) {
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(5);
    const tl_wire_follow_t follow = {.axis = 0, .target = 1, .compensation = 2, .silence_us = 200000};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_FOLLOW, &follow));
}

static void hold_tip(int32_t c_q16, uint32_t at_ms) {
    const tl_wire_set_point_t point = {.axis = 0, .value = c_q16, .at_us = fake.t_us + 1000ULL * at_ms};
    fake_ask(TL_WIRE_SET_POINT, &point);
}

// At rest at `c`, pushed from below.
static void arrive(int32_t c) {
    hold_tip(c - 5 * TL_DEG_ONE, 600);
    fake_run_ms(600);
    hold_tip(c, 600);
    fake_run_ms(1000 - 200);
    hold_tip(c, 1);
    fake_run_ms(150);
}

// The largest step of the motor's goal, counts in a millisecond, while it follows a tip that rests.
static double largest_step(int32_t c, uint32_t ms) {
    double most = 0.0;
    for (uint32_t i = 0; i < ms; i++) {
        const tl_count_q8_t before = app.axes[0].path.q;
        hold_tip(c, 1);
        fake_run_ms(1);
        const double step = fabs((double)(app.axes[0].path.q - before)) / TL_COUNT_ONE;
        most = step > most ? step : most;
    }
    return most;
}

static double goal(void) {
    return (double)app.axes[0].path.q / TL_COUNT_ONE;
}

static void test_a_table_without_limits_is_not_moved(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX];
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NO_TABLE, adapt(0, TL_RATIO_ONE, 100));
    const uint16_t size = fake_table(blob, 0, 0);
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_TABLE, adapt(1, TL_RATIO_ONE, 100));
    TEST_ASSERT_EQUAL(0, adapt(0, TL_RATIO_ONE, 100));
}

static void test_nor_further_than_they_say(void) {
    use_table(0);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_TABLE, adapt(OFFSET + 1, TL_RATIO_ONE, 100));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_TABLE, adapt(-OFFSET - 1, TL_RATIO_ONE, 100));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_TABLE, adapt(0, TL_RATIO_ONE / 2 - 1, 100));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_BEYOND_TABLE, adapt(0, TL_RATIO_ONE * 3 / 2 + 1, 100));
    TEST_ASSERT_EQUAL(0, adapt(-OFFSET, TL_RATIO_ONE * 3 / 2, 100));
}

static void test_a_table_is_blended_in_without_a_jump(void) {
    use_table(0);
    begin();
    const int32_t c = 10 * TL_DEG_ONE;
    arrive(c);
    const double before = goal(), width = (double)tl_lookup_width(&app.axes[0].tip.lookup,
                                                                  app.axes[0].tip.compensator.p, &(uint32_t){0}) /
                                          TL_COUNT_ONE;
    TEST_ASSERT_EQUAL(0, adapt(OFFSET, TL_RATIO_ONE, 500));
    TEST_ASSERT_TRUE(largest_step(c, 250) <= 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(10.0, before - OFFSET / 2.0, goal()); // half of the time
    TEST_ASSERT_TRUE(largest_step(c, 300) <= 1.0);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, before - OFFSET, goal());
    TEST_ASSERT_EQUAL(0, adapt(0, TL_RATIO_ONE / 2, 1)); // as fast as may be
    TEST_ASSERT_TRUE(largest_step(c, 3000) <= 1.01);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, before - width / 4.0, goal());
}

static void test_a_lost_host_takes_the_adaptation_with_it(void) {
    use_table(0);
    begin();
    const int32_t c = 10 * TL_DEG_ONE;
    arrive(c);
    TEST_ASSERT_EQUAL(0, adapt(OFFSET, TL_RATIO_ONE, 400));
    largest_step(c, 200); // in the middle of it
    double most = 0.0;
    for (int i = 0; i < 1500; i++) { // the host says nothing any more
        const tl_count_q8_t before = app.axes[0].path.q;
        fake_run_ms(1);
        most = fmax(most, fabs((double)(app.axes[0].path.q - before)) / TL_COUNT_ONE);
    }
    TEST_ASSERT_TRUE(most <= 1.0);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_HOLD, fake_status(0).mode);
    TEST_ASSERT_EQUAL(0, app.axes[0].tip.compensator.undo.moved.offset.goal);
    TEST_ASSERT_EQUAL(0, app.axes[0].tip.compensator.undo.moved.offset.now);
    begin();
    arrive(c);
    arrive(c);
    const double calibrated = goal();
    TEST_ASSERT_EQUAL(0, adapt(OFFSET, TL_RATIO_ONE, 100));
    largest_step(c, 500);
    TEST_ASSERT_DOUBLE_WITHIN(1.0, calibrated - OFFSET, goal()); // from the calibrated table
}

static void test_the_bus_takes_it_too(void) {
    use_table(0);
    TEST_ASSERT_EQUAL(0, adapt(OFFSET, TL_RATIO_ONE, 0));
    TEST_ASSERT_EQUAL(OFFSET * 65536, app.axes[0].tip.compensator.undo.moved.offset.now);
    tl_app_bus(&app, false);
    TEST_ASSERT_EQUAL(0, app.axes[0].tip.compensator.undo.moved.offset.now);
}

static void test_another_table_is_whole_and_not_moved(void) {
    use_table(0);
    begin();
    arrive(10 * TL_DEG_ONE);
    TEST_ASSERT_EQUAL(0, adapt(OFFSET, TL_RATIO_ONE, 400));
    largest_step(10 * TL_DEG_ONE, 200);
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = movable(blob, 7);
    TEST_ASSERT_EQUAL(TL_UPLOAD_NOT_OFF, fake_upload(0, blob, size)); // first it has to rest
    fake_enable(0, 0);
    fake_run_ms(500);
    const tl_count_q8_t before = app.axes[0].q;
    TEST_ASSERT_EQUAL(TL_UPLOAD_OK, fake_upload(0, blob, size));
    TEST_ASSERT_EQUAL(0, app.axes[0].tip.compensator.undo.moved.offset.goal);
    TEST_ASSERT_EQUAL(7, app.axes[0].tip.lookup.table.created_s);
    fake_enable(0, 1);
    fake_run_ms(200);
    TEST_ASSERT_INT_WITHIN(TL_COUNT_ONE, before, app.axes[0].path.q);
}

static void test_a_refused_table_leaves_the_one_that_flash_has(void) {
    use_table(3);
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = movable(blob, 4);
    blob[100] ^= 1U;
    TEST_ASSERT_EQUAL(TL_UPLOAD_REFUSED, fake_upload(0, blob, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_CRC, fake_status(0).table_reason);
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NEWEST, fake_status(0).table);
    TEST_ASSERT_TRUE(app.axes[0].has_table);
    TEST_ASSERT_EQUAL(3, app.axes[0].tip.lookup.table.created_s);
}

static void test_a_load_without_a_section_changes_nothing(void) {
    use_table(0);
    begin();
    arrive(10 * TL_DEG_ONE);
    const double before = goal();
    const tl_wire_load_t load = {.axis = 0, .load_q8 = 100 * 256, .within_ms = 10};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LOAD, &load));
    largest_step(10 * TL_DEG_ONE, 100);
    TEST_ASSERT_DOUBLE_WITHIN(0.01, before, goal());
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_table_without_limits_is_not_moved);
    RUN_TEST(test_nor_further_than_they_say);
    RUN_TEST(test_a_table_is_blended_in_without_a_jump);
    RUN_TEST(test_a_lost_host_takes_the_adaptation_with_it);
    RUN_TEST(test_the_bus_takes_it_too);
    RUN_TEST(test_another_table_is_whole_and_not_moved);
    RUN_TEST(test_a_refused_table_leaves_the_one_that_flash_has);
    RUN_TEST(test_a_load_without_a_section_changes_nothing);
    return UNITY_END();
}
