"""Does a speech encoder gain from a second language (RG 7.1.2)? Pre-trained on one against two, in equal steps.

    gesticulator probe two-languages --data STORE --other STORE2 --work DIR [--steps 300]

STORE gives the first language (its English recordings by default, `--language`), STORE2 the second
(`python -m data_module.build performer --languages de ...`). Both encoders have the same seed, size and number of
steps; the second sees both languages, so less of each. The figure is how often the row that did come, 10 to 120 ms
ahead, is told from ten others of the same crop (chance 9.1 %), on test recordings of either language that neither
encoder heard; differences are paired over recordings. The network that sums up what was heard is part of what is
tested, since predictive coding trains it with the encoder.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.speech.speech_encoder import PredictiveCoding
from data_module.store import Store
from eval import stats
from eval.table import Cell, Column, Table
from gesticulator import config as configs
from gesticulator import presets
from gesticulator.config import Config
from gesticulator.fit import generator_for
from gesticulator.stages import Run
from gesticulator.stages.sounds import Crops
from gesticulator.stages.speech import speech_stage

_CROPS = 12
"""Crops of each test recording."""


def names_of(store: Store, split: str, language: str | None = None) -> list[str]:
    """Recordings of a split, and of a language where one is named."""
    return [info.name for info in store.recordings
            if info.split == split and language in (None, info.language)]


def trained(config: Config, store: Store, language: str, other: Store | None, work: Path, progress: bool
            ) -> PredictiveCoding:
    """Predictive coding on one language, or on two where another store is given; kept in `work`."""
    place = work / ("two" if other is not None else "one")
    place.mkdir(parents=True, exist_ok=True)
    more = (_sound_of(other, place),) if other is not None else ()
    run = Run(config, store, place, progress=progress, speech=more)
    held = names_of(store, "val", language) or names_of(store, "train", language)[:1]
    return run.get(speech_stage(lambda run: names_of(store, "train", language), lambda run: held, [language])).eval()


def _sound_of(store: Store, place: Path) -> Path:
    """A folder with links to the training sound of a store, so that its test speech stays unheard."""
    folder = place / f"speech-of-{store.fingerprint[:12]}"
    folder.mkdir(exist_ok=True)
    for name in names_of(store, "train"):
        link = folder / f"{name}.flac"
        if not link.exists():
            link.symlink_to(store.path.resolve() / "recordings" / f"{name}.flac")
    return folder


@torch.inference_mode()
def accuracies(model: PredictiveCoding, store: Store, names: Sequence[str], length: int) -> NDArray[np.float64]:
    """[recordings] percent of rows told right, the mean over steps ahead; the same crops and negatives every time."""
    out = []
    for place, name in enumerate(names):
        crops = Crops.of_store(store, [name], (), length).sample(generator_for(11, place), _CROPS)
        torch.manual_seed(place)
        out.append(100 * float(model.accuracy({"samples": torch.as_tensor(crops)}).mean()))
    return np.array(out)


def figures(config: Config, store: Store, language: str, other: Store, work: Path, progress: bool = True) -> Table:
    """Percent told right by either encoder on either test speech, and two less one."""
    models = {"one": trained(config, store, language, None, work, progress),
              "two": trained(config, store, language, other, work, progress)}
    length = round(3 * config.rhythm.frames * 16000 / config.rhythm.fps)
    second = sorted({info.language for info in other.recordings})
    tests = {language: (store, names_of(store, "test", language)),
             "+".join(second): (other, names_of(other, "test"))}
    rows: dict[str, dict[str, Cell]] = {}
    for title, (source, names) in tests.items():
        values = {name: accuracies(model, source, names, length) for name, model in models.items()}
        rows[title] = {"recordings": len(names), **{key: stats.mean_interval(own) for key, own in values.items()},
                       "two - one": stats.paired(values["two"], values["one"])}
    return table(rows, config.schedules.speech.steps, language, second)


def table(rows: Mapping[str, Mapping[str, Cell]], steps: int, first: str, second: Sequence[str]) -> Table:
    """What is shown."""
    columns = {"recordings": Column("recordings"), "one": Column("one language, right", "%", 1),
               "two": Column("two, right", "%", 1), "two - one": Column("two - one", "%", 1)}
    return Table("A speech encoder of one language or of two", columns, rows, "test speech", [
        f"Encoders pre-trained for {steps} steps on {first}, or on it and {', '.join(second)}."],
        {"steps": steps, "first": first, "second": list(second)})


def arguments(parser: argparse.ArgumentParser) -> None:
    """Two stores and where encoders are trained."""
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--other", required=True, metavar="STORE2")
    parser.add_argument("--work", required=True, metavar="DIR")
    parser.add_argument("--language", default="en")
    parser.add_argument("--preset", default="regression", help="whose speech encoder it is (regression)")
    parser.add_argument("--steps", type=int, default=300)


def run(arguments: argparse.Namespace) -> list[Table]:
    """Train both and compare; InputError for a language that is not there."""
    torch.set_num_threads(1)
    store, other = Store.open(arguments.data), Store.open(arguments.other)
    for split in ("train", "test"):
        if not names_of(store, split, arguments.language):
            raise InputError(store.path, f"has no {arguments.language} recording in its {split} split",
                             "check --language")
    config = configs.with_settings(presets.preset(arguments.preset), [f"schedules.speech.steps={arguments.steps}"])
    return [figures(config, store, arguments.language, other, Path(arguments.work))]
