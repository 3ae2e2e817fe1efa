#include "card.h"

#include <avr/io.h>
#include <util/delay.h>

#define SELECT _BV(PB2) /* D10 */
#define DATA_OUT _BV(PB3) /* D11 */
#define DATA_IN _BV(PB4) /* D12 */
#define CLOCK _BV(PB5) /* D13 */

#define GO_IDLE 0
#define SEND_CONDITION 8
#define SET_BLOCK_SIZE 16
#define READ_BLOCK 17
#define WRITE_BLOCK 24
#define APPLICATION 55
#define READ_OPERATING_CONDITIONS 58
#define START_UP 41 /* after APPLICATION */

#define READY 0x00
#define IDLE 0x01
#define ILLEGAL 0x04
#define TOKEN 0xFE
#define ACCEPTED 0x05
#define HIGH_CAPACITY 0x40000000UL

static uint8_t counts_bytes; /* a card of up to 2 GB is addressed by byte, a larger one by block */

static uint8_t exchange(uint8_t byte)
{
    SPDR = byte;
    while (!(SPSR & _BV(SPIF)))
        ;
    return SPDR;
}

static void skip(uint8_t count)
{
    while (count--)
        exchange(0xFF);
}

static void deselect(void)
{
    PORTB |= SELECT;
    exchange(0xFF); /* the card lets go of the line at the next clock */
}

static uint8_t failed(void)
{
    deselect();
    return 0;
}

/* Wait for the first byte that is not 0xFF, `attempts` bytes at most, and return it; 0xFF if none came. */
static uint8_t answer(uint16_t attempts)
{
    uint8_t byte = 0xFF;
    while (attempts-- && byte == 0xFF)
        byte = exchange(0xFF);
    return byte;
}

static uint32_t read32(void)
{
    uint32_t value = 0;
    uint8_t left = 4;
    while (left--)
        value = value << 8 | exchange(0xFF);
    return value;
}

/* Select the card and send a command; return its first answer. */
static uint8_t command(uint8_t index, uint32_t argument)
{
    PORTB &= (uint8_t) ~SELECT;
    exchange(0xFF);
    exchange(0x40 | index);
    exchange((uint8_t) (argument >> 24));
    exchange((uint8_t) (argument >> 16));
    exchange((uint8_t) (argument >> 8));
    exchange((uint8_t) argument);
    /* Checksums count only before the card is in SPI mode: for these two commands. */
    exchange(index == GO_IDLE ? 0x95 : index == SEND_CONDITION ? 0x87 : 0xFF);
    return answer(10);
}

static uint8_t start_up(uint32_t capacity)
{
    uint16_t left = 350; /* about 3 ms each */
    while (left--) {
        command(APPLICATION, 0);
        if (command(START_UP, capacity) == READY)
            return 1;
        _delay_ms(1);
    }
    return 0;
}

static uint8_t identify(void)
{
    uint8_t left = 10;
    while (command(GO_IDLE, 0) != IDLE)
        if (--left == 0)
            return 0;
    if (command(SEND_CONDITION, 0x1AA) & ILLEGAL) {
        counts_bytes = 1; /* a card of version 1 */
        return start_up(0);
    }
    if ((read32() & 0xFFF) != 0x1AA || !start_up(HIGH_CAPACITY) || command(READ_OPERATING_CONDITIONS, 0) != READY)
        return 0;
    counts_bytes = !(read32() & HIGH_CAPACITY);
    return 1;
}

uint8_t card_open(void)
{
    PORTB |= SELECT | DATA_IN; /* pulled up, so that an empty socket says 0xFF */
    DDRB |= SELECT | DATA_OUT | CLOCK;
    SPCR = _BV(SPE) | _BV(MSTR) | _BV(SPR1) | _BV(SPR0); /* 125 kHz: a card that wakes up takes up to 400 kHz */
    skip(10); /* 74 clocks, unselected */
    if (!identify() || (counts_bytes && command(SET_BLOCK_SIZE, CARD_BLOCK_SIZE) != READY)) {
        deselect();
        SPCR = 0;
        return 0;
    }
    deselect();
    SPCR = _BV(SPE) | _BV(MSTR); /* 4 MHz, which level shifters on cheap sockets stand */
    return 1;
}

static uint32_t address_of(uint32_t block)
{
    return counts_bytes ? block * CARD_BLOCK_SIZE : block;
}

uint8_t card_read(uint32_t block, uint8_t *to)
{
    uint16_t left = CARD_BLOCK_SIZE;
    if (command(READ_BLOCK, address_of(block)) != READY || answer(50000U) != TOKEN)
        return failed();
    while (left--)
        *to++ = exchange(0xFF);
    skip(2); /* the checksum, which is not used */
    deselect();
    return 1;
}

uint8_t card_begin_write(uint32_t block)
{
    if (command(WRITE_BLOCK, address_of(block)) != READY)
        return failed();
    exchange(0xFF);
    exchange(TOKEN);
    return 1;
}

void card_put(uint8_t byte)
{
    exchange(byte);
}

uint8_t card_end_write(void)
{
    skip(2); /* the checksum, which is not used */
    return (exchange(0xFF) & 0x1F) == ACCEPTED ? 1 : failed();
}

uint8_t card_has_written(void)
{
    if (exchange(0xFF) != 0xFF)
        return 0;
    deselect();
    return 1;
}
