"""Parameters: every bound, every error text, YAML in both forms, the gain's checks, the documentation's table."""

from __future__ import annotations

import array
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ik_controller import ControllerParameters
from ik_controller.errors import ParameterError
from ik_controller.kinematics import orientation_error
from ik_controller.parameter_file import values_in
from ik_controller.parameters import ORIENTATION_ERRORS, SECTIONS, gain_matrix, specs, table

SPECS = {spec.name: spec for spec in specs()}
BOUNDED = [(s.name, side) for s in SPECS.values() for side in ("low", "high") if getattr(s, side) is not None]


def refused(values) -> str:
    with pytest.raises(ParameterError) as caught:
        ControllerParameters.from_mapping(values)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("name", "side"), BOUNDED)
def test_every_bound_is_taken_itself_and_refused_beyond(name, side):
    bound = getattr(SPECS[name], side)
    beyond = bound * (1 + 1e-9) if side == "high" else (bound * (1 - 1e-9) if bound else -1e-9)
    extra = {"gain": 1.0} if name == "rate" else {}
    taken = getattr(ControllerParameters.from_mapping({name: bound, **extra}), name)
    assert taken in (bound, (bound,))
    text = refused({name: beyond, **extra})
    assert text.startswith(f"{name} = ")
    assert SPECS[name].bounds in text


@pytest.mark.parametrize("name", [s.name for s in SPECS.values() if s.legal])
def test_every_choice_is_taken_and_any_other_refused_with_the_list(name):
    for choice in SPECS[name].legal:
        assert getattr(ControllerParameters.from_mapping({name: choice}), name) == choice
    text = refused({name: "nonsense"})
    assert all(choice in text for choice in SPECS[name].legal)


WRONG = {"bool": ["yes", 1, None], "str": [1, None, ["a"], b"a"], "float": ["1", None, True, [1.0], math.nan, 10**400]}
WRONG["tuple[float, ...]"] = ["1", None, True, [True], ["a"], [math.nan], {1.0: 2.0}, b"1", [[1.0]]]
WRONG["tuple[str, ...]"] = ["a", 1, None, [1], {"a": 1}, b"a"]


@pytest.mark.parametrize("name", SPECS)
def test_every_parameter_refuses_other_types(name):
    for wrong in WRONG[SPECS[name].kind]:
        assert refused({name: wrong}).startswith(f"{name} = ")


@pytest.mark.parametrize("name", [s.name for s in SPECS.values() if s.kind == "float" and s.section != "limits"])
def test_infinity_is_no_number(name):
    assert "finite" in refused({name: math.inf}) or SPECS[name].bounds in refused({name: math.inf})


def test_a_limit_may_be_infinite():
    assert ControllerParameters(velocity_limits=(math.inf, 1.0)).velocity_limits == (math.inf, 1.0)


@pytest.mark.parametrize("name", [s.name for s in SPECS.values() if s.lengths])
def test_lists_of_fixed_length(name):
    lengths = SPECS[name].lengths
    for length in range(max(lengths) + 2):
        if length in lengths:
            values = [50.0] * length if length < 36 else np.eye(6).ravel().tolist()
            assert len(getattr(ControllerParameters.from_mapping({name: values}), name)) == length
        else:
            assert f"got {length}" in refused({name: [50.0] * length})


def test_unknown_names_get_a_suggestion():
    assert "unknown parameter 'gian'; did you mean: gain" in refused({"gian": 1.0})
    assert "did you mean: velocity_scale" in refused({"velocity_scala": 1.0})
    assert all(name in refused({"zzzzzz": 1.0}) for name in SPECS)  # nothing is near: all of them
    assert "unknown parameter '5'" in refused({5: 1.0})
    assert "unknown parameter 'True'" in refused({True: 1.0})


def test_one_number_stands_for_a_list_of_one_and_arrays_for_lists():
    assert ControllerParameters.from_mapping({"gain": 20}).gain == (20.0,)
    for values in ([1, 2, 3, 4, 5, 6], np.arange(1.0, 7.0), array.array("d", range(1, 7)), range(1, 7)):
        assert ControllerParameters.from_mapping({"gain": values}).gain == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def test_values_that_do_not_go_together():
    assert "2 values for 1 locked_joint_names" in refused(
        {"locked_joint_names": ["a"], "locked_joint_values": [1.0, 2.0]}
    )
    late = {"reference_delay": 0.2, "command_timeout": 0.1}
    assert "reference_delay 0.2 s must be below command_timeout 0.1 s" in refused(
        {"reference_mode": "interpolate", **late}
    )
    ControllerParameters.from_mapping(late)  # extrapolating, the delay is not used


# -- the gain


@given(st.lists(st.floats(0.1, 900.0), min_size=6, max_size=6), st.integers(0, 2**32 - 1))
def test_any_positive_definite_gain_below_the_rate_is_taken(rates, seed):
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    matrix = basis @ np.diag(rates) @ basis.T
    np.testing.assert_allclose(gain_matrix(tuple(matrix.ravel()), 1e-3), matrix)
    np.testing.assert_array_equal(gain_matrix(tuple(rates), 1e-3), np.diag(rates))
    np.testing.assert_array_equal(gain_matrix((rates[0],), 1e-3), rates[0] * np.eye(6))


@given(st.lists(st.floats(0.1, 900.0), min_size=6, max_size=6), st.integers(0, 2**32 - 1), st.integers(0, 5))
def test_an_indefinite_or_too_fast_gain_is_refused(rates, seed, index):
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    for wrong, text in (
        (-0.01, "must be positive definite"),
        (0.0, "must be positive definite"),
        (1100.0, "must be ≤ 1"),
    ):
        values = list(rates)
        values[index] = wrong
        if wrong != 0.0:  # zero comes out of a product of matrices as round-off of either sign
            assert text in refused({"gain": (basis @ np.diag(values) @ basis.T).ravel().tolist()})
        assert text in refused({"gain": values})


