"""Whether a refactoring changed any byte: `python benchmarks/golden.py record FILE.json`, then `... compare FILE.json`.

`record` runs the product on fixed inputs and stores the SHA-256 of everything it writes. `compare` runs the same inputs
again, lists each name whose digest differs or is missing, and exits with 1 if there is any. Bits are promised on one
machine only, so the file is recorded from one commit, compared at another, and never committed.

Only the command line and the public names of `gesticulator` are used, so modules may move between the two commits.

    example     the example in every format that can be written here, and looped to over five minutes (done in pieces)
    variation   nine seconds of it with each option of the command, and on two characters
    recording   ten pieces of real speech from $GESTICULATOR_DATA/speech, or of the example where that is absent
    stream      the example in pieces of odd sizes, with pauses, thinking, listening and an interruption
    edit        gesture plans that were edited as JSON and rendered again
    paper       the bundle in the papers' own form: options, words, and a plan rendered again
    clips       loops, masks, layers, keys, faces, and a folder with texts

A name is KIND:GROUP/CASE, such as bvh:edit/swap. `plan:` and `html:` hold what was decided, the others the motion;
`--motion` compares the motion alone, for a change that adds fields to the plan. `--only GROUP` runs one group.
"""

import argparse
import copy
import functools
import hashlib
import io
import json
import os
import platform
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from threadpoolctl import threadpool_limits

import gesticulator
from gesticulator import Gesticulator, InputError, infer

ROOT = Path(__file__).resolve().parents[1]
SPEECH, TEXT = ROOT / "examples" / "speech.flac", ROOT / "examples" / "speech.txt"
SUFFIXES = (".bvh", ".glb", ".vrma", ".usda", ".npz", ".csv", ".json", ".html", ".g1.csv")
"""Formats whose bytes depend on nothing but the input; .fbx, films and .usdc are left out."""
KINDS = {"json": "plan"}
"""Suffix -> kind of a name, where it is not the suffix."""
DECISIONS = ("plan", "html")
"""Kinds that hold the plan, which may gain fields."""
PIECE = 9.2
"""Seconds of the example in which its first two lines are said."""
PIECES = (1, 777, 4800, 0, 12345, 160, 31999)
"""Samples that are fed to a stream at a time, over and over."""
MACHINE = {"processor": platform.processor() or platform.machine(), "python": platform.python_version(),
           "numpy": np.__version__}
"""What bits depend on beside the code."""
Plan = dict[str, Any]

OPTIONS: dict[str, tuple[str, ...]] = {
    "plain": (), "speaker": ("--speaker", "story"), "legs": ("--legs",), "seated": ("--seated",),
    "mirror": ("--mirror",), "small": ("--intensity", ".6"), "large": ("--intensity", "1.5"),
    "activity": ("--activity", ".5"), "still": ("--activity", "0"), "calm": ("--energy", "calm"),
    "lively": ("--energy", "lively"),
    "hold": ("--hold-still", "3.2-5.0"), "cue_time": ("--cue", "2.5=shrug"), "variation": ("--variation", "1"),
    "cql": ("--interpreter", "cql"), "statistical": ("--interpreter", "statistical"),
    "low": ("--hand-height", "low"), "slow": ("--hand-speed", "low", "--hand-radius", ".3"), "seed": ("--seed", "3"),
    "cold": ("--temperature", "0"), "fps": ("--fps", "24"), "gain": ("--gain", "-12"),
    "many": ("--legs", "--mirror", "--energy", "calm", "--cue", "1=wave", "--hold-still", "5-7", "--seed", "9"),
}
"""Case -> options of the command, without words."""
SPOKEN: dict[str, tuple[str, ...]] = {
    "text": (), "text_cql": ("--interpreter", "cql"),
    "cue_word": ("--cue", "voice=wave", "--cue", "screen=point ahead"), "text_legs": ("--legs", "--variation", "2"),
}
"""Case -> options of the command, with words."""


