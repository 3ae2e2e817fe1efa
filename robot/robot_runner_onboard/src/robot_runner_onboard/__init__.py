"""What Robot Runner needs on a robot, without ROS: the tasks of a mission and the watchdog.

It keeps to Python 3.8, which ROS Noetic has.
"""
