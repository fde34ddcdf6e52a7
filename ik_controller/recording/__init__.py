"""Bags: rosbag2's own MCAP files, written crash safe, read streaming, recovered after a crash. No ROS."""
