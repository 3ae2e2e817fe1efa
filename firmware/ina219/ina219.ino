/* A power meter for robots: averages the registers of an INA219, or of several, 200 times a second and sends
   them up a serial line, as docs/ina219-protocol.md says; with an SD card in its socket it records the same frames there.

   For an Arduino Nano (ATmega328P, 16 MHz). It uses avr-libc alone, and has a main() of its own: the Arduino core, with
   its timer interrupt a thousand times a second, stays out of the way. `make` builds it without the Arduino IDE. */

#include <avr/interrupt.h>
#include <stdint.h>

#include "card_log.h"
#include "device_clock.h"
#include "frames.h"
#include "line.h"
#include "mark.h"
#include "sensor.h"
#include "settings.h"

static uint16_t sequence; /* of the next sample */

static void publish(const uint8_t *frame, uint8_t size)
{
    line_send(frame, size); /* without room it is lost, as the next sequence number tells */
    card_log_frame(frame, size);
}

static void say_hello(void)
{
    uint8_t frame[FRAME_LONGEST];
    uint8_t number;
    for (number = 0; number < sensor_count(); number++) {
        uint16_t configuration = sensor_configuration(number);
        uint32_t us = device_clock_us();
        uint8_t address = sensor_address(number);
        if (number == 0)
            publish(frame, frame_hello(frame, sequence, us, configuration));
        publish(frame, frame_sensor(frame, sequence, us, address, configuration, sensor_lag_us()));
    }
}

static void tell_mark(void)
{
    uint8_t frame[FRAME_MARK_SIZE];
    publish(frame, frame_mark(frame, sequence, device_clock_us(), mark_is_on()));
    if (!mark_is_on())
        card_log_flush();
}

static void take_sample(void)
{
    uint8_t frame[FRAME_LONGEST];
    uint8_t number;
    uint16_t shunt;
    uint16_t bus;
    uint32_t us = device_clock_us();
    for (number = 0; number < sensor_count(); number++) {
        if (!sensor_take(number, &shunt, &bus))
            continue;
        if (number == 0)
            publish(frame, frame_sample(frame, sequence, us, shunt, bus));
        else
            publish(frame, frame_further(frame, sequence, us, sensor_address(number), shunt, bus));
    }
}

/* Take the sample that is due; those that came due before it and were missed use up their numbers. */
static void sample(uint8_t due)
{
    uint8_t is_hello_due = line_take_request();
    for (;;) {
        is_hello_due |= sequence % SAMPLE_RATE_HZ == 0;
        if (--due == 0)
            break;
        sequence++;
    }
    if (is_hello_due)
        say_hello();
    if (mark_has_changed())
        tell_mark();
    take_sample();
    sequence++;
}

int main(void)
{
    line_open();
    mark_open();
    card_log_open();
    device_clock_start();
    sei();
    sensor_open(); /* its waits need the clock */
    device_clock_start(); /* the first sample is due a period after the sensor has something to say */
    for (;;) {
        uint8_t due = device_clock_take_due();
        if (due)
            sample(due);
        else if (device_clock_take_look())
            sensor_look();
        else if (!card_log_work())
            device_clock_wait();
    }
}
