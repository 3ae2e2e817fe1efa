#include "device_clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <util/atomic.h>

#include "rest.h"
#include "settings.h"

#define TICKS_PER_US (F_CPU / 8 / 1000000UL)
#define PERIOD_US (1000000UL / SAMPLE_RATE_HZ)
#define PERIOD_TICKS (PERIOD_US * TICKS_PER_US)
#define LOOKS (LOOK_RATE_HZ / SAMPLE_RATE_HZ)
#define LOOK_TICKS (PERIOD_TICKS / LOOKS)
/* A moment nearer than this could have gone by before the interrupt has set it: 32 us. */
#define MARGIN_TICKS 64

static volatile uint32_t period_began_us;
static volatile uint8_t samples_due;
static volatile uint8_t is_look_due;
static volatile uint8_t is_due; /* one of both */
static uint8_t looks_begun; /* in this period */
static uint16_t state = 0xACE1; /* of the chance: anything but 0 */

/* Marsaglia, Xorshift RNGs (2003): 16 bits with a period of 65535. */
uint16_t device_clock_chance(uint16_t limit)
{
    uint16_t drawn;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        state ^= state << 7;
        state ^= state >> 9;
        state ^= state << 8;
        drawn = state;
    }
    return (uint16_t) ((uint32_t) drawn * limit >> 16);
}

static void begin_look(void)
{
    OCR1B = (uint16_t) (looks_begun * LOOK_TICKS + MARGIN_TICKS + device_clock_chance(LOOK_TICKS - MARGIN_TICKS));
    looks_begun++;
}

ISR(TIMER1_COMPA_vect)
{
    period_began_us += PERIOD_US;
    if (samples_due < UINT8_MAX)
        samples_due++;
    is_due = 1;
    looks_begun = 0;
    begin_look();
}

ISR(TIMER1_COMPB_vect)
{
    is_look_due = is_due = 1;
    if (looks_begun < LOOKS)
        begin_look();
}

void device_clock_start(void)
{
    TCCR1A = 0;
    TCCR1B = 0;
    TCNT1 = 0;
    OCR1A = PERIOD_TICKS - 1;
    TIFR1 = _BV(OCF1A) | _BV(OCF1B);
    period_began_us = 0;
    samples_due = is_look_due = is_due = 0;
    looks_begun = 0;
    begin_look();
    TIMSK1 = _BV(OCIE1A) | _BV(OCIE1B);
    TCCR1B = _BV(WGM12) | _BV(CS11); /* clear on compare match; 16 MHz / 8 */
    set_sleep_mode(SLEEP_MODE_IDLE); /* the timer and the line go on */
}

uint32_t device_clock_us(void)
{
    uint32_t us;
    uint16_t ticks;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        us = period_began_us;
        ticks = TCNT1;
        /* The period may just have ended, its interrupt still to come. */
        if ((TIFR1 & _BV(OCF1A)) && ticks < PERIOD_TICKS / 2)
            us += PERIOD_US;
    }
    return us + ticks / TICKS_PER_US;
}

uint8_t device_clock_is_due(void)
{
    return is_due;
}

uint8_t device_clock_take_due(void)
{
    uint8_t taken;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        taken = samples_due;
        samples_due = 0;
        is_due = is_look_due;
    }
    return taken;
}

uint8_t device_clock_take_look(void)
{
    uint8_t taken;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        taken = is_look_due;
        is_look_due = 0;
        is_due = samples_due != 0;
    }
    return taken;
}

void device_clock_wait(void)
{
    rest_unless(&is_due);
}
