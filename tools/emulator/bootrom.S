// Stand-in for the RP2040's boot ROM, so that an unmodified Pico SDK image starts in the emulator and finds its ROM functions.
//
// Layout as the RP2040 datasheet (2.8.3) describes it: magic and version at 0x10, then 16-bit pointers to the function
// table, the data table and the look-up function. Memory and bit functions are Thumb code; whatever touches the flash chip is
// a BKPT that the emulator serves (rom.js), so that erasing and programming cost time and can be cut short.

    .syntax unified
    .cpu cortex-m0plus
    .thumb
    .section .text

    .word 0x20041f00                // stack while booting: just below where the second stage is copied
    .word reset + 1
    .word halt + 1                  // NMI
    .word halt + 1                  // HardFault

    .byte 'M', 'u', 1, 3            // 0x10: magic; version 3 is the B2 silicon
    .hword functions
    .hword data
    .hword lookup + 1

    .align 2
// The second stage: 256 bytes from flash with a CRC that the emulator checks. Without a valid one: USB boot.
    .thumb_func
reset:
    ldr r0, =0x20041f00
    bkpt 0xe0                       // r0: where to; back in r0: valid or not
    cmp r0, #0
    beq usb_boot
    ldr r0, =0x20041f01
    movs r1, #0
    mov lr, r1                      // tells the second stage to go on into the image
    bx r0

    .thumb_func
usb_boot:
    bkpt 0xe1
    .thumb_func
halt:
    b halt

// void *lookup(uint16_t *table, uint32_t code): pairs of code and 16-bit value up to a zero code
    .thumb_func
lookup:
    ldrh r2, [r0]
    cmp r2, #0
    beq 2f
    cmp r2, r1
    beq 1f
    adds r0, #4
    b lookup
1:  ldrh r0, [r0, #2]
    bx lr
2:  movs r0, #0
    bx lr

// uint8_t *memset(uint8_t *p, uint8_t value, uint32_t n), and the same for words, which it takes where it can
    .thumb_func
memset4:
memset:
    push {r0, r4}
    uxtb r1, r1
    lsls r3, r1, #8
    orrs r1, r3
    lsls r3, r1, #16
    orrs r1, r3
    lsls r3, r0, #30
    bne 3f
1:  subs r2, #4
    blo 2f
    stmia r0!, {r1}
    b 1b
2:  adds r2, #4
3:  cmp r2, #0
    beq 4f
    strb r1, [r0]
    adds r0, #1
    subs r2, #1
    b 3b
4:  pop {r0, r4}
    bx lr

// uint8_t *memcpy(uint8_t *to, uint8_t *from, uint32_t n), and the same for words; four words at a time, as the chip's
    .thumb_func
memcpy44:
memcpy:
    push {r0, r4, r5, r6}
    movs r3, r0
    orrs r3, r1
    lsls r3, r3, #30
    bne 3f
1:  subs r2, #16
    blo 2f
    ldmia r1!, {r3, r4, r5, r6}
    stmia r0!, {r3, r4, r5, r6}
    b 1b
2:  adds r2, #16
3:  cmp r2, #0
    beq 4f
    ldrb r3, [r1]
    strb r3, [r0]
    adds r1, #1
    adds r0, #1
    subs r2, #1
    b 3b
4:  pop {r0, r4, r5, r6}
    bx lr

    .thumb_func
popcount32:
    movs r1, #0
1:  cmp r0, #0
    beq 2f
    subs r2, r0, #1                 // clears the lowest bit that is set
    ands r0, r2
    adds r1, #1
    b 1b
2:  movs r0, r1
    bx lr

    .thumb_func
reverse32:
    movs r1, #0
    movs r2, #32
1:  lsrs r0, r0, #1
    adcs r1, r1
    subs r2, #1
    bne 1b
    movs r0, r1
    bx lr

    .thumb_func
clz32:
    movs r1, #32
1:  cmp r0, #0
    beq 2f
    subs r1, #1
    lsrs r0, r0, #1
    b 1b
2:  movs r0, r1
    bx lr

    .thumb_func
ctz32:
    movs r1, #32
1:  cmp r0, #0
    beq 2f
    subs r1, #1
    lsls r0, r0, #1
    b 1b
2:  movs r0, r1
    bx lr

    .thumb_func
connect_internal_flash:
    bkpt 0xe2
    bx lr
    .thumb_func
flash_exit_xip:
    bkpt 0xe3
    bx lr
// The operation starts at its BKPT; 0xe6 answers in r0 whether it still runs, and takes a microsecond.
    .thumb_func
flash_range_erase:                  // (offset, count, block size, block command)
    bkpt 0xe4
    b wait
    .thumb_func
flash_range_program:                // (offset, data, count)
    bkpt 0xe5
wait:
    bkpt 0xe6
    cmp r0, #0
    bne wait
    bx lr
    .thumb_func
flash_flush_cache:
    bkpt 0xe7
    bx lr
    .thumb_func
flash_enter_cmd_xip:
    bkpt 0xe8
    bx lr

    .align 2
functions:
    .hword 'P' | '3' << 8, popcount32 + 1
    .hword 'R' | '3' << 8, reverse32 + 1
    .hword 'L' | '3' << 8, clz32 + 1
    .hword 'T' | '3' << 8, ctz32 + 1
    .hword 'M' | 'S' << 8, memset + 1
    .hword 'S' | '4' << 8, memset4 + 1
    .hword 'M' | 'C' << 8, memcpy + 1
    .hword 'C' | '4' << 8, memcpy44 + 1
    .hword 'U' | 'B' << 8, usb_boot + 1
    .hword 'I' | 'F' << 8, connect_internal_flash + 1
    .hword 'E' | 'X' << 8, flash_exit_xip + 1
    .hword 'R' | 'E' << 8, flash_range_erase + 1
    .hword 'R' | 'P' << 8, flash_range_program + 1
    .hword 'F' | 'C' << 8, flash_flush_cache + 1
    .hword 'C' | 'X' << 8, flash_enter_cmd_xip + 1
data:
    .word 0

    .ltorg
