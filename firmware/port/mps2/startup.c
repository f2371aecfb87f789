// From reset to main(), and the vector table.
#include "mps2.h"

extern uint32_t data_begin[], data_end[], bss_begin[], bss_end[], stack_top[];
extern const uint32_t data_source[];

int main(void);
void reset_handler(void);
void fault_handler(void);
void control_interrupt(void);
void line_interrupt(void);
void line_sent_interrupt(void);
void world_interrupt(void);

void reset_handler(void) {
    SCB_CPACR |= 0xFU << 20; // the floating-point unit, for the motors' model
    const uint32_t *from = data_source;
    for (uint32_t *to = data_begin; to < data_end; to++) {
        *to = *from++;
    }
    for (uint32_t *to = bss_begin; to < bss_end; to++) {
        *to = 0;
    }
    main();
}

typedef void (*handler_t)(void);

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    handler_t handlers[15];
    handler_t interrupts[IRQS];
} vectors = {
    .stack = stack_top,
    .handlers = {reset_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler,
                 fault_handler, fault_handler, fault_handler, fault_handler, fault_handler, fault_handler,
                 fault_handler, fault_handler, fault_handler},
    .interrupts = {[IRQ_UART0_RX] = line_interrupt,
                   [IRQ_UART0_TX] = line_sent_interrupt,
                   [IRQ_UART1_RX] = world_interrupt,
                   [IRQ_TIMER0] = control_interrupt},
};
