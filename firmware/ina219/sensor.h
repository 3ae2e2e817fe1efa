/* The INA219s: what is read from them, as it is (Texas Instruments, SBOS448G, section 8.6).

   A sensor converts the shunt's voltage without a pause, so that nothing of the current is missed, and its register is
   looked at several times a sample. The voltage of the bus, which changes slowly, is converted in between: after 200 to 399
   looks, by chance, so that the pauses beat in step with no load. */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* How far the middle of what a sample averages lies before its time stamp, us: half a period, and a conversion, of which
   one half is the conversion's own and the other how long a register is held on average until the next one. */
uint32_t sensor_lag_us(void);

uint8_t sensor_count(void);

uint8_t sensor_address(uint8_t number);

/* Reset and configure the sensors, and wait for their first conversions, 0.1 s each at most. */
void sensor_open(void);

/* Look at the sensors' registers. */
void sensor_look(void);

/* Return what a sensor saw since the last call, on average, and begin anew; 0 if it did not answer. What is lost by
   rounding is kept for the next call. */
uint8_t sensor_take(uint8_t number, uint16_t *shunt, uint16_t *bus);

/* Return the configuration register, 0 if the sensor does not answer. A sensor that lost its power and with it its
   configuration is configured again; what is returned is what was found since the last call. */
uint16_t sensor_configuration(uint8_t number);

#ifdef __cplusplus
}
#endif

#endif