class Golden:
    """Runs cases and collects digests; a case that fails is noted and the others still run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.digests: dict[str, str] = {}
        self.failures: dict[str, str] = {}

    @contextmanager
    def case(self, name: str) -> Iterator[None]:
        """Note what goes wrong within."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - any fault at all is what this program looks for
            self.failures[name] = f"{type(error).__name__}: {error}"

    def add(self, kind: str, case: str, data: bytes) -> None:
        """Note the digest of what a case wrote."""
        name = f"{kind}:{case}"
        if name in self.digests:
            raise ValueError(f"{name} is written twice")
        self.digests[name] = hashlib.sha256(data).hexdigest()

    def infer(self, case: str, *arguments: str | Path, suffixes: Sequence[str] = (".bvh",)) -> Path:
        """Run the command, note the digests of what it writes; the path of its output without the suffix."""
        out = self.folder / case / "out"
        asked = [part for suffix in suffixes for part in ("-o", f"{out}{suffix}")]
        with self.case(case):
            run_command([*map(str, arguments), *asked, "--quiet"])
            for suffix in suffixes:
                last = suffix.rpartition(".")[2]
                name = f"{case}{suffix}" if last == "csv" else case
                self.add(KINDS.get(last, last), name, Path(f"{out}{suffix}").read_bytes())
        return out

    def sound(self, seconds: float) -> Path:
        """The begin of the example as a file."""
        return cut(SPEECH, self.folder / f"begin_{seconds:g}.wav", 0.0, seconds)

    def text(self) -> Path:
        """What is said in the first `PIECE` seconds of the example, with times.

        Times are given because the aligner's decoder adapts to what it aligned before in the same process, so that
        digests would depend on the order of the cases.
        """
        words = "".join(TEXT.read_text(encoding="utf-8").splitlines(keepends=True)[:2]).split()
        step = PIECE / len(words)
        path = self.folder / "begin.json"
        path.write_text(json.dumps([{"word": word, "start": round(i * step, 2), "end": round((i + 0.9) * step, 2)}
                                    for i, word in enumerate(words)]), encoding="utf-8")
        return path


def run_command(arguments: Sequence[str]) -> None:
    """`python -m gesticulator.infer` in this process, which loads the models once; RuntimeError where it fails."""
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            infer.main(arguments)
    except SystemExit as end:
        raise RuntimeError(f"exit code {end.code}: {said.getvalue().strip()}") from None


def cut(source: Path, target: Path, start: float, seconds: float) -> Path:
    """Write a part of a sound file as 16-bit WAV."""
    samples, rate = soundfile.read(source, dtype="int16")
    soundfile.write(target, samples[round(start * rate):round((start + seconds) * rate)], rate, subtype="PCM_16")
    return target


# ------------------------------------------------------------------------------------------------------- the groups

def example(golden: Golden) -> None:
    """Every format that can be written here, the command in a fresh process, and a recording of over five minutes."""
    writable = []
    for suffix in SUFFIXES:
        probe = golden.folder / f"probe{suffix}"
        try:
            gesticulator.Gesticulator.from_pretrained()(golden.sound(1.0)).save(probe)
        except InputError as error:  # what the writer needs is not installed
            print(f"left out: {suffix} ({error})", file=sys.stderr)
        else:
            writable.append(suffix)
    # The only alignment in this process, see `Golden.text`.
    golden.infer("example/text", SPEECH, "--text", TEXT, suffixes=writable)
    golden.infer("example/plain", SPEECH, suffixes=(".bvh", ".json"))
    with golden.case("example/process"):
        out = golden.folder / "process.bvh"
        subprocess.run([sys.executable, "-m", "gesticulator.infer", golden.sound(3.0), "-o", out, "--quiet"],
                       check=True, capture_output=True)
        golden.add("bvh", "example/process", out.read_bytes())
    samples, rate = soundfile.read(SPEECH, dtype="int16")
    soundfile.write(golden.folder / "long.wav", np.tile(samples, 10), rate, subtype="PCM_16")
    golden.infer("example/long", golden.folder / "long.wav", "--fps", "20", suffixes=(".bvh", ".glb"))


