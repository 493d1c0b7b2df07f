"""The sweep: settings are drawn by Optuna, scored in batches, and reported to Optuna."""

import contextlib
import os
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import optuna
from optuna.distributions import CategoricalDistribution, FloatDistribution
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from mvedge_jax._settings import Setting, of_preset, with_settings
from mvedge_jax.lightfield import LightField

from ._evaluate import Objective, check_objective, evaluate
from ._space import Space
from ._submit import Submit, in_threads

_OWNER, _LOST = "owner", "lost"
# Columns of the rows besides those of scenes and space.
_COLUMNS = ("number", "state", "mean")


class Swept(NamedTuple):
    """A finished sweep.

    Attributes:
        study: the Optuna study with all trials.
        choices: the best setting by path, numbers and static fields, `start` included:
            `EdgeDepth.for_light_field(light_field, preset=preset, choices=choices)` is its model.
        value: mean score of the best setting over the scenes.
        rows: one dictionary per setting: number, state, varied values, the score on each scene and
            their mean.
    """

    study: optuna.Study
    choices: dict[str, Setting]
    value: float
    rows: list[dict[str, Any]]


def sweep(
    scenes: Sequence[str | Path | LightField],
    space: Space,
    *,
    preset: Literal["full", "learned", "edges", "thesis"] = "full",
    start: Mapping[str, Setting] | None = None,
    trials: int = 64,
    batch: int = 4,
    wave: int = 16,
    objective: Objective = "bad_07",
    journal: str | Path | None = None,
    name: str = "sweep",
    sampler: optuna.samplers.BaseSampler | None = None,
    pruner: optuna.pruners.BasePruner | None = None,
    threads: int = 2,
    submit: Submit | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Swept:
    """Searches the setting of an `EdgeDepth` with the least mean score over scenes.

    Optuna draws settings in waves; they are scored scene after scene. Settings that differ in
    traced numbers alone run in batches through one program, which computes stages that no varied
    number reaches once (`batched`); each combination of choices is compiled separately. Between
    scenes the pruner may stop a setting. The result depends on seed, wave and scenes, not on
    `submit`.

    Args:
        scenes: light fields, or their paths, which remote workers need.
        space: the search space.
        preset: of the model, see `EdgeDepth.for_light_field`.
        start: other numbers and static fields, by path; the preset's by default. Varied settings
            start from them if they lie in the intervals of `space`.
        trials: total number of settings, those in `journal` included.
        batch: number of settings per call of the program.
        wave: number of settings drawn at a time; they depend on earlier waves only.
        objective: a field of `DepthScores`, or a jittable function of `DepthResult` and
            `LightField`; smaller is better.
        journal: file of the trials, from which a stopped sweep resumes; processes may share it.
        name: name of the study in the journal.
        sampler: sampler of settings; TPE with seed 0 by default.
        pruner: none by default, such as `optuna.pruners.MedianPruner`.
        threads: number of threads that run batches if `submit` is None, each about one core; use 1
            within context managers of JAX such as `jax.enable_x64`, which affect one thread.
        submit: runs a function elsewhere, as Dask's `Client.submit`; by default in threads.
        progress: called after each wave with the number of settings tried and the best score.

    Returns:
        The best setting and all trials.

    Raises:
        ValueError: there are no scenes, a count is below 1, the objective is unknown, the journal
            holds a sweep over another space, `space` or `start` do not fit the preset's model, or
            no setting had a finite score.
    """
    scenes = list(scenes)
    counts = {"scenes": len(scenes), "trials": trials, "batch": batch, "wave": wave}
    for label, count in {**counts, "threads": threads}.items():
        if count < 1:
            raise ValueError(f"`{label}` must be at least 1, got {count}.")
    check_objective(objective)
    start = dict(start or {})
    model = with_settings(of_preset(preset), start)
    space.check(model)
    run = _Run(dict(zip(_names(scenes), scenes, strict=True)), space, preset, start, objective)
    study = _study(journal, name, sampler, pruner)
    _adopt(study, run)
    if not study.trials and (first := space.start(model)) is not None:
        study.enqueue_trial(first)
    distributions = _distributions(space)
    with in_threads(threads) if submit is None else contextlib.nullcontext(submit) as calls:
        while (left := trials - _finished(study)) > 0:
            asked = [study.ask(distributions) for _ in range(min(wave, left))]
            for trial in asked:
                trial.set_user_attr(_OWNER, _owner())
            _run_wave(study, asked, run, batch, calls)
            if progress is not None:
                progress(_finished(study), _best(study))
    return _swept(study, start)


class _Run(NamedTuple):
    """The common arguments of all settings of a sweep."""

    scenes: dict[str, str | Path | LightField]
    space: Space
    preset: str
    start: dict[str, Setting]
    objective: Objective


def _study(
    journal: str | Path | None,
    name: str,
    sampler: optuna.samplers.BaseSampler | None,
    pruner: optuna.pruners.BasePruner | None,
) -> optuna.Study:
    storage = None
    if journal is not None:
        journal = Path(journal)
        journal.parent.mkdir(parents=True, exist_ok=True)
        try:
            storage = JournalStorage(JournalFileBackend(str(journal)))
        except (IsADirectoryError, ValueError) as reason:
            raise ValueError(
                f"`journal` {journal} must be a journal of Optuna or a new file: {reason}."
            ) from None
    return optuna.create_study(
        study_name=name,
        storage=storage,
        sampler=sampler or optuna.samplers.TPESampler(seed=0, constant_liar=True),
        pruner=pruner or optuna.pruners.NopPruner(),
        load_if_exists=True,
    )


def _adopt(study: optuna.Study, run: _Run) -> None:
    """Refuses the journal of another sweep; enqueues settings of killed processes again."""
    told = {
        "space": repr(_distributions(run.space)),
        "scenes": list(run.scenes),
        "objective": run.objective if isinstance(run.objective, str) else "a function",
        "preset": run.preset,
        "start": run.start,
    }
    for key, value in told.items():
        before = study.user_attrs.get(key)
        if before is None:
            study.set_user_attr(key, value)
        elif before != value:
            raise ValueError(
                f"the journal holds a sweep with {key} {before}, not {value}; name another journal "
                "or another study."
            )
    for trial in study.get_trials(states=(TrialState.RUNNING,)):
        if _alive(trial.user_attrs.get(_OWNER, "")):
            continue
        study.set_user_attr(_LOST, [*_lost(study), trial.number])
        study.tell(trial.number, state=TrialState.FAIL)
        study.enqueue_trial(trial.params)


def _lost(study: optuna.Study) -> list[int]:
    """Unfinished settings of killed processes, which were enqueued again."""
    return study.user_attrs.get(_LOST, [])


def _owner() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


def _alive(owner: str) -> bool:
    """Whether the owning process is alive; one on another machine is assumed to be."""
    host, _, number = owner.partition(":")
    if not number or host != socket.gethostname():
        return bool(number)
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return int(number) != os.getpid()


def _distributions(space: Space) -> dict[str, Any]:
    return {
        **{n: FloatDistribution(i.low, i.high, log=i.log) for n, i in space.numbers.items()},
        **{n: CategoricalDistribution(v) for n, v in space.choices.items()},
    }


def _finished(study: optuna.Study) -> int:
    done = (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
    return len(study.get_trials(deepcopy=False, states=done)) - len(_lost(study))


def _best(study: optuna.Study) -> float:
    done = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
    return min((float(t.value) for t in done if t.value is not None), default=float("nan"))


def _names(scenes: Sequence[str | Path | LightField]) -> list[str]:
    """Names of the scenes in rows and journals, made unique by numbers."""
    names, taken = [], {_OWNER, *_COLUMNS}
    for scene in scenes:
        own = (scene.name if isinstance(scene, LightField) else Path(scene).name) or "scene"
        tries = (own, *(f"{own} ({i})" for i in range(2, len(scenes) + 3)))
        names.append(next(name for name in tries if name not in taken))
        taken.add(names[-1])
    return names


def _run_wave(
    study: optuna.Study, trials: list[optuna.Trial], run: _Run, batch: int, submit: Submit
) -> None:
    """Scores settings scene after scene; the pruner may stop some in between."""
    total, space = {trial.number: 0.0 for trial in trials}, run.space
    for index, (name, scene) in enumerate(run.scenes.items()):
        running = []
        for part in _batches(trials, space, batch):
            rows = np.asarray([[trial.params[n] for n in space.names] for trial in part])
            options = {
                "names": space.names,
                "choices": run.start | {n: part[0].params[n] for n in space.choices},
                "preset": run.preset,
                "objective": run.objective,
                "batch": batch,
            }
            rows = rows.reshape(len(part), len(space.names))
            running.append((part, submit(evaluate, scene, rows, **options)))
        left = []
        for part, future in running:
            for trial, score in zip(part, future.result(), strict=True):
                trial.set_user_attr(name, float(score))
                if not np.isfinite(score):
                    study.tell(trial, state=TrialState.FAIL)
                    continue
                total[trial.number] += float(score)
                trial.report(total[trial.number] / (index + 1), index)
                left.append(trial)
        last = index + 1 == len(run.scenes)
        trials = [] if last else [trial for trial in left if not trial.should_prune()]
        for trial in left:
            if last:
                study.tell(trial, total[trial.number] / len(run.scenes))
            elif trial not in trials:
                study.tell(trial, state=TrialState.PRUNED)


def _batches(
    trials: Sequence[optuna.Trial], space: Space, batch: int
) -> Iterable[list[optuna.Trial]]:
    """Settings that share a program, a few at a time."""
    groups: dict[tuple, list[optuna.Trial]] = {}
    for trial in trials:
        choices = tuple(trial.params[name] for name in space.choices)
        groups.setdefault(choices, []).append(trial)
    for group in groups.values():
        yield from (group[i : i + batch] for i in range(0, len(group), batch))


def _swept(study: optuna.Study, start: dict[str, Setting]) -> Swept:
    rows, lost = [], _lost(study)
    for trial in study.get_trials(deepcopy=False):
        if trial.number in lost or not trial.state.is_finished():
            continue
        scores = {n: trial.user_attrs.get(n) for n in study.user_attrs["scenes"]}
        state = trial.state.name.lower()
        mean = trial.value if trial.state == TrialState.COMPLETE else None
        rows.append(
            {"number": trial.number, "state": state, **trial.params, **scores, "mean": mean}
        )
    if not np.isfinite(_best(study)):
        raise ValueError("no setting had a finite score on every scene.")
    choices = start | study.best_trial.params
    return Swept(study, choices, float(study.best_value), rows)
