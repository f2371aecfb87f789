"""A board or drive, its tables and its tracker as a node of ROS 2."""
