/* The INA219: what is read from it, as it is (Texas Instruments, SBOS448G, section 8.6). */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Reset and configure the sensor; 0 if it does not answer. */
uint8_t sensor_open(void);

/* Read both voltages; 0 if the sensor does not answer. */
uint8_t sensor_read(uint16_t *shunt, uint16_t *bus);

/* Return the configuration register, 0 if the sensor does not answer. A sensor that lost its power and with it its
   configuration is configured again; what is returned is what was found. */
uint16_t sensor_configuration(void);

#ifdef __cplusplus
}
#endif

#endif
