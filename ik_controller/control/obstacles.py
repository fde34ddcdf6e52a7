"""Obstacles: what keeps the arm off itself and off the world, as inequalities G q̇ ≤ g inside the law.

For a pair at distance d with gradient ∇d = nᵀ(J_a − J_b), n from b to a through the nearest points, two rules hold:

    velocity damper (Faverjon and Tournassoud 1987)   ḋ ≥ −κ (d − d_min)            while d is below d_influence
    braking                                           d(q_s) ≥ d_min                for q_s all along the braking path

The braking path starts where this cycle's velocity leads, q + q̇ dt, and is that of joints which all brake as hard as
they can: q_s = q + q̇ dt + q̇ t − ½ a t² up to t = |q̇|/a. It is the rule of the joint bounds (`limits`), for distances:
a velocity is taken only if the arm can stop after it. Both are linearised about the velocity q̇_b that brakes hardest
from here. With it the arm stays on the path that the last cycle found free, however fast it is and however little its
joints can do about it, so q̇_b meets every row whose distance is not below d_min already. Row and path are exact at
q̇_b, and the slope is that of the chord up to the hardest acceleration: what is left out is on the safe side.

The rows bend a tool's path as little as they can: the velocity nearest to the wanted one, by what the tool does, is
looked for first among those that the rows allow; along it the joints' limits then slow the arm. A pair that is nearer
than d_min, because it started so or an obstacle came, must get farther at κ (d_min − d), as far as the joints can.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import daqp
import numpy as np
from numpy.typing import NDArray

from ik_controller.control.limits import JointLimits
from ik_controller.control.obstacle_rows import MOST_ROWS, hardest_stop, obstacle_rows
from ik_controller.control.reach import BOUNDS
from ik_controller.control.status import Limit
from ik_controller.errors import ModelError, ParameterError, choices
from ik_controller.kinematics.accelerate import compiled
from ik_controller.kinematics.chain import chain_of
from ik_controller.kinematics.collision import ArmCollision, arm_collision
from ik_controller.kinematics.collision_world import World, read_world
from ik_controller.kinematics.model import RobotModel
from ik_controller.parameters import ControllerParameters

Array = NDArray[np.float64]

_ALLOWED = 1e-9  # [m/s or rad/s, rows have unit length] by which a row may be missed
_CLOSEST_WEIGHT = 1e-4  # joint velocities, over their limits, against the tool's [m/s, rad/s]
_TURNING = 6.0  # [1/rad] how fast a row's direction may turn with the joints
_NEAR_BOUND = 20.0  # [1/s] how fast a joint is let near its bound while it slides
_NO_TASK = np.zeros((0, 0))
_SOLVED = 1


# What a scene is made of; all else may be changed while it is in use.
SCENE_PARAMETERS = ("self_collision", "obstacle_avoidance", "obstacles", "srdf", "self_minimum_distance")

_ARMS: WeakKeyDictionary[RobotModel, tuple[tuple[Any, ...], ArmCollision]] = WeakKeyDictionary()


class Scene:
    """What may not touch: `arm`, the arm's capsules and pairs, None where nothing is watched; `world`, the solids, and
    `world_watched`, whether there may be any.
    """

    def __init__(self, arm: ArmCollision | None = None, world_watched: bool = False) -> None:
        self.arm = arm
        self.world = World()
        self.world_watched = world_watched

    @classmethod
    def of(cls, model: RobotModel, parameters: ControllerParameters) -> Scene:
        """Return the scene that parameters describe. Raises ParameterError, ModelError for files and shapes."""
        watched = parameters.obstacle_avoidance or bool(parameters.obstacles)
        if not watched and not parameters.self_collision:
            return cls()
        key = tuple(getattr(parameters, name) for name in ("posture", "urdf", *SCENE_PARAMETERS))
        kept = _ARMS.get(model)
        if kept is None or kept[0] != key:  # fitting and sorting out takes up to seconds
            arm = arm_collision(
                model,
                np.array(parameters.posture) if parameters.posture else None,
                minimum=parameters.self_minimum_distance,
                self_collision=parameters.self_collision,
                srdf=parameters.srdf or None,
                folder=Path(parameters.urdf).parent if parameters.urdf else None,
            )
            kept = _ARMS[model] = key, arm
        scene = cls(kept[1], watched)
        if parameters.obstacles:
            scene.world = read_world(parameters.obstacles, _placement(model))
        return scene

    def copy(self) -> Scene:
        """Return a scene of its own."""
        other = Scene()
        other.restore(self.state())
        return other

    def state(self) -> dict[str, Any]:
        """Return the scene as JSON types, for `restore`; floats come back bit for bit."""
        return {
            "arm": None if self.arm is None else self.arm.state(),
            "world": self.world.state(),
            "world_watched": self.world_watched,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take a state of `state`."""
        self.arm = None if state["arm"] is None else ArmCollision.restored(state["arm"])
        self.world_watched = bool(state["world_watched"])
        self.world.restore(state["world"])