def variation(golden: Golden) -> None:
    """Each option of the command, and characters."""
    sound, text = golden.sound(PIECE), golden.text()
    for name, options in OPTIONS.items():
        golden.infer(f"variation/{name}", sound, *options, suffixes=(".bvh", ".json"))
    for name, options in SPOKEN.items():
        golden.infer(f"variation/{name}", sound, "--text", text, *options, suffixes=(".bvh", ".json"))
    figure = golden.infer("variation/figure", golden.sound(3.0), "--legs", suffixes=(".bvh", ".glb"))
    for suffix in (".bvh", ".glb"):
        character = figure.with_suffix(suffix)
        for name, options in {"moved": (), "seated": ("--seated",), "touching": ("--no-contacts", "--mirror")}.items():
            golden.infer(f"variation/character{suffix}_{name}", sound, "--character", character, *options,
                         suffixes=(suffix, ".csv"))


def recording(golden: Golden) -> None:
    """Ten pieces of nine seconds, or all of a recording that is shorter."""
    folder = Path(os.environ.get("GESTICULATOR_DATA", "")) / "speech"
    found = sorted(folder.glob("*.flac"))[:10] if "GESTICULATOR_DATA" in os.environ else []
    starts = [(path, 5.0 if soundfile.info(path).duration > 15 else 0.0) for path in found]
    starts += [(SPEECH, 2.4 * i) for i in range(10 - len(found))]
    for source, start in starts:
        name = f"{source.stem}_{start:g}"
        piece = cut(source, golden.folder / f"{name}.wav", start, 9.0)
        golden.infer(f"recording/{name}", piece, suffixes=(".bvh", ".json"))


