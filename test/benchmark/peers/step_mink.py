"""mink with daqp on MuJoCo: FrameTask and PostureTask, limits as it sets them up; pose as an equality where it comes
first.
"""

import mink
import mujoco
import numpy as np
from step_common import serve

# MuJoCo takes a URDF; frames on fixed joints are to stay, and links without mass are given some.
COMPILER = '<mujoco><compiler fusestatic="false" boundmass="0.01" boundinertia="0.001" discardvisual="true"/></mujoco>'


def make(task, case):
    """Return (step, joints) for a case."""
    dt = float(task["dt"])
    with open(str(task["urdf_shapes" if case == "self-collision" else "urdf"])) as file:
        text = file.read()
    model = mujoco.MjModel.from_xml_string(text.replace("</robot>", COMPILER + "</robot>"))
    configuration = mink.Configuration(model, q=task["start"])
    pose = mink.FrameTask(str(task["tip"]), "body", position_cost=1.0, orientation_cost=1.0)
    posture = mink.PostureTask(model, cost=1e-3)
    posture.set_target(task["posture"])
    slow = float(task["slow"]) if case == "limits saturated" else 1.0
    names = [model.joint(j).name for j in range(model.njnt)]
    speeds = dict(zip(names, (slow * task["velocity"]).tolist(), strict=True))
    tasks, constraints = [pose, posture], None
    limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
    if case == "bare":
        tasks, limits = [pose], []
    elif case == "priorities":
        height = mink.FrameTask("panda_link4", "body", position_cost=[0.0, 0.0, 1.0], orientation_cost=0.0)
        place = configuration.get_transform_frame_to_world("panda_link4", "body").translation().copy()
        place[2] = float(task["height"])
        height.set_target(mink.SE3.from_translation(place))
        tasks, constraints = [height, posture], [pose]
    elif case == "self-collision":
        pairs = []
        for first, second in task["pairs"]:
            groups = [
                [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == str(link)]
                for link in (first, second)
            ]
            pairs.append(tuple(groups))
        limits.append(mink.CollisionAvoidanceLimit(model, pairs, minimum_distance_from_collisions=0.02))
    targets = [mink.SE3.from_matrix(pose) for pose in task["poses"]]

    def step(k):
        pose.set_target(targets[k])
        velocity = mink.solve_ik(configuration, tasks, dt, "daqp", limits=limits, constraints=constraints)
        configuration.integrate_inplace(velocity, dt)

    return step, lambda: np.array(configuration.q)


serve(make)
