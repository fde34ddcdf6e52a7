"""Page: the arm, the target to drag, plots and controls in the browser; served by viser.

All browsers see the same scene. One of them steers: it alone has the gizmo and the controls; others watch and may take
over. What the user does comes out through the `Steering` callbacks; what the arm does goes in through `show…`.
"""

from __future__ import annotations

import contextlib
import html
import io
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import trimesh
import viser
import viser.uplot
from numpy.typing import NDArray

from ik_controller.kinematics.collision_distance import BOX, CYLINDER, HALF_SPACE
from ik_controller.kinematics.collision_world import World
from ik_controller.kinematics.model import RobotModel
from ik_controller.view.shapes import ArmShapes

Array = NDArray[np.float64]

_GHOST = (245, 133, 24)  # the commanded arm, and what belongs to it
_TARGET = (31, 119, 180)
_HISTORY = 10.0  # [s] that the plots reach back
_TRAIL = 400  # points
_REPLOT = 0.4  # [s]
_RETELL = 0.5  # [s] between two changes of the numbers below the sentence
_APART = 3e-3  # [rad or m] from where on a joint's command is seen beside the joint
_STILL = 2e-5  # [rad or m] of a joint that are no motion to the eye
_VIEW = (1.25, -1.05, 0.95), (0.15, 0.05, 0.35)  # where one looks from, and to
_VIEW_UPRIGHT = (1.5, -1.25, 0.6), (0.15, 0.05, -0.15)
_LEVELS = {0: "#2f9e44", 1: "#e8a100", 2: "#d6336c"}  # of diagnostics: OK, warning, error; grey: stale
_HELP = (
    "Drag the arrows, planes or rings at the tool: the arm follows while you hold them, and stops when you let go. "
    "Solid: the measured arm; orange: the commanded one, where they differ."
)


@dataclass
class Steering:
    """What a page can ask for; each call comes from viser's threads.

    `drag(pose, held)`: the gizmo's `pin.SE3` in the base frame, `held` False when let go; `set(name, value)` a
    parameter; `press(name)` one of "pause", "resume", "reset", "record", "seal".
    """

    drag: Callable[[Any, bool], None]
    set: Callable[[str, float], None]
    press: Callable[[str], None]


# Parameter → (label, lowest, highest, step).
SLIDERS = {
    "gain": ("gain K [1/s]", 1.0, 200.0, 1.0),
    "damping": ("damping λ", 0.0, 0.5, 0.01),
    "posture_gain": ("null-space gain [1/s]", 0.0, 10.0, 0.1),
    "velocity_scale": ("speed scale", 0.01, 1.0, 0.01),
}
_BUTTONS = {
    "arm": {"Pause": "pause", "Go on": "resume", "Reset": "reset"},
    "recording": {"Record": "record", "Stop": "seal"},
}


