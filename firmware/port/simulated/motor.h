// A geared DC motor with a quadrature encoder, in encoder counts: no backlash of its own, but friction.
#ifndef MOTOR_H
#define MOTOR_H

#include <stdbool.h>
#include <stdint.h>

#define MOTOR_STEP_US 25

#ifndef MOTOR_REAL
#define MOTOR_REAL double // float where the core has no other: then with -fsingle-precision-constant
#endif

typedef struct {
    double position;    // counts
    MOTOR_REAL speed;   // counts/s
    MOTOR_REAL duty;    // -1 to 1
    MOTOR_REAL current; // mA
    bool blocked;
} motor_t;

// MOTOR_STEP_US on.
void motor_step(motor_t *motor);
// What the encoder's counter would show had it begun at 0 there.
int32_t motor_counts(const motor_t *motor);

#endif
