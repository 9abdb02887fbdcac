"""Recordings as data sets of other formats: LeRobot, MCAP, rosbag2. The formats:
docs/how-to/export.md."""
