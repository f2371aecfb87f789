// A Raspberry Pi Pico 2 with the Motor 2040's circuit around it: two DRV8833 for four motors, a shunt of 0.47 ohm for
// each, and one ADC input behind an eightfold multiplexer. No such board is sold; who builds one finds the pins here.
// The names are those of the Motor 2040's header. Pins are the same but for those that a Pico 2 has no contact for.
// Included by the SDK's assembly, too: nothing but definitions.
#ifndef TAUTLINE_BOARD_PICO2_H
#define TAUTLINE_BOARD_PICO2_H

// pico_cmake_set PICO_PLATFORM=rp2350

#include "boards/pico2.h"

#define MOTOR2040_MOTOR_A_P_PIN 4 // to 11: two for each motor
#define MOTOR2040_NUM_MOTORS    4

#define MOTOR2040_ENCODER_A_A_PIN 0 // and B on the pin above
#define MOTOR2040_ENCODER_B_A_PIN 2
#define MOTOR2040_ENCODER_C_A_PIN 12
#define MOTOR2040_ENCODER_D_A_PIN 14

#define MOTOR2040_TX_PIN 16 // the stop button's

#define MOTOR2040_SHARED_ADC_PIN     26
#define MOTOR2040_ADC_ADDR_0_PIN     18
#define MOTOR2040_ADC_ADDR_1_PIN     19
#define MOTOR2040_ADC_ADDR_2_PIN     20
#define MOTOR2040_VOLTAGE_SENSE_ADDR 4
#define MOTOR2040_FAULT_SENSE_ADDR   5

#endif
