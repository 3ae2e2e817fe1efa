#include "frames.h"

#include <util/crc16.h>

#include "settings.h"

#define SAMPLE 0x11
#define HELLO 0x12
#define MARK 0x13
#define SENSOR 0x14
#define FURTHER_SAMPLE 0x15
#define HEADER_SIZE 6
#define CHECKSUM_SIZE 2

static uint8_t *put16(uint8_t *to, uint16_t value)
{
    *to++ = (uint8_t) value;
    *to++ = (uint8_t) (value >> 8);
    return to;
}

static uint8_t *put32(uint8_t *to, uint32_t value)
{
    return put16(put16(to, (uint16_t) value), (uint16_t) (value >> 16));
}

/* Write the header and return where the payload goes; every payload begins with the time. */
static uint8_t *begin(uint8_t *frame, uint8_t kind, uint16_t sequence, uint32_t us)
{
    *frame++ = 0xA5;
    *frame++ = 0x5A;
    *frame++ = kind;
    frame++; /* the length: when it is known */
    return put32(put16(frame, sequence), us);
}

static uint8_t finish(uint8_t *frame, uint8_t *end)
{
    uint16_t checksum = 0xFFFF;
    const uint8_t *byte;
    frame[3] = (uint8_t) (end - frame - HEADER_SIZE);
    for (byte = frame + 2; byte < end; byte++)
        checksum = _crc_xmodem_update(checksum, *byte);
    put16(end, checksum);
    return (uint8_t) (end - frame + CHECKSUM_SIZE);
}

uint8_t frame_sample(uint8_t *frame, uint16_t sequence, uint32_t us, uint16_t shunt, uint16_t bus)
{
    return finish(frame, put16(put16(begin(frame, SAMPLE, sequence, us), shunt), bus));
}

uint8_t frame_hello(uint8_t *frame, uint16_t sequence, uint32_t us, uint16_t configuration)
{
    uint8_t *end = put16(begin(frame, HELLO, sequence, us), SAMPLE_RATE_HZ);
    return finish(frame, put16(put32(end, SHUNT_MICROOHM), configuration));
}

uint8_t frame_sensor(
    uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t address, uint16_t configuration, uint32_t lag_us)
{
    uint8_t *end = begin(frame, SENSOR, sequence, us);
    *end++ = address;
    end = put16(put32(end, SHUNT_MICROOHM), configuration);
    end = put32(end, lag_us);
    *end++ = LOOK_RATE_HZ / SAMPLE_RATE_HZ;
    return finish(frame, end);
}

uint8_t frame_further(
    uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t address, uint16_t shunt, uint16_t bus)
{
    uint8_t *end = begin(frame, FURTHER_SAMPLE, sequence, us);
    *end++ = address;
    return finish(frame, put16(put16(end, shunt), bus));
}

uint8_t frame_mark(uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t is_on)
{
    uint8_t *end = begin(frame, MARK, sequence, us);
    *end++ = is_on;
    return finish(frame, end);
}
