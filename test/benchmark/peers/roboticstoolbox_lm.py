"""Peter Corke's Robotics Toolbox, ik_LM in C++, its defaults but for the tolerance: E = ½ |e|² for |e| = 1e-6."""

import warnings

import roboticstoolbox
from common import load, run

task = load()
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    robot = roboticstoolbox.Robot.URDF(str(task["urdf"]))
links = {link.name: link for link in robot.links}
chain = robot.ets(start=links[str(task["base"])], end=links[str(task["tip"])])


def solve(i):
    """Return the joints, or None."""
    answer = chain.ik_LM(task["poses"][i], q0=task["starts"][i], tol=0.5e-12)
    return answer.q if answer.success else None


run(task, solve)
