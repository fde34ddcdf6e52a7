"""PlaCo: frame task and joints task, its own QP; a hard frame task where the pose comes first."""

import json
import tempfile

import placo
from step_common import serve


def make(task, case):
    """Return (step, joints) for a case."""
    watched = case == "self-collision"
    path = str(task["urdf_shapes" if watched else "urdf"])
    robot = placo.RobotWrapper(path, 0 if watched else placo.Flags.ignore_collisions)
    names = [str(name) for name in task["names"]]

    def place(q):
        for name, value in zip(names, q, strict=True):
            robot.set_joint(name, value)

    place(task["start"])
    robot.update_kinematics()
    solver = placo.KinematicsSolver(robot)
    solver.mask_fbase(True)
    solver.dt = float(task["dt"])
    pose = solver.add_frame_task(str(task["tip"]), task["poses"][0])
    pose.configure("pose", "hard" if case == "priorities" else "soft", 1.0, 1.0)
    if case == "bare":
        solver.enable_joint_limits(False)
        solver.enable_velocity_limits(False)
        solver.add_regularization_task(1e-6)  # as it must have one for a redundant arm
    else:
        posture = solver.add_joints_task()
        posture.set_joints(dict(zip(names, task["posture"].tolist(), strict=True)))
        posture.configure("posture", "soft", 1e-6)  # the square of the cost that Pink and mink take
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        if case == "limits saturated":
            for name, speed in zip(names, (task["velocity"] * float(task["slow"])).tolist(), strict=True):
                robot.set_velocity_limit(name, speed)
    if case == "priorities":
        target = robot.get_T_world_frame("panda_link4")[:3, 3].copy()
        target[2] = float(task["height"])
        height = solver.add_position_task("panda_link4", target)
        height.mask.set_axises("z", "task")
        height.configure("height", "soft", 1.0)
    elif watched:
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            json.dump(task["pairs"].tolist(), file)
            file.flush()
            robot.load_collision_pairs(file.name)
        apart = solver.add_avoid_self_collisions_constraint()
        apart.self_collisions_margin, apart.self_collisions_trigger = 0.02, 0.05
        apart.configure("apart", "hard")
    targets = list(task["poses"])
    first = robot.get_joint_offset(names[0])
    assert [robot.get_joint_offset(name) for name in names] == list(range(first, first + len(names)))

    def step(k):
        pose.T_world_frame = targets[k]
        solver.solve(True)
        robot.update_kinematics()

    return step, lambda: robot.state.q[first : first + len(names)].copy()


serve(make)
