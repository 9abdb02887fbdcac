"""Dynamixel servos as a gripper."""
