/* What a builder of the meter may change; each can also be given to the compiler: make FLAGS=-DSHUNT_MICROOHM=50000UL */
#ifndef SETTINGS_H
#define SETTINGS_H

/* Samples a second. 1000000 and the timer's 2000000 ticks must be multiples of it. */
#ifndef SAMPLE_RATE_HZ
#define SAMPLE_RATE_HZ 200UL
#endif

/* The shunt on the sensor's board, in micro-ohm: R100 is 0.1 ohm. The host reckons with it, the firmware does not. */
#ifndef SHUNT_MICROOHM
#define SHUNT_MICROOHM 100000UL
#endif

/* The sensor's address: 0x40 with A0 and A1 open, as the boards come. */
#ifndef SENSOR_ADDRESS
#define SENSOR_ADDRESS 0x40
#endif

/* Several sensors on the bus: their addresses, the first one's first, such as 0x40,0x41; at most four. */
#ifndef SENSOR_ADDRESSES
#define SENSOR_ADDRESSES SENSOR_ADDRESS
#endif

/* Bus range 16 V, shunt range 320 mV, eight 12-bit conversions of the shunt averaged, one of the bus (SBOS448G, table 4).
   A battery above 16 V needs 0x39DD: bus range 32 V. The mode (bits 2 to 0) is the firmware's: see sensor.h. */
#ifndef SENSOR_CONFIGURATION
#define SENSOR_CONFIGURATION 0x19DDU
#endif

/* How often the sensor's register is looked at, Hz; a sample is the mean of the looks since the one before. */
#ifndef LOOK_RATE_HZ
#define LOOK_RATE_HZ 1000UL
#endif

/* Bits a second of the serial line; docs/ina219-protocol.md promises 115200. */
#ifndef LINE_BAUD
#define LINE_BAUD 115200UL
#endif

/* The sensor's bus. 400 kHz is what every INA219 takes in fast mode. */
#ifndef BUS_HZ
#define BUS_HZ 400000UL
#endif

#if F_CPU != 16000000UL
#error "The timer, the line and the bus are set for a 16 MHz ATmega328P, such as an Arduino Nano."
#endif
#if 1000000UL % SAMPLE_RATE_HZ != 0 || SAMPLE_RATE_HZ < 40 || SAMPLE_RATE_HZ > 400
#error "SAMPLE_RATE_HZ must divide 1000000, and lie between 40 (the timer) and 400 (two looks at the sensor a sample)."
#endif
#if LOOK_RATE_HZ < SAMPLE_RATE_HZ || LOOK_RATE_HZ > 2000
#error "LOOK_RATE_HZ must lie between SAMPLE_RATE_HZ and 2000 (a look takes some 0.13 ms on the bus)."
#endif

#endif
