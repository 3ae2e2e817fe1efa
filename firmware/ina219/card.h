/* An SD card in SPI mode, in blocks of 512 bytes (SD Association, Physical Layer Simplified Specification, section 7). */
#ifndef CARD_H
#define CARD_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CARD_BLOCK_SIZE 512

/* Wake the card up, a second at most; 0 if there is none. Chip select is D10. */
uint8_t card_open(void);

/* Read a block; 0 if the card does not give it. */
uint8_t card_read(uint32_t block, uint8_t *to);

/* Writing a block: begin, 512 times put, end, and then ask whether it is done, as often as need be. The card may take a
   quarter of a second to store a block, in which the program goes on with other things. */
uint8_t card_begin_write(uint32_t block);
void card_put(uint8_t byte);
uint8_t card_end_write(void);
uint8_t card_has_written(void);

#ifdef __cplusplus
}
#endif

#endif
