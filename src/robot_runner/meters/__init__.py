"""The profilers: the INA219 power meter, PsUtil, and everything else that measures a robot or a computer."""
