/* The file on the card that takes the frames: INA219.BIN in the root folder of a FAT16 or FAT32 file system.

   It is made on a computer, full of zeros, and written in place: nothing about the file system changes, so that the
   power may go at any moment. */
#ifndef CARD_FILE_H
#define CARD_FILE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    uint32_t first; /* block of the card */
    uint32_t count; /* blocks that lie on end */
} card_file_t;

/* Find the file; 0 if it is not there. `scratch` holds CARD_BLOCK_SIZE bytes. */
uint8_t card_file_find(card_file_t *file, uint8_t *scratch);

/* Return the number of the first block that is all zeros, counted from the file's beginning; its count if none is. */
uint32_t card_file_end(const card_file_t *file, uint8_t *scratch);

#ifdef __cplusplus
}
#endif

#endif
