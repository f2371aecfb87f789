// What bytes carry to the app and back, whatever the transport: half frames, sessions on a serial line, tables.
#include "fake_board.h"
#include "tautline/tl_serial.h"

void setUp(void) {
    fake_new(2);
}
void tearDown(void) {}

static size_t ping_frame(uint8_t *frame) {
    const tl_wire_ping_t ping = {.host_us = 5};
    return tl_wire_frame(frame, TL_WIRE_PING, 3, &ping);
}

static bool answers_a_ping(void) {
    const tl_wire_ping_t ping = {.host_us = 9};
    fake_ask(TL_WIRE_PING, &ping);
    return heard_count[TL_WIRE_PONG] == 1 && heard[TL_WIRE_PONG].pong.host_us == 9;
}

// -- half frames ------------------------------------------------------------------------------------------------

static void test_a_half_frame_costs_nothing_that_comes_later(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_limits_t limits = {.axis = 1}; // long enough to swallow several requests
    const size_t size = tl_wire_frame(frame, TL_WIRE_LIMITS, 1, &limits);
    for (size_t sent = 1; sent < size; sent++) {
        tl_app_receive(&app, frame, sent);
        fake_run_ms(25);
        TEST_ASSERT_TRUE_MESSAGE(answers_a_ping(), "the first request after a host that died in a frame");
    }
}

static void test_the_rest_of_a_slow_frame_is_waited_for(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const size_t size = ping_frame(frame);
    fake_listen();
    memset(heard_count, 0, sizeof(heard_count));
    for (size_t i = 0; i < size; i++) {
        tl_app_receive(&app, frame + i, 1);
        fake_run_ms(15);
    }
    fake_listen();
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_PONG]);
}

static void test_what_a_false_beginning_took_with_it_is_found(void) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    const tl_wire_limits_t limits = {.axis = 1};
    tl_wire_frame(frame, TL_WIRE_LIMITS, 1, &limits);
    tl_app_receive(&app, frame, TL_WIRE_HEADER_SIZE); // bytes lost on the line: only its head came
    const size_t size = ping_frame(frame);
    fake_listen();
    memset(heard_count, 0, sizeof(heard_count));
    tl_app_receive(&app, frame, size);
    fake_run_ms(25);
    fake_listen();
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_PONG]);
    TEST_ASSERT_EQUAL(TL_WIRE_HEADER_SIZE, app.counters.bytes_bad);
}

// -- a serial line ----------------------------------------------------------------------------------------------

static struct {
    uint8_t to_board[512], to_host[4096];
    size_t come, taken, sent, room;
} wire;

static size_t wire_read(void *context, uint8_t *out, size_t room) {
    (void)context;
    const size_t left = wire.come - wire.taken;
    const size_t size = left < room ? left : room;
    memcpy(out, wire.to_board + wire.taken, size);
    wire.taken += size;
    return size;
}

static size_t wire_write(void *context, const uint8_t *bytes, size_t size) {
    (void)context;
    const size_t fits = size < wire.room ? size : wire.room;
    memcpy(wire.to_host + wire.sent, bytes, fits);
    wire.sent += fits;
    wire.room -= fits;
    return fits;
}

static const tl_serial_t line = {.read = wire_read, .write = wire_write};

static void start_on_a_line(void) {
    memset(&wire, 0, sizeof(wire));
    tl_app_init(&app, &fake_port);
    tl_serial_init(&app, &line);
}

static void test_a_line_gives_every_byte_once_however_slow_it_is(void) {
    start_on_a_line();
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR};
    wire.come = tl_wire_frame(wire.to_board, TL_WIRE_HELLO, 7, &hello);
    const size_t size = TL_WIRE_HEADER_SIZE + tl_wire_size(TL_WIRE_IDENTITY) + TL_WIRE_CRC_SIZE;
    for (unsigned i = 0; i < 3U * size && wire.sent < size; i++) {
        wire.room = i % 3U; // 0, 1 or 2 bytes at a time
        tl_serial_task();
    }
    wire.room = 100;
    tl_serial_task();
    TEST_ASSERT_EQUAL(size, wire.sent);
    tl_wire_parser_t parser = {0};
    const uint8_t *data = wire.to_host;
    size_t left = wire.sent;
    tl_wire_frame_t frame;
    TEST_ASSERT_TRUE(tl_wire_parse(&parser, &data, &left, &frame));
    TEST_ASSERT_EQUAL(TL_WIRE_IDENTITY, frame.type);
    TEST_ASSERT_EQUAL(7, frame.sequence);
}

