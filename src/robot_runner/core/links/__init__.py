"""How a robot, a host or a device is reached: protocols, hosts and serial lines."""
