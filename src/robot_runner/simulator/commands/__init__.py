"""The command that offers the embedded robot on a ROS graph."""
