/* An INA219 on the microcontroller's bus, as its data sheet describes it (Texas Instruments, SBOS448G). */
#ifndef SENSOR_H
#define SENSOR_H

#include <stdint.h>

#include "load.h"

struct avr_t;

struct sensor {
    const struct load *load;
    uint8_t address;
    double share; /* of the load's current that flows through its shunt */
    double shunt; /* ohm */
    double slowness; /* of its own oscillator, in parts of one: the data sheet allows conversions 10 % longer */
    double noise; /* V at the shunt, standard deviation of one conversion */
    uint64_t seed;
    double (*now)(void); /* s */
    int is_away; /* its wires are off: it does not answer */
    int is_stuck; /* its registers keep what they hold */
    struct avr_t *avr;
    uint16_t configuration;
    uint16_t shunt_register, bus_register;
    int is_ready; /* CNVR */
    enum { IDLE, SHUNT, BUS } converting;
    double begun; /* s: the conversion that goes on */
    uint8_t pointer;
    int is_selected;
    int byte; /* of the transfer */
    uint8_t high;
    uint16_t given; /* the register that is being read: it does not change between its bytes */
};

/* Have it listen on the bus; it is as after power-on. */
void sensor_attach(struct sensor *sensor, struct avr_t *avr);

/* As after power-on: the configuration is the sensor's own. */
void sensor_reset(struct sensor *sensor);

#endif
