/* The device's clock, the beat of its samples and the looks at the sensor between them: all from timer 1. */
#ifndef DEVICE_CLOCK_H
#define DEVICE_CLOCK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Start, or start anew from 0. */
void device_clock_start(void);

/* Microseconds since the start, modulo 2^32. */
uint32_t device_clock_us(void);

/* How many samples became due since the last call: 0 or 1, and more only if the caller was late. */
uint8_t device_clock_take_due(void);

/* Whether a look at the sensor became due since the last call. Looks come LOOK_RATE_HZ times a second on average, each
   at a random moment of its own share of the period, so that no load can beat in step with them. */
uint8_t device_clock_take_look(void);

/* A number that looks like chance, below the limit. */
uint16_t device_clock_chance(uint16_t limit);

/* Whether a sample or a look is due. */
uint8_t device_clock_is_due(void);

/* Sleep until the next interrupt, unless something is due already. */
void device_clock_wait(void);

#ifdef __cplusplus
}
#endif

#endif
