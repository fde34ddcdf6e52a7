"""TSID: TaskSE3Equality and TaskJointPosture, bounds by TaskJointPosVelAccBounds; inverse dynamics with eiquadprog."""

import numpy as np
import pinocchio as pin
from step_common import serve
from tsid import tsid_pywrap as tsid

GAIN = 100.0  # of the pose [1/s]; critically damped


def make(task, case):
    """Return (step, joints) for a case."""
    if case == "self-collision":
        raise NotImplementedError
    dt, n = float(task["dt"]), len(task["start"])
    robot = tsid.RobotWrapper(str(task["urdf"]), [""], False)
    model = robot.model()
    q, v = task["start"].copy(), np.zeros(n)
    problem = tsid.InverseDynamicsFormulationAccForce("step", robot, False)
    problem.computeProblemData(0.0, q, v)
    pose = tsid.TaskSE3Equality("pose", robot, str(task["tip"]))
    pose.setKp(GAIN * GAIN * np.ones(6))
    pose.setKd(2.0 * GAIN * np.ones(6))
    pose.useLocalFrame(False)
    problem.addMotionTask(pose, 1.0, 0 if case == "priorities" else 1, 0.0)
    posture = tsid.TaskJointPosture("posture", robot)
    posture.setKp(np.ones(n))
    posture.setKd(2.0 * np.ones(n))
    problem.addMotionTask(posture, 1e-6 if case == "bare" else 1e-3, 1, 0.0)
    posture.setReference(tsid.TrajectoryEuclidianConstant("rest", task["posture"]).computeNext())
    if case == "priorities":
        height = tsid.TaskSE3Equality("height", robot, "panda_link4")
        height.setKp(np.ones(6))
        height.setKd(2.0 * np.ones(6))
        height.setMask(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
        place = robot.framePosition(problem.data(), model.getFrameId("panda_link4"))
        height.setReference(tsid.TrajectorySE3Constant("height", place).computeNext())
        problem.addMotionTask(height, 1.0, 1, 0.0)
    if case != "bare":
        speed = task["velocity"] * (float(task["slow"]) if case == "limits saturated" else 1.0)
        bounds = tsid.TaskJointPosVelAccBounds("bounds", robot, dt)
        bounds.setPositionBounds(task["lower"], task["upper"])
        bounds.setVelocityBounds(speed)
        bounds.setAccelerationBounds(task["acceleration"])
        problem.addMotionTask(bounds, 1.0, 0, 0.0)
    solver = tsid.SolverHQuadProgFast("solver")
    solver.resize(problem.nVar, problem.nEq, problem.nIn)
    targets = [tsid.TrajectorySE3Constant("pose", pin.SE3(pose)).computeNext() for pose in task["poses"]]
    state = [q, v, 0.0]

    def step(k):
        q, v, time = state
        pose.setReference(targets[k])
        data = problem.computeProblemData(time, q, v)
        change = problem.getAccelerations(solver.solve(data))
        mean = v + 0.5 * dt * change
        state[:] = pin.integrate(model, q, dt * mean), v + dt * change, time + dt

    step.kept = locals().copy()  # tasks that Python lets go of are gone for TSID too
    return step, lambda: state[0]


serve(make)
