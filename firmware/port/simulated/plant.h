// The hardware of simulated boards: motors, their encoders, drivers and supply, and what can go wrong with them.
#ifndef PLANT_H
#define PLANT_H

#include <stdbool.h>
#include <stdint.h>

#include "motor.h"
#include "tautline/tl_port.h"

#define PLANT_DRIVER_MA 425U  // of the reference board's drivers: motor.c cuts the current off there
#define PLANT_LEAST_MV  4000U // of the supply, below which its motors should not be driven

// It stays until it is taken back.
typedef enum {
    PLANT_WELL,      // takes back all that is wrong with an axis, and with supply and stop button
    PLANT_BLOCKED,   // the motor is held fast
    PLANT_UNPLUGGED, // the encoder shows nothing any more
    PLANT_REVERSED,  // the motor's wires are swapped
    PLANT_COARSE,    // the encoder counts every eighth count
    PLANT_JUMP,      // the encoder jumps, once
    PLANT_DRIVER,    // the driver reports a fault
    PLANT_SUPPLY,    // the supply is low
    PLANT_ESTOP,     // the stop button, a contact that closes, is pressed
} plant_ill_t;

typedef struct {
    uint8_t axes;
    uint16_t supply_mv;
    bool estop_closed;
    motor_t motors[TL_WIRE_AXES_MAX];
    int32_t encoder_zero[TL_WIRE_AXES_MAX]; // counters begin at 0 with each start
    plant_ill_t ills[TL_WIRE_AXES_MAX];
    int32_t stuck[TL_WIRE_AXES_MAX]; // what an encoder that is unplugged shows
} plant_t;

// Everything at rest at 0, and well.
void plant_init(plant_t *plant, uint8_t axes);
// The board starts: encoders count from 0, nothing is driven; motors go on where they are.
void plant_start(plant_t *plant);
// Nothing is driven.
void plant_release(plant_t *plant);
// MOTOR_STEP_US on.
void plant_step(plant_t *plant);

// What tl_port.h asks for.
int32_t plant_encoder(const plant_t *plant, uint8_t axis);
void plant_drive(plant_t *plant, uint8_t axis, tl_duty_q15_t duty);
int32_t plant_current_ma(const plant_t *plant, uint8_t axis);
bool plant_driver_fault(const plant_t *plant, uint8_t axis);

// True position, counts Q8.
int32_t plant_true_q8(const plant_t *plant, uint8_t axis);
// Sets a motor, at rest, to a true position (counts Q8): where the instrument was put by hand.
void plant_place(plant_t *plant, uint8_t axis, int32_t q_q8);
void plant_inject(plant_t *plant, uint8_t axis, plant_ill_t ill);
// What is wrong with it.
const char *plant_ill_name(const plant_t *plant, uint8_t axis);
// The ill of a name (well, blocked, ...); false: there is none.
bool plant_ill_of(const char *name, plant_ill_t *ill);

#endif
