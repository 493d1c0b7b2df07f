"""The fast part of the corpus of hostile inputs; `run.py` runs all of it with limits."""

import pytest
from hostile.corpus import every_case

CASES = every_case()


def test_the_corpus_is_large():
    assert len(CASES) >= 500


@pytest.mark.parametrize("case", [case for case in CASES if case.fast], ids=lambda case: case.name)
def test_fast(case, tmp_path, capfd):
    case.run(tmp_path)
    assert not capfd.readouterr().err, "a library spoke"


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for case in CASES if not case.fast], ids=lambda c: c.name)
def test_slow(case, tmp_path, capfd):
    case.run(tmp_path)
    assert not capfd.readouterr().err, "a library spoke"
