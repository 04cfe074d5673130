"""Does a speech encoder gain from a second language (RG 7.1.2)? Pre-trained on one against two, in equal steps.

    python -m eval.two_languages --data STORE --other STORE2 --work DIR [--steps 300] [--out FILE.json]

STORE gives the first language (its English recordings by default, `--language`), STORE2 the second
(`python -m data_module.build performer --languages de ...`). Both encoders have the same seed, size and number of
steps; the second sees both languages, so less of each. The figure is how often the row that did come, 10 to 120 ms
ahead, is told from ten others of the same crop (chance 9.1 %), on test recordings of either language that neither
encoder heard; differences are paired over recordings. The network that sums up what was heard is part of what is
tested, since predictive coding trains it with the encoder.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from data_module.errors import InputError, one_line_errors
from data_module.speech.speech_encoder import PredictiveCoding
from data_module.store import Store
from eval.bootstrap import interval
from eval.results import publish
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


def figures(config: Config, store: Store, language: str, other: Store, work: Path, progress: bool = True
            ) -> dict[str, Any]:
    """The table as plain values: per test language, one, two and two - one."""
    models = {"one language": trained(config, store, language, None, work, progress),
              "two languages": trained(config, store, language, other, work, progress)}
    length = round(3 * config.rhythm.frames * 16000 / config.rhythm.fps)
    second = sorted({info.language for info in other.recordings})
    tests = {language: (store, names_of(store, "test", language)),
             "+".join(second): (other, names_of(other, "test"))}
    out: dict[str, Any] = {"steps": config.schedules.speech.steps, "first": language, "second": second, "tests": {}}
    for title, (source, names) in tests.items():
        values = {name: accuracies(model, source, names, length) for name, model in models.items()}
        out["tests"][title] = {"recordings": len(names), **{k: interval(v).to_dict() for k, v in values.items()},
                               "two - one": interval(values["two languages"] - values["one language"]).to_dict()}
    return out


def markdown(result: dict[str, Any]) -> str:
    """The table for a reader."""
    lines = [f"Encoders pre-trained for {result['steps']} steps on {result['first']}, or on it and "
             f"{', '.join(result['second'])}.", "",
             "| test speech | recordings | one language, % right | two, % right | two - one |", "|---|---|---|---|---|"]
    for title, row in result["tests"].items():
        cells = [f"{row[key]['mean']:.1f} [{row[key]['low']:.1f}, {row[key]['high']:.1f}]"
                 for key in ("one language", "two languages", "two - one")]
        lines.append(f"| {title} | {row['recordings']} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.two_languages", description="One language against two for the speech encoder.")
    p.add_argument("--data", required=True, metavar="STORE")
    p.add_argument("--other", required=True, metavar="STORE2")
    p.add_argument("--work", required=True, metavar="DIR")
    p.add_argument("--language", default="en")
    p.add_argument("--preset", default="default")
    p.add_argument("--steps", type=int, default=300)
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.two_languages"):
        torch.set_num_threads(1)
        store, other = Store.open(arguments.data), Store.open(arguments.other)
        for source, split in ((store, "train"), (store, "test")):
            if not names_of(source, split, arguments.language):
                raise InputError(source.path, f"has no {arguments.language} recording in its {split} split",
                                 "check --language")
        config = presets.preset(arguments.preset)
        speech = dataclasses.replace(config.schedules.speech, steps=arguments.steps)
        config = dataclasses.replace(config, schedules=dataclasses.replace(config.schedules, speech=speech))
        result = figures(config, store, arguments.language, other, Path(arguments.work))
        publish(result, markdown(result), arguments.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
