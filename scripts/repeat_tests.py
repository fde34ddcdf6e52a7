"""Run tests many times in a row, on a loaded machine if asked for, and count: `make repeat`, or

python scripts/repeat_tests.py --times 20 --load 2 test/ros
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections import Counter

BUSY = [sys.executable, "-c", "while True: pass"]


def main() -> int:
    """Return 0 where no test failed in any round."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tests", nargs="+", help="files, folders or node ids of pytest")
    parser.add_argument("--times", type=int, default=20, help="rounds (20)")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside the tests (0)")
    options = parser.parse_args()
    pytest = [sys.executable, "-m", "pytest", "-q", "-m", "not soak", "-p", "no:cacheprovider", "-rfE", *options.tests]
    failures: Counter[str] = Counter()
    passed = 0
    busy = [subprocess.Popen(BUSY) for _ in range(options.load)]
    try:
        for number in range(1, options.times + 1):
            begin = time.monotonic()
            done = subprocess.run(pytest, capture_output=True, text=True, check=False)
            failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
            if done.returncode not in (0, 1):
                print(done.stdout, done.stderr, file=sys.stderr)
                return 2
            failures.update(failed)
            passed += not failed
            print(
                f"round {number}: {len(failed)} failed, {time.monotonic() - begin:.0f} s {' '.join(failed)}", flush=True
            )
            if failed:
                print(done.stdout, file=sys.stderr, flush=True)
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
