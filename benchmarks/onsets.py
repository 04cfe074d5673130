"""How well our onsets, found without knowing the future, agree with librosa's onsets of the whole file.

    GESTICULATOR_DATA=... python benchmarks/onsets.py [--out docs/results/onsets.json]

F-measure, precision and recall at 50 ms (mir_eval) on the readings in speech/, librosa at its defaults as the
reference, onsets closer than 50 ms merged on both sides.
"""

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
    intervals = np.diff(find_beats(Speech(samples, SAMPLE_RATE)).times)
    seconds = len(samples) / SAMPLE_RATE
    return {"seconds": seconds, "onsets_per_second": len(ours) / seconds, "librosa_per_second": len(whole) / seconds,
            "f": f, "precision": precision, "recall": recall, "mean_interval": float(intervals.mean())}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "results" / "onsets.json")
    arguments = parser.parse_args()
    readings = sorted((Path(os.environ.get("GESTICULATOR_DATA", "")) / "speech").glob("*.flac"))
    if not readings:
        parser.error("GESTICULATOR_DATA names no folder that holds speech/ with recordings")
    rows = {path.stem: measure(path) for path in readings}
    rows["mean"] = {key: float(np.mean([row[key] for row in rows.values()])) for key in next(iter(rows.values()))}
    rounded = {name: {key: round(value, 4) for key, value in row.items()} for name, row in rows.items()}
    print(json.dumps(rounded, indent=1))
    write_text(arguments.out, json.dumps({"tolerance": TOLERANCE, "rows": rounded}, indent=1) + "\n")


if __name__ == "__main__":
    main()
