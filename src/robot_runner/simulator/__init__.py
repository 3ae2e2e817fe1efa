"""The embedded robot: a TurtleBot3 Burger in a physics simulation, with battery, power meter and on-board computer.

Needs the extra `robot-runner[sim]` (MuJoCo and NumPy); nothing of it is imported before a simulation is opened.
"""
