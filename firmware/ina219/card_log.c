#include "card_log.h"

#include <avr/io.h>

#include "card.h"
#include "card_file.h"
#include "device_clock.h"
#include "settings.h"

#define LAMP _BV(PD5) /* D5 */

/* A card may be busy for 250 ms (Physical Layer Specification, 4.6.2.2), in which 200 samples a second
   are 844 bytes with what is said once a second, and a block has to be written before and after. */
#define QUEUE_SIZE 1152
#define PATIENCE_US 1000000UL

static uint8_t queue[QUEUE_SIZE]; /* before the recording begins, the scratch for looking at the card */
static uint16_t first;
static uint16_t queued;

static card_file_t file;
static uint32_t next_block;
static uint16_t to_put; /* bytes that the block being written still lacks */
static uint32_t busy_since_us;
static enum { CLOSED, READY, WRITING, BUSY } state;

static void close_log(void)
{
    state = CLOSED;
    PORTD &= (uint8_t) ~LAMP;
}

void card_log_open(void)
{
    DDRD |= LAMP;
    if (!card_open() || !card_file_find(&file, queue))
        return;
    next_block = card_file_end(&file, queue);
    if (next_block == file.count)
        return;
    state = READY;
    PORTD |= LAMP;
}

static void append(uint8_t byte)
{
    uint16_t at = first + queued;
    queue[at < QUEUE_SIZE ? at : at - QUEUE_SIZE] = byte;
    queued++;
}

void card_log_frame(const uint8_t *frame, uint8_t count)
{
    if (state == CLOSED || queued + count > QUEUE_SIZE)
        return;
    while (count--)
        append(*frame++);
}

void card_log_flush(void)
{
    /* What the block being written still takes belongs to it; the blocks after it are to come out even. */
    uint16_t over = (uint16_t) (queued - to_put) % CARD_BLOCK_SIZE;
    uint16_t lacking = over ? CARD_BLOCK_SIZE - over : 0;
    if (state == CLOSED || queued + lacking > QUEUE_SIZE)
        return;
    while (lacking--)
        append(0);
}

static void begin_block(void)
{
    if (next_block == file.count || !card_begin_write(file.first + next_block)) {
        close_log();
        return;
    }
    to_put = CARD_BLOCK_SIZE;
    state = WRITING;
}

static void write_block(void)
{
    while (to_put && !device_clock_is_due()) {
        card_put(queue[first]);
        if (++first == QUEUE_SIZE)
            first = 0;
        queued--;
        to_put--;
    }
    if (to_put)
        return;
    if (!card_end_write()) {
        close_log();
        return;
    }
    next_block++;
    busy_since_us = device_clock_us();
    state = BUSY;
}

static void look_whether_done(void)
{
    if (card_has_written())
        state = READY;
    else if (device_clock_us() - busy_since_us > PATIENCE_US)
        close_log();
}

uint8_t card_log_work(void)
{
    switch (state) {
    case READY:
        if (queued < CARD_BLOCK_SIZE)
            return 0;
        begin_block();
        return 1;
    case WRITING:
        write_block();
        return 1;
    case BUSY:
        look_whether_done();
        return state == READY && queued >= CARD_BLOCK_SIZE;
    default:
        return 0;
    }
}
