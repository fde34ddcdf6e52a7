"""The report in a browser: it loads nothing, says what it should, and its slider moves every plot and the arm."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Watched, browser

from ik_controller.control.controller import Step
from ik_controller.control.status import Code, Limit, Status
from ik_controller.recording.replay import Cycle
from ik_controller.recording.timeline import Lane, Timeline, collect
from ik_controller.report.page import describe, page, write_page
from ik_controller.report.summary import facts, headline, seconds, si
from ik_controller.session import Session
from ik_controller.share import bag_folder

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def golden():
    return collect(bag_folder("panda_golden"))


@pytest.fixture(scope="module")
def file(golden, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page(golden, path)
    return path


@pytest.fixture(scope="module")
def chromium():
    with browser() as opened:
        yield opened


def opened(chromium, file, **options):
    """Open the page; its console must stay silent and no request may leave, which the caller checks at its end."""
    watched = Watched(chromium, **{"viewport": {"width": 1280, "height": 800}, **options})
    watched.page.goto(file.as_uri())
    watched.until("typeof page === 'object'")
    return watched


def done(watched, file):
    assert watched.errors == []
    assert watched.requests == [file.as_uri()]
    watched.page.close()


def test_the_page_names_no_other_address(golden):
    text = page(golden)
    script = text[text.index("<style>") :]
    assert not re.findall(r"""(?:src|href)\s*=\s*["']?(?!data:)[a-z]""", text, re.IGNORECASE)
    assert "url(" not in script
    assert "@import" not in script
    assert "default-src 'none'" in text  # and a browser would not let it


def test_the_slider_moves_every_plot_and_the_arm(chromium, file, golden):
    watched = opened(chromium, file)
    look = watched.page.evaluate
    charts = look("page.charts.length")
    assert charts >= 7
    at = "page.charts.map((c) => +c.line.style.transform.match(/[\\d.]+/)[0] / c.plot.over.clientWidth)"
    before, arm = look(at), look("page.scene.canvas.toDataURL()")
    slider = watched.page.locator("#slider")
    slider.fill("2400")
    after = look(at)
    duration = golden.timeline.first("time_s")[-1]
    share = golden.timeline.first("time_s")[2400] / duration
    assert after == pytest.approx([share] * charts, abs=0.01)
    assert all(abs(x - y) > 0.1 for x, y in zip(after, before, strict=True))
    assert look("page.scene.canvas.toDataURL()") != arm
    assert watched.page.locator("#now").text_content() == f"{golden.timeline.first('time_s')[2400]:.3f} s"
    assert watched.page.locator("#state").text_content() == "tracking"
    numbers = watched.page.locator("#chart-position .number").all_text_contents()
    model = golden.timeline.session.model
    expected = [golden.timeline.first(f"{name}_position_rad")[2400] for name in model.joint_names]
    units = {"rad": 1.0, "mrad": 1e-3, "µrad": 1e-6}
    shown = [float(text.split()[0]) * units[text.split()[1]] for text in numbers]
    np.testing.assert_allclose(shown, expected, rtol=6e-3)
    # Moving over one plot moves the others too.
    watched.page.locator("#chart-velocity").evaluate("(e) => e.scrollIntoView({block: 'center'})")
    box = watched.page.locator("#chart-velocity .u-over").bounding_box()
    watched.page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    watched.until("Math.abs(page.now / (run.rows - 1) - 0.25) < 0.02")
    assert look(at) == pytest.approx([0.25] * charts, abs=0.02)
    done(watched, file)


def test_the_arm_is_drawn_where_the_model_puts_it(chromium, file, golden):
    watched = opened(chromium, file)
    model, timeline = golden.timeline.session.model, golden.timeline
    for k in (100, 1500, 2900):
        q = np.array([timeline.first(f"{name}_position_rad")[k] for name in model.joint_names])
        tool = watched.page.evaluate("(k) => framesAt(jointsAt(k)).pop()", k)
        pose = model.forward(q)
        np.testing.assert_allclose(tool[:9], pose.rotation.ravel(), atol=1e-6)
        np.testing.assert_allclose(tool[9:], pose.translation, atol=1e-6)
    done(watched, file)


def test_zoom_play_theme_units_narrow_and_print(chromium, file, tmp_path):
    watched = opened(chromium, file, color_scheme="dark")
    look, tab = watched.page.evaluate, watched.page
    background = "getComputedStyle(document.body).backgroundColor"
    dark = look(background)
    tab.locator("#theme").click()
    assert look(background) != dark
    # Dragging over a plot zooms all of them; the button goes back.
    tab.locator("#chart-position").evaluate("(e) => e.scrollIntoView({block: 'center'})")
    box = tab.locator("#chart-position .u-over").bounding_box()
    tab.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 20)
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 20, steps=4)
    tab.mouse.up()
    ranges = "page.charts.map((c) => c.plot.scales.x.max - c.plot.scales.x.min)"
    whole = look("run.duration")
    watched.until(f"{ranges}.every((r) => r < 0.3 * run.duration)")
    tab.locator("#whole").click()
    watched.until(f"{ranges}.every((r) => r > 0.9 * run.duration)")
    assert whole > 12.0
    # From per cent of the limits to radians.
    axis = "page.charts.find((c) => c.spec.id === 'velocity').unit"
    assert look(axis) == "% of limit"
    tab.locator("#chart-velocity .head button").click()
    assert look(axis) == "rad/s"
    # It plays.
    tab.locator("#slider").fill("0")
    tab.locator("#play").click()
    watched.until("page.now > 20")
    tab.locator("#play").click()
    # A telephone: nothing sticks out to the side.
    tab.set_viewport_size({"width": 390, "height": 800})
    watched.until("document.documentElement.scrollWidth <= 390")
    watched.until("page.charts.every((c) => c.plot.width < 380)")
    # On paper it is light, whatever it was; and afterwards as before.
    tab.locator("#theme").click()
    paper = tab.pdf(format="A4", print_background=True)
    assert paper.startswith(b"%PDF")
    assert look("document.documentElement.dataset.theme") == "dark"
    done(watched, file)


