"""The nodes of the tasks and of the watchdog for ROS 1: thin shells around `robot_runner_onboard`."""
