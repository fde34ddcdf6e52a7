"""Kinematics of a serial arm: model, Jacobians, representations, errors, inverses, solvers, closed forms. No ROS."""