def test_the_symmetric_part_must_be_positive_definite():
    """Positive eigenvalues alone would let the error grow for a while."""
    matrix = 10.0 * np.eye(6)
    matrix[0, 1] = 100.0
    assert np.linalg.eigvals(matrix).min() > 0.0
    assert "positive definite" in refused({"gain": matrix.ravel().tolist()})


def test_the_gain_is_held_against_the_rate():
    assert "at most 200 1/s" in refused({"gain": 201.0, "rate": 200.0})
    assert ControllerParameters(gain=(200.0,), rate=200.0).gain == (200.0,)
    assert "at most" in refused({"rate": 100.0, "gain": [1.0] * 5 + [100.1]})


# -- files

ROS_FILE = """
/**:
  ros__parameters:
    gain: [1, 2, 3, 4, 5, 6]
    robot: panda
    feed_forward: false
    velocity_scale: 0.5
"""
PLAIN_FILE = "gain: [1, 2, 3, 4, 5, 6]\nrobot: panda\nfeed_forward: false\nvelocity_scale: 0.5\n"


@pytest.mark.parametrize("text", [ROS_FILE, ROS_FILE.replace("/**", "/ns/ik_controller"), PLAIN_FILE])
def test_yaml_in_both_forms(tmp_path, text):
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    expected = ControllerParameters(
        gain=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), robot="panda", feed_forward=False, velocity_scale=0.5
    )
    assert ControllerParameters.from_yaml(file) == expected
    assert ControllerParameters.from_yaml(str(file)) == expected


def test_a_file_of_one_node_and_wildcards_needs_no_name(tmp_path):
    """One fully named node, the wildcards that fit it, and what is nested below a namespace."""
    file = tmp_path / "parameters.yaml"
    file.write_text(
        "/**: {ros__parameters: {gain: 1.0, damping: 0.1}}\n"
        "/other/*: {ros__parameters: {rate: 100.0}}\n"
        "cell: {left: {arm: {ros__parameters: {damping: 0.2}}}}\n"
    )
    assert values_in(file) == {"gain": 1.0, "damping": 0.2}
    assert values_in(file, "/other/arm") == {"gain": 1.0, "damping": 0.1, "rate": 100.0}
    assert values_in(file, "cell/left/arm") == values_in(file)


def test_a_file_of_other_nodes_names_them(tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("/left/arm: {ros__parameters: {gain: 1.0}}\n/right/arm: {ros__parameters: {gain: 2.0}}\n")
    assert values_in(file, "/right/arm") == {"gain": 2.0}
    with pytest.raises(ParameterError, match="has no parameters for /arm; it has: /left/arm, /right/arm"):
        values_in(file, "/arm")


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "holds no parameters"),
        (b"- 1\n- 2\n", "holds no parameters"),
        (b"gain: [1, 2\n", "is not YAML"),
        (b"gain: 1\n---\ngain: 2\n", "is not YAML"),
        (b"\xff\xfe\x00\x01", "cannot be read: not text"),
        (
            b"a: {ros__parameters: {gain: 1}}\nb: {ros__parameters: {gain: 2}}\n",
            "has parameters of 2 nodes, name one: /a, /b",
        ),
        (b"gian: 1\n", "unknown parameter 'gian'; did you mean: gain"),
        (b"5: 1\n", "unknown parameter '5'"),
        (b"on: 1\n", "unknown parameter 'True'"),
        (b"gain: fast\n", "gain = 'fast': need a list"),
        (b"rate: 5000.0\n", "rate = 5000.0: need"),
    ],
)
def test_files_that_hold_no_parameters(tmp_path, content, text):
    file = tmp_path / "parameters.yaml"
    file.write_bytes(content)
    with pytest.raises(ParameterError) as caught:
        ControllerParameters.from_yaml(file)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    for path in (tmp_path / "nowhere.yaml", tmp_path):
        with pytest.raises(ParameterError, match="cannot be read") as caught:
            ControllerParameters.from_yaml(path)
        assert str(path) in str(caught.value)


def test_the_mapping_is_json_and_comes_back_the_same():
    parameters = ControllerParameters(gain=(0.1, 1 / 3, 3, 4, 5, 6), robot="ur5e", posture=(1e-300,), record=False)
    assert ControllerParameters.from_mapping(json.loads(json.dumps(parameters.as_mapping()))) == parameters
    assert ControllerParameters.from_mapping({}) == ControllerParameters()


def test_replace_leaves_the_original_alone():
    original = ControllerParameters()
    assert original.replace({"damping": 0.1}).damping == 0.1
    assert original.damping == 0.05


# -- the documentation


def test_the_table_tells_of_every_parameter():
    text = table()
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    assert len(rows) == len(SPECS)
    for spec, row in zip(
        SPECS.values(), sorted(rows, key=lambda row: list(SPECS).index(row.split("`")[1])), strict=True
    ):
        assert row.startswith(f"| `{spec.name}` |")
        assert row.count("|") == 7
        assert spec.description in row
        assert spec.unit in row
        assert spec.bounds in row
    assert [line[4:].lower() for line in text.splitlines() if line.startswith("### ")] == list(SECTIONS)
    assert all(spec.description.endswith((".", ")")) and spec.section in SECTIONS for spec in SPECS.values())


def test_orientation_errors_are_those_of_the_kinematics():
    assert set(ORIENTATION_ERRORS) == set(orientation_error.ORIENTATION_ERRORS)
    assert ControllerParameters().orientation_error == orientation_error.DEFAULT_ORIENTATION_ERROR
