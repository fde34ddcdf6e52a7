"""The live page in a real browser: drag the target, two browsers, controls; no ROS."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("viser")

from browser import Watched, browser

from ik_controller.kinematics.collision_world import World, box, capsule, cylinder, half_space, sphere
from ik_controller.robots import build_model, bundled_parameters
from ik_controller.view.door import Door
from ik_controller.view.page import Page, Steering

PATIENCE = 60.0  # [s]
PARAMETERS = bundled_parameters("panda")
MODEL = build_model(PARAMETERS)


class Shown:
    """A page with the Panda behind its door; `drags`, `settings`, `presses`: what its users did."""

    def __init__(self) -> None:
        self.drags: list[tuple[Any, bool]] = []
        self.settings: list[tuple[str, float]] = []
        self.presses: list[str] = []
        steering = Steering(
            lambda pose, held: self.drags.append((pose, held)),
            lambda name, value: self.settings.append((name, value)),
            self.presses.append,
        )
        self.page = Page("panda", steering)
        self.page.load(MODEL)
        self.q = np.array(PARAMETERS.posture)
        for kind in ("measured", "commanded"):
            self.page.show_arm(kind, self.q)
        self.page.show_status(0, "tracking", [("limit", "none")])
        self.page.show_parameters({"gain": 50.0, "damping": 0.05, "posture_gain": 1.0, "velocity_scale": 0.5})
        self.door = Door("127.0.0.1", 0, self.page.port)

    def close(self) -> None:
        self.door.close()
        self.page.close()

    def clients(self) -> list[Any]:
        return list(self.page.server.get_clients().values())


@pytest.fixture
def shown() -> Iterator[Shown]:
    made = Shown()
    yield made
    made.close()


def until(condition: Callable[[], Any], what: str, page: Any = None) -> Any:
    """Wait until something holds; `page` keeps playwright's events going meanwhile."""
    by = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < by, f"never: {what}"
        if page is not None:
            page.wait_for_timeout(50)
        else:
            time.sleep(0.05)
    return found


def drawn(page: Any) -> None:
    """Wait for two frames; without a graphics card on a busy machine, one can take seconds."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    page.wait_for_timeout(60)


def pixel(client: Any, point: np.ndarray, width: int, height: int) -> tuple[float, float]:
    """Return where a point of the scene is on a browser's canvas."""
    camera = client.camera
    w, x, y, z = camera.wxyz
    inside = pin.Quaternion(w, x, y, z).matrix().T @ (point - camera.position)
    scale = 0.5 * height / np.tan(0.5 * camera.fov)
    return 0.5 * width + scale * inside[0] / inside[2], 0.5 * height + scale * inside[1] / inside[2]


def test_dragging_the_target(shown):
    with browser() as chromium:
        watched = Watched(chromium, viewport={"width": 900, "height": 600})
        page = watched.page
        page.goto(shown.door.address)
        client = until(shown.clients, "the browser connects", page)[0]
        page.get_by_text("you steer").wait_for()
        page.get_by_text("tracking").first.wait_for()
        until(lambda: client.camera.fov > 0.0, "the camera is told", page)
        tool = MODEL.forward(shown.q)
        # The gizmo keeps its size on the screen: its arrows are hit somewhere along their projection.
        start = np.array(pixel(client, tool.translation, 900, 600))
        ahead = np.array(pixel(client, tool.translation + 0.1 * tool.rotation[:, 2], 900, 600))
        along = (ahead - start) / np.linalg.norm(ahead - start)
        for reach in (60.0, 45.0, 75.0, 30.0, 90.0, 110.0):
            grip = start + reach * along
            page.mouse.move(*grip)
            drawn(page)
            page.mouse.down()
            for step in range(1, 8):
                page.mouse.move(*(grip + 8.0 * step * along))
                drawn(page)
            page.mouse.up()
            drawn(page)
            if shown.drags:
                break
        until(lambda: shown.drags and not shown.drags[-1][1], "the target is let go", page)
        moved = shown.drags[-1][0]
        way, turn = np.linalg.norm(moved.translation - tool.translation), pin.log3(moved.rotation @ tool.rotation.T)
        assert way > 0.005 or np.linalg.norm(turn) > 0.02  # which handle was gripped depends on the view
        assert any(held for _, held in shown.drags)
        assert [e for e in watched.errors if "THREE.Clock" not in e and "GPU stall" not in e] == []
        own = f"http://127.0.0.1:{shown.door.port}/"
        assert all(url.startswith((own, f"blob:{own}", "data:", "ws://127.0.0.1")) for url in watched.requests)


def test_one_steers_the_others_watch(shown):
    with browser() as chromium:
        size = {"width": 500, "height": 700}
        first, second = Watched(chromium, viewport=size).page, Watched(chromium, viewport=size).page
        first.goto(shown.door.address)
        first.get_by_text("you steer").wait_for()
        second.goto(shown.door.address)
        second.get_by_text("another browser steers; you watch").wait_for()
        assert second.get_by_role("button", name="Pause").count() == 0

        first.get_by_role("button", name="Pause").click()
        until(lambda: shown.presses == ["pause"], "the button is told", first)
        second.get_by_role("button", name="Steer here").click()
        second.get_by_text("you steer").wait_for()
        first.get_by_text("another browser steers; you watch").wait_for()

        second.close()  # who steered is gone: nobody does
        first.get_by_text("nobody steers; you watch").wait_for()
        first.get_by_role("button", name="Steer here").click()
        first.get_by_text("you steer").wait_for()


def test_sliders_set_parameters(shown):
    with browser() as chromium:
        page = Watched(chromium, viewport={"width": 700, "height": 900}).page
        page.goto(shown.door.address)
        page.get_by_text("you steer").wait_for()
        box = page.get_by_text("speed scale").locator("xpath=ancestor::*[descendant::input][1]").locator("input").last
        assert float(box.input_value()) == 0.5  # the node's value
        assert shown.settings == []  # showing it sets nothing
        box.fill("0.25")
        box.press("Enter")
        until(lambda: ("velocity_scale", 0.25) in shown.settings, "the slider is told", page)


def test_every_kind_of_obstacle_is_shown(shown):
    world = World()
    world.put("box", box(0.1, 0.2, 0.3))
    world.put("ball", sphere(0.1))
    world.put("capsule", capsule(0.05, 0.4))
    world.put("post", cylinder(0.05, 1.0))
    world.put("table", half_space(np.array([0.0, 0.0, 1.0]), -0.1))
    shown.page.show_obstacles(world)
    assert len(shown.page._obstacles) == 5
    assert shown.page._obstacles[4].position[2] == pytest.approx(-0.105)  # the slab ends where the half-space does
    shown.page.show_obstacles(World())
    assert shown.page._obstacles == []
