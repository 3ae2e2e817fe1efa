"""Robots on a ROS graph: links over ROS 1, ROS 2, DDS and rosbridge, the TurtleBot3, profilers of topics and graphs."""