static void test_a_line_has_a_session_from_hello_on(void) {
    start_on_a_line();
    const tl_wire_ping_t ping = {0};
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_SESSION, fake_ask(TL_WIRE_PING, &ping));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_SESSION, fake_enable(0, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, app.axes[0].mode);
    const tl_wire_marker_t marker = {0};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_SESSION, fake_ask(TL_WIRE_MARKER, &marker));
    TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_HELLO, &hello));
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_IDENTITY]);
    TEST_ASSERT_TRUE(answers_a_ping());
}

static void test_each_hello_on_a_line_ends_the_session_before(void) {
    start_on_a_line();
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR};
    const tl_wire_telemetry_t on = {.axis = 0, .divider = 1};
    fake_ask(TL_WIRE_HELLO, &hello);
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_TELEMETRY, &on));
    uint8_t frame[TL_WIRE_FRAME_MAX];
    tl_app_receive(&app, frame, ping_frame(frame)); // a reply that nobody takes
    fake_run_ms(20);
    fake_ask(TL_WIRE_HELLO, &hello);
    TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_IDENTITY]);
    TEST_ASSERT_EQUAL(0, app.axes[0].telemetry.divider);
    TEST_ASSERT_EQUAL(1, app.counters.bus_losses);
    fake_run_ms(20);
    memset(heard_count, 0, sizeof(heard_count));
    fake_listen();
    TEST_ASSERT_EQUAL(0, heard_count[TL_WIRE_BATCH] + heard_count[TL_WIRE_PONG]);
}

// -- tables by message ------------------------------------------------------------------------------------------

static int write_part(uint8_t axis, const uint8_t *blob, uint16_t offset, uint8_t count) {
    tl_wire_table_write_t part = {.axis = axis, .count = count, .offset = offset};
    memcpy(part.bytes, blob + offset, count <= TL_WIRE_PART ? count : TL_WIRE_PART);
    return fake_ask(TL_WIRE_TABLE_WRITE, &part);
}

static int store(uint8_t axis, uint16_t size) {
    const tl_wire_table_store_t request = {.axis = axis, .size = size};
    return fake_ask(TL_WIRE_TABLE_STORE, &request);
}

static void write_all(uint8_t axis, const uint8_t *blob, uint16_t size) {
    for (uint16_t at = 0; at < size; at = (uint16_t)(at + TL_WIRE_PART)) {
        const uint16_t left = (uint16_t)(size - at);
        TEST_ASSERT_EQUAL(0, write_part(axis, blob, at, (uint8_t)(left < TL_WIRE_PART ? left : TL_WIRE_PART)));
    }
}

static uint16_t read_all(uint8_t axis, uint8_t *out) {
    uint16_t size = 0;
    for (;;) {
        const tl_wire_table_read_t request = {.axis = axis, .offset = size};
        TEST_ASSERT_EQUAL(-1, fake_ask(TL_WIRE_TABLE_READ, &request));
        TEST_ASSERT_EQUAL(1, heard_count[TL_WIRE_TABLE_PART]);
        const tl_wire_table_part_t *part = &heard[TL_WIRE_TABLE_PART].table_part;
        TEST_ASSERT_EQUAL(axis, part->axis);
        TEST_ASSERT_EQUAL(size, part->offset);
        memcpy(out + size, part->bytes, part->count);
        size = (uint16_t)(size + part->count);
        if (part->count < TL_WIRE_PART) {
            return size;
        }
    }
}

