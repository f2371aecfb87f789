/// Registers of Arm's MPS2 board that this port uses; where they are depends on the core's image (machine.h).
#ifndef TAUTLINE_MPS2_H
#define TAUTLINE_MPS2_H

#include <stdint.h>

#include "machine.h"

typedef struct {
    volatile uint32_t data, state, control, interrupt, divider; ///< divider: of the baud rate, 16 or more
} mps2_uart_t;
#define UART_TX_FULL             1U ///< of state
#define UART_RX_FULL             2U
#define UART_TX_ENABLE           1U ///< of control
#define UART_RX_ENABLE           2U
#define UART_TX_INTERRUPT_ENABLE 4U
#define UART_RX_INTERRUPT_ENABLE 8U
#define UART_TX_INTERRUPT        1U ///< of interrupt; written: cleared
#define UART_RX_INTERRUPT        2U

typedef struct {
    volatile uint32_t control, value, reload, interrupt; ///< counts down, from reload after 0
} mps2_timer_t;
#define TIMER_ENABLE           1U
#define TIMER_INTERRUPT_ENABLE 8U

#define TIMER0 ((mps2_timer_t *)MACHINE_TIMER0)
#define UART0  ((mps2_uart_t *)MACHINE_UART0)
#define UART1  ((mps2_uart_t *)MACHINE_UART1)

#define PSRAM         ((uint8_t *)MACHINE_PSRAM) ///< 16 MB
#define NVIC_ENABLE   ((volatile uint32_t *)0xE000E100U)
#define NVIC_PRIORITY ((volatile uint8_t *)0xE000E400U)
#define SCB_AIRCR     (*(volatile uint32_t *)0xE000ED0CU)
#define SCB_CPACR     (*(volatile uint32_t *)0xE000ED88U)
#define AIRCR_RESET   0x05FA0004U

static inline void interrupt_enable(uint32_t number, uint8_t priority) {
    NVIC_PRIORITY[number] = priority;
    NVIC_ENABLE[number / 32U] = 1U << number % 32U; // zeros change nothing
}

static inline uint32_t interrupts_off(void) {
    uint32_t before;
    __asm volatile("mrs %0, primask\n cpsid i" : "=r"(before)::"memory");
    return before;
}

static inline void interrupts_restore(uint32_t before) {
    __asm volatile("msr primask, %0" ::"r"(before) : "memory");
}

static inline void wait_for_interrupt(void) {
    __asm volatile("wfi" ::: "memory");
}

static inline _Noreturn void chip_reset(void) {
    SCB_AIRCR = AIRCR_RESET;
    for (;;) {
    }
}

#endif
