"""ROS 2 driver for Weiss Robotics WSG servo grippers: the lifecycle node ``wsg_gripper``."""
