/* The frames of docs/ina219-protocol.md. */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FRAME_SAMPLE_SIZE 16
#define FRAME_HELLO_SIZE 20
#define FRAME_MARK_SIZE 13
#define FRAME_SENSOR_SIZE 24
#define FRAME_FURTHER_SIZE 17
#define FRAME_LONGEST FRAME_SENSOR_SIZE

/* Each writes a frame and returns its size. */
uint8_t frame_sample(uint8_t *frame, uint16_t sequence, uint32_t us, uint16_t shunt, uint16_t bus);
uint8_t frame_hello(uint8_t *frame, uint16_t sequence, uint32_t us, uint16_t configuration);
uint8_t frame_sensor(
    uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t address, uint16_t configuration, uint32_t lag_us);
uint8_t frame_further(
    uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t address, uint16_t shunt, uint16_t bus);
uint8_t frame_mark(uint8_t *frame, uint16_t sequence, uint32_t us, uint8_t is_on);

#ifdef __cplusplus
}
#endif

#endif
