"""Peak memory and first-call time of the README's example, of this tree or of another.

    python experiments/benchmarks/readme.py --light-field ../shared/data/hci/cotton [--tree PATH]

The first Python blocks of the README run word for word in a process of their own without any
compilation cache, once up to the gradient and once with it; the light field stands in for "scene".
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from _report import print_table

_HERE = Path(__file__).resolve().parents[2]
# What reads a result waits for it, as an example's reader does.
_VALUE = "\nimport jax\njax.block_until_ready(result)\n"
_GRADIENT = _VALUE + "jax.block_until_ready(gradient)\n"


def example(tree: Path) -> str:
    """The Python blocks of a tree's README up to the one with the gradient."""
    text = (tree / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    last = next(i for i, block in enumerate(blocks) if "gradient = " in block)
    return "\n".join(blocks[: last + 1])


def measured(code: str, tree: Path, folder: Path) -> tuple[float, float]:
    """Seconds and peak GiB of a process that runs `code` in `folder`."""
    plain = {k: v for k, v in os.environ.items() if "CACHE" not in k}
    environment = {**plain, "PYTHONPATH": str(tree), "MVEDGE_CACHE": "off"}
    start = time.perf_counter()
    child = subprocess.Popen([sys.executable, "-c", code], cwd=folder, env=environment)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"the example of {tree} ended with {child.returncode}.")
    return time.perf_counter() - start, usage.ru_maxrss / 2**20


def main() -> None:
    """Runs the example and prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--light-field", type=Path, required=True, help="folder of cotton")
    parser.add_argument("--tree", type=Path, default=_HERE, help="checkout to measure")
    parser.add_argument("--value-only", action="store_true", help="without the gradient")
    options = parser.parse_args()
    whole = example(options.tree)
    cases = {"value": whole.split("\nloss = ")[0] + _VALUE, "with gradient": whole + _GRADIENT}
    if options.value_only:
        del cases["with gradient"]
    rows = []
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "scene").symlink_to(options.light_field.resolve())
        for case, code in cases.items():
            seconds, peak = measured(code, options.tree.resolve(), Path(name))
            rows.append({"example": case, "process, s": seconds, "peak GiB": peak})
    print_table(rows, title=f"README's example of {options.tree}")


if __name__ == "__main__":
    main()
