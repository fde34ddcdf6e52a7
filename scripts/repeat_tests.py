"""Run tests many times in a row, on a loaded machine if asked for, and count: `make repeat`, or

python scripts/repeat_tests.py --times 20 --load 2 test/ros

Each round is a process of its own, forked from this one when the kernels are loaded: that would take seconds each time.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from typing import IO

import pytest

from ik_controller.robots import build_model, bundled_parameters
from ik_controller.session import Session

BUSY = [sys.executable, "-c", "while True: pass"]
OPTIONS = ["-q", "-m", "not soak", "-p", "no:cacheprovider", "-rfE"]


def run_round(tests: list[str], output: IO[bytes]) -> int:
    """Run tests in a child of this process, with what they say in a file; return pytest's exit code."""
    child = os.fork()
    if child == 0:
        for stream in (1, 2):
            os.dup2(output.fileno(), stream)
        code = pytest.main([*OPTIONS, *tests])
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> int:
    """Return 0 where no test failed in any round."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tests", nargs="+", help="files, folders or node ids of pytest")
    parser.add_argument("--times", type=int, default=20, help="rounds (20)")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the tests (0)")
    options = parser.parse_args()
    parameters = bundled_parameters("panda")
    Session(build_model(parameters), parameters).warm_up()
    failures: Counter[str] = Counter()
    passed = 0
    busy = [subprocess.Popen(BUSY) for _ in range(options.load)]
    try:
        for number in range(1, options.times + 1):
            begin = time.monotonic()
            with tempfile.TemporaryFile() as output:
                code = run_round(options.tests, output)
                output.seek(0)
                said = output.read().decode(errors="replace")
            failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
            if code < 0:
                failed.append(f"killed-by-signal-{-code}")
            elif code > 1:  # nothing to repeat
                print(said, file=sys.stderr)
                return 2
            failures.update(failed)
            passed += code == 0
            print(
                f"round {number}: {len(failed)} failed, {time.monotonic() - begin:.0f} s {' '.join(failed)}", flush=True
            )
            if failed:
                print(said, file=sys.stderr, flush=True)
    finally:
        for process in busy:
            process.kill()
            process.wait()
        print(f"{passed} of {options.times} rounds without a failure")
        for name, count in failures.most_common():
            print(f"{count} × {name}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
