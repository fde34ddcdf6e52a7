"""`ik_controller solve`: a tool pose in, joints out, with the way there if asked."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from ik_controller.verbs.common import add_json_argument, add_model_arguments, model_from, print_json, print_table

if TYPE_CHECKING:
    from ik_controller.kinematics.model import RobotModel
    from ik_controller.kinematics.solution import Solution

HELP = "joints for a tool pose, by iteration or in closed form"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the verb's arguments."""
    # Before Python 3.14 argparse takes -1e-3 for an option.
    parser._negative_number_matcher = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    parser.add_argument(
        "--pose",
        nargs=7,
        type=float,
        required=True,
        metavar=("X", "Y", "Z", "QX", "QY", "QZ", "QW"),
        help="tool pose in the base frame: position [m], unit quaternion",
    )
    parser.add_argument(
        "--method",
        metavar="METHOD",
        help="newton, damped, transpose or analytic (default: damped; for --all analytic, where the arm has one)",
    )
    parser.add_argument("--start", nargs="+", type=float, metavar="Q", help="start [rad or m] (default: mid-range)")
    parser.add_argument("--axes", default="xyzrpy", help="subset of xyzrpy that counts; xyy is x, y and yaw")
    parser.add_argument(
        "--frame", default="base", help="base or body: whose axes those are; newton, transpose: or space"
    )
    parser.add_argument("--step", nargs="+", type=float, default=[1.0], metavar="L", help="step λ, or one a joint")
    parser.add_argument("--history", action="store_true", help="show every iteration")
    parser.add_argument("--all", action="store_true", help="all solutions that the closed form or the restarts find")
    parser.add_argument("--seed", type=int, default=0, help="of the random restarts (default: 0)")
    parser.add_argument("--restarts", type=int, help="random restarts (default: 100 for damped, else 0)")
    parser.add_argument("--max-iterations", type=int, metavar="N", help="iterations of one attempt")
    parser.add_argument("--position-tolerance", type=float, default=1e-6, metavar="M", help="[m] (default: 1e-6)")
    parser.add_argument(
        "--orientation-tolerance", type=float, default=1e-6, metavar="RAD", help="[rad] (default: 1e-6)"
    )
    parser.add_argument(
        "--swivel", type=float, metavar="RAD", help="elbow angle, analytic, 7 joints (default: start's)"
    )
    parser.add_argument("--no-limits", action="store_true", help="disregard joint limits")
    add_model_arguments(parser, default="panda")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    """Solve, print, and return 0 where the pose is reached, else 1."""
    from ik_controller.kinematics.solve import solve_ik

    model = model_from(arguments)
    if arguments.method is None:
        arguments.method = "damped"
        if arguments.all and arguments.axes == "xyzrpy":
            from ik_controller.kinematics.closed_form import recognise

            arguments.method = "damped" if recognise(model) is None else "analytic"
    solution = solve_ik(
        model,
        arguments.pose,
        arguments.start,
        arguments.method,
        axes=arguments.axes,
        frame=arguments.frame,
        step=arguments.step[0] if len(arguments.step) == 1 else arguments.step,
        position_tolerance=arguments.position_tolerance,
        orientation_tolerance=arguments.orientation_tolerance,
        max_iterations=arguments.max_iterations,
        restarts=arguments.restarts,
        seed=arguments.seed,
        respect_limits=not arguments.no_limits,
        all_solutions=arguments.all,
        history=arguments.history,
        swivel=arguments.swivel,
    )
    if arguments.json:
        print_json(as_mapping(model, solution, arguments.method))
    else:
        show(model, solution, arguments)
    return 0 if solution.converged else 1


def as_mapping(model: RobotModel, solution: Solution, method: str) -> dict[str, Any]:
    """Return what --json prints."""
    return {
        "converged": solution.converged,
        "reason": solution.reason,
        "method": method,
        "joints": list(model.joint_names),
        "q": solution.q,
        "solutions": list(solution.solutions),
        "position_error_m": solution.position_error_m,
        "orientation_error_rad": solution.orientation_error_rad,
        "iterations": solution.iterations,
        "restarts": solution.restarts,
        "free": list(solution.free),
        "history": [row._asdict() for row in solution.history],
    }


def show(model: RobotModel, solution: Solution, arguments: argparse.Namespace) -> None:
    """Print the answer for people."""
    from ik_controller.kinematics.solution import REASONS

    if solution.history:
        header = ("try", "k", *model.joint_names, "position [m]", "rotation [rad]")
        rows = [
            (
                str(row.restart),
                str(row.k),
                *(f"{x:.3g}" for x in row.q),
                f"{row.position_error_m:.1e}",
                f"{row.orientation_error_rad:.1e}",
            )
            for row in solution.history
        ]
        print_table(rows, header)
        print()
    for sentence in solution.free:
        print(f"Singular: {sentence}")
    if len(solution.solutions) > 1:
        numbered = [
            (str(k), *(f"{x:.6f}" for x in q)) for k, q in enumerate(solution.solutions, 1)
        ]  # the nearest to the start first
        print_table(numbered, ("solution", *model.joint_names))
    else:
        rows = [
            (name, f"{x:.6f}", "m" if slides else "rad", f"{lower:.4g}", f"{upper:.4g}")
            for name, x, slides, lower, upper in zip(
                model.joint_names, solution.q, model.prismatic, model.lower, model.upper, strict=True
            )
        ]
        print_table(rows, ("joint", "q", "unit", "lower", "upper"))
    print()
    print_table(
        [
            ("result", solution.reason if solution.converged else f"{solution.reason}: {REASONS[solution.reason]}"),
            ("position error", f"{solution.position_error_m:.3e} m"),
            ("orientation error", f"{solution.orientation_error_rad:.3e} rad"),
            ("iterations", f"{solution.iterations}, restarts {solution.restarts} ({arguments.method})"),
        ]
    )
    if not solution.converged:
        print("The joints above are the closest found.")
