"""Pink with daqp: FrameTask and PostureTask, limits as it sets them up; pose as an equality where it comes first."""

import numpy as np
import pinocchio as pin
from pink import Configuration, solve_ik
from pink.barriers import SelfCollisionBarrier
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, PostureTask
from step_common import serve


def make(task, case):
    """Return (step, joints) for a case."""
    dt, tip = float(task["dt"]), str(task["tip"])
    shapes = barriers = None
    if case == "self-collision":
        model, shapes, _ = pin.buildModelsFromUrdf(str(task["urdf_shapes"]))
        of_link = {name: [] for pair in task["pairs"] for name in pair}
        for k, shape in enumerate(shapes.geometryObjects):
            of_link.get(model.frames[shape.parentFrame].name, []).append(k)
        for first, second in task["pairs"]:
            for a in of_link[first]:
                for b in of_link[second]:
                    shapes.addCollisionPair(pin.CollisionPair(a, b))
        barriers = [SelfCollisionBarrier(n_collision_pairs=min(len(shapes.collisionPairs), 3), d_min=0.02)]
    else:
        model = pin.buildModelFromUrdf(str(task["urdf"]))
    if case == "limits saturated":
        model.velocityLimit *= float(task["slow"])
    made = pin.GeometryData(shapes) if shapes is not None else None
    configuration = Configuration(model, model.createData(), task["start"], collision_model=shapes, collision_data=made)
    pose = FrameTask(tip, position_cost=1.0, orientation_cost=1.0)
    posture = PostureTask(cost=1e-3)
    posture.set_target(task["posture"])
    tasks, constraints = [pose, posture], None
    limits = [ConfigurationLimit(model), VelocityLimit(model)]
    if case == "bare":
        tasks, limits = [pose], []
    elif case == "priorities":
        height = FrameTask("panda_link4", position_cost=[0.0, 0.0, 1.0], orientation_cost=0.0)
        place = configuration.get_transform_frame_to_world("panda_link4").copy()
        place.translation[2] = float(task["height"])
        height.set_target(pin.SE3(np.eye(3), place.translation))
        tasks, constraints = [height, posture], [pose]
    targets = [pin.SE3(pose) for pose in task["poses"]]

    def step(k):
        pose.set_target(targets[k])
        velocity = solve_ik(
            configuration, tasks, dt, solver="daqp", limits=limits, constraints=constraints, barriers=barriers,
            safety_break=False,  # it steps over a bound by a micrometre, and would raise
        )  # fmt: skip
        configuration.integrate_inplace(velocity, dt)

    return step, lambda: configuration.q


serve(make)
