#include "sensor.h"

#include <math.h>
#include <simavr/avr_twi.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_io.h>

#define POWER_ON 0x399F
#define RESET 0x8000
#define SHUNT_MODE 1
#define BUS_MODE 2
#define CONTINUOUS 4
#define SHUNT_STEP 10e-6 /* V */
#define BUS_STEP 4e-3 /* V */

/* Table 5: how many single conversions are averaged, by the four bits that choose resolution or averaging. */
static int averaged(unsigned setting)
{
    return setting > 8 ? 1 << (setting & 7) : 1;
}

/* The same table: how long a single one takes, s (typical), and how many steps one of its own is worth. */
static double single(const struct sensor *sensor, unsigned setting, int *coarseness)
{
    static const double seconds[] = {84e-6, 148e-6, 276e-6, 532e-6};
    int bits = setting & 8 ? 3 : setting & 3;
    *coarseness = 8 >> bits;
    return seconds[bits] * (1 + sensor->slowness);
}

static unsigned setting_of(const struct sensor *sensor, int is_bus)
{
    return sensor->configuration >> (is_bus ? 7 : 3) & 15;
}

static double duration(const struct sensor *sensor, int is_bus)
{
    int coarseness;
    unsigned setting = setting_of(sensor, is_bus);
    return averaged(setting) * single(sensor, setting, &coarseness);
}

/* Sums of twelve even numbers that look like chance (Steele, Lea, Flood: splitmix64) are nearly normal. */
static double normal(struct sensor *sensor)
{
    double sum = -6;
    for (int count = 0; count < 12; count++) {
        uint64_t z = sensor->seed += 0x9E3779B97F4A7C15;
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9;
        z = (z ^ z >> 27) * 0x94D049BB133111EB;
        sum += (double) ((z ^ z >> 31) >> 11) / 9007199254740992.0;
    }
    return sum;
}

static double clip(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* The converter integrates over each conversion (delta-sigma); each is clipped and rounded before they are averaged. */
static uint16_t convert_shunt(struct sensor *sensor)
{
    int coarseness, limit = 4000 << (sensor->configuration >> 11 & 3);
    unsigned setting = setting_of(sensor, 0);
    int count = averaged(setting);
    double each = single(sensor, setting, &coarseness), sum = 0;
    for (int at = 0; at < count; at++) {
        double amperes = sensor->share * load_mean(sensor->load, sensor->begun + at * each, sensor->begun + (at + 1) * each);
        double volts = amperes * sensor->shunt + (sensor->noise > 0 ? sensor->noise * normal(sensor) : 0);
        sum += clip(rint(volts / SHUNT_STEP / coarseness) * coarseness, -limit, limit);
    }
    return (uint16_t) (int) rint(sum / count);
}

static uint16_t convert_bus(const struct sensor *sensor)
{
    int coarseness, limit = sensor->configuration & 0x2000 ? 8000 : 4000;
    single(sensor, setting_of(sensor, 1), &coarseness);
    return (uint16_t) (int) clip(rint(sensor->load->volts / BUS_STEP / coarseness) * coarseness, 0, limit);
}

static void begin_cycle(struct sensor *sensor, double at)
{
    unsigned mode = sensor->configuration & 7;
    sensor->begun = at;
    sensor->converting = mode & SHUNT_MODE ? SHUNT : mode & BUS_MODE ? BUS : IDLE;
}

/* A cycle is over: it is told by CNVR, and the next one follows without a pause where the mode says continuous. */
static void end_cycle(struct sensor *sensor, double at)
{
    sensor->is_ready = 1;
    if (sensor->configuration & CONTINUOUS)
        begin_cycle(sensor, at);
    else
        sensor->converting = IDLE;
}

/* Do what was due until now: a register holds what was converted last, whatever the mode has become. */
static void catch_up(struct sensor *sensor)
{
    while (sensor->converting != IDLE) {
        int is_bus = sensor->converting == BUS;
        double end = sensor->begun + duration(sensor, is_bus);
        if (end > sensor->now())
            return;
        if (sensor->is_stuck)
            ;
        else if (is_bus)
            sensor->bus_register = convert_bus(sensor);
        else
            sensor->shunt_register = convert_shunt(sensor);
        if (!is_bus && sensor->configuration & BUS_MODE) {
            sensor->converting = BUS;
            sensor->begun = end;
        } else {
            end_cycle(sensor, end);
        }
    }
}

void sensor_reset(struct sensor *sensor)
{
    sensor->configuration = POWER_ON;
    sensor->shunt_register = sensor->bus_register = 0;
    sensor->is_ready = 0;
    sensor->pointer = 0;
    begin_cycle(sensor, sensor->now());
}

static uint16_t value(struct sensor *sensor)
{
    catch_up(sensor);
    switch (sensor->pointer) {
    case 0:
        return sensor->configuration;
    case 1:
        return sensor->shunt_register;
    case 2:
        return (uint16_t) (sensor->bus_register << 3 | sensor->is_ready << 1);
    case 3:
        sensor->is_ready = 0; /* reading the power register clears CNVR; without calibration it holds 0 */
        return 0;
    default:
        return 0;
    }
}

/* Writing the configuration abandons the conversion that goes on, and clears CNVR unless the mode is an idle one. */
static void configure(struct sensor *sensor, uint16_t configuration)
{
    if (sensor->pointer != 0)
        return;
    catch_up(sensor);
    if (configuration & RESET) {
        sensor_reset(sensor);
        return;
    }
    sensor->configuration = configuration;
    if (configuration & (SHUNT_MODE | BUS_MODE))
        sensor->is_ready = 0;
    begin_cycle(sensor, sensor->now());
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
    if (sensor->byte == 0)
        sensor->given = value(sensor);
    return (uint8_t) (sensor->byte++ == 0 ? sensor->given >> 8 : sensor->given);
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
        sensor->is_selected = !sensor->is_away && address >> 1 == sensor->address;
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