class Page:
    """The page of one arm on a loopback port; `steering` None makes it one to watch only."""

    def __init__(self, title: str, steering: Steering | None = None, dark: bool = False) -> None:
        with contextlib.redirect_stdout(io.StringIO()):  # viser tells its own address, which is not the door's
            self.server = viser.ViserServer(host="127.0.0.1", port=0, label=title, verbose=False)
        self.port: int = self.server.get_port()
        self._steering = steering
        self._lock = threading.RLock()
        self._model: RobotModel | None = None
        self._shapes: ArmShapes | None = None
        self._joints: dict[str, dict[int, Any]] = {}
        self._shown: dict[str, Array] = {}
        self._tool = pin.SE3.Identity()
        self._steerer: int | None = None
        self._held = False
        self._gizmo: Any = None
        self._controls: dict[int, _Controls] = {}
        self._values: dict[str, float] = {}
        self._history: deque[tuple[float, float, float, float]] = deque()
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._trail_drawn = self._plotted = self._retold = 0.0
        self._obstacles: list[Any] = []

        server = self.server
        server.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, control_width="medium", brand_color=_TARGET
        )
        server.scene.set_up_direction("+z")
        server.scene.add_grid(
            "/floor",
            width=4.0,
            height=4.0,
            cell_size=0.1,
            section_size=0.5,
            cell_color=(48, 52, 58) if dark else (225, 225, 225),
            section_color=(80, 86, 95) if dark else (180, 180, 180),
            position=(0.0, 0.0, -0.001),
            shadow_opacity=0.0,
        )
        server.scene.configure_default_lights(cast_shadow=False)  # shadows cost a browser without GPU its fluency
        server.initial_camera.position, server.initial_camera.look_at = _VIEW
        self._sentence = server.gui.add_html(_sentence(3, "waiting for the node"))
        self._facts = server.gui.add_html("")  # markdown is compiled in the browser, at each change
        self._note = ""  # what could not be shown of the arm
        with server.gui.add_folder("Last 10 s", order=1e6):
            self._plots = (
                self._plot("position error [mm]", ("error", _TARGET)),
                self._plot("orientation error [°]", ("error", _TARGET)),
                self._plot("fastest joint [% of its limit]", ("speed", (84, 131, 46))),
            )
        server.on_client_connect(self._joined)
        server.on_client_disconnect(self._left)

    def close(self) -> None:
        """Stop serving."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # -- the arm

    def load(self, model: RobotModel, folders: Sequence[str] = ()) -> None:
        """Show another arm, and say once what could not be shown of it."""
        shapes = ArmShapes(model, folders)
        with self._lock:
            for kind in self._joints:
                self.server.scene.remove_by_name(f"/{kind}")
            self._joints = {"measured": {}, "commanded": {}}
            for kind, joints in self._joints.items():
                for index, mesh in enumerate(shapes.meshes):
                    if mesh.joint not in joints:
                        joints[mesh.joint] = self.server.scene.add_frame(
                            f"/{kind}/{mesh.joint}", show_axes=False, visible=kind == "measured"
                        )
                    ghost = kind == "commanded"
                    self.server.scene.add_mesh_simple(
                        f"/{kind}/{mesh.joint}/{index}",
                        np.asarray(mesh.vertices, dtype=np.float32),
                        np.asarray(mesh.faces, dtype=np.uint32),
                        color=_GHOST if ghost else mesh.color,
                        opacity=0.25 if ghost else None,
                        cast_shadow=not ghost,
                    )
            self._model, self._shapes = model, shapes
            self._shown.clear()
            self._trail.clear()
            self._history.clear()
        if shapes.note and shapes.note != self._note:
            self.notify("Robot", shapes.note)
        self._note = shapes.note

    def show_arm(self, kind: str, q: Array) -> None:
        """Place an arm, `kind` "measured" or "commanded", at q (n,)."""
        with self._lock:
            if self._model is None or self._shapes is None:
                return
            if np.abs(q - self._shown.get(kind, np.full(len(q), np.inf))).max() < _STILL:
                return  # a resting arm costs neither the network nor the browser
            self._shown[kind] = np.array(q)
            with self.server.atomic():
                if kind == "measured":
                    self._place(kind)
                self._show_ghost()
            if kind == "commanded" or not self._trail:
                self._tool = self._model.forward(q)
                self._leave_trail(self._tool.translation)
                if not self._held and self._gizmo is not None:
                    self._gizmo.position = self._tool.translation
                    self._gizmo.wxyz = _wxyz(self._tool.rotation)

    def _place(self, kind: str) -> None:
        assert self._shapes is not None
        for joint, placement in self._shapes.place(self._shown[kind]).items():
            frame = self._joints[kind][joint]
            position, wxyz = placement.translation, _wxyz(placement.rotation)
            if np.abs(position - frame.position).max() > 1e-6 or np.abs(wxyz - frame.wxyz).max() > 1e-6:
                frame.position, frame.wxyz = position, wxyz

    def _show_ghost(self) -> None:
        apart = len(self._shown) == 2 and np.abs(self._shown["measured"] - self._shown["commanded"]).max() > _APART
        for frame in self._joints["commanded"].values():
            if frame.visible != apart:
                frame.visible = apart
        if apart:  # what is hidden need not move
            self._place("commanded")

    def _leave_trail(self, point: Array) -> None:
        if self._trail and np.linalg.norm(point - self._trail[-1]) < 2e-3:
            return
        self._trail.append(np.array(point))
        now = time.monotonic()
        if len(self._trail) > 2 and now - self._trail_drawn > 0.2:
            self._trail_drawn = now
            points = np.array(self._trail, dtype=np.float32)
            self.server.scene.add_line_segments(
                "/trail", points=np.stack((points[:-1], points[1:]), axis=1), colors=_GHOST, thickness=2.0
            )

    # -- what is told

    def show_status(self, level: int, sentence: str, facts: Sequence[tuple[str, str]] = ()) -> None:
        """Show the status: `level` as in diagnostics (0 OK, 1 warning, 2 error, 3 stale), a sentence, a few facts."""
        text = _sentence(level, sentence)
        now = time.monotonic()
        if self._sentence.content != text:
            self._sentence.content = text
        elif now - self._retold < _RETELL:
            return
        self._retold = now
        table = _table(facts)
        if self._facts.content != table:
            self._facts.content = table

    def show_errors(self, seconds: float, position: float, orientation: float, speed: float) -> None:
        """Add to the plots: at `seconds`, errors [m, rad] and the fastest joint's share of its limit."""
        if self._history and seconds < self._history[-1][0]:
            self._history.clear()
        self._history.append((seconds, 1e3 * position, np.degrees(orientation), 100.0 * speed))
        while self._history[0][0] < seconds - _HISTORY:
            self._history.popleft()
        now = time.monotonic()
        if now - self._plotted < _REPLOT:
            return
        self._plotted = now
        table = np.array(self._history)
        for column, plot in enumerate(self._plots, start=1):
            plot.data = (table[:, 0] - seconds, table[:, column])

    def show_parameters(self, values: dict[str, float]) -> None:
        """Show the node's parameters on the sliders."""
        with self._lock:
            self._values = dict(values)
            for controls in self._controls.values():
                controls.show(values)

    def show_obstacles(self, world: World) -> None:
        """Show the solids of a world."""
        with self._lock:
            for old in self._obstacles:
                old.remove()
            self._obstacles = []
            for index, (kind, size, rotation, center, _) in enumerate(zip(*world.arrays(), strict=True)):
                look: dict[str, Any] = {"color": (200, 80, 70), "opacity": 0.6, "wxyz": _wxyz(rotation)}
                name, scene = f"/obstacles/{index}", self.server.scene
                if kind == BOX:
                    handle: Any = scene.add_box(name, dimensions=2.0 * size, position=center, **look)
                elif kind == HALF_SPACE:  # as a slab whose upper face is its boundary
                    below = center - 0.005 * rotation[:, 2]
                    handle = scene.add_box(name, dimensions=(2.0, 2.0, 0.01), position=below, **look)
                elif kind == CYLINDER:
                    handle = scene.add_cylinder(name, radius=size[1], height=2.0 * size[0], position=center, **look)
                else:
                    shape = trimesh.creation.capsule(height=2.0 * size[0], radius=size[1])
                    shape.apply_translation((0.0, 0.0, -shape.bounds.mean(axis=0)[2]))
                    handle = scene.add_mesh_simple(name, shape.vertices, shape.faces, position=center, **look)
                self._obstacles.append(handle)

    def notify(self, title: str, text: str) -> None:
        """Tell all browsers something."""
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=6.0)

    def _plot(self, title: str, *series: tuple[str, tuple[int, int, int]]) -> Any:
        lines = tuple(
            viser.uplot.Series(label=name, stroke=f"rgb{color}", width=2, points={"show": False})
            for name, color in series
        )
        return self.server.gui.add_uplot(
            (np.array([-_HISTORY, 0.0]), *(np.zeros(2) for _ in series)),
            (viser.uplot.Series(label="s"), *lines),
            title=title,
            scales={"x": {"time": False, "range": [-_HISTORY, 0.0]}},
            legend={"show": False},
            aspect=3.0,
        )

    # -- who steers

    def _joined(self, client: Any) -> None:
        if client.camera.image_height > client.camera.image_width:  # a telephone: the panel covers the lower half
            client.camera.position, client.camera.look_at = _VIEW_UPRIGHT
        if self._note:
            client.add_notification("Robot", self._note, auto_close_seconds=6.0)
        if self._steering is None:
            return
        with self._lock:
            self._controls[client.client_id] = _Controls(self, client, self._steering)
            self._controls[client.client_id].show(self._values)
            self._hand_over(client.client_id if self._steerer is None else self._steerer)

    def _left(self, client: Any) -> None:
        with self._lock:
            self._controls.pop(client.client_id, None)
            if client.client_id == self._steerer:
                self._gizmo = None
                self._let_go()
                self._hand_over(None)

    def _hand_over(self, steerer: int | None) -> None:
        """Give the gizmo and the controls to one browser."""
        with self._lock:
            if steerer != self._steerer and self._gizmo is not None:
                self._let_go()
                self._gizmo.remove()
                self._gizmo = None
            self._steerer = steerer
            for number, controls in self._controls.items():
                controls.enable(number == steerer, steerer)
            if steerer is not None and self._gizmo is None:
                self._gizmo = self._controls[steerer].client.scene.add_transform_controls(
                    "/target",
                    scale=0.22,
                    line_width=3.0,
                    depth_test=False,
                    position=self._tool.translation,
                    wxyz=_wxyz(self._tool.rotation),
                )
                self._gizmo.on_update(self._dragged)

    async def _dragged(self, event: Any) -> None:
        # A coroutine, so that start, updates and end come in order.
        with self._lock:
            if self._steering is None or event.client_id != self._steerer:
                return
            self._held = event.phase != "end"
            w, x, y, z = event.target.wxyz
            pose = pin.XYZQUATToSE3(np.array((*event.target.position, x, y, z, w)))
        self._steering.drag(pose, self._held)

    def _let_go(self) -> None:
        if self._held and self._steering is not None:
            self._held = False
            self._steering.drag(self._tool, False)


