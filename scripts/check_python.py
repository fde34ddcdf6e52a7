"""Say in one line what is wrong with this Python, if anything, before `make` builds .venv. Runs on any Python."""
# ruff: noqa: UP031, F401

import os
import sys


def problem():
    """Return what is wrong and what helps, or an empty text."""
    version = "%d.%d" % sys.version_info[:2]
    if not (3, 10) <= sys.version_info[:2] <= (3, 13):
        return "need Python 3.10 to 3.13, this is %s; say which: make PYTHON=python3.12" % version
    try:
        import ensurepip
        import venv
    except ImportError as error:
        return "Python %s lacks %s; on Debian and Ubuntu: sudo apt-get install python3-venv" % (version, error.name)
    distro = os.environ.get("ROS_DISTRO")
    if distro:
        try:
            import rclpy
        except ImportError as error:
            return (
                "ROS_DISTRO is %s, but Python %s cannot import its rclpy (%s); source its setup.bash and take its "
                "Python (make PYTHON=/usr/bin/python3), or unset ROS_DISTRO for the wheels"
                % (distro, version, str(error).splitlines()[0])
            )
    return ""


if __name__ == "__main__":
    message = problem()
    if message:
        sys.exit("%s: %s" % (sys.executable, message))
