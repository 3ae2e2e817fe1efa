/* Waiting for an interrupt, asleep. */
#ifndef REST_H
#define REST_H

#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <stdint.h>

/* Sleep until the next interrupt, unless the flag, which an interrupt sets, is set already. */
static inline void rest_unless(const volatile uint8_t *flag)
{
    cli();
    if (*flag) {
        sei();
        return;
    }
    sleep_enable();
    sei(); /* takes effect after the next instruction, so that no interrupt slips in between */
    sleep_cpu();
    sleep_disable();
}

#endif