class Streamed:
    """Collects what a stream gives."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.frames, self.blocks, self.calls = hashlib.sha256(), hashlib.sha256(), hashlib.sha256()

    def take(self, given: Any) -> None:
        """Note frames and blocks, and how many came at once."""
        for part in (given.rotations, given.root_positions):
            self.frames.update(np.ascontiguousarray(part, dtype="<f8").tobytes())
        for block in given.blocks:
            self.blocks.update(f"{block.start!r} {block.end!r} {block.lexeme} {block.silent}\n".encode())
        self.calls.update(f"{given.first} {len(given.rotations)} {len(given.blocks)}\n".encode())

    def feed(self, samples: Any) -> None:
        """Feed samples in pieces of odd sizes."""
        at = turn = 0
        while at < len(samples):
            size = PIECES[turn % len(PIECES)]
            self.take(self.stream.feed(samples[at:at + size]))
            at, turn = at + size, turn + 1


def conversation(streamed: Streamed, samples: Any, rate: int) -> None:
    """Speak, be interrupted, think, listen, idle, miss some sound, hurry."""
    stream = streamed.stream
    streamed.take(stream.idle(0.7))
    streamed.feed(samples[:round(4.1 * rate)])
    streamed.take(stream.idle(1.3))
    streamed.feed(samples[round(4.1 * rate):round(8.6 * rate)])
    streamed.take(stream.interrupt(stream.made / stream.fps - 0.4))
    streamed.take(stream.idle(0.9))
    streamed.take(stream.think(2.1))
    streamed.take(stream.listen(samples[10 * rate:13 * rate]))
    streamed.feed(samples[14 * rate:17 * rate])
    streamed.take(stream.pass_over(0.8))
    streamed.feed(samples[18 * rate:20 * rate])
    streamed.take(stream.interrupt())
    stream.hurried = True
    streamed.feed(samples[20 * rate:23 * rate])
    stream.hurried = False
    streamed.feed(samples[23 * rate:25 * rate])


def stream(golden: Golden) -> None:
    """The whole example, and conversations, with both latencies and several options."""
    speech = gesticulator.load_speech(SPEECH)
    system, rate = Gesticulator.from_pretrained(), speech.sample_rate
    words = [gesticulator.Word(text, 0.5 + 0.4 * i, 0.8 + 0.4 * i)
             for i, text in enumerate(TEXT.read_text(encoding="utf-8").split()[:20])]
    cases: dict[str, tuple[dict[str, Any], bool]] = {
        "full": ({}, False), "low": ({"latency": "low"}, False), "words": ({"text": True}, False),
        "talk_full": ({}, True), "talk_low": ({"latency": "low", "seed": 5, "legs": True}, True),
        "talk_words": ({"text": True, "latency": "low", "interpreter": "cql"}, True),
        "talk_shaped": ({"intensity": 0.6, "variation": 1, "hold_still": ((2.0, 4.0),)}, True),
        "talk_slow": ({"sample_rate": 22050, "hand_height": "low", "activity": 0.5, "mirror": True}, True),
    }
    for name, (options, talks) in cases.items():
        with golden.case(f"stream/{name}"):
            streamed = Streamed(system.stream(**{"sample_rate": rate, **options}))
            if options.get("text"):
                streamed.stream.add_words(words)
            if talks:
                conversation(streamed, speech.samples, rate)
            else:
                streamed.feed(speech.samples)
            streamed.take(streamed.stream.finish())
            for kind in ("frames", "blocks", "calls"):
                golden.digests[f"{kind}:stream/{name}"] = getattr(streamed, kind).hexdigest()


# ------------------------------------------------------------------------------------------------------------ edits

def blocks(plan: Plan, first: int, count: int = 1, **values: Any) -> None:
    """Set members of some blocks."""
    for block in plan["blocks"][first:first + count]:
        block.update(copy.deepcopy(values))


def draw_again(plan: Plan, first: int, count: int, number: int) -> None:
    """Another variation of some blocks."""
    for block in plan["blocks"][first:first + count]:
        block["draw"]["variation"] = number


def move_beat(plan: Plan, at: int, share: float) -> None:
    """Move the beat at the end of a block by a share of the shorter of its two neighbours."""
    left, right = plan["blocks"][at:at + 2]
    moved = round(left["end"] + share * min(left["end"] - left["start"], right["end"] - right["start"]), 3)
    left["end"] = right["start"] = moved


def join(plan: Plan, at: int) -> None:
    """Delete the beat between a block and the next."""
    plan["blocks"][at]["end"] = plan["blocks"].pop(at + 1)["end"]


def split(plan: Plan, at: int) -> None:
    """Make a beat in the middle of a block."""
    block = plan["blocks"][at]
    second = copy.deepcopy(block)
    block["end"] = second["start"] = round((block["start"] + block["end"]) / 2, 3)
    plan["blocks"].insert(at + 1, second)


def knobs(plan: Plan, **values: Any) -> None:
    """Set knobs."""
    plan["knobs"].update(values)


def cue(plan: Plan, gesture: str, **values: Any) -> None:
    """Ask for a gesture."""
    plan.setdefault("cues", []).append({"gesture": gesture, **values})


def steps(*parts: Callable[[Plan], object]) -> Callable[[Plan], object]:
    """Several edits, one after the other."""
    return lambda plan: [part(plan) for part in parts]


EDITS: dict[str, Callable[[Plan], object]] = {
    "none": lambda plan: None,
    "swap": lambda plan: blocks(plan, 5, lexeme=53),
    "swap_run": lambda plan: blocks(plan, 8, 3, lexeme=174),
    "free": lambda plan: blocks(plan, 6, 2, lexeme=None),
    "silence": lambda plan: blocks(plan, 9, 4, silent=True),
    "wake": lambda plan: blocks(plan, 0, 1, silent=False),
    "variation": lambda plan: draw_again(plan, 7, 2, 3),
    "seed": lambda plan: blocks(plan, 11, draw={"seed": 77, "variation": 0, "block": 4}),
    "small_block": lambda plan: blocks(plan, 4, 3, intensity=0.3),
    "large_block": lambda plan: blocks(plan, 12, intensity=1.7),
    "mirror_block": lambda plan: blocks(plan, 6, 3, mirror=True),
    "locked": steps(lambda plan: blocks(plan, 5, 4, locked=True), lambda plan: knobs(plan, activity=0.4)),
    "locked_mirror": steps(lambda plan: blocks(plan, 2, 6, locked=True), lambda plan: knobs(plan, mirror=True)),
    "move_later": lambda plan: move_beat(plan, 6, 0.25),
    "move_earlier": lambda plan: move_beat(plan, 10, -0.3),
    "join": lambda plan: join(plan, 7),
    "split": lambda plan: split(plan, 1),
    "intensity": lambda plan: knobs(plan, intensity=0.5),
    "activity": lambda plan: knobs(plan, activity=0.5),
    "hold_still": lambda plan: knobs(plan, hold_still=[[2.0, 3.5], [6.0, 7.0]]),
    "energy": lambda plan: knobs(plan, energy="calm"),
    "mirror": lambda plan: knobs(plan, mirror=True),
    "cue_word": lambda plan: cue(plan, "wave", word="voice"),
    "cue_time": lambda plan: cue(plan, "point left", time=4.5, intensity=1.3, mirror=True),
    "cue_lexeme": lambda plan: cue(plan, plan["lexicon"][53]["name"], time=5.5),
    "combined": steps(
        lambda plan: blocks(plan, 3, 2, lexeme=22, intensity=1.4), lambda plan: blocks(plan, 9, locked=True),
        lambda plan: move_beat(plan, 5, 0.2), lambda plan: join(plan, 14), lambda plan: draw_again(plan, 18, 3, 1),
        lambda plan: knobs(plan, intensity=0.8, hold_still=[[7.0, 8.0]]),
        lambda plan: cue(plan, "nod", time=1.5), lambda plan: cue(plan, "shrug", word="gestures")),
}
"""Case -> what is changed in the plan of the first seconds of the example."""


def edit(golden: Golden) -> None:
    """Plans edited as JSON and rendered by the command, and a plan rendered through the library."""
    sound = golden.sound(PIECE)
    both = (".bvh", ".json")
    base = golden.infer("edit/base", sound, "--text", golden.text(), suffixes=both)
    other = golden.infer("edit/other_base", sound, "--interpreter", "cql", "--variation", "1", "--energy", "calm",
                         "--cue", "3=stop", "--hand-height", "high", suffixes=both)
    for name, change in EDITS.items():
        golden.infer(f"edit/{name}", sound, "--plan", changed(golden, base, name, change), suffixes=both)
    for name in ("swap", "join", "energy", "silence", "combined"):
        change = EDITS["locked" if name == "combined" else name]  # that plan has no words to place a cue at
        path = changed(golden, other, f"other_{name}", change)
        golden.infer(f"edit/other_{name}", sound, "--plan", path, "--legs", suffixes=both)
    twice = golden.folder / "edit" / "swap" / "out"
    golden.infer("edit/twice", sound, "--plan", changed(golden, twice, "twice", EDITS["move_later"]), "--mirror",
                 "--intensity", "1.2", suffixes=both)
    with golden.case("edit/library"):
        system = Gesticulator.from_pretrained()
        first = system(sound, text=golden.text(), seed=2, cues=())
        again = system(sound, plan=first.plan(), intensity=0.7)
        golden.add("plan", "edit/library", json.dumps([first.explain(), again.explain()], sort_keys=True).encode())
        for name, made in {"first": first, "again": again}.items():
            golden.add("frames", f"edit/library_{name}", made.rotations.tobytes() + made.positions().tobytes())


def changed(golden: Golden, base: Path, name: str, change: Callable[[Plan], object]) -> Path:
    """The plan that was written beside `base`, edited."""
    plan = json.loads(Path(f"{base}.json").read_text(encoding="utf-8"))
    change(plan)
    path = golden.folder / f"plan_{name}.json"
    path.write_text(json.dumps(plan), encoding="utf-8")
    return path


def paper(golden: Golden) -> None:
    """The papers' own form."""
    sound, text, both = golden.sound(PIECE), golden.text(), (".bvh", ".json")
    for name, options in {"plain": (), "cql": ("--interpreter", "cql"), "statistical": ("--interpreter", "statistical"),
                          "seed": ("--seed", "3"), "still": ("--activity", "0"), "legs": ("--legs",),
                          "text": ("--text", str(text))}.items():
        golden.infer(f"paper/{name}", sound, "--bundle", "paper", *options, suffixes=both)
    base = golden.infer("paper/base", sound, "--bundle", "paper", suffixes=both)
    for name in ("swap", "silence", "move_later"):
        golden.infer(f"paper/edit_{name}", sound, "--bundle", "paper", "--plan",
                     changed(golden, base, f"paper_{name}", EDITS[name]), suffixes=both)


