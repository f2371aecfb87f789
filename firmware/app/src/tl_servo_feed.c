#include "tautline/tl_servo.h"

void tl_servo_feed(tl_servo_t *servo, const tl_path_t *path) {
    // D on the path's speed belongs to it: the step takes D on the measured one off again. Gains have 17 bits here.
    const int32_t bend = path->bend >> servo->bend_down, gain = servo->path_gain;
    const int32_t way = path->speed != 0 ? path->speed : bend;
    int32_t feed = ((path->speed >> servo->speed_down >> 1) * gain >> 1) + (bend * servo->inertia >> 2);
    if (way != 0) {
        const int32_t friction = servo->gains.friction << 8;
        feed += way > 0 ? friction : -friction;
    }
    servo->feed = feed;
    servo->feed_step = bend * gain >> servo->bend_per_speed;
}
