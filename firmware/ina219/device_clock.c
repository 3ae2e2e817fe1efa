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

static volatile uint32_t period_began_us;
static volatile uint8_t due;

ISR(TIMER1_COMPA_vect)
{
    period_began_us += PERIOD_US;
    if (due < UINT8_MAX)
        due++;
}

void device_clock_start(void)
{
    TCCR1A = 0;
    TCCR1B = 0;
    TCNT1 = 0;
    OCR1A = PERIOD_TICKS - 1;
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
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
    return due != 0;
}

uint8_t device_clock_take_due(void)
{
    uint8_t taken;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        taken = due;
        due = 0;
    }
    return taken;
}

void device_clock_wait(void)
{
    rest_unless(&due);
}
