"""ROS 1 through its own client library, rospy."""
