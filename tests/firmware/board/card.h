/* An SD card of more than 2 GB in SPI mode, kept in a file (SD Association, Physical Layer Simplified Specification). */
#ifndef CARD_H
#define CARD_H

#include <stdint.h>
#include <stdio.h>

struct avr_t;

struct card {
    FILE *image;
    double busy_s; /* how long it takes to store a block, every so often */
    int busy_every; /* blocks; the others take 2 ms */
    int stored;
    double (*now)(void);
    struct avr_t *avr;
    int is_selected;
    uint8_t command[6];
    int got; /* bytes of the command */
    int is_application; /* the next command is one of those */
    int wakes; /* how often it was asked to start up */
    uint8_t out[600]; /* what it is going to say */
    int out_at, out_count;
    uint32_t block; /* being written */
    int takes; /* 0: commands; 1: waits for the token; 2: takes the block */
    uint8_t in[514];
    int in_count;
    double busy_until;
};

void card_attach(struct card *card, struct avr_t *avr);

#endif
