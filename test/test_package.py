"""Packaging: what is installed and found by checkout and by wheel, and one version everywhere."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import ik_controller
from ik_controller import share
from ik_controller.errors import ModelError

ROOT = Path(__file__).parent.parent
PARTS = ["ik_controller", "config", "bags", "launch", "resource", "package.xml", "setup.py", "setup.cfg",
         "pyproject.toml", "LICENSE"]  # fmt: skip


def run(*command, **options):
    result = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def test_package_xml_is_one_that_colcon_accepts():
    packages = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    package = packages.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    assert not warnings
    assert package.name == "ik_controller"
    assert package.get_build_type() == "ament_python"


def test_one_version_everywhere():
    version = ik_controller.__version__
    xml = (ROOT / "package.xml").read_text(encoding="utf-8")
    assert re.findall(r"<version>(.*?)</version>", xml) == [version]
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    assert re.findall(r'^    version="(.*?)"', setup, re.MULTILINE) == [version]
    changes = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
    assert re.findall(r"^(\d+\.\d+\.\d+)\b.*\n-+$", changes, re.MULTILINE)[0] == version


def test_documented_parameters_are_those_of_the_code():
    page = runpy.run_path(str(ROOT / "scripts" / "make_docs.py"))["page"]()
    assert page == (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8"), "run: make docs"


def test_the_table_of_reasons_is_made_from_the_code():
    text = (ROOT / "docs" / "node.md").read_text(encoding="utf-8")
    assert runpy.run_path(str(ROOT / "scripts" / "make_docs.py"))["node_page"](text) == text, "run `make docs`"


def test_every_direct_dependency_is_pinned_for_every_python():
    markers = pytest.importorskip("packaging.requirements")
    listed = re.search(r"install_requires=\[(.*?)\]", (ROOT / "setup.py").read_text(encoding="utf-8"), re.DOTALL)
    needed = [markers.Requirement(text) for text in re.findall(r'"(.*?)"', listed.group(1))]
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    pins = [markers.Requirement(line) for line in lines if line and not line.startswith("#")]
    for python in ("3.10", "3.11", "3.12", "3.13"):
        for need in needed:
            found = [
                pin
                for pin in pins
                if pin.name.lower() == need.name.lower()
                and (pin.marker is None or pin.marker.evaluate({"python_version": python}))
            ]
            assert len(found) == 1, f"{need.name} on Python {python}: {found}"
            (exact,) = found[0].specifier
            assert exact.operator == "=="
            assert exact.version in need.specifier


def test_checkout_is_found():
    assert share.share_folder() == ROOT
    assert share.robot_names() == ["panda", "ur5e"]
    assert share.robot_folder("panda") == ROOT / "config" / "panda"


def test_unknown_robot_names_the_legal_ones():
    with pytest.raises(ModelError, match=r"unknown robot 'r2d2'.*panda, ur5e"):
        share.robot_folder("r2d2")
    with pytest.raises(ModelError, match="unknown robot"):
        share.robot_folder("../config/panda")


def test_ament_prefix_path_is_found(tmp_path, monkeypatch):
    installed = tmp_path / "prefix" / "share" / "ik_controller"
    (installed / "config" / "robot").mkdir(parents=True)
    (installed / "package.xml").touch()
    module = tmp_path / "elsewhere" / "ik_controller" / "share.py"
    monkeypatch.setattr(share, "__file__", str(module))
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "python"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere{os.pathsep}{tmp_path / 'prefix'}")
    assert share.share_folder() == installed
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(ModelError, match="not installed"):
        share.share_folder()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel built from a copy of the repo, so that nothing is left in it."""
    setuptools = pytest.importorskip("setuptools")
    if tuple(map(int, setuptools.__version__.split(".")[:2])) < (70, 1):
        pytest.importorskip("wheel")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for part in PARTS:
        if (ROOT / part).is_dir():
            shutil.copytree(ROOT / part, source / part, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / part, source / part)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    run(*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source)
    (file,) = folder.glob("*.whl")
    return file


def test_wheel_holds_all_files(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    root = next(name.split("/")[0] for name in names if ".data/" in name)
    data = f"{root}/data/share"
    assert f"{data}/ament_index/resource_index/packages/ik_controller" in names
    for folder in ("config", "bags", "launch"):
        for file in (ROOT / folder).rglob("*"):
            if file.is_file() and "__pycache__" not in file.parts:
                assert f"{data}/ik_controller/{file.relative_to(ROOT)}" in names
    for asset in (ROOT / "ik_controller" / "report" / "assets").iterdir():
        assert str(asset.relative_to(ROOT)) in names
    for module in (ROOT / "ik_controller").rglob("*.py"):
        assert str(module.relative_to(ROOT)) in names, "a folder without __init__.py is left out of wheels"


def test_installed_wheel_finds_its_robots_and_commands(wheel, tmp_path):
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    prefix = tmp_path / "prefix"
    run(*pip, "install", "--no-deps", "--no-index", "--ignore-installed", "--prefix", prefix, wheel)
    (site,) = prefix.glob("**/site-packages")
    environment = {**os.environ, "PYTHONPATH": str(site)}
    code = "import ik_controller.share as s; print(s.__file__, s.share_folder(), s.robot_folder('ur5e'), sep='\\n')"
    found = run(sys.executable, "-c", code, cwd=tmp_path, env=environment).splitlines()
    assert found[0].startswith(str(prefix))
    assert found[1:] == [str(prefix / "share/ik_controller"), str(prefix / "share/ik_controller/config/ur5e")]
    for name in ("ik_controller", "ik_controller_node"):
        assert (prefix / "bin" / name).is_file()
    assert "demo" in run(sys.executable, prefix / "bin" / "ik_controller", "--help", cwd=tmp_path, env=environment)
