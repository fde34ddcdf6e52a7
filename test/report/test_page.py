"""The report in a browser: it loads nothing, says what it should, and its slider moves every plot and the arm."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import Watched, browser
from long_run import make_run

from ik_controller.recording.timeline import Lane, collect
from ik_controller.report.page import describe, page, write_page
from ik_controller.report.summary import facts, headline, seconds, si
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
    watched.until("typeof page === 'object' && page.ready")
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


class Extremes:
    """Keeps the smallest and largest value of every signal, taken from every cycle."""

    def begin(self, signals):
        self.names = list(signals.names)
        self.low, self.high = np.full(len(self.names), np.inf), np.full(len(self.names), -np.inf)

    def take(self, rows, states):
        self.low = np.fmin(self.low, np.fmin.reduce(rows, axis=0))
        self.high = np.fmax(self.high, np.fmax.reduce(rows, axis=0))


OPENED = """() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(
  () => done(performance.now()))))"""  # [ms] since the navigation began, when what is in sight was painted
REACTIONS = """async () => {
  const painted = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const slider = document.getElementById('slider'), found = {slider: [], zoom: [], theme: []};
  const timed = async (what, act) => {
    const begin = performance.now();
    act();
    await painted();
    found[what].push(performance.now() - begin);
  };
  for (let k = 0; k < 20; k++) await timed('slider', () => {
    slider.value = Math.round((k * 7 % 20) / 20 * run.rows);
    slider.dispatchEvent(new Event('input'));
  });
  for (let k = 0; k < 3; k++) {
    const from = 0.1 * k * run.duration;
    await timed('zoom', () => page.charts[2].plot.setScale('x', {min: from, max: from + 0.1 * run.duration}));
    await timed('zoom', () => document.getElementById('whole').click());
    await timed('theme', () => document.getElementById('theme').click());
  }
  return found;
}"""


@pytest.mark.parametrize("seconds", [20.0, pytest.param(600.0, marks=pytest.mark.soak)])
def test_a_long_run_stays_small_keeps_its_peaks_and_opens_at_once(seconds, chromium, tmp_path):
    begin = time.monotonic()
    bag = make_run(tmp_path / "run", seconds)
    made = time.monotonic()
    extremes = Extremes()
    collected = collect(bag, sinks=[extremes])
    file = tmp_path / "long.html"
    write_page(collected, file)
    written = time.monotonic()
    assert collected.replay.identical
    assert file.stat().st_size < 15 * MEGABYTE
    watched = Watched(chromium, viewport={"width": 1280, "height": 800})
    watched.page.goto(file.as_uri())
    look = watched.page.evaluate
    painted = look(OPENED)
    watched.until("page.ready")
    complete = look(OPENED)
    assert look("run.bucket") > 1
    assert (
        f"{look('run.rows')} columns of {look('run.bucket')} cycles" in watched.page.locator("#sampling").inner_text()
    )
    for name, low, high in zip(extremes.names, extremes.low, extremes.high, strict=True):
        drawn = "name => columns[name] && ['low', 'high'].map((k) => columns[name][k].filter(Number.isFinite))"
        drawn = look(
            f"(name) => ({drawn})(name)?.map((v, i) => v.reduce((a, b) => i ? Math.max(a, b) : Math.min(a, b)))", name
        )
        if name != "time_s" and not name.startswith(("tool_", "target_")) and np.isfinite(low):
            np.testing.assert_array_equal(np.float32(drawn), np.float32((low, high)), name)
    reactions = look(REACTIONS)
    told = ", ".join(f"{what} {np.median(ms):.0f} ms (at most {max(ms):.0f})" for what, ms in reactions.items())
    print(
        f"\n{seconds:.0f} s at 1 kHz: recorded in {made - begin:.0f} s, reported in {written - made:.0f} s: "
        f"{file.stat().st_size / MEGABYTE:.1f} MB; painted after {painted:.0f} ms, "
        f"what is out of sight after {complete:.0f} ms; reacts: {told}"
    )
    done(watched, file)


def test_a_run_of_the_demos_length_is_below_five_megabytes(tmp_path):
    collected = collect(make_run(tmp_path / "run", 12.6))
    size = len(page(collected).encode())
    assert collected.timeline.envelope.size == 1  # every cycle
    assert size < 5 * MEGABYTE


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