def clips(golden: Golden) -> None:
    """Layouts of a clip, faces, and a folder of recordings."""
    sound, text = golden.sound(PIECE), golden.text()
    for name, options in {"loop": ("--loop",), "keys": ("--keys", "all"), "upper": ("--mask", "upper"),
                          "name": ("--clip-name", "talk"), "lips": ("--face", "lips"),
                          "face": ("--face", "full", "--mood", ".4", "--cue", "2.5=smile"),
                          "face_legs": ("--face", "full", "--legs", "--mouth", "1.5")}.items():
        golden.infer(f"clips/{name}", sound, *options, suffixes=(".glb", ".vrma"))
    golden.infer("clips/face_words", sound, "--text", text, "--face", "full", suffixes=(".glb", ".npz", ".csv"))
    figure = golden.infer("clips/figure", golden.sound(3.0), "--legs", suffixes=(".glb",)).with_suffix(".glb")
    golden.infer("clips/additive", sound, "--character", figure, "--layer", "additive", suffixes=(".glb",))
    folder, texts, out = (golden.folder / name for name in ("talks", "texts", "clips_out"))
    folder.mkdir()
    texts.mkdir()
    for index in range(3):
        cut(SPEECH, folder / f"talk{index}.wav", 3.0 * index, 3.0)
        (texts / f"talk{index}.txt").write_text("you can wave at me\n", encoding="utf-8")
    with golden.case("clips/folder"):
        run_command([str(folder), "-o", f"{out}/", "--preview", f"{out}/", "--text", f"{texts}/", "--manifest",
                     str(out / "manifest.jsonl"), "--quiet"])
        for path in sorted([*out.glob("*.bvh"), *out.glob("*.html")]):
            golden.add(path.suffix[1:], f"clips/folder_{path.stem}", path.read_bytes())


