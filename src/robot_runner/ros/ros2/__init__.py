"""ROS 2 through its own client library, rclpy."""
