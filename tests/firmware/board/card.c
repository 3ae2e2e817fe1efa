#include "card.h"

#include <simavr/avr_ioport.h>
#include <simavr/avr_spi.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>
#include <string.h>

#define BLOCK 512
#define SELECT 2 /* PB2 */
#define WAKES 3 /* askings until it is ready */

static void say(struct card *card, uint8_t byte)
{
    card->out[card->out_count++] = byte;
}

static void say_block(struct card *card, uint32_t block)
{
    uint8_t data[BLOCK] = {0};
    fseek(card->image, (long) block * BLOCK, SEEK_SET);
    if (fread(data, 1, BLOCK, card->image) != BLOCK) {
        say(card, 0x09); /* out of range */
        return;
    }
    say(card, 0xFF);
    say(card, 0xFE);
    memcpy(card->out + card->out_count, data, BLOCK);
    card->out_count += BLOCK;
    say(card, 0);
    say(card, 0);
}

static void obey(struct card *card)
{
    uint8_t index = card->command[0] & 0x3F, idle = card->wakes < WAKES;
    uint32_t argument = (uint32_t) card->command[1] << 24 | card->command[2] << 16 | card->command[3] << 8
        | card->command[4];
    int is_application = card->is_application;
    card->is_application = 0;
    card->out_at = card->out_count = 0;
    say(card, 0xFF); /* answers come a byte late */
    if (index == 0 && card->command[5] == 0x95) {
        card->wakes = 0;
        say(card, 1);
    } else if (index == 8 && card->command[5] == 0x87) {
        say(card, idle);
        for (int byte = 1; byte < 5; byte++)
            say(card, card->command[byte]);
    } else if (index == 55) {
        card->is_application = 1;
        say(card, idle);
    } else if (index == 41 && is_application && argument == 0x40000000) {
        card->wakes++;
        say(card, card->wakes < WAKES);
    } else if (index == 58) {
        say(card, idle);
        say(card, 0xC0);
        say(card, 0xFF);
        say(card, 0x80);
        say(card, 0);
    } else if (index == 17 && !idle) {
        say(card, 0);
        say_block(card, argument);
    } else if (index == 24 && !idle) {
        say(card, 0);
        card->block = argument;
        card->takes = 1;
    } else {
        say(card, 4 | idle); /* illegal */
    }
}

static void store(struct card *card)
{
    fseek(card->image, (long) card->block * BLOCK, SEEK_SET);
    fwrite(card->in, 1, BLOCK, card->image);
    fflush(card->image);
    card->takes = 0;
    card->busy_until = card->now() + (++card->stored % card->busy_every ? 2e-3 : card->busy_s);
    card->out_at = card->out_count = 0;
    say(card, 0xE5); /* accepted */
}

static void take_data(struct card *card, uint8_t byte)
{
    if (card->takes == 1) {
        card->in_count = 0;
        card->takes = byte == 0xFE ? 2 : 1;
        return;
    }
    card->in[card->in_count++] = byte;
    if (card->in_count == BLOCK + 2)
        store(card);
}

static void take_command(struct card *card, uint8_t byte)
{
    if (card->got == 0 && (byte & 0xC0) != 0x40)
        return;
    card->command[card->got++] = byte;
    if (card->got == 6) {
        card->got = 0;
        obey(card);
    }
}

/* One byte goes each way at the same time: what the card says was fixed before it hears. */
static uint8_t exchange(struct card *card, uint8_t byte)
{
    uint8_t said = 0xFF;
    if (card->out_at < card->out_count)
        said = card->out[card->out_at++];
    else if (card->now() < card->busy_until)
        return 0;
    if (card->takes && card->out_at == card->out_count)
        take_data(card, byte);
    else
        take_command(card, byte);
    return said;
}

static void hear(struct avr_irq_t *irq, uint32_t byte, void *param)
{
    struct card *card = param;
    uint8_t said = card->is_selected ? exchange(card, (uint8_t) byte) : 0xFF;
    (void) irq;
    avr_raise_irq(avr_io_getirq(card->avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_INPUT), said);
}

static void select_card(struct avr_irq_t *irq, uint32_t level, void *param)
{
    struct card *card = param;
    (void) irq;
    card->is_selected = !level;
    card->got = 0;
}

void card_attach(struct card *card, struct avr_t *avr)
{
    card->avr = avr;
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_SPI_GETIRQ(0), SPI_IRQ_OUTPUT), hear, card);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), SELECT), select_card, card);
}
