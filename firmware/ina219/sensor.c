#include "sensor.h"

#include "device_clock.h"
#include "settings.h"
#include "twi.h"

#define CONFIGURATION 0x00
#define SHUNT_VOLTAGE 0x01
#define BUS_VOLTAGE 0x02
#define RESET 0x8000U
#define MODE 7U
#define CONVERTING_SHUNT ((SENSOR_CONFIGURATION & ~MODE) | 5U)
#define CONVERTING_BUS ((SENSOR_CONFIGURATION & ~MODE) | 6U)
#define READY 2U /* CNVR, in the bus voltage register */
#define PATIENCE_US 100000UL /* the longest conversion takes 75 ms */

/* Looks between two conversions of the bus voltage: by chance, so that the pauses fall on no fixed moment of a period. */
#define BUS_FEWEST 200
#define BUS_SPREAD 200

/* Table 5 of the data sheet, typical; bits 6 to 3 choose. */
#define SHUNT_SETTING ((SENSOR_CONFIGURATION >> 3) & 15U)
#define SINGLE_US (SHUNT_SETTING == 0 ? 84UL : SHUNT_SETTING == 1 ? 148UL : SHUNT_SETTING == 2 ? 276UL : 532UL)
#define SHUNT_US (SHUNT_SETTING & 8U ? 532UL << (SHUNT_SETTING & 7U) : SINGLE_US)

typedef struct {
    uint8_t address;
    uint8_t is_converting_bus;
    uint8_t has_bus;
    uint16_t until_bus; /* looks */
    uint8_t looks;
    int32_t sum; /* of the looks, and what rounding left over */
    uint16_t bus;
    uint16_t odd; /* a configuration that was found and is not ours, until it has been told */
} sensor_t;

static const uint8_t addresses[] = {SENSOR_ADDRESSES};
#define COUNT (sizeof addresses)
static sensor_t sensors[COUNT];

/* A sample of each sensor, and once a second a hello and what is said of each sensor, within what the line carries. */
_Static_assert(COUNT <= 4, "At most four sensors can be looked at in time.");
_Static_assert(SAMPLE_RATE_HZ * (16 + 17 * (COUNT - 1)) + 24 * COUNT + 20 <= LINE_BAUD / 10,
    "The line cannot carry so many samples: lower SAMPLE_RATE_HZ.");

uint32_t sensor_lag_us(void)
{
    return 1000000UL / SAMPLE_RATE_HZ / 2 + SHUNT_US;
}

uint8_t sensor_count(void)
{
    return COUNT;
}

uint8_t sensor_address(uint8_t number)
{
    return addresses[number];
}

/* Look whether the sensor still has the configuration that it was given; 0 if it does not answer. */
static uint8_t verify(sensor_t *sensor)
{
    uint16_t found;
    if (!twi_read_register(sensor->address, CONFIGURATION, &found))
        return 0;
    if (found != (sensor->is_converting_bus ? CONVERTING_BUS : CONVERTING_SHUNT))
        sensor->odd = found;
    return 1;
}

static uint8_t configure(sensor_t *sensor, uint16_t configuration)
{
    sensor->is_converting_bus = configuration == CONVERTING_BUS;
    return twi_write_register(sensor->address, CONFIGURATION, configuration);
}

/* Take the bus voltage if it was converted, and go back to the shunt's. */
static void look_at_bus(sensor_t *sensor)
{
    uint16_t bus;
    if (!twi_read_register(sensor->address, BUS_VOLTAGE, &bus) || !(bus & READY))
        return;
    sensor->bus = bus;
    sensor->has_bus = 1;
    configure(sensor, CONVERTING_SHUNT);
}

static uint8_t wait_for_conversion(const sensor_t *sensor)
{
    uint32_t begun_us = device_clock_us();
    uint16_t bus;
    while (twi_read_register(sensor->address, BUS_VOLTAGE, &bus))
        if (bus & READY)
            return 1;
        else if (device_clock_us() - begun_us > PATIENCE_US)
            return 0;
    return 0;
}

void sensor_open(void)
{
    uint8_t number;
    twi_open();
    for (number = 0; number < COUNT; number++) {
        sensor_t *sensor = &sensors[number];
        sensor->address = addresses[number];
        sensor->until_bus = BUS_FEWEST;
        if (configure(sensor, RESET) && configure(sensor, CONVERTING_BUS) && wait_for_conversion(sensor))
            look_at_bus(sensor);
    }
    for (number = 0; number < COUNT; number++)
        wait_for_conversion(&sensors[number]);
}

void sensor_look(void)
{
    uint8_t number;
    for (number = 0; number < COUNT; number++) {
        sensor_t *sensor = &sensors[number];
        uint16_t shunt;
        if (!twi_read_register(sensor->address, SHUNT_VOLTAGE, &shunt))
            continue;
        sensor->sum += (int16_t) shunt;
        sensor->looks++;
        if (sensor->is_converting_bus) {
            look_at_bus(sensor);
        } else if (sensor->until_bus-- == 0 || !sensor->has_bus) {
            verify(sensor);
            configure(sensor, CONVERTING_BUS);
            sensor->until_bus = BUS_FEWEST + device_clock_chance(BUS_SPREAD);
        }
    }
}

uint8_t sensor_take(uint8_t number, uint16_t *shunt, uint16_t *bus)
{
    sensor_t *sensor = &sensors[number];
    int32_t mean;
    if (sensor->looks == 0 || !sensor->has_bus) {
        sensor->sum = sensor->looks = 0;
        return 0;
    }
    mean = sensor->sum / sensor->looks;
    sensor->sum -= mean * sensor->looks;
    sensor->looks = 0;
    *shunt = (uint16_t) mean;
    *bus = sensor->bus;
    return 1;
}

uint16_t sensor_configuration(uint8_t number)
{
    sensor_t *sensor = &sensors[number];
    uint16_t odd;
    if (!verify(sensor)) {
        twi_recover();
        return 0;
    }
    odd = sensor->odd;
    sensor->odd = 0;
    if (!odd)
        return CONVERTING_SHUNT;
    configure(sensor, CONVERTING_SHUNT);
    return odd;
}
