/* The serial line to the host. */
#ifndef LINE_H
#define LINE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

void line_open(void);

/* Queue bytes to be sent; all of them, or none if there is no room. Return whether there was. */
uint8_t line_send(const uint8_t *bytes, uint8_t count);

/* Whether the host asked for a hello since the last call. */
uint8_t line_take_request(void);

#ifdef __cplusplus
}
#endif

#endif
