"""A complete training: all required stages from a store to a bundle, resumable."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torch import nn

from data_module.errors import InputError
from data_module.files import lock, read_object, write_text
from data_module.store import Store
from gesticulator.bundle.bundle import Bundle, save
from gesticulator.bundle.card import model_card
from gesticulator.bundle.config import Config
from gesticulator.training import distributed
from gesticulator.training import fit as fitting
from gesticulator.training.stages import BLOCKS, CORPUS, STAGES, Run, Stage, assemble, closure, wanted
from gesticulator.training.stages.base import Figures


@dataclass(frozen=True)
class TrainOptions:
    """Options of a training. speech: folders of additional audio for pre-training the speech encoder. redo: stages to
    train again. only: stop after this stage and those that it needs."""

    device: str = "cpu"
    workers: int = 1
    progress: bool = True
    speech: tuple[Path, ...] = ()
    redo: tuple[str, ...] = ()
    only: str | None = None
    precision: str = "float32"
    """See `gesticulator.training.fit.FitOptions`."""
    memory: float | None = None
    """See `gesticulator.training.stages.base.Run`."""


def train(config: Config, store: Store, out: Path, work: Path, options: TrainOptions | None = None) -> Bundle | None:
    """Run all unfinished stages and write the bundle; None if `only` is given. Several processes run it together
    (`gesticulator.training.distributed.joined`).

    InputError if settings and store do not match, or another training has locked the work folder.
    """
    options = options or TrainOptions()
    stages = wanted(config)
    if options.only is not None:
        if STAGES[options.only] not in stages:
            raise InputError(f"--stage {options.only}", "is not part of these settings",
                             "see text, gate and front_end in --set")
        stages = [STAGES[options.only]]
    run = TimedRun(config, store, work, options.device, options.progress and distributed.leads(), options.speech,
                   options.workers, options.precision, options.memory)
    with contextlib.ExitStack() as held:
        processes = distributed.processes()

        def begin() -> None:
            held.enter_context(lock(work, "a training"))
            claim(work, store)
            for stage in closure(stages, config):
                schedule = run.schedule(stage)
                # Each process takes the same number of rows.
                if schedule.batch % processes and schedule.steps:
                    raise InputError(f"schedules.{stage.schedule}.batch={schedule.batch}",
                                     f"cannot be divided among {processes} processes",
                                     "set a batch that is a multiple of the processes")
            for name in options.redo:
                run.redo(STAGES[name])

        distributed.lead(begin)
        run.get(BLOCKS)  # report problems of the store before hours of training
        run.follow(list(closure(stages, config)))
        if options.only is not None:
            return None
        trained = assemble(run, provenance(run))
        distributed.lead(lambda: save(trained, out, model_card(trained)))
        return trained


def claim(work: Path, store: Store) -> None:
    """Assign a work folder to a store; InputError if it belongs to another."""
    record, known = work / "store.json", None
    if record.exists():
        with contextlib.suppress(InputError):  # truncated by a crash: write again
            known = read_object(record, "delete it").get("fingerprint")
    if known not in (None, store.fingerprint):
        raise InputError(store.path, f"is not the store that {work} was started with (its settings or contents "
                         "differ)", "give another --work folder or delete that one")
    if known is None:
        write_text(record, json.dumps({"fingerprint": store.fingerprint}))


def provenance(run: Run) -> dict[str, Any]:
    """The training data, in plain values."""
    store, corpus = run.store, run.get(CORPUS)
    hours = {split: round(float(corpus.durations[corpus.select(split)].sum()) / 3600, 3)
             for split in ("train", "val", "test")}
    return {"store": store.corpus, "fingerprint": store.fingerprint, "licence": store.licence, "seed": store.seed,
            "hours": hours, "blocks": len(corpus.silent), "more_speech": [folder.name for folder in run.speech]}


@dataclass
class TimedRun(Run):
    """A run that prints its progress and an estimate of the remaining time.

    The measured time per step of each stage is stored in the work folder, so a resumed run can estimate more than a
    first one.
    """

    plan: list[Stage[Any]] = field(default_factory=list)

    def follow(self, plan: Sequence[Stage[Any]]) -> None:
        """Run all stages of a plan in turn, printing a line for each."""
        self.plan = list(plan)
        for place, stage in enumerate(self.plan):
            if self.progress:
                print(self.position(place), file=sys.stderr)
            self.get(stage)

    def position(self, place: int) -> str:
        """Progress, such as "stage 3 of 11: lexicon, 2500 steps, about 4 min; after it about 30 min, 2 stages not
        measured"."""
        stage, times = self.plan[place], self.times()
        head = f"stage {place + 1} of {len(self.plan)}: {stage.name}"
        if self.finished(stage):
            return f"{head}, finished before"
        # Only stages that will run count for the estimate.
        rest = [later for later in self.plan[place + 1:] if not self.finished(later)]
        known = [self.schedule(later).steps * times[later.name] for later in rest if later.name in times]
        head += f", {self.schedule(stage).steps} steps"
        if stage.name in times:
            head += f", {about(self.schedule(stage).steps * times[stage.name])}"
        unknown = len(rest) - len(known)
        after = ([about(sum(known))] if known else []) + (
            [f"{unknown} {'stage' if unknown == 1 else 'stages'} not measured yet"] if unknown else [])
        return head + (f"; after it {', '.join(after)}" if after else "")

    def times(self) -> dict[str, float]:
        """Stage -> seconds per step, as last measured in this work folder."""
        with contextlib.suppress(InputError):
            return {name: value for name, value in read_object(self.work / TIMES, "delete it", python=True).items()
                    if isinstance(value, float) and 0 < value < float("inf")}
        return {}

    def fit(self, stage: Stage[Any], model: nn.Module, task: fitting.Task, folder: Path) -> Figures:
        """See `Run.fit`; also records the time per step, including validation and checkpoints."""
        began, steps = time.monotonic(), 0

        def counted(step: int) -> None:
            nonlocal steps
            steps += 1
            if task.before_step is not None:
                task.before_step(step)

        try:
            return super().fit(stage, model, replace(task, before_step=counted), folder)
        finally:
            if steps >= MEASURED and distributed.leads():
                write_text(self.work / TIMES, json.dumps({
                    **self.times(), stage.name: (time.monotonic() - began) / steps}, indent=1))


TIMES = "times.json"
MEASURED = 5
"""Least number of steps for a valid time measurement: the first step is slower."""


def about(seconds: float) -> str:
    """A readable duration, such as "about 4 min"."""
    if seconds < 90:
        return f"about {max(1, round(seconds))} s"
    if seconds < 90 * 60:
        return f"about {round(seconds / 60)} min"
    return f"about {seconds / 3600:.1f} h"
