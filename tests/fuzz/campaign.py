"""Run the fuzz tests many times over, each batch in an interpreter of its own.

A batch that kills its interpreter is a failure like any other, and is reported with its seed:

    python tests/fuzz/campaign.py --examples 10000
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import mht_slam

FOLDER = Path(__file__).parent
HOUR = 3600.0
MEMORY = 6 * 2**30
"""Bytes that a batch may take: who fills it fails with the example, and is not killed."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--examples", type=int, default=10_000, help="stop after so many")
    parser.add_argument("--seed", type=int, default=0, help="of the first batch")
    parser.add_argument("--times", type=int, default=3, help="ordinary test runs in one batch")
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    done, seed = 0, options.seed
    failures: list[str] = []
    while done < options.examples:
        count, code = run_batch(seed, options.times)
        done += count
        print(f"seed {seed}: {count} examples, exit code {code}; {done} so far", flush=True)
        if code < 0:
            failures.append(f"seed {seed} killed its interpreter by signal {-code}")
        elif code > 0:
            failures.append(f"seed {seed} failed")
        seed += 1
        if count == 0:  # the next batch would do no better
            break
    crashes = sum("signal" in failure for failure in failures)
    print(
        f"mht-slam {mht_slam.__version__}: {done} examples from seeds {options.seed} to "
        f"{seed - 1}, {crashes} crashes, {len(failures) - crashes} other failures"
    )
    print(*failures, sep="\n")
    return 1 if failures or done < options.examples else 0


def run_batch(seed: int, times: int) -> tuple[int, int]:
    """Examples of a batch, and its exit code: minus the signal that killed it, if one did."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider"]
    done = subprocess.run(  # noqa: S603 - our own interpreter and tests
        [*command, str(FOLDER), f"--hypothesis-seed={seed}", "--hypothesis-show-statistics"],
        env=os.environ | {"MHT_SLAM_FUZZ_TIMES": str(times)},
        capture_output=True,
        text=True,
        check=False,
        timeout=HOUR,
    )
    if done.returncode != 0:
        print(done.stdout[-20_000:], done.stderr[-5_000:], sep="\n", flush=True)
    counts = re.findall(r"(\d+) passing, (\d+) failing", done.stdout)
    return sum(int(passing) + int(failing) for passing, failing in counts), done.returncode


if __name__ == "__main__":
    sys.exit(main())
