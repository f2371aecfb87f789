/// Teleoperation from C: sends the tip's bending angle to a board 250 times a second. libusb and common/ are all it
/// needs.
///
///     stream [AXIS] [SECONDS]
///
/// Build: cmake --build --preset gcc (where libusb-1.0's header is installed: Debian's libusb-1.0-0-dev).
/// Put your own master device where demand() is. When the sender stops or hangs, the board brings the axis to rest.
#include <inttypes.h>
#include <libusb.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "tautline/tl_wire.h"

#define ENDPOINT_OUT 0x01
#define ENDPOINT_IN  0x81
#define RATE_HZ      250
#define TIMEOUT_MS   500U
#define LEAD_US      8000U ///< a set-point holds so long after it was sent
#define DEG_Q16      65536.0
#define TIP          1U      ///< follow's target: configurations, through the tables
#define FULL         2U      ///< its compensation: f_remain and backlash
#define SILENCE_US   300000U ///< without a set-point for so long the axis comes to rest
#define PI           3.14159265358979323846

static libusb_device_handle *device;
static tl_wire_parser_t parser;
static uint16_t sequence;

/// Where the tip shall be at t_s, deg from where it was at the start.
static double demand(double t_s) {
    return 10.0 * sin(2.0 * PI * t_s / 4.0);
}

static void fail(const char *what, int error) {
    fprintf(stderr, "stream: %s: %s\n", what, error < 0 ? libusb_error_name(error) : "no answer");
    exit(1);
}

static void transmit(uint8_t type, const void *message) {
    uint8_t frame[TL_WIRE_FRAME_MAX];
    int moved = 0;
    const int size = (int)tl_wire_frame(frame, type, ++sequence, message);
    const int error = libusb_bulk_transfer(device, ENDPOINT_OUT, frame, size, &moved, TIMEOUT_MS);
    if (error < 0 || moved != size) {
        fail("the board does not take data", error);
    }
}

/// Sends a request and waits for its answer, of type `expected`, into *answer.
static void request(uint8_t type, const void *message, uint8_t expected, tl_wire_message_t *answer) {
    transmit(type, message);
    for (int tries = 0; tries < 20; tries++) {
        uint8_t data[4096];
        int moved = 0;
        const int error = libusb_bulk_transfer(device, ENDPOINT_IN, data, sizeof(data), &moved, TIMEOUT_MS);
        if (error < 0 && error != LIBUSB_ERROR_TIMEOUT) {
            fail("the board is gone", error);
        }
        const uint8_t *at = data;
        size_t left = (size_t)moved;
        tl_wire_frame_t frame;
        bool answered = false;
        while (tl_wire_parse(&parser, &at, &left, &frame)) {
            if (frame.sequence == sequence && tl_wire_decode(frame.type, frame.payload, frame.size, answer)) {
                if (frame.type == TL_WIRE_ERROR) {
                    fprintf(stderr,
                            "stream: the board refused request 0x%02x for reason %u (tl_wire.h: TL_WIRE_REASONS)\n",
                            (unsigned)answer->error.request, (unsigned)answer->error.reason);
                    exit(1);
                }
                answered = answered || frame.type == expected;
            }
        }
        if (answered) {
            return;
        }
    }
    fail("request", 0);
}

static double now_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int argc, char **argv) {
    const uint8_t axis = argc > 1 ? (uint8_t)atoi(argv[1]) : 0;
    const double seconds = argc > 2 ? atof(argv[2]) : 5.0;
    libusb_context *context = NULL;
    int error = libusb_init(&context);
    if (error < 0) {
        fail("libusb", error);
    }
    device = libusb_open_device_with_vid_pid(context, TL_WIRE_USB_VENDOR, TL_WIRE_USB_PRODUCT);
    if (device == NULL) {
        fail("no board is attached", LIBUSB_ERROR_NO_DEVICE);
    }
    error = libusb_claim_interface(device, 0);
    if (error < 0) {
        fail("another program uses the board", error);
    }

    tl_wire_message_t answer;
    const tl_wire_hello_t hello = {.protocol_major = TL_WIRE_MAJOR, .protocol_minor = TL_WIRE_MINOR};
    request(TL_WIRE_HELLO, &hello, TL_WIRE_IDENTITY, &answer);
    if (answer.identity.protocol_major != TL_WIRE_MAJOR) {
        fprintf(stderr, "stream: the board speaks protocol %u: build this program against its firmware's common/\n",
                (unsigned)answer.identity.protocol_major);
        return 1;
    }
    // Board time of now_s() == 0, from the shortest of a few round trips.
    double board_us = 0.0;
    double shortest = 1.0;
    for (int i = 0; i < 16; i++) {
        const double before = now_s();
        request(TL_WIRE_PING, &(tl_wire_ping_t){.host_us = 0}, TL_WIRE_PONG, &answer);
        const double trip = now_s() - before;
        if (trip < shortest) {
            shortest = trip;
            board_us = (double)answer.pong.t_us - 1e6 * (before + 0.5 * trip);
        }
    }

    request(TL_WIRE_ENABLE, &(tl_wire_enable_t){.axis = axis, .on = 1}, TL_WIRE_ACK, &answer);
    do { // the first time it checks motor and encoder before it holds
        const struct timespec pause = {.tv_nsec = 20000000};
        nanosleep(&pause, NULL);
        request(TL_WIRE_GET_STATUS, &(tl_wire_get_status_t){.axis = axis}, TL_WIRE_STATUS, &answer);
    } while (answer.status.mode == TL_WIRE_MODE_CHECK);
    const tl_wire_follow_t follow = {.axis = axis, .target = TIP, .compensation = FULL, .silence_us = SILENCE_US};
    request(TL_WIRE_FOLLOW, &follow, TL_WIRE_ACK, &answer);
    request(TL_WIRE_GET_STATUS, &(tl_wire_get_status_t){.axis = axis}, TL_WIRE_STATUS, &answer);
    const int32_t start_q16 = answer.status.c_ref_q16;

    const double began = now_s();
    const long count = lround(seconds * RATE_HZ);
    long late = 0;
    for (long i = 0; i < count; i++) {
        const double due = began + (double)i / RATE_HZ;
        const double ahead = due - now_s();
        if (ahead > 0.0) {
            const struct timespec pause = {.tv_nsec = (long)(1e9 * ahead)};
            nanosleep(&pause, NULL);
        } else if (ahead < -0.5 / RATE_HZ) {
            late++;
        }
        const double t_s = now_s() - began;
        const tl_wire_set_point_t point = {
            .axis = axis,
            .value = start_q16 + (int32_t)lround(DEG_Q16 * demand(t_s)),
            .at_us = (uint64_t)(board_us + 1e6 * (began + t_s)) + LEAD_US,
        };
        transmit(TL_WIRE_SET_POINT, &point);
    }
    const double took = now_s() - began;
    request(TL_WIRE_ENABLE, &(tl_wire_enable_t){.axis = axis, .on = 0}, TL_WIRE_ACK, &answer);
    request(TL_WIRE_GET_COUNTERS, &(tl_wire_get_counters_t){.clear = 0}, TL_WIRE_COUNTERS, &answer);
    printf("%ld set-points in %.2f s, %ld late; the board took %" PRIu32 " and dropped %" PRIu32 "\n", count, took,
           late, answer.counters.set_points, answer.counters.set_points_dropped);
    libusb_release_interface(device, 0);
    libusb_close(device);
    libusb_exit(context);
    return 0;
}