def test_what_the_page_says_is_what_was_found(chromium, file, golden):
    watched = opened(chromium, file)
    text = watched.page.locator("body").inner_text()
    assert headline(golden) in text
    errors = golden.replay.errors.as_mapping()
    assert f"{si(errors['position_rms_m'], 'm')} RMS" in text
    assert "bit-identical" in text or "differs" in text
    for lane in golden.timeline.lanes:
        assert lane.name in text
    for name in ("panda_joint1", "/ik_controller/target_pose", "numpy", "panda_hand_tcp"):
        assert name in text
    done(watched, file)


def long_run(robot, cycles):
    """A run as long as that, made without the law: every signal moves, one cycle in the middle is far out."""
    session = Session(robot.model, robot.parameters)
    timeline = Timeline()
    q0 = robot.home
    random = np.random.default_rng(1).normal(size=(1000, 7))

    def stream():
        for k in range(cycles):
            session.status = Status(Code.TRACKING, 1.0, Limit.NONE, -1, k % 1000 < 5, 0.1)
            error = np.concatenate((1e-6 * random[k % 1000, :3], 1e-6 * random[k % 1000, 3:6]))
            if k == cycles // 2:
                error = np.full(6, 0.01)
            swing = np.sin(0.0007 * k)
            step = Step(q0 + 0.3 * swing, 0.2 * swing + 1e-3 * random[k % 1000], error, session.status)
            yield Cycle(k, k * 1_000_000, int(1e4 * abs(random[k % 1000, 0])), 150_000, step, None)

    for _ in timeline.watch(stream(), session):
        pass
    return timeline


@pytest.mark.parametrize("cycles", [40_000, pytest.param(600_000, marks=pytest.mark.soak)])
def test_a_long_run_stays_small_and_keeps_its_peak(cycles, golden, panda, chromium, tmp_path):
    timeline = long_run(panda, cycles)
    file = tmp_path / "long.html"
    write_page(replace(golden, timeline=timeline), file)
    assert file.stat().st_size < 15 * MEGABYTE
    watched = opened(chromium, file)
    look = watched.page.evaluate
    assert look("run.bucket") > 1
    assert look("Math.max(...columns.position_error_m.high)") == pytest.approx(0.01 * 3**0.5, rel=1e-6)
    assert (
        f"{look('run.rows')} columns of {look('run.bucket')} cycles" in watched.page.locator("#sampling").inner_text()
    )
    moved = watched.page.evaluate("""() => {
      const begin = performance.now();
      for (let k = 0; k < 20; k++) page.show(k * 300);
      return (performance.now() - begin) / 20;
    }""")
    print(f"{cycles} cycles: {file.stat().st_size / MEGABYTE:.1f} MB, {moved:.1f} ms to move the cursor")
    done(watched, file)


def test_a_run_of_the_demos_length_is_below_five_megabytes(golden, panda):
    text = page(replace(golden, timeline=long_run(panda, 12_600)))
    assert len(text.encode()) < 5 * MEGABYTE


def test_text_of_a_bag_cannot_become_code(golden):
    lane = Lane("</script><script>alert(1)</script>", held=True, cycles=1)
    timeline = replace(golden.timeline)
    timeline.__dict__.update(golden.timeline.__dict__)
    timeline.lanes = [*golden.timeline.lanes, lane]
    text = page(replace(golden, timeline=timeline))
    assert "<script>alert" not in text
    content = re.search(r'<script id="content" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert json.loads(content[1])["lanes"][-1]["name"] == lane.name


def test_headline_says_what_held_it_back(golden):
    assert headline(golden).endswith("nothing held it back.")
    timeline = replace(golden.timeline)
    timeline.__dict__.update(golden.timeline.__dict__)
    timeline.lanes = [Lane("tracking", False, 3000), Lane("velocity limit of 'joint4'", True, 1017, 0.45)]
    run = replace(golden, timeline=timeline)
    assert "held back by the velocity limit of 'joint4' for 33 % of the time" in headline(run)
    held = next(fact for fact in facts(run) if fact.name == "Held back by")
    assert held.value == "velocity limit of 'joint4'"
    assert "down to 45 %" in held.text


def test_the_columns_are_as_described(golden):
    content, blob = describe(golden)
    size = sum(len(c["kinds"]) * (8 if c["type"] == "f8" else 4) * content["rows"] for c in content["columns"])
    assert size == len(blob)
    time = np.frombuffer(blob, "<f8", content["rows"])
    np.testing.assert_array_equal(time, golden.timeline.first("time_s"))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0 m"),
        (6.612e-6, "6.61 µm"),
        (0.1519, "152 mm"),
        (9.996e-4, "1.00 mm"),
        (12.345, "12.3 m"),
        (-2e-9, "-2.00 nm"),
    ],
)
def test_numbers_for_people(value, text):
    assert si(value, "m") == text


def test_times_for_people():
    assert [seconds(value) for value in (0.314, 12.204, 603.0)] == ["0.31 s", "12.2 s", "10 min 3 s"]
