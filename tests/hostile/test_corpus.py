"""The fast part of the corpus of hostile inputs; `run.py` runs all of it with limits."""

import importlib

import pytest
from hostile.case import CASES

MODULES = (
    "mutations", "claims", "metadata", "containers", "folders", "arguments", "names", "words",
    "results", "commands",
)  # fmt: skip
for module in MODULES:  # each registers its cases
    importlib.import_module(f"hostile.{module}")


def test_the_corpus_is_large():
    assert len(CASES) >= 500


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=name, marks=[] if case.fast else [pytest.mark.slow])
        for name, case in CASES.items()
    ],
)
def test_case(case, tmp_path, capfd):
    case.run(tmp_path)
    assert not capfd.readouterr().err, "a library spoke"
