#!/usr/bin/env bash
# Build this package with colcon from PyPI in a throw-away folder and check what is installed. Needs no ROS.
#   scripts/check_colcon.sh [PYTHON]     PYTHON has the package's dependencies; .venv's unless given
set -euo pipefail
cd "$(dirname "$0")/.."
repo=$PWD
python=$(command -v "${1:-$repo/.venv/bin/python}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() {
    echo "colcon check: $*" >&2
    exit 1
}

pip_install() { "$work/venv/bin/python" -m pip --disable-pip-version-check --quiet install "$@"; }

"$python" -m venv "$work/venv"
pip_install -r scripts/requirements-colcon.txt || { sleep 10; pip_install -r scripts/requirements-colcon.txt; }

colcon() { "$work/venv/bin/colcon" --log-base "$work/log" "$@"; }

# A package.xml that catkin_pkg rejects is silently built as plain Python, which `ros2 run` does not find.
listed=$(colcon list --base-paths "$repo")
grep -q '^ik_controller.*(ros\.ament_python)$' <<<"$listed" || fail "colcon list says: $listed"

colcon build --base-paths "$repo" --build-base "$work/build" --install-base "$work/install" >"$work/output" 2>&1 ||
    { cat "$work/output" >&2; fail "colcon build failed"; }
prefix=$work/install/ik_controller

for file in lib/ik_controller/ik_controller lib/ik_controller/ik_controller_node \
    share/ament_index/resource_index/packages/ik_controller share/ik_controller/package.xml; do
    [ -f "$prefix/$file" ] || fail "not installed: $file"
done
[ -n "$(find "$prefix" -path '*/ik_controller/report/assets/page.html')" ] || fail "not installed: the report's page"
for executable in ik_controller ik_controller_node; do
    [ -x "$prefix/lib/ik_controller/$executable" ] || fail "not executable: $executable"
done
for folder in config bags launch; do
    [ -d "$repo/$folder" ] || fail "the repo has no folder $folder"
    difference=$(diff -r -x __pycache__ "$repo/$folder" "$prefix/share/ik_controller/$folder" 2>&1) ||
        fail "share/ik_controller/$folder differs: $difference"
done

for file in demo arm servo; do
    [ -f "$prefix/share/ik_controller/launch/$file.launch.py" ] || fail "no launch file $file"
    "$python" -m py_compile "$prefix/share/ik_controller/launch/$file.launch.py" || fail "$file.launch.py is no Python"
done

# Run what was installed, from elsewhere, as a sourced workspace runs it.
cd "$work"
set +u
# shellcheck disable=SC1091
source "$work/install/setup.bash"
set -u
found=$("$python" -c 'import ik_controller.share as share; print(share.__file__, share.share_folder())')
[ "${found//$prefix/}" != "$found" ] && [ "${found//$repo\//}" = "$found" ] || fail "the installed tree is not what is used: $found"
"$python" "$prefix/lib/ik_controller/ik_controller" --help >"$work/help" 2>&1 ||
    { cat "$work/help" >&2; fail "the installed ik_controller --help failed"; }
"$python" -c 'import ik_controller.ros.process' || fail "the installed node cannot be imported"
echo "colcon check: ros.ament_python, executables, ament index, package.xml, config, bags and launch are in place"
