/* The two-wire bus (I2C) as its only master. Every wait has an end; 0 means that nobody answered.
   The device's clock must go, and interrupts be on. */
#ifndef TWI_H
#define TWI_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

void twi_open(void);

/* Free a bus on which a slave still holds the data line, in the middle of a byte that nobody clocks any more. */
void twi_recover(void);

/* Write a 16-bit register, the high byte first. */
uint8_t twi_write_register(uint8_t address, uint8_t reg, uint16_t value);

/* Read a 16-bit register, the high byte first. */
uint8_t twi_read_register(uint8_t address, uint8_t reg, uint16_t *value);

#ifdef __cplusplus
}
#endif

#endif
