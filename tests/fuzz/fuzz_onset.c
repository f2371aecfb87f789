// Any motion of a motor and anything that a camera may show of it: the detector ends each reversal with a reason, and
// measures only where it says so.
#include "fuzz.h"

#include "tautline/tl_onset.h"

#define FRAMES    200
#define IMAGE_Q12 (4096 * 4096) // px, of the header

static tl_history_t history;
static tl_onset_detector_t detector;
static tl_us_t now_us;
static tl_count_q8_t q;

static tl_onset_config_t any_config(void) {
    tl_onset_config_t config = tl_onset_defaults();
    if (between(0, 1) == 0) {
        config.delay_us = (uint32_t)between(0, 450000);
        config.guard_us = (uint32_t)between(0, 100000);
        config.lost_us = (uint32_t)between(0, 1000000);
        config.timeout_us = (uint32_t)between(0, 5000000);
        config.turn = between(0, 20 * TL_COUNT_ONE);
        config.sigma_wanted = between(0, 20 * TL_COUNT_ONE);
        config.sigma_usable = between(0, 1000 * TL_COUNT_ONE);
        config.noise_px = between(0, 4 * 4096);
        config.curvature = (uint32_t)between(0, 1 << 21);
        config.threshold = (uint16_t)between(0, 1000);
        config.frames_min = (uint8_t)between(0, 40);
        config.frames_max = (uint8_t)between(0, 70);
    }
    return config;
}

static void check(const tl_onset_t *onset) {
    PROMISE(onset->reason <= TL_ONSET_SLOPE_TOO_SMALL);
    PROMISE(onset->direction == 1 || onset->direction == -1);
    PROMISE(onset->width >= 0 && onset->sigma >= 0 && onset->sigma_stop >= 0 && onset->noise >= 0);
    if (onset->reason == TL_ONSET_USED) {
        PROMISE(onset->started && onset->q2 != TL_ONSET_UNKNOWN && onset->width != TL_ONSET_UNKNOWN);
        PROMISE(onset->sigma <= detector.config.sigma_usable && onset->start_us >= onset->turn_us);
    }
}

static void run(uint32_t ms, int32_t speed) {
    for (uint32_t i = 0; i < ms; i++) {
        now_us += 1000U;
        q = tl_clamp(q + speed, -4000000 * TL_COUNT_ONE, 4000000 * TL_COUNT_ONE);
        tl_history_push(&history, now_us, q);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    fuzz_from(data, size);
    tl_history_init(&history);
    const tl_onset_config_t config = any_config();
    if (!tl_onset_init(&detector, &config)) {
        return 0;
    }
    now_us = 1000000U;
    q = 0;
    const int32_t width = between(0, 600) * TL_COUNT_ONE, slope = between(0, 400), noise = between(0, 2000);
    int32_t way = 4 * TL_COUNT_ONE, tip = 0;
    for (int frame = 0; frame < FRAMES; frame++) {
        const uint32_t odd = fuzz_byte();
        way = odd < 12U ? -way : (odd < 16U ? between(-5000, 5000) : way);
        run(odd == 16U ? (uint32_t)between(0, 700) : 40U, way);
        tip = q - width / 2 > tip ? q - width / 2 : (q + width / 2 < tip ? q + width / 2 : tip);
        const int64_t seen = (int64_t)tip * slope / TL_COUNT_ONE;
        tl_marker_t marker = {.arrival_us = now_us,
                              .u = (tl_px_q12_t)(seen % IMAGE_Q12) + between(-noise, noise),
                              .v = between(-noise, noise),
                              .valid = odd != 17U,
                              .other_motion = odd == 18U};
        if (odd == 19U) {
            marker.u = between(-IMAGE_Q12, IMAGE_Q12);
            marker.v = between(-IMAGE_Q12, IMAGE_Q12);
            marker.sigma = between(0, IMAGE_Q12);
            marker.arrival_us -= (uint32_t)between(0, 2000000);
        }
        marker.u = tl_clamp(marker.u, -IMAGE_Q12, IMAGE_Q12);
        tl_onset_t onset;
        if (odd == 20U ? tl_onset_poll(&detector, &history, now_us, &onset)
                       : tl_onset_sample(&detector, &history, &marker, &onset)) {
            check(&onset);
        }
    }
    return 0;
}
