"""ROS 2 over DDS, with no ROS installed."""
