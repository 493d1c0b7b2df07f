"""Runs the whole corpus with limits of time and memory: `python tests/hostile/run.py`.

`--only WORD` picks the cases whose names hold it. The exit code is the number of failures, at most
100; the slowest and the largest case end the report.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).parents[1]))

from hostile.corpus import Outcome, Worker, every_case, work


def main() -> int:
    """Runs the cases and prints what failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", help="a part of the names")
    parser.add_argument("--worker", action="store_true", help="for the script itself")
    options = parser.parse_args()
    if options.worker:
        work()
        return 0
    worker, outcomes = Worker(), {}
    for case in every_case():
        if options.only in case.name:
            outcomes[case.name] = found = worker.run(case)
            if found.verdict:
                sys.stdout.write(f"FAILED  {case.name!r}: {found.verdict}\n")
                sys.stdout.flush()
    worker.close()
    return _report(outcomes)


def _report(outcomes: dict[str, Outcome]) -> int:
    bad = sum(bool(found.verdict) for found in outcomes.values())
    seconds = sum(found.seconds for found in outcomes.values())
    sys.stdout.write(f"{len(outcomes)} cases, {bad} failed, {seconds:.0f} s\n")
    for title, field in (("slowest", "seconds"), ("largest", "bytes")):
        name = max(outcomes, key=lambda name: getattr(outcomes[name], field))
        found = outcomes[name]
        size = f"{found.seconds:.1f} s, {found.bytes / 2**30:.2f} GiB"
        sys.stdout.write(f"{title}: {name!r}, {size}\n")
    return min(bad, 100)


if __name__ == "__main__":
    sys.exit(main())
