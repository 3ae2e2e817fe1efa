/* An INA219 on the microcontroller's bus, as its data sheet describes it (Texas Instruments, SBOS448G). */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdint.h>

#include "load.h"

struct avr_t;

struct sensor {
    const struct load *load;
    double shunt; /* ohm */
    double (*now)(void); /* s */
    int is_away; /* its wires are off: it does not answer */
    struct avr_t *avr;
    uint16_t configuration;
    double configured_at;
    uint8_t pointer;
    int is_selected;
    int byte; /* of the transfer */
    uint8_t high;
};

/* Have it listen on the bus; it is as after power-on. */
void sensor_attach(struct sensor *sensor, struct avr_t *avr);

/* As after power-on: the configuration is the sensor's own. */
void sensor_reset(struct sensor *sensor);

#endif
