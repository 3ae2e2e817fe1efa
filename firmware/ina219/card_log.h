/* The recording on the card: the same bytes that go up the line, in a file that is made beforehand. */
#ifndef CARD_LOG_H
#define CARD_LOG_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Look for a card and the file on it, and continue behind what the file holds. Without one, nothing is recorded.
   An LED at D5 is lit while a recording goes on. */
void card_log_open(void);

/* Queue a frame to be recorded; it is left out if the card is too slow, as its sequence number will tell. */
void card_log_frame(const uint8_t *frame, uint8_t count);

/* Have everything written, also what does not fill a block: the rest of the block becomes zeros. */
void card_log_flush(void);

/* Write for as long as no sample is due. Return whether there is more to do at once. */
uint8_t card_log_work(void);

#ifdef __cplusplus
}
#endif

#endif
