#include "sensor.h"

#include "settings.h"
#include "twi.h"

#define CONFIGURATION 0x00
#define SHUNT_VOLTAGE 0x01
#define BUS_VOLTAGE 0x02
#define RESET 0x8000U

uint8_t sensor_open(void)
{
    twi_open();
    return twi_write_register(SENSOR_ADDRESS, CONFIGURATION, RESET)
        && twi_write_register(SENSOR_ADDRESS, CONFIGURATION, SENSOR_CONFIGURATION);
}

uint8_t sensor_read(uint16_t *shunt, uint16_t *bus)
{
    return twi_read_register(SENSOR_ADDRESS, SHUNT_VOLTAGE, shunt)
        && twi_read_register(SENSOR_ADDRESS, BUS_VOLTAGE, bus);
}

uint16_t sensor_configuration(void)
{
    uint16_t found = 0;
    if (!twi_read_register(SENSOR_ADDRESS, CONFIGURATION, &found)) {
        twi_recover();
        return 0;
    }
    if (found != SENSOR_CONFIGURATION)
        twi_write_register(SENSOR_ADDRESS, CONFIGURATION, SENSOR_CONFIGURATION);
    return found;
}