def _placement(model: RobotModel) -> Any:
    """Return the function from a link fixed to the base to its `pin.SE3` in the base frame."""
    import pinocchio as pin

    fixed = {
        f.name: pin.SE3(f.placement)
        for f in model.pin_model.frames
        if f.type == pin.FrameType.BODY and f.parentJoint == 0
    }
    fixed[model.base_frame] = fixed[""] = pin.SE3.Identity()

    def placement(name: str) -> Any:
        if name not in fixed:
            legal = choices(sorted(filter(None, fixed)))
            raise ModelError(f"frame '{name}' is not a link that is fixed to the base; legal: {legal}")
        return fixed[name]

    return placement


class Obstacles:
    """The rows of one cycle: `update`, then ask. `count` of them; `braking` (n,), the velocity that brakes hardest;
    `distance` [m] of the nearest pair, `nearest` its names, both only of pairs within reach of this cycle.
    """

    def __init__(self, model: RobotModel, parameters: ControllerParameters, scene: Scene) -> None:
        """Raises ParameterError where the distances do not fit each other."""
        if parameters.influence_distance <= parameters.minimum_distance:
            raise ParameterError(
                f"influence_distance {parameters.influence_distance:g} m must be above "
                f"minimum_distance {parameters.minimum_distance:g} m"
            )
        n = model.n
        self.scene = scene
        self._model = model
        self._chain = tuple(chain_of(model))
        self._settings = np.array(
            (
                parameters.minimum_distance,
                parameters.self_minimum_distance,
                parameters.influence_distance,
                min(parameters.obstacle_gain, parameters.rate),
            )
        )
        self._rows, self._bounds, self._about = np.zeros((MOST_ROWS, n)), np.zeros(MOST_ROWS), np.zeros((MOST_ROWS, 4))
        self.braking, self._deceleration = np.zeros(n), np.zeros(n)
        self._nearest = (-1, -1)
        self.count = self._here = 0
        self.distance = math.inf
        self._dt = 0.0

    @property
    def watching(self) -> bool:
        """Whether there is anything to keep apart."""
        arm = self.scene.arm
        return arm is not None and (len(arm.pairs) > 0 or len(self.scene.world) > 0)

    def update(self, q: Array, v: Array, a: Array, limits: JointLimits, dt: float) -> int:
        """Work out the rows of the cycle that starts at the commanded q, v (n,) with the last acceleration a (n,);
        return how many there are. `limits` are this cycle's.
        """
        arm, world = self.scene.arm, self.scene.world
        self.count, self._here, self._dt = 0, 0, dt
        if arm is None or not self.watching:
            return 0
        hardest_stop(
            v, a, dt, limits.low, limits.high, limits.acceleration, limits.jerk, self.braking, self._deceleration
        )
        self._here, self.count, self.distance, first, second = obstacle_rows(
            self._chain,
            (arm.joint, arm.ends, arm.radius, arm.pairs, arm.reach),
            world.arrays(),
            q,
            limits.low,
            limits.high,
            self.braking,
            self._deceleration,
            dt,
            self._settings,
            self._rows,
            self._bounds,
            self._about,
        )
        self._nearest = first, second
        return self.count

    @property
    def rows(self) -> tuple[Array, Array]:
        """G (count, n) and g (count,) of this cycle."""
        return self._rows[: self.count], self._bounds[: self.count]

    def allow(self, velocity: Array) -> bool:
        """Tell whether G q̇ ≤ g for a velocity (n,) that the joints can take now."""
        return self.count == 0 or allowed(self._rows, self._bounds, self.count, velocity)

    def let(self, wanted: Array) -> bool:
        """Tell whether the dampers let a velocity (n,) pass that the joints may be far from: braking rows know nothing
        about it.
        """
        return self._here == 0 or allowed(self._rows, self._bounds, self._here, wanted)

    def pass_by(
        self, wanted: Array, jacobian: Array | None, q: Array, limits: JointLimits
    ) -> tuple[Array, Limit, tuple[str, ...], float]:
        """Return the velocity (n,) nearest to `wanted` (n,) that rows and limits allow, and what keeps it from there:
        which limit, names and distance [m] of the pair.

        Nearest by what the tool does, J (m, n), and far behind that by what the joints do; by the joints alone without
        J. The dampers, the joints' bounds and speeds come first, and then the braking path and how soon the joints can
        get there, so that an arm that brakes is not led astray.

        A pressed arm's normals turn as it moves. What that does in one cycle to what the rows push back must die out
        too, in every direction: the joints get a weight that grows with that push.
        """
        rows, bounds = self.rows
        aim, low, high, metric, pull = sliding_problem(
            wanted,
            _NO_TASK if jacobian is None else jacobian,
            q,
            limits.velocity,
            limits.table[BOUNDS],
            limits.low,
            limits.high,
        )
        quiet = _TURNING * self._dt
        diagonal = metric.reshape(-1)[:: q.size + 1]
        plain = diagonal.copy()
        diagonal += quiet * pull
        here = rows[: self._here], bounds[: self._here]
        found, push = _nearest_allowed(aim, metric, low, high, *here)
        pushed = float(np.add.reduce(push))
        if pushed > 2.0 * pull:  # squeezed: more than was reckoned with
            diagonal[:] = plain + quiet * pushed
            found, push = _nearest_allowed(aim, metric, low, high, *here)
        aim = aim if found is None else found
        velocity = np.fmin(np.fmax(aim, limits.low), limits.high)
        if (velocity != aim).any() or found is None or not self.allow(velocity):
            diagonal[:] = plain
            found, push = _nearest_allowed(aim, metric, limits.low, limits.high, rows, bounds)
            if found is None:  # squeezed from two sides: at least not nearer
                found = self.braking
            velocity = np.fmin(np.fmax(found, limits.low), limits.high)
        row = int(np.argmax(push)) if push.any() else int(np.argmax(rows.dot(wanted) - bounds))
        first, second = int(self._about[row, 0]), int(self._about[row, 1])
        limit = Limit.SELF_COLLISION if second >= 0 else Limit.OBSTACLE
        return velocity, limit, self._names(first, second), self._about.item(row, 2)

    @property
    def nearest(self) -> tuple[str, ...]:
        """The names of the nearest pair, empty where nothing is near."""
        first, second = self._nearest
        return self._names(first, second) if first >= 0 else ()

    def _names(self, first: int, second: int) -> tuple[str, str]:
        assert self.scene.arm is not None
        links = self.scene.arm.links
        return links[first], links[second] if second >= 0 else self.scene.world.names[-1 - second]


