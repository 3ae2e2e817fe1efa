#include "sensor.h"

#include <math.h>
#include <simavr/avr_twi.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>

#define ADDRESS 0x40
#define POWER_ON 0x399F
#define RESET 0x8000
#define CONTINUOUS 7

/* Table 5: how long a conversion takes, s, by the four bits that choose resolution or averaging. */
static double conversion(unsigned setting)
{
    static const double single[] = {84e-6, 148e-6, 276e-6, 532e-6};
    if (!(setting & 8) || setting == 8)
        return single[setting == 8 ? 3 : setting & 3];
    return 532e-6 * (1 << (setting & 7));
}

void sensor_reset(struct sensor *sensor)
{
    sensor->configuration = POWER_ON;
    sensor->configured_at = sensor->now();
    sensor->pointer = 0;
}

static int clip(double value, int low, int high)
{
    return value < low ? low : value > high ? high : (int) lrint(value);
}

static uint16_t shunt_register(const struct sensor *sensor, double from, double to)
{
    int limit = 4000 << (sensor->configuration >> 11 & 3);
    return (uint16_t) clip(load_mean(sensor->load, from, to) * sensor->shunt / 10e-6, -limit, limit);
}

static uint16_t bus_register(const struct sensor *sensor)
{
    int limit = sensor->configuration & 0x2000 ? 8000 : 4000;
    return (uint16_t) (clip(sensor->load->volts / 4e-3, 0, limit) << 3 | 2);
}

/* The two voltages are converted in turn, the shunt's first; a register holds what was converted last. */
static uint16_t voltage_register(const struct sensor *sensor, int is_bus)
{
    double shunt_s = conversion(sensor->configuration >> 3 & 15);
    double bus_s = conversion(sensor->configuration >> 7 & 15);
    double since = sensor->now() - sensor->configured_at;
    double end = is_bus ? shunt_s + bus_s : shunt_s;
    double rounds = floor((since - end) / (shunt_s + bus_s));
    double begun = sensor->configured_at + rounds * (shunt_s + bus_s);
    if (rounds < 0 || (sensor->configuration & CONTINUOUS) != CONTINUOUS)
        return 0;
    return is_bus ? bus_register(sensor) : shunt_register(sensor, begun, begun + shunt_s);
}

static uint16_t value(const struct sensor *sensor)
{
    switch (sensor->pointer) {
    case 0:
        return sensor->configuration;
    case 1:
    case 2:
        return voltage_register(sensor, sensor->pointer == 2);
    default:
        return 0;
    }
}

static void configure(struct sensor *sensor, uint16_t configuration)
{
    if (sensor->pointer != 0)
        return;
    sensor->configuration = configuration & RESET ? POWER_ON : configuration;
    sensor->configured_at = sensor->now();
}

static void take(struct sensor *sensor, uint8_t byte)
{
    if (sensor->byte == 0)
        sensor->pointer = byte;
    else if (sensor->byte == 1)
        sensor->high = byte;
    else if (sensor->byte == 2)
        configure(sensor, (uint16_t) (sensor->high << 8 | byte));
    sensor->byte++;
}

static uint8_t give(struct sensor *sensor)
{
    uint16_t whole = value(sensor);
    return (uint8_t) (sensor->byte++ == 0 ? whole >> 8 : whole);
}

static void hear(struct avr_irq_t *irq, uint32_t word, void *param)
{
    struct sensor *sensor = param;
    avr_irq_t *answer = avr_io_getirq(sensor->avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_INPUT);
    avr_twi_msg_irq_t message = {.u.v = word};
    uint8_t what = message.u.twi.msg, address = message.u.twi.addr;
    (void) irq;
    if (what & TWI_COND_STOP)
        sensor->is_selected = 0;
    if (what & TWI_COND_START) {
        sensor->is_selected = !sensor->is_away && address >> 1 == ADDRESS;
        sensor->byte = 0;
        if (sensor->is_selected)
            avr_raise_irq(answer, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
    }
    if (!sensor->is_selected)
        return;
    if (what & TWI_COND_WRITE) {
        take(sensor, message.u.twi.data);
        avr_raise_irq(answer, avr_twi_irq_msg(TWI_COND_ACK, address, 1));
    }
    if (what & TWI_COND_READ)
        avr_raise_irq(answer, avr_twi_irq_msg(TWI_COND_READ, address, give(sensor)));
}

void sensor_attach(struct sensor *sensor, struct avr_t *avr)
{
    sensor->avr = avr;
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_TWI_GETIRQ(0), TWI_IRQ_OUTPUT), hear, sensor);
    sensor_reset(sensor);
}
