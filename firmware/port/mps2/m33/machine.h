/// The Cortex-M33 image of Arm's MPS2 board (AN505), which QEMU calls mps2-an505. The core starts in the secure state
/// and stays there: peripherals and memory are at their secure aliases, and nothing is handed to the other state.
#ifndef TAUTLINE_MPS2_MACHINE_H
#define TAUTLINE_MPS2_MACHINE_H

#define MACHINE_NAME   "m33"
#define MPS2_CLOCK_HZ  20000000U
#define MACHINE_TIMER0 0x50000000U
#define MACHINE_UART0  0x50200000U
#define MACHINE_UART1  0x50201000U
#define MACHINE_PSRAM  0x80000000U

enum { IRQ_TIMER0 = 3, IRQ_UART0_RX = 32, IRQ_UART0_TX = 33, IRQ_UART1_RX = 34, IRQS = 35 };

#endif
