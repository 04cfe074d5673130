"""What an FBX file costs: python benchmarks/fbx.py [FILE.fbx ...] [--out FILE.json]

`gesticulator infer` brings 12 s of speech onto characters in FBX files and writes FBX: for one recording, and for two,
which share one Blender. Shown are processor time and wall time of the whole command, its start, models and Blender
included, the processor time of each further recording, and the size of the file against that of the character. The
first row is the same recording as BVH, without Blender. Without files, characters of the zoo (`tests/zoo.py`) are
converted, one of them with a mesh four times as fine, too.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from data_module.speech.audio import SAMPLE_RATE, load_speech  # noqa: E402
from eval.table import Column, Provenance, Table, publish  # noqa: E402
from gesticulator.characters.blender import run_in_blender  # noqa: E402
from tests.zoo import ANIMALS, Unavailable, character_file  # noqa: E402

SECONDS, MANY = 12, 2
"""Length of a recording; recordings of a batch."""
CHARACTERS = (("MakeHuman Mixamo, man", 0), ("MakeHuman Rigify DEF, child", 0), ("MakeHuman Mixamo, man", 1))
"""Of the zoo, and how often the edges of their mesh are halved."""
COLUMNS = {"one_wall": Column("one recording, by the clock", "s", 1, "low"),
           "one": Column("processor time", "s", 1, "low"),
           "more": Column("each further one, processor time", "s", 1, "low"),
           "size": Column("character", "MB", 2), "written": Column("written", "MB", 2),
           "ratio": Column("written / character", "", 2, "low")}


def seconds(command: list[str]) -> tuple[float, float]:
    """Wall and processor time of a command with its children. It must succeed."""
    begin, before = time.monotonic(), os.times()
    subprocess.run(command, check=True, capture_output=True)
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return time.monotonic() - begin, used


def row(character: Path | None, speech: Path, folder: Path) -> dict[str, float]:
    """The figures of a character; of none, those of BVH."""
    suffix = ".bvh" if character is None else ".fbx"
    given = [] if character is None else ["--character", str(character)]
    recordings = [folder / f"part{number}.wav" for number in range(MANY)]
    for recording in recordings:
        recording.write_bytes(speech.read_bytes())
    infer = [sys.executable, "-m", "gesticulator", "infer"]
    target = folder / f"one{suffix}"
    wall, used = seconds([*infer, str(speech), *given, "-o", str(target)])
    _, all_used = seconds([*infer, *map(str, recordings), *given, "-o", f"{folder}/many/", "--format",
                                  suffix[1:]])
    out = {"one_wall": wall, "one": used, "more": (all_used - used) / (MANY - 1),
           "written": target.stat().st_size / 1e6}
    if character is not None:
        out["size"] = character.stat().st_size / 1e6
        out["ratio"] = out["written"] / out["size"]
    return out


def converted(folder: Path) -> dict[str, Path]:
    """Name -> FBX file of the characters of the zoo that this machine has."""
    out = {}
    for name, times in CHARACTERS:
        animal = next(animal for animal in ANIMALS if animal.name == name)
        target = folder / f"{name.lower().replace(' ', '_').replace(',', '')}_{times}.fbx"
        try:
            source = character_file(animal)
        except Unavailable as lacking:
            print(f"left out: {name} ({lacking})", flush=True)
            continue
        run_in_blender(source, ROOT / "tests" / "zoo_fbx.py", str(source), str(times), str(target))
        out[name + ("" if times == 0 else f", mesh {4 ** times} times as fine")] = target
    return out


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("files", nargs="*", type=Path, metavar="FILE.fbx", help="characters (default: some of the zoo)")
    p.add_argument("--out", metavar="FILE.json", help="a .md is written beside it")
    a = p.parse_args()
    import soundfile

    with tempfile.TemporaryDirectory() as place:
        folder, speech = Path(place), Path(place) / "speech.wav"
        soundfile.write(speech, load_speech(ROOT / "examples" / "speech.flac").samples[:SECONDS * SAMPLE_RATE],
                        SAMPLE_RATE)
        characters = {path.stem: path for path in a.files} or converted(folder)
        rows = {"BVH, no character": row(None, speech, folder)}
        for name, path in characters.items():
            rows[name] = row(path, speech, folder)
            print(name, rows[name], flush=True)
    load = os.getloadavg()[0]
    publish([Table("FBX files of 12 s of motion", COLUMNS, rows, "character", notes=(
        f"All of `gesticulator infer`, for one recording and for {MANY}. The machine was busy with other work (load "
        f"{load:.1f} at the end): processor time says what the command needs, the clock what was left of it.",),
        facts={"load": load})], a.out,
            Provenance.now(shlex.join(["python", "benchmarks/fbx.py", *sys.argv[1:]])))


if __name__ == "__main__":
    main()
