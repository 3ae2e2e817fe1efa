#include "mark.h"

#include <avr/io.h>

#define PIN _BV(PD4) /* D4 */

/* A button bounces for some milliseconds: a change counts once it was seen in three samples on end. */
#define STEADY 3

static uint8_t is_on;
static uint8_t seen;

void mark_open(void)
{
    DDRD &= (uint8_t) ~PIN;
    PORTD |= PIN; /* pulled up: open is off */
}

uint8_t mark_has_changed(void)
{
    uint8_t is_low = !(PIND & PIN);
    if (is_low == is_on) {
        seen = 0;
        return 0;
    }
    if (++seen < STEADY)
        return 0;
    seen = 0;
    is_on = is_low;
    return 1;
}

uint8_t mark_is_on(void)
{
    return is_on;
}
