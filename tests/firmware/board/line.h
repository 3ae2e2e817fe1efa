/* The other end of the microcontroller's UART: a pseudo-terminal, as a USB adapter would be a serial port. */
#ifndef LINE_H
#define LINE_H

#include <stdint.h>
#include <stdio.h>

struct avr_t;

struct line {
    double corrupt; /* share of the bytes that are changed on the way */
    uint64_t seed;
    const volatile double *taken; /* bytes that the host has taken, on which the board waits; null or below 0: it does not */
    double given; /* bytes handed over since the line was opened */
    FILE *truth; /* takes the bytes as they were sent; may be null */
    double (*now)(void);
    int terminal; /* the adapter's side */
    struct avr_t *avr;
    uint8_t packet[64];
    int count; /* bytes in the packet */
    double begun; /* when its first byte came */
    uint64_t sent, corrupted;
    int is_closed; /* the program at the other end has left */
};

/* Make the pseudo-terminal and print its name. */
int line_open(struct line *line);

/* Wait until a program opens it, `patience` real seconds at most; return whether one did. */
int line_wait(struct line *line, double patience);

void line_attach(struct line *line, struct avr_t *avr);

/* Hand over what has waited for long enough, and take what the host sent. To be called every millisecond or so. */
void line_serve(struct line *line);

/* Only see whether the other end was closed. */
void line_look(struct line *line);

#endif
