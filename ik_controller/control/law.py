"""The law q̇ = J⁺(ẋ_d + K e) + (I − J⁺J) q̇₀ (notes N11, N12), discretised to second order.

Over a cycle from t to t + dt, the error e is taken at the cycle's start and ẋ_d as the reference's secant over the
cycle, so that the feed-forward ends where the reference does. J is taken at the *predicted middle* of the cycle,
q + ½ q̇_previous dt: joint velocities change by at most a·dt between cycles, so the middle is known to O(dt²), and with it
the integration is the midpoint rule at the price of one forward kinematics more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ik_controller.control.reference import Reference
from ik_controller.kinematics.damped_inverse import DampedInverse
from ik_controller.kinematics.model import RobotModel, frame_jacobian
from ik_controller.kinematics.orientation_error import ORIENTATION_ERRORS
from ik_controller.parameters import ControllerParameters, gain_matrix

Array = NDArray[np.float64]

# Share of the acceleration limits that the approach to a target plans its braking with; the rest is for the moving
# reference, the turning of J and the posture.
_BRAKING_SHARE = 0.7
# The posture is sought at most at this share of the velocity limits.
_POSTURE_SHARE = 0.2


class Law:
    """Wanted joint velocities for tool references. Keeps `error` (6,) and the factored `inverse` of the last call."""

    def __init__(self, model: RobotModel, parameters: ControllerParameters) -> None:
        """Raises ParameterError where gain or posture do not fit."""
        self._model = model
        self._gain = gain_matrix(parameters.gain, 1.0 / parameters.rate)
        rates = np.abs(np.linalg.eigvals(self._gain))
        self._fastest, self.slowest_gain = float(rates.max()), float(rates.min())
        self._feed_forward = parameters.feed_forward
        self._orientation_error = ORIENTATION_ERRORS[parameters.orientation_error]
        self._posture = np.array(parameters.posture) if parameters.posture else None
        self._posture_gain = parameters.posture_gain
        self._velocity_limit = model.velocity_limit * parameters.velocity_scale
        self._acceleration = _BRAKING_SHARE * model.acceleration_limit * parameters.acceleration_scale
        self.inverse = DampedInverse(6, parameters.damping, parameters.singular_value_threshold)
        self.error = np.zeros(6)
        self.jacobian = np.zeros((6, model.n))
        self._sides = np.zeros((6, 2))  # right-hand sides: feedback, feed-forward
        self._data: Any = model.pin_model.createData()
        self._middle_data: Any = model.pin_model.createData()
        tool = self._data.oMf[model.tool_id]
        self._rotation, self._position = tool.rotation, tool.translation  # views that forward kinematics overwrites

    def tool_pose(self, q: Array) -> tuple[Array, Array]:
        """Return (position (3,), rotation (3, 3)) of the tool at q; views that the next call overwrites."""
        model = self._model
        pin.forwardKinematics(model.pin_model, self._data, model.expand(q))
        pin.updateFramePlacement(model.pin_model, self._data, model.tool_id)
        return self._position, self._rotation

    def observe(self, reference: Reference, q: Array) -> Array:
        """Set and return `error` (6,) = reference ⊖ tool pose at q (n,) [m, rad]; zero where the reference has no pose."""
        if reference.position is None or reference.rotation is None:
            self.error = np.zeros(6)
            return self.error
        position, rotation = self.tool_pose(q)
        self.error = error = np.empty(6)
        np.subtract(reference.position, position, error[:3])
        error[3:] = self._orientation_error.function(reference.rotation, rotation)
        return error

    def velocity(self, reference: Reference, q: Array, v: Array, dt: float) -> tuple[Array, Array | None]:
        """Return (task, null): J⁺(ẋ_d + K e) and (I − J⁺J) q̇₀, each (n,) [rad/s or m/s]; null None without posture.

        q (n,): joints at which e and J are taken; v (n,): the last commanded velocity; dt [s].
        """
        sides = self._sides
        error = self.observe(reference, q)
        feedback = self._gain.dot(error)
        if reference.rotation is not None:
            feedback[3:] = self._orientation_error.to_angular_velocity(feedback[3:], self._rotation)
        sides[:, 0] = feedback
        sides[:, 1] = reference.twist if self._feed_forward or reference.position is None else 0.0

        self.jacobian = jacobian = frame_jacobian(
            self._model, self._middle_data, q + (0.5 * dt) * v, self._model.tool_id
        )
        self.inverse.factor(jacobian)
        solved = self.inverse.apply(sides)
        approach = solved[:, 0]
        task: Array = solved[:, 1] + self._braking(approach) * approach
        if self._posture is None:
            return task, None
        seek = (self._posture - q) * self._posture_gain
        speed = np.abs(seek) / self._velocity_limit
        seek *= _POSTURE_SHARE / max(float(speed.max()), _POSTURE_SHARE)
        return task, seek - self.inverse.apply(jacobian.dot(seek))

    def _braking(self, approach: Array) -> float:
        """Return the factor on the feedback velocity from which every joint can brake to a stop at the target.

        q̇ = K δ decays at the rate K only while K |q̇| ≤ a; from further away the fastest approach that can still stop is
        q̇ = √(2 a (δ − a/2K²)), its tangent continuation. With r = K q̇/a the ratio of the two is √(2r − 1)/r.
        """
        ratio = self._fastest * float((np.abs(approach) / self._acceleration).max())
        return math.sqrt(2.0 * ratio - 1.0) / ratio if ratio > 1.0 else 1.0
