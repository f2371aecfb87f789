#include "motor.h"

#include <tgmath.h>

// A micro gearmotor on 6 V with its spindle: 20 000 counts/s without load, mechanical time constant 30 ms.
#define FREE_SPEED    20000.0 // counts/s at full duty
#define TIME_CONSTANT 0.030   // s
#define SLIDING       0.035   // duty that sliding friction takes
#define STATIC        0.050   // duty that breaks it away
#define STRIBECK      150.0   // counts/s within which static falls to sliding friction
#define STALL         700.0   // mA at full duty, blocked
#define CHOP          425.0   // mA at which the driver cuts the current off

void motor_step(motor_t *motor) {
    const MOTOR_REAL dt = MOTOR_STEP_US * 1e-6;
    const MOTOR_REAL most = CHOP / STALL;
    const MOTOR_REAL drive = fmin(fmax(motor->duty - motor->speed / FREE_SPEED, -most), most);
    motor->current = STALL * drive;
    if (motor->blocked) {
        motor->speed = 0.0;
        return;
    }
    if (motor->speed == 0.0 && fabs(motor->duty) <= STATIC) {
        return;
    }
    const MOTOR_REAL direction = motor->speed != 0.0 ? copysign(1.0, motor->speed) : copysign(1.0, motor->duty);
    const MOTOR_REAL friction = SLIDING + (STATIC - SLIDING) * exp(-fabs(motor->speed) / STRIBECK);
    const MOTOR_REAL speed = motor->speed + (drive - direction * friction) * FREE_SPEED / TIME_CONSTANT * dt;
    // Friction stops a motor, it does not turn it round.
    motor->speed = speed * direction < 0.0 ? 0.0 : speed;
    motor->position += (double)(motor->speed * dt);
}

int32_t motor_counts(const motor_t *motor) {
    return (int32_t)(uint32_t)(uint64_t)(int64_t)floor(motor->position);
}