GROUPS = {"example": example, "variation": variation, "recording": recording, "stream": stream, "edit": edit,
          "paper": paper, "clips": clips}


# ---------------------------------------------------------------------------------------------------------- the verbs

def run_groups(names: Iterable[str]) -> Golden:
    """All cases of some groups."""
    with tempfile.TemporaryDirectory() as folder:
        golden = Golden(Path(folder))
        for name in names:
            with golden.case(name):
                GROUPS[name](golden)
    for case, wrong in golden.failures.items():
        print(f"failed: {case}: {wrong}")
    return golden


def record(path: Path, groups: Sequence[str]) -> int:
    """Write the digests; the exit code."""
    golden = run_groups(groups)
    if golden.failures:
        return 1
    path.write_text(json.dumps({"machine": MACHINE, "digests": golden.digests}, indent=1) + "\n", encoding="utf-8")
    print(f"{len(golden.digests)} digests recorded in {path}")
    return 0


def compare(path: Path, groups: Sequence[str], motion: bool) -> int:
    """Print what differs from the recorded digests; the exit code."""
    recorded = json.loads(path.read_text(encoding="utf-8"))
    if recorded["machine"] != MACHINE:
        print(f"recorded with {recorded['machine']}, compared with {MACHINE}: bits may differ")

    def counts(name: str) -> bool:
        kind, _, case = name.partition(":")
        return case.partition("/")[0] in groups and not (motion and kind in DECISIONS)

    before = {name: digest for name, digest in recorded["digests"].items() if counts(name)}
    golden = run_groups(groups)
    now = {name: digest for name, digest in golden.digests.items() if counts(name)}
    wrong = [f"differs: {name}" for name in before if name in now and before[name] != now[name]]
    wrong += [f"missing: {name}" for name in before if name not in now]
    wrong += [f"not recorded: {name}" for name in now if name not in before]
    for line in wrong:
        print(line)
    equal = sum(now.get(name) == digest for name, digest in before.items())
    print(f"{equal} of {len(before)} digests are equal")
    return 1 if wrong or golden.failures else 0


def main() -> int:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    p.add_argument("verb", choices=("record", "compare"))
    p.add_argument("file", type=Path, help="the file of digests")
    p.add_argument("--motion", action="store_true", help="compare the motion, not the plans")
    p.add_argument("--only", choices=tuple(GROUPS), action="append", help="run this group; may be given several times")
    asked = p.parse_args()
    groups = asked.only or list(GROUPS)
    threadpool_limits(1)
    warnings.simplefilter("ignore")
    # Every command shares one set of loaded models.
    Gesticulator.from_pretrained = functools.cache(Gesticulator.from_pretrained)  # type: ignore[method-assign]
    return record(asked.file, groups) if asked.verb == "record" else compare(asked.file, groups, asked.motion)


if __name__ == "__main__":
    sys.exit(main())
