// Port functions of an axis whose motor, encoder and clock a test does not ask.
#ifndef SILENT_PORT_H
#define SILENT_PORT_H

#include "tautline/tl_port.h"

static inline tl_us_t no_time(void *context) {
    (void)context;
    return 0;
}

static inline int32_t no_encoder(void *context, uint8_t index) {
    (void)context;
    (void)index;
    return 0;
}

static inline void no_drive(void *context, uint8_t index, tl_duty_q15_t duty) {
    (void)context;
    (void)index;
    (void)duty;
}

#endif
