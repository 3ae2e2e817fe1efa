#include "twi.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/delay.h>
#include <util/twi.h>

#include "device_clock.h"
#include "rest.h"
#include "settings.h"

/* A byte takes 25 us. */
#define PATIENCE_US 1000
#define SDA _BV(PC4)
#define SCL _BV(PC5)

static volatile uint8_t is_done;

ISR(TWI_vect)
{
    TWCR = _BV(TWEN); /* no more interrupts; the bus waits for us */
    is_done = 1;
}

void twi_open(void)
{
    PORTC |= SDA | SCL; /* weak pull-ups; the sensor's board has its own */
    TWSR = 0;
    TWBR = (F_CPU / BUS_HZ - 16) / 2;
    TWCR = _BV(TWEN);
}

void twi_recover(void)
{
    uint8_t pulse;
    TWCR = 0;
    PORTC &= (uint8_t) ~(SDA | SCL); /* an output pulls low; an input lets the pull-ups raise */
    DDRC &= (uint8_t) ~SDA;
    for (pulse = 0; pulse < 9; pulse++) {
        DDRC |= SCL;
        _delay_us(5);
        DDRC &= (uint8_t) ~SCL;
        _delay_us(5);
    }
    twi_open();
}

/* Set the hardware going and return its status, or TW_BUS_ERROR if it did not come to an end. */
static uint8_t act(uint8_t control)
{
    uint32_t begun_us = device_clock_us();
    is_done = 0;
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWIE) | control;
    while (!is_done) {
        if (device_clock_us() - begun_us > PATIENCE_US)
            return TW_BUS_ERROR;
        rest_unless(&is_done);
    }
    return TW_STATUS;
}

static uint8_t start(void)
{
    uint8_t status = act(_BV(TWSTA));
    return status == TW_START || status == TW_REP_START;
}

static uint8_t send(uint8_t byte)
{
    uint8_t status;
    TWDR = byte;
    status = act(0);
    return status == TW_MT_SLA_ACK || status == TW_MT_DATA_ACK || status == TW_MR_SLA_ACK;
}

static void stop(void)
{
    uint8_t left = 100;
    TWCR = _BV(TWINT) | _BV(TWEN) | _BV(TWSTO);
    while ((TWCR & _BV(TWSTO)) && --left) /* some microseconds: half a clock of the bus */
        ;
}

uint8_t twi_write_register(uint8_t address, uint8_t reg, uint16_t value)
{
    uint8_t done = start() && send((uint8_t) (address << 1 | TW_WRITE)) && send(reg) && send((uint8_t) (value >> 8))
        && send((uint8_t) value);
    stop();
    return done;
}

uint8_t twi_read_register(uint8_t address, uint8_t reg, uint16_t *value)
{
    uint8_t high = 0;
    uint8_t done = start() && send((uint8_t) (address << 1 | TW_WRITE)) && send(reg) && start()
        && send((uint8_t) (address << 1 | TW_READ));
    if (done) {
        done = act(_BV(TWEA)) == TW_MR_DATA_ACK;
        high = TWDR;
    }
    if (done) {
        done = act(0) == TW_MR_DATA_NACK;
        *value = (uint16_t) (high << 8 | TWDR);
    }
    stop();
    return done;
}