def _nearest_allowed(
    wanted: Array, hessian: Array, low: Array, high: Array, rows: Array, bounds: Array
) -> tuple[Array | None, Array]:
    """Return argmin ½ (q̇ − wanted)ᵀ H (q̇ − wanted) with G q̇ ≤ g, within [low, high] (n,), and the rows' multipliers;
    None and zeros where there is none.
    """
    n, count = wanted.size, bounds.size
    upper, lower = np.empty(n + count), np.empty(n + count)
    upper[:n], upper[n:] = high, bounds
    lower[:n], lower[n:] = low, -1e30
    sense = np.zeros(n + count, dtype=np.int32)
    solution, _, flag, info = daqp.solve(hessian, -hessian.dot(wanted), rows, upper, lower, sense, primal_tol=1e-11)
    if flag != _SOLVED:  # DAQP leaves in the multipliers what was there before
        return None, np.zeros(count)
    return solution, info["lam"][n:]


@compiled
def allowed(rows: Array, bounds: Array, count: int, velocity: Array) -> bool:
    """Tell whether a velocity (n,) meets the first `count` rows."""
    for k in range(count):
        total = 0.0
        for i in range(velocity.shape[0]):
            total += rows[k, i] * velocity[i]
        if not total <= bounds[k] + _ALLOWED:
            return False
    return True


@compiled
def sliding_problem(
    wanted: Array, jacobian: Array, q: Array, velocity: Array, bounds: Array, low: Array, high: Array
) -> tuple[Array, Array, Array, Array, float]:
    """Return aim (n,): `wanted` slowed to the speed limits; lower and upper velocities (n,) that heed position bounds
    and speeds but not accelerations; the metric JᵀJ + D (n, n), D alone for a J without rows; |metric · aim|.
    """
    n = q.shape[0]
    excess = 1.0
    for i in range(n):
        excess = max(excess, abs(wanted[i]) / velocity[i])
    aim, lowest, highest, metric = np.empty(n), np.empty(n), np.empty(n), np.zeros((n, n))
    weight = _CLOSEST_WEIGHT if jacobian.shape[0] > 0 else 1.0
    for i in range(n):
        aim[i] = wanted[i] / excess
        highest[i] = max(high[i], min(velocity[i], _NEAR_BOUND * (bounds[i] - q[i])))
        lowest[i] = min(low[i], max(-velocity[i], -_NEAR_BOUND * (bounds[n + i] + q[i])))
        for j in range(n):
            for k in range(jacobian.shape[0]):
                metric[i, j] += jacobian[k, i] * jacobian[k, j]
        metric[i, i] += weight / (velocity[i] * velocity[i])
    square = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += metric[i, j] * aim[j]
        square += total * total
    return aim, lowest, highest, metric, math.sqrt(square)
