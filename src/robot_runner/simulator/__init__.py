"""The embedded robot: a TurtleBot3 Burger in a physics simulation, with battery, power meter and on-board computer."""
