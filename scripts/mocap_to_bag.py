#!/usr/bin/env python3
"""Turn a hand-carried motion (TUM text: time x y z qx qy qz qw a line) into a bag of targets scaled to a bundled robot.

    python scripts/mocap_to_bag.py FILE BAG [--robot panda] [--size 0.4] [--turn 0.5]

The motion is moved to the robot's posture and scaled to `--size` [m]; rotations are scaled by `--turn`. Stamps stay as
they are, gaps, repetitions and all. Then: ik_controller demo --targets BAG
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pinocchio as pin

from ik_controller.errors import BagError
from ik_controller.messages import cdr
from ik_controller.recording.target_bag import TimedTarget, write_targets
from ik_controller.robots import build_model, bundled_parameters


def main() -> None:
    """Read, scale, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--robot", default="panda")
    parser.add_argument("--size", type=float, default=0.4)
    parser.add_argument("--turn", type=float, default=0.5)
    arguments = parser.parse_args()

    parameters = bundled_parameters(arguments.robot)
    model = build_model(parameters)
    home = model.forward(np.array(parameters.posture))
    table = np.loadtxt(arguments.file)
    if table.ndim != 2 or table.shape[1] != 8:
        raise BagError(f"{arguments.file}: need 8 numbers a line: time x y z qx qy qz qw")
    low, high = table[:, 1:4].min(axis=0), table[:, 1:4].max(axis=0)
    scale = arguments.size / float((high - low).max())
    rotations = [pin.Quaternion(*row[[7, 4, 5, 6]]).normalized().toRotationMatrix() for row in table]

    targets = []
    before, turned = rotations[0], home.rotation

    first = table[0, 0]
    for row, rotation in zip(table, rotations, strict=True):
        position = home.translation + scale * (row[1:4] - 0.5 * (low + high))
        # Scaled step by step: a rotation scaled as a whole would jump where it passes half a turn.
        turned = pin.exp3(arguments.turn * pin.log3(rotation @ before.T)) @ turned
        before = rotation
        stamp = round(row[0] * 1e9)
        pose = pin.SE3(turned, position)
        time = round((row[0] - first) * 1e9)
        targets.append(TimedTarget(time, "target_pose", cdr.pose_message(stamp, model.base_frame, pose)))
    write_targets(arguments.bag, targets, round(first * 1e9))
    gaps = np.diff(table[:, 0])
    print(
        f"{len(targets)} poses over {table[-1, 0] - first:.1f} s, scaled by {scale:.3f}; longest gap {gaps.max():.1f} s"
    )


if __name__ == "__main__":
    main()
