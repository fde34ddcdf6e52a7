"""The live page: the arm in a browser (optional extra `view`: viser). Knows no ROS; `ros/viewer.py` feeds it."""
