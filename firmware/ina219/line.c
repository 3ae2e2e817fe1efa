#include "line.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "settings.h"

#define REQUEST '?'

/* 256 bytes, so that indices of 8 bits wrap by themselves. The interrupt moves `first`, the program `last`. */
static uint8_t queue[256];
static volatile uint8_t first;
static volatile uint8_t last;
static volatile uint8_t is_asked;

ISR(USART_UDRE_vect)
{
    if (first == last)
        UCSR0B &= (uint8_t) ~_BV(UDRIE0);
    else
        UDR0 = queue[first++];
}

ISR(USART_RX_vect)
{
    if (UDR0 == REQUEST)
        is_asked = 1;
}

void line_open(void)
{
    UCSR0A = _BV(U2X0); /* 8 clocks a bit: at 115200 nearer to the truth than 16 */
    UBRR0 = (F_CPU + LINE_BAUD * 4) / (LINE_BAUD * 8) - 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00); /* 8 data bits, no parity, 1 stop bit */
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

uint8_t line_send(const uint8_t *bytes, uint8_t count)
{
    uint8_t room = (uint8_t) (first - last - 1);
    if (count > room)
        return 0;
    while (count--) {
        queue[last] = *bytes++;
        last++;
    }
    UCSR0B |= _BV(UDRIE0);
    return 1;
}

uint8_t line_take_request(void)
{
    uint8_t asked = is_asked;
    if (asked)
        is_asked = 0;
    return asked;
}
