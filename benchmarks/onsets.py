"""How well our onsets, found without knowing the future, agree with librosa's onsets of the whole file.

    GESTICULATOR_DATA=... python benchmarks/onsets.py [--out docs/results/onsets.json]

F-measure, precision and recall at 50 ms (mir_eval) on the readings in speech/, librosa at its defaults as the
reference, onsets closer than 50 ms merged on both sides.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import librosa
import mir_eval
import numpy as np

from data_module.files import write_text
from data_module.speech.audio import SAMPLE_RATE, load_speech
from data_module.speech.beats import find_beats
from data_module.speech.onsets import detect_onsets, merged
from data_module.types import Speech

TOLERANCE = 0.05


def measure(path: Path) -> dict[str, float]:
    """One recording's row."""
    samples = load_speech(path).samples
    ours = detect_onsets(samples, SAMPLE_RATE)
    whole = merged(librosa.onset.onset_detect(y=samples, sr=SAMPLE_RATE, units="time"), TOLERANCE)
    f, precision, recall = mir_eval.onset.f_measure(whole, ours, window=TOLERANCE)
    intervals = find_beats(Speech(samples, SAMPLE_RATE)).intervals
    seconds = len(samples) / SAMPLE_RATE
    return {"seconds": seconds, "onsets_per_second": len(ours) / seconds, "librosa_per_second": len(whole) / seconds,
            "f": f, "precision": precision, "recall": recall, "mean_interval": float(intervals.mean())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "results" / "onsets.json")
    arguments = parser.parse_args()
    folder = os.environ.get("GESTICULATOR_DATA")
    if not folder:
        parser.error("GESTICULATOR_DATA is not set: it names the folder that holds speech/")
    rows = {path.stem: measure(path) for path in sorted((Path(folder) / "speech").glob("*.flac"))}
    if not rows:
        parser.error("there is no recording in GESTICULATOR_DATA/speech")
    rows["mean"] = {key: float(np.mean([row[key] for row in rows.values()])) for key in next(iter(rows.values()))}
    print(f"{'':16}" + "".join(f"{key:>20}" for key in rows["mean"]))
    for name, row in rows.items():
        print(f"{name:16}" + "".join(f"{value:20.3f}" for value in row.values()))
    rounded = {name: {key: round(value, 4) for key, value in row.items()} for name, row in rows.items()}
    write_text(arguments.out, json.dumps({"tolerance": TOLERANCE, "rows": rounded}, indent=1) + "\n")


if __name__ == "__main__":
    main()
