#include "bridge.h"

#include "hardware/adc.h"
#include "hardware/clocks.h"
#include "hardware/gpio.h"
#include "hardware/pwm.h"
#include "hardware/structs/iobank0.h"
#include "hardware/structs/padsbank0.h"
#include "pico.h"

enum {
    PWM_HZ = 20000,
    CLOCK_HZ = SYS_CLK_HZ, // 125 MHz, RP2350: 150
    PERIOD = CLOCK_HZ / PWM_HZ,
    SENSE_BEFORE_END = CLOCK_HZ / 1000000,       // the ADC holds its sample within this time
    DEAD_TIME = CLOCK_HZ / 1000000 * 450 / 1000, // t_DEAD of TI's DRV8833 data sheet: neither side conducts
    SHUNT_MILLIOHM = 470, // motor2040.hpp of Pimoroni's pimoroni-pico, gain 1; its offset of -5 mA is left out
    ADC_FULL_SCALE_MV = 3300,
    FAULT_BELOW_MV = ADC_FULL_SCALE_MV / 4,
    SENSE_SAMPLES = 4,    // the ADC's FIFO
    SENSE_EVERY = 3 * 48, // cycles of its 48 MHz clock, 96 of which are the conversion
    ADC_SHARED_INPUT = MOTOR2040_SHARED_ADC_PIN - 26,
};

static unsigned sense_turn;
static unsigned sense_address;

static inline unsigned pin_p(unsigned axis) {
    return MOTOR2040_MOTOR_A_P_PIN + 2 * axis;
}

// As pwm_gpio_to_slice_num(), which may end up in flash.
static inline unsigned slice(unsigned axis) {
    return pin_p(axis) >> 1 & 7;
}

static void __not_in_flash_func(set_levels)(unsigned axis, uint32_t p, uint32_t n) {
    // Both inputs of a bridge are the two channels of one slice: one write, so that they change in the same period.
    pwm_hw->slice[slice(axis)].cc = p | n << 16;
}

// In ten turns each current twice, supply and fault line once. The latter is an open drain.
static void __not_in_flash_func(select_sense)(void) {
    const unsigned turn = sense_turn;
    sense_turn = turn < 9 ? turn + 1 : 0;
    const unsigned address = turn < 5 ? turn : (turn < 9 ? turn - 5 : MOTOR2040_FAULT_SENSE_ADDR);
    if (address == MOTOR2040_FAULT_SENSE_ADDR) {
        hw_set_bits(&padsbank0_hw->io[MOTOR2040_SHARED_ADC_PIN], PADS_BANK0_GPIO0_PUE_BITS);
    } else {
        hw_clear_bits(&padsbank0_hw->io[MOTOR2040_SHARED_ADC_PIN], PADS_BANK0_GPIO0_PUE_BITS);
    }
    sense_address = address;
    gpio_put(MOTOR2040_ADC_ADDR_0_PIN, address & 1);
    gpio_put(MOTOR2040_ADC_ADDR_1_PIN, address >> 1 & 1);
    gpio_put(MOTOR2040_ADC_ADDR_2_PIN, address >> 2 & 1);
}

void bridge_init(void) {
    hard_assert(clock_get_hz(clk_sys) == CLOCK_HZ);
    for (unsigned axis = 0; axis < MOTOR2040_NUM_MOTORS; axis++) {
        pwm_config config = pwm_get_default_config();
        pwm_config_set_wrap(&config, PERIOD - 1);
        pwm_init(slice(axis), &config, true);
        set_levels(axis, 0, 0);
        gpio_set_function(pin_p(axis), GPIO_FUNC_PWM);
        gpio_set_function(pin_p(axis) + 1, GPIO_FUNC_PWM);
    }
    const unsigned address_pins[] = {MOTOR2040_ADC_ADDR_0_PIN, MOTOR2040_ADC_ADDR_1_PIN, MOTOR2040_ADC_ADDR_2_PIN};
    for (unsigned i = 0; i < 3; i++) {
        gpio_init(address_pins[i]);
        gpio_set_dir(address_pins[i], GPIO_OUT);
    }
    adc_init();
    adc_gpio_init(MOTOR2040_SHARED_ADC_PIN);
    adc_select_input(ADC_SHARED_INPUT);
    adc_set_clkdiv(SENSE_EVERY - 1);
    adc_fifo_setup(true, false, SENSE_SAMPLES, false, false);
    select_sense();
}

static uint32_t slices(void) {
    uint32_t mask = 0;
    for (unsigned axis = 0; axis < MOTOR2040_NUM_MOTORS; axis++) {
        mask |= 1u << slice(axis);
    }
    return mask;
}

uint32_t bridge_align(uint32_t ticks) {
    pwm_set_mask_enabled(0);
    for (unsigned axis = 0; axis < MOTOR2040_NUM_MOTORS; axis++) {
        pwm_set_counter(slice(axis), (uint16_t)((2 * PERIOD - SENSE_BEFORE_END - ticks % PERIOD) % PERIOD));
    }
    return slices();
}

void __not_in_flash_func(bridge_drive)(unsigned axis, tl_duty_q15_t duty) {
    const tl_duty_q15_t limited = tl_clamp(duty, -32768, 32768);
    const uint32_t size = (uint32_t)(limited < 0 ? -limited : limited);
    uint32_t on = size * PERIOD >> 15;
    if (on > 0) {
        on = on + DEAD_TIME < PERIOD ? on + DEAD_TIME : PERIOD;
    }
    // The driving side stays high, the other one goes low for the time the bridge drives, at the period's end.
    if (limited >= 0) {
        set_levels(axis, PERIOD, PERIOD - on);
    } else {
        set_levels(axis, PERIOD - on, PERIOD);
    }
}

void __not_in_flash_func(bridge_coast_all)(void) {
    for (unsigned pin = MOTOR2040_MOTOR_A_P_PIN; pin < MOTOR2040_MOTOR_A_P_PIN + 2 * MOTOR2040_NUM_MOTORS; pin++) {
        iobank0_hw->io[pin].ctrl = GPIO_FUNC_PWM | IO_BANK0_GPIO0_CTRL_OUTOVER_VALUE_LOW
                                                       << IO_BANK0_GPIO0_CTRL_OUTOVER_LSB;
    }
}

void __not_in_flash_func(bridge_sense_start)(void) {
    (void)adc_hw->fifo; // a conversion that was under way when the last measurement ended
    hw_set_bits(&adc_hw->cs, ADC_CS_START_MANY_BITS);
}

int32_t __not_in_flash_func(bridge_sense_finish)(unsigned *what) {
    hw_clear_bits(&adc_hw->cs, ADC_CS_START_MANY_BITS);
    uint32_t most = 0;
    while (!(adc_hw->fcs & ADC_FCS_EMPTY_BITS)) {
        const uint32_t sample = adc_hw->fifo;
        most = sample > most ? sample : most;
    }
    const uint32_t millivolt = most * ADC_FULL_SCALE_MV >> 12;
    *what = sense_address;
    select_sense();
    switch (*what) {
    case BRIDGE_SUPPLY:
        return (int32_t)(millivolt * ((139u << 10) / 39u) >> 10);
    case BRIDGE_FAULT:
        return millivolt < FAULT_BELOW_MV;
    default:
        return (int32_t)(millivolt * ((1000u << 10) / SHUNT_MILLIOHM) >> 10);
    }
}
