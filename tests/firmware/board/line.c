#define _GNU_SOURCE
#include "line.h"

#include <fcntl.h>
#include <poll.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

#define LATENCY 4e-3 /* s that an adapter waits for a packet to fill */

int line_open(struct line *line)
{
    struct termios raw;
    int host;
    line->terminal = posix_openpt(O_RDWR | O_NOCTTY);
    if (line->terminal < 0 || grantpt(line->terminal) || unlockpt(line->terminal))
        return 0;
    /* Opened and closed once, so that its state says whether anybody has it open. */
    host = open(ptsname(line->terminal), O_RDWR | O_NOCTTY);
    if (host < 0 || tcgetattr(host, &raw))
        return 0;
    cfmakeraw(&raw);
    tcsetattr(host, TCSANOW, &raw);
    close(host);
    printf("%s\n", ptsname(line->terminal));
    fflush(stdout);
    return 1;
}

static int is_open(struct line *line, int for_writing, int patience_ms)
{
    struct pollfd state = {.fd = line->terminal, .events = for_writing ? POLLOUT : 0};
    poll(&state, 1, patience_ms);
    return !(state.revents & POLLHUP);
}

int line_wait(struct line *line, double patience)
{
    for (int left = (int) (patience * 1000); left > 0 && !is_open(line, 0, 0); left--)
        usleep(1000);
    line->is_closed = !is_open(line, 0, 0);
    line->count = 0;
    line->given = 0;
    return !line->is_closed;
}

/* Numbers that look like chance and are the same each time (Steele, Lea, Flood: splitmix64). */
static double chance(struct line *line)
{
    uint64_t z = line->seed += 0x9E3779B97F4A7C15;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9;
    z = (z ^ z >> 27) * 0x94D049BB133111EB;
    return (double) ((z ^ z >> 31) >> 11) / 9007199254740992.0;
}

static void hand_over(struct line *line)
{
    for (int at = 0; at < line->count && !line->is_closed;) {
        line->is_closed = !is_open(line, 1, 1000);
        ssize_t written = line->is_closed ? 0 : write(line->terminal, line->packet + at, (size_t) (line->count - at));
        at += written > 0 ? (int) written : 0;
    }
    line->given += line->count;
    while (line->taken && *line->taken >= 0 && *line->taken < line->given && is_open(line, 0, 0))
        usleep(20);
    line->count = 0;
}

static void hear(struct avr_irq_t *irq, uint32_t value, void *param)
{
    struct line *line = param;
    uint8_t byte = (uint8_t) value;
    (void) irq;
    line->sent++;
    if (line->truth)
        fputc(byte, line->truth);
    if (line->corrupt > 0 && chance(line) < line->corrupt) {
        byte ^= (uint8_t) (1 + (int) (chance(line) * 255));
        line->corrupted++;
    }
    if (line->count == 0)
        line->begun = line->now();
    line->packet[line->count++] = byte;
    if (line->count == sizeof line->packet)
        hand_over(line);
}

void line_serve(struct line *line)
{
    struct pollfd state = {.fd = line->terminal, .events = POLLIN};
    uint8_t byte;
    if (line->count && line->now() - line->begun >= LATENCY)
        hand_over(line);
    poll(&state, 1, 0);
    if (state.revents & POLLHUP)
        line->is_closed = 1;
    else if ((state.revents & POLLIN) && read(line->terminal, &byte, 1) == 1)
        avr_raise_irq(avr_io_getirq(line->avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT), byte);
}

void line_look(struct line *line)
{
    if (!is_open(line, 0, 0))
        line->is_closed = 1;
}

void line_attach(struct line *line, struct avr_t *avr)
{
    uint32_t flags = 0; /* no copy on our own terminal, no sleeping when the firmware polls */
    line->avr = avr;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), hear, line);
}
