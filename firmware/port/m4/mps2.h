/// Registers of Arm's MPS2 board with its Cortex-M4 image (AN386) that this port uses.
#ifndef TAUTLINE_M4_MPS2_H
#define TAUTLINE_M4_MPS2_H

#include <stdint.h>

#define MPS2_CLOCK_HZ 25000000U

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

#define TIMER0 ((mps2_timer_t *)0x40000000U)
#define UART0  ((mps2_uart_t *)0x40004000U)
#define UART1  ((mps2_uart_t *)0x40005000U)

enum { IRQ_UART0_RX = 0, IRQ_UART0_TX = 1, IRQ_UART1_RX = 2, IRQ_TIMER0 = 8, IRQS = 32 };

#define PSRAM         ((uint8_t *)0x21000000U) ///< 16 MB
#define NVIC_ENABLE   (*(volatile uint32_t *)0xE000E100U)
#define NVIC_PRIORITY ((volatile uint8_t *)0xE000E400U)
#define SCB_AIRCR     (*(volatile uint32_t *)0xE000ED0CU)
#define SCB_CPACR     (*(volatile uint32_t *)0xE000ED88U)
#define AIRCR_RESET   0x05FA0004U

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
