"""The process `ik_controller_node`, also `python -m ik_controller.ros`."""

from __future__ import annotations

from ik_controller.endings import end_when_told, leave


def run() -> None:
    """Be the process. What the node needs takes a second to import, in which it may be told to end."""
    end_when_told()
    from ik_controller.ros.process import main

    leave(main())


if __name__ == "__main__":
    run()
