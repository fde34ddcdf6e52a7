"""ROS: the node, its loop, its parameters, the simulated arm and the target streamer. Alone imports rclpy."""

import os
import sys

# The ROS wheels of PyPI put share/ below the environment but leave this unset, and rclpy's type lookup needs it.
os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
