"""Control: reference, law, limits, controller, status. A pure function of its arguments and state; no clock, no ROS."""
