/* The mark: an input that somebody pulls low while the measured window lasts, so that a recording shows it. */
#ifndef MARK_H
#define MARK_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

void mark_open(void);

/* Look at the input; to be called once a sample. Return whether the mark has changed. */
uint8_t mark_has_changed(void);

/* Whether the mark is on: the input was low when it changed last. */
uint8_t mark_is_on(void);

#ifdef __cplusplus
}
#endif

#endif
