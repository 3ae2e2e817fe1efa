"""How a robot, a host or a device is reached: protocols, and what stands behind them."""