static void test_a_table_by_message_is_stored_and_read_back(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX], back[TL_TABLE_SIZE_MAX + TL_WIRE_PART];
    TEST_ASSERT_EQUAL(0, read_all(1, back));
    const uint16_t size = fake_table(blob, 1, 7);
    write_all(1, blob, size);
    TEST_ASSERT_EQUAL(0, store(1, size));
    TEST_ASSERT_EQUAL(size, read_all(1, back));
    TEST_ASSERT_EQUAL_MEMORY(blob, back, size);
    TEST_ASSERT_EQUAL(TL_WIRE_TABLE_NEWEST, fake_status(1).table);
    fake_start(2, TL_WIRE_BOOT_POWER);
    TEST_ASSERT_EQUAL(size, read_all(1, back));
}

static void test_a_table_by_message_is_refused_with_a_reason(void) {
    uint8_t blob[TL_TABLE_SIZE_MAX];
    const uint16_t size = fake_table(blob, 0, 7);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, write_part(2, blob, 0, 10));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, write_part(0, blob, 0, 0));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_RANGE, write_part(0, blob, 0, TL_WIRE_PART + 1));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_TABLE_SIZE, write_part(0, blob, TL_WIRE_PART, TL_WIRE_PART));
    write_all(0, blob, size);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_TABLE_SIZE, store(0, (uint16_t)(size + 1U))); // a part was lost
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_TABLE_SIZE, store(0, size));                  // and nothing of it is left
    write_all(1, blob, size);
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_TABLE_REFUSED, store(1, size));
    TEST_ASSERT_EQUAL(TL_TABLE_BAD_AXIS, fake_status(1).table_reason);
    TEST_ASSERT_EQUAL(0, fake.operations);
    write_all(0, blob, size);
    TEST_ASSERT_EQUAL(0, fake_enable(1, 1));
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_NOT_OFF, store(0, size));
    const tl_wire_table_read_t beyond = {.axis = 2};
    TEST_ASSERT_EQUAL(TL_WIRE_REASON_AXIS, fake_ask(TL_WIRE_TABLE_READ, &beyond));
}

// -- restart ----------------------------------------------------------------------------------------------------

static void test_a_restart_waits_until_the_axes_rest(void) {
    const tl_wire_set_position_t here = {.axis = 0};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_SET_POSITION, &here));
    const tl_wire_get_limits_t ask = {.axis = 0};
    fake_ask(TL_WIRE_GET_LIMITS, &ask);
    tl_wire_limits_t limits = heard[TL_WIRE_LIMITS].limits;
    limits.acceleration_q8_s2 = 10000 * TL_COUNT_ONE; // from 4000 counts/s to rest in 0.4 s
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_LIMITS, &limits));
    TEST_ASSERT_EQUAL(0, fake_enable(0, 1));
    fake_run_ms(500);
    const tl_wire_move_t move = {.axis = 0, .q_q8 = 20000 * TL_COUNT_ONE, .speed_q8_s = 4000 * TL_COUNT_ONE};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_MOVE, &move));
    fake_run_ms(700);
    TEST_ASSERT_TRUE(fake.speed[0] > 3000.0);
    const tl_wire_reboot_t reboot = {.key = TL_WIRE_KEY};
    TEST_ASSERT_EQUAL(0, fake_ask(TL_WIRE_REBOOT, &reboot));
    for (unsigned ms = 0; ms < 2000U && fake.rebooted == 0; ms++) {
        fake_run_ms(1);
    }
    TEST_ASSERT_EQUAL(1, fake.rebooted);
    TEST_ASSERT_EQUAL(TL_WIRE_MODE_OFF, app.axes[0].mode);
    TEST_ASSERT_TRUE(fake.speed[0] < 100.0 && fake.speed[0] > -100.0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_half_frame_costs_nothing_that_comes_later);
    RUN_TEST(test_the_rest_of_a_slow_frame_is_waited_for);
    RUN_TEST(test_what_a_false_beginning_took_with_it_is_found);
    RUN_TEST(test_a_line_gives_every_byte_once_however_slow_it_is);
    RUN_TEST(test_a_line_has_a_session_from_hello_on);
    RUN_TEST(test_each_hello_on_a_line_ends_the_session_before);
    RUN_TEST(test_a_table_by_message_is_stored_and_read_back);
    RUN_TEST(test_a_table_by_message_is_refused_with_a_reason);
    RUN_TEST(test_a_restart_waits_until_the_axes_rest);
    return UNITY_END();
}
