"""The power meter: an INA219 sensor behind a microcontroller, on a serial line or a card, or behind a kernel driver."""
