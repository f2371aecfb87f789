#include "quadrature.h"

#include "hardware/gpio.h"
#include "hardware/pio.h"
#include "hardware/timer.h"
#include "quadrature.pio.h"

enum { PULL_UP_US = 500 }; // five time constants of the pad's 80 kOhm with a nanofarad of cable

static void start(unsigned axis, unsigned pin_a) {
    pio_sm_config config = quadrature_program_get_default_config(0);
    sm_config_set_in_pins(&config, pin_a);
    sm_config_set_in_shift(&config, false, false, 32);
    sm_config_set_out_shift(&config, true, false, 32);
    pio_sm_init(pio0, axis, quadrature_offset_settled, &config);
    // The state that the first round compares with is the one that is there; the count starts at 0.
    pio_sm_exec(pio0, axis, pio_encode_in(pio_pins, 2));
    pio_sm_exec(pio0, axis, pio_encode_mov(pio_osr, pio_isr));
    pio_sm_exec(pio0, axis, pio_encode_set(pio_y, 0));
    pio_sm_set_enabled(pio0, axis, true);
}

void quadrature_init(const uint8_t *pins_a, unsigned axes) {
    pio_add_program(pio0, &quadrature_program);
    for (unsigned axis = 0; axis < axes; axis++) {
        for (unsigned pin = pins_a[axis]; pin <= pins_a[axis] + 1U; pin++) {
            pio_gpio_init(pio0, pin);
            gpio_pull_up(pin);
        }
        pio_sm_set_consecutive_pindirs(pio0, axis, pins_a[axis], 2, false);
    }
    busy_wait_us_32(PULL_UP_US);
    for (unsigned axis = 0; axis < axes; axis++) {
        start(axis, pins_a[axis]);
    }
}

bool quadrature_slipped(unsigned axis) {
    const uint32_t flag = 1u << axis;
    if (!(pio0->irq & flag)) {
        return false;
    }
    pio0->irq = flag;
    return true;
}
