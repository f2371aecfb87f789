#include "motor.h"

#include <math.h>

// A micro gearmotor on 6 V with its spindle: 20 000 counts/s without load, mechanical time constant 30 ms.
#define FREE_SPEED    20000.0 // counts/s at full duty
#define TIME_CONSTANT 0.030   // s
#define SLIDING       0.035   // duty that sliding friction takes
#define STATIC        0.050   // duty that breaks it away
#define STRIBECK      150.0   // counts/s within which static falls to sliding friction
#define STALL         700.0   // mA at full duty, blocked
#define CHOP          425.0   // mA at which the driver cuts the current off

// Where MOTOR_REAL is float nothing of double is left.
static MOTOR_REAL size_of(MOTOR_REAL x) {
    return x < 0 ? -x : x;
}

static MOTOR_REAL exponential(MOTOR_REAL x) {
    return sizeof(x) == sizeof(float) ? (MOTOR_REAL)expf((float)x) : (MOTOR_REAL)exp((double)x);
}

void motor_step(motor_t *motor) {
    const MOTOR_REAL dt = MOTOR_STEP_US * 1e-6;
    const MOTOR_REAL most = CHOP / STALL;
    const MOTOR_REAL wanted = motor->duty - motor->speed / FREE_SPEED;
    const MOTOR_REAL drive = wanted > most ? most : wanted < -most ? -most : wanted;
    motor->current = STALL * drive;
    if (motor->blocked) {
        motor->speed = 0.0;
        return;
    }
    if (motor->speed == 0.0 && size_of(motor->duty) <= STATIC) {
        return;
    }
    const MOTOR_REAL direction = (motor->speed != 0.0 ? motor->speed : motor->duty) < 0.0 ? -1.0 : 1.0;
    const MOTOR_REAL friction = SLIDING + (STATIC - SLIDING) * exponential(-size_of(motor->speed) / STRIBECK);
    const MOTOR_REAL speed = motor->speed + (drive - direction * friction) * FREE_SPEED / TIME_CONSTANT * dt;
    // Friction stops a motor, it does not turn it round.
    motor->speed = speed * direction < 0.0 ? 0.0 : speed;
    motor->position += (double)(motor->speed * dt);
}

int32_t motor_counts(const motor_t *motor) {
    return (int32_t)(uint32_t)(uint64_t)(int64_t)floor(motor->position);
}
