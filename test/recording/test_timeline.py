"""Signals, their thinning out, and export: against definitions, an independent path, and other readers."""

from __future__ import annotations

import csv
import importlib.util
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ik_controller.control.status import Code, Limit, Status
from ik_controller.kinematics.jacobian import analyse
from ik_controller.messages import cdr
from ik_controller.recording.cycles import Cycle
from ik_controller.recording.envelope import Envelope
from ik_controller.recording.export import CsvSink, ParquetSink
from ik_controller.recording.reader import open_bag
from ik_controller.recording.timeline import Timeline, collect, reasons
from ik_controller.robots import bundled_parameters
from ik_controller.session import Session
from ik_controller.share import bag_folder


@pytest.fixture(scope="module")
def golden(tmp_path_factory):
    """The golden run's timeline, with its CSV and Parquet."""
    folder = tmp_path_factory.mktemp("golden")
    sinks = [CsvSink(folder / "run.csv")]
    if importlib.util.find_spec("pyarrow"):
        sinks.append(ParquetSink(folder / "run.parquet"))
    run = collect(bag_folder("panda_golden"), sinks=sinks)
    for sink in sinks:
        sink.close()
    return run, folder


@given(st.lists(st.integers(1, 60), min_size=1, max_size=12), st.integers(1, 5), st.randoms(use_true_random=False))
def test_an_envelope_keeps_every_peak(lengths, half, random):
    envelope = Envelope(2, 2 * half)
    blocks = []
    for length in lengths:
        block = np.array([[random.gauss(0.0, 1.0), random.gauss(0.0, 1.0)] for _ in range(length)])
        block[np.array([random.random() < 0.2 for _ in range(length)]), 1] = np.nan
        blocks.append(block)
        envelope.take(block, np.array([1 << random.randrange(4) for _ in range(length)]))
    rows = np.vstack(blocks)
    assert len(envelope) == -(-len(rows) // envelope.size) <= 2 * half
    for k in range(len(envelope)):
        bucket = rows[k * envelope.size : (k + 1) * envelope.size]
        np.testing.assert_array_equal(envelope.first[k], bucket[0])
        for column in range(2):
            known = bucket[~np.isnan(bucket[:, column]), column]
            low, high = envelope.low[k, column], envelope.high[k, column]
            assert (low, high) == (known.min(), known.max()) if len(known) else np.isnan([low, high]).all()


def test_signals_are_those_of_the_bag(golden):
    """Positions and errors against the messages as recorded; tool and singular values against the model."""
    run, _ = golden
    timeline = run.timeline
    bag = open_bag(bag_folder("panda_golden"))
    commands = [cdr.decode(cdr.JOINT_STATE, m.data) for m in bag.messages(["/joint_commands"])]
    joints = timeline.session.model.joint_names
    position = np.column_stack([timeline.first(f"{name}_position_rad") for name in joints])
    commanded = np.isfinite(position).all(axis=1)
    np.testing.assert_allclose(position[commanded], [m.position for m in commands], atol=1e-9)
    velocity = np.column_stack([timeline.first(f"{name}_velocity_rad_s") for name in joints])[commanded]
    acceleration = np.column_stack([timeline.first(f"{name}_acceleration_rad_s2") for name in joints])[commanded]
    np.testing.assert_allclose(acceleration[1:], np.diff(velocity, axis=0) / timeline.session.dt, atol=1e-9)
    model = timeline.session.model
    for k in (10, 1000, 2500):
        q = position[commanded][k - 1]  # a cycle starts where the one before ended
        tool = [timeline.first(f"tool_{axis}_m")[commanded][k] for axis in "xyz"]
        np.testing.assert_allclose(tool, model.forward(q).translation, atol=1e-12)
        analysis = analyse(model.jacobian(q))
        assert timeline.first("manipulability")[commanded][k] == pytest.approx(analysis.manipulability)
        assert timeline.first("smallest_singular_value")[commanded][k] == pytest.approx(
            analysis.smallest_singular_value
        )
    errors = run.replay.errors.as_mapping()
    assert np.nanmax(timeline.high("position_error_m")) == pytest.approx(errors["position_max_m"])
    assert np.nanmax(timeline.high("orientation_error_rad")) == pytest.approx(errors["orientation_max_rad"])


def test_csv_and_parquet_hold_every_cycle_bit_for_bit(golden):
    parquet = pytest.importorskip("pyarrow.parquet")
    run, folder = golden
    with (folder / "run.csv").open(encoding="utf-8") as file:
        header, *rows = list(csv.reader(file))
    assert header == [*run.timeline.signals.names, "state"]
    assert len(rows) == run.timeline.cycles == run.replay.cycles
    table = parquet.read_table(folder / "run.parquet")
    assert table.column_names == header
    for number, name in enumerate(header[:-1]):
        values = np.array([float(row[number]) if row[number] else np.nan for row in rows])
        np.testing.assert_array_equal(values, run.timeline.first(name))  # one cycle a bucket: the envelope is all
        np.testing.assert_array_equal(values, table[name].to_numpy())
    assert {row[-1] for row in rows} == {"holding", "tracking"} == set(table["state"].to_pylist())


def test_period_percentiles_and_lanes_are_counted_cycle_by_cycle(panda):
    session = Session(panda.model, panda.parameters)
    random = np.random.default_rng(0)
    late = random.integers(0, 400_000, 9001)

    def cycles():
        for k in range(9001):
            code, limit = (Code.TRACKING, Limit.VELOCITY) if k % 10 == 0 else (Code.HOLDING, Limit.NONE)
            session.status = Status(code, 0.5 if k == 70 else 1.0, limit, 3 if k % 10 == 0 else -1)
            yield Cycle(k, 10**18 + k * 1_000_000, int(late[k]), 1000, None, None)

    timeline = Timeline(capacity=256)
    assert sum(1 for _ in timeline.watch(cycles(), session)) == 9001
    periods = 1000.0 + np.diff(late) * 1e-3
    np.testing.assert_allclose(timeline.period_percentiles(), np.percentile(periods, (50, 99)), atol=0.2)
    assert timeline.longest_period == pytest.approx(periods.max())
    counted = {lane.name: (lane.cycles, lane.least_scale) for lane in timeline.lanes}
    assert counted["holding"] == (8100, 1.0)
    assert counted["velocity limit of 'panda_joint4'"] == (901, 0.5)
    assert len(timeline.envelope) <= 256
    assert np.nanmax(timeline.high("period_s")) == pytest.approx(periods.max() * 1e-6)


def test_memory_does_not_grow_with_the_run(panda):
    def peak(count):
        session = Session(panda.model, panda.parameters)
        timeline = Timeline(capacity=512)
        tracemalloc.start()
        for _ in timeline.watch((Cycle(k, k * 1_000_000, 0, 1000, None, None) for k in range(count)), session):
            pass
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak(40_000) < 1.2 * peak(10_000)


def test_every_reason_of_a_status_is_told():
    names = ("shoulder", "elbow")
    status = Status(Code.TRACKING, 0.4, Limit.VELOCITY, 1, True, 0.01, feasible=False)
    assert reasons(status, names) == [
        ("tracking", False),
        ("velocity limit of 'elbow'", True),
        ("near a singularity, damped", True),
        ("direction not kept within the limits", True),
    ]
    near = Status(Code.TRACKING, 0.4, Limit.OBSTACLE, pair=("hand", "table"))
    assert reasons(near, names)[1] == ("obstacle: hand and table", True)
    assert reasons(Status(Code.NO_FEEDBACK), names) == [("joint states have stopped", True)]
    assert reasons(Status(Code.FAULT, reason="the drive says no"), names)[1] == ("the drive says no", True)


def test_targets_alone_are_run_on_the_ideal_arm(tmp_path: Path):
    run = collect(bag_folder("ur5e_figure_eight"), robot=bundled_parameters("ur5e").replace({"rate": 100.0}))
    assert run.simulated
    assert run.replay.errors.as_mapping()["position_rms_m"] < 1e-3
    assert run.timeline.session.model.n == 6
