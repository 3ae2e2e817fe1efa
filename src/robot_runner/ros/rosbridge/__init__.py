"""A robot behind a rosbridge server, reached over a WebSocket from a machine without ROS."""