class _Controls:
    """One browser's controls: who steers, sliders, buttons."""

    def __init__(self, page: Page, client: Any, steering: Steering) -> None:
        self.client, self._steering = client, steering
        gui = client.gui
        self._who = gui.add_markdown("")
        self._take = gui.add_button("Steer here")
        self._take.on_click(lambda _: page._hand_over(client.client_id))
        self._quiet = False
        self._folder = gui.add_folder("Steering")
        with self._folder:
            gui.add_markdown(_HELP)
            for label, names in _BUTTONS.items():
                group = gui.add_button_group(label, tuple(names))
                group.on_click(lambda event, names=names: steering.press(names[event.target.value]))
            self._sliders = {
                name: gui.add_slider(label, min=low, max=high, step=step, initial_value=low)
                for name, (label, low, high, step) in SLIDERS.items()
            }
        for name, slider in self._sliders.items():
            slider.on_update(lambda _, name=name, slider=slider: self._slid(name, slider))

    def _slid(self, name: str, slider: Any) -> None:
        if not self._quiet:
            self._steering.set(name, float(slider.value))

    def show(self, values: dict[str, float]) -> None:
        self._quiet = True
        for name, slider in self._sliders.items():
            if name in values:
                low, high = SLIDERS[name][1:3]
                slider.value = min(max(values[name], low), high)
        self._quiet = False

    def enable(self, steers: bool, steerer: int | None) -> None:
        watching = "nobody steers" if steerer is None else "another browser steers"
        self._who.content = "**you steer**" if steers else f"{watching}; you watch"
        self._take.visible = not steers
        self._folder.visible = steers


def _sentence(level: int, text: str) -> str:
    color = _LEVELS.get(level, "#868e96")
    dot = f"<span style='color:{color}'>&#9679;</span>"
    return f"<p style='margin:6px 12px;font-size:14px;font-weight:600'>{dot} {html.escape(text)}</p>"


def _table(facts: Sequence[tuple[str, str]]) -> str:
    row = "<tr><td style='padding:1px 12px 1px 0;opacity:.7'>{}</td><td style='padding:1px 0'>{}</td></tr>"
    rows = "".join(row.format(html.escape(name), html.escape(value)) for name, value in facts)
    return f"<table style='margin:2px 12px;font-size:13px;border-collapse:collapse'>{rows}</table>" if facts else ""


def _wxyz(rotation: Array) -> Array:
    x, y, z, w = pin.Quaternion(rotation).coeffs()
    return np.array((w, x, y, z))
