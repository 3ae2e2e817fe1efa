/* The device's clock, and the beat of its samples: both from timer 1. */
#ifndef DEVICE_CLOCK_H
#define DEVICE_CLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

void device_clock_start(void);

/* Microseconds since the start, modulo 2^32. */
uint32_t device_clock_us(void);

/* How many samples became due since the last call: 0 or 1, and more only if the caller was late. */
uint8_t device_clock_take_due(void);

/* Whether a sample is due. */
uint8_t device_clock_is_due(void);

/* Sleep until the next interrupt, unless a sample is due already. */
void device_clock_wait(void);

#ifdef __cplusplus
}
#endif

#endif
