"""`gesticulator tune`: search for the best settings of a stage on the validation split (Optuna, extra `tune`).

Trials are recorded in an SQLite file, so an interrupted search resumes, even within a trial: stages are cached in the
work folder as in a training. It suits choices that a validation figure can decide. The quality of motion must be
viewed, and measured by `gesticulator ablate`.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from data_module.errors import InputError
from data_module.files import lock
from gesticulator.cli import Command

if TYPE_CHECKING:
    from data_module.store import Store
    from gesticulator.bundle.config import Config

Value: TypeAlias = int | float | str
Settings: TypeAlias = Mapping[str, Value]
"""Path of a setting -> value."""
SHOWN = 5
"""Number of best trials printed at the end."""


@dataclass(frozen=True)
class SearchRange:
    """The search range of a setting: from low to high (integers if both are; log: uniform in the logarithm), or
    choices."""

    path: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()

    @classmethod
    def parse(cls, text: str) -> SearchRange:
        """PATH=LOW..HIGH, PATH=LOW..HIGH:log or PATH=A,B,C; `InputError` for anything else."""
        path, mark, spec = text.partition("=")
        wrong = InputError(f"--search {text[:60]}", "is not a range", "write PATH=64..256, PATH=1e-4..1e-2:log "
                           "or PATH=a,b")
        if not (path and mark and spec):
            raise wrong
        if ".." not in spec:
            return cls(path, choices=tuple(spec.split(",")))
        span, _, scale = spec.partition(":")
        ends = span.split("..")
        try:
            low, high = map(float, ends)
        except ValueError:
            raise wrong from None
        if not (low < high < float("inf")) or scale not in ("", "log") or (scale and low <= 0):
            raise wrong
        return cls(path, low, high, bool(scale), all(end.strip().lstrip("-").isdecimal() for end in ends))

    def suggested(self, trial: Any) -> Value:
        """Optuna's suggestion in a trial."""
        if self.choices:
            return str(trial.suggest_categorical(self.path, self.choices))
        if self.whole:
            return int(trial.suggest_int(self.path, int(self.low), int(self.high), log=self.log))
        return float(trial.suggest_float(self.path, self.low, self.high, log=self.log))


@dataclass(frozen=True)
class SettingSearch:
    """A search. file: SQLite file with all studies of a work folder; name: of this study; highest: whether to
    maximise."""

    file: Path
    name: str
    ranges: tuple[SearchRange, ...]
    highest: bool = False
    seed: int = 1

    def run(self, objective: Callable[[Settings], float], trials: int) -> list[tuple[float, dict[str, Value]]]:
        """Run until `trials` trials are done, including earlier ones; returns all of them, the best first. A trial
        interrupted by a kill is repeated. `InputError` if another process is searching."""
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        states = optuna.trial.TrialState
        with lock(self.file, "a search", beside=True):
            study = optuna.create_study(storage=f"sqlite:///{self.file}", study_name=self.name, load_if_exists=True,
                                        direction="maximize" if self.highest else "minimize")
            for killed in study.get_trials(states=(states.RUNNING,)):
                study.tell(killed.number, state=states.FAIL)
                study.enqueue_trial(killed.params)
            while len(done := study.get_trials(states=(states.COMPLETE,))) < trials:
                # A new seed per trial: a resumed search would otherwise repeat its first samples.
                study.sampler = optuna.samplers.TPESampler(seed=self.seed + len(done))
                trial = study.ask()
                value = objective({one.path: one.suggested(trial) for one in self.ranges})
                study.tell(trial, value)
            results = [(float(trial.value), dict(trial.params)) for trial in done if trial.value is not None]
        return sorted(results, key=lambda pair: -pair[0] if self.highest else pair[0])


def figure_of(config: Config, store: Store, work: Path, stage: str, figure: str, settings: Settings) -> float:
    """A validation figure of a stage trained under changed settings."""
    from gesticulator.bundle.config import with_settings
    from gesticulator.training.stages import Run, every_stage

    run = Run(with_settings(config, [f"{path}={value}" for path, value in settings.items()]), store, work,
              progress=False, workers=os.cpu_count() or 1)
    run.get(every_stage()[stage])
    figures = run.figures[stage]
    if figure not in figures:
        raise InputError(f"--figure {figure}", f"is not a figure of {stage}", f"choose among {', '.join(figures)}")
    return float(figures[figure])


def _arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--data", required=True, metavar="STORE", help="a store made by gesticulator build")
    p.add_argument("--work", required=True, metavar="DIR", help="work folder for stages and the search")
    p.add_argument("--stage", required=True, metavar="STAGE", help="the stage to train (gesticulator train --list)")
    p.add_argument("--figure", required=True, metavar="NAME", help="the validation figure to optimise, such as nll")
    p.add_argument("--highest", action="store_true", help="maximise the figure instead of minimising it")
    p.add_argument("--search", required=True, action="append", metavar="PATH=RANGE", dest="ranges",
                   help="a setting and its range: LOW..HIGH, LOW..HIGH:log, or A,B,C")
    p.add_argument("--trials", type=int, default=20, metavar="N",
                   help="total number of trials, including earlier ones (default 20)")
    p.add_argument("--preset", default="default", help="the preset to start from")
    p.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", dest="settings",
                   help="change a setting of the preset, for every trial")
    p.add_argument("--seed", type=int, default=1, help="seed of the search (default 1)")


def _run(args: argparse.Namespace) -> int:
    if find_spec("optuna") is None:
        raise InputError("tune", "needs Optuna, which is not installed", "pip install 'gesticulator-extra[tune]'")
    if args.trials < 1 or args.seed < 0:
        raise InputError("--trials or --seed", "is too small", "give 1 trial at least, and a seed of 0 or more")
    ranges = tuple(map(SearchRange.parse, args.ranges))
    from data_module.store import Store
    from gesticulator.bundle.config import digest, with_settings
    from gesticulator.training.presets import preset
    from gesticulator.training.stages import every_stage
    from gesticulator.training.stages.training import claim

    if args.stage not in every_stage():
        raise InputError(f"--stage {args.stage}", "is not a stage", f"choose among {', '.join(every_stage())}")
    config = with_settings(preset(args.preset), args.settings)
    store, work = Store.open(args.data), Path(args.work)
    work.mkdir(parents=True, exist_ok=True)
    key = digest(config, [repr(one) for one in ranges], args.stage, args.figure, args.highest, args.seed)
    with lock(work, "a search"):
        claim(work, store)
        results = SettingSearch(work / "tune.db", key, ranges, args.highest, args.seed).run(
            partial(figure_of, config, store, work, args.stage, args.figure), args.trials)
    print("\n".join(report(results, args.stage, args.figure)), flush=True)
    return 0


def report(results: Sequence[tuple[float, Settings]], stage: str, figure: str) -> list[str]:
    """The best trials, each with its settings as arguments."""
    head = f"{len(results)} trials; {figure} of {stage}, the best first:"
    return [head, *(f"  {value:10.5g}  " + " ".join(f"--set {path}={given}" for path, given in settings.items())
                    for value, settings in results[:SHOWN])]


COMMAND = Command(
    "search for the settings of a stage that are best on the validation split", _arguments, _run,
    examples=("tune --data STORE --work DIR --stage interpreter --figure nll --search schedules.interpreter.rate="
              "1e-4..1e-2:log --trials 20",
              "tune --data STORE --work DIR --stage lexicon --figure quantised --search lexicon.size=25,50,100"))
