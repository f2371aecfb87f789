#include "plant.h"

#include <string.h>

#define SUPPLY_MV  6000U
#define SUPPLY_LOW 2500U // with a supply that is ill
#define JUMP       30000 // counts
#define COARSE     8

void plant_init(plant_t *plant, uint8_t axes) {
    memset(plant, 0, sizeof(*plant));
    plant->axes = axes;
    plant->supply_mv = SUPPLY_MV;
}

void plant_start(plant_t *plant) {
    for (uint8_t i = 0; i < plant->axes; i++) {
        plant->encoder_zero[i] = motor_counts(&plant->motors[i]);
    }
    plant_release(plant);
}

void plant_release(plant_t *plant) {
    for (uint8_t i = 0; i < plant->axes; i++) {
        plant->motors[i].duty = 0;
    }
}

void plant_step(plant_t *plant) {
    for (uint8_t i = 0; i < plant->axes; i++) {
        motor_step(&plant->motors[i]);
    }
}

int32_t plant_encoder(const plant_t *plant, uint8_t axis) {
    const int32_t count = (int32_t)((uint32_t)motor_counts(&plant->motors[axis]) - (uint32_t)plant->encoder_zero[axis]);
    const int32_t stuck = plant->stuck[axis];
    switch (plant->ills[axis]) {
    case PLANT_UNPLUGGED:
        return stuck;
    case PLANT_COARSE:
        return stuck + (count - stuck) / COARSE;
    default:
        return count;
    }
}

void plant_drive(plant_t *plant, uint8_t axis, tl_duty_q15_t duty) {
    plant->motors[axis].duty = (MOTOR_REAL)(plant->ills[axis] == PLANT_REVERSED ? -duty : duty) / (MOTOR_REAL)32768;
}

int32_t plant_current_ma(const plant_t *plant, uint8_t axis) {
    const MOTOR_REAL current = plant->motors[axis].current;
    return current < 0 ? -(int32_t)((MOTOR_REAL)1 / 2 - current) : (int32_t)(current + (MOTOR_REAL)1 / 2);
}

bool plant_driver_fault(const plant_t *plant, uint8_t axis) {
    return plant->ills[axis] == PLANT_DRIVER;
}

int32_t plant_true_q8(const plant_t *plant, uint8_t axis) {
    const double q8 = plant->motors[axis].position * 256.0;
    return (int32_t)(uint32_t)(uint64_t)(int64_t)(q8 < 0.0 ? q8 - 0.5 : q8 + 0.5);
}

void plant_place(plant_t *plant, uint8_t axis, int32_t q_q8) {
    motor_t *motor = &plant->motors[axis];
    const int32_t before = motor_counts(motor);
    motor->position = q_q8 / 256.0;
    motor->speed = 0;
    const uint32_t moved = (uint32_t)motor_counts(motor) - (uint32_t)before;
    plant->encoder_zero[axis] = (int32_t)((uint32_t)plant->encoder_zero[axis] + moved);
}

void plant_inject(plant_t *plant, uint8_t axis, plant_ill_t ill) {
    const int32_t shown = plant_encoder(plant, axis);
    plant->ills[axis] = ill;
    plant->supply_mv = SUPPLY_MV;
    plant->estop_closed = false;
    for (unsigned i = 0; i < sizeof(plant->ills) / sizeof(plant->ills[0]); i++) { // all axes have these two in common
        plant->supply_mv = plant->ills[i] == PLANT_SUPPLY ? SUPPLY_LOW : plant->supply_mv;
        plant->estop_closed = plant->estop_closed || plant->ills[i] == PLANT_ESTOP;
    }
    plant->motors[axis].blocked = ill == PLANT_BLOCKED;
    // Whatever was or is wrong with the encoder, it goes on from what it shows; but for a jump.
    const int32_t count = ill == PLANT_JUMP ? shown + JUMP : shown;
    plant->encoder_zero[axis] = (int32_t)((uint32_t)motor_counts(&plant->motors[axis]) - (uint32_t)count);
    plant->stuck[axis] = count;
}

static const char *const ill_names[] = {"well", "blocked", "unplugged", "reversed", "coarse",
                                        "jump", "driver",  "supply",    "estop"};

const char *plant_ill_name(const plant_t *plant, uint8_t axis) {
    return ill_names[plant->ills[axis]];
}

bool plant_ill_of(const char *name, plant_ill_t *ill) {
    for (unsigned i = 0; i < sizeof(ill_names) / sizeof(ill_names[0]); i++) {
        if (strcmp(name, ill_names[i]) == 0) {
            *ill = (plant_ill_t)i;
            return true;
        }
    }
    return false;
}
