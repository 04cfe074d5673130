"""Run every command and Python block of the first pages as they are written.

`python tests/documented.py [PAGE ...]` (README.md and the guides of `PAGES`) reads the pages of this checkout, makes
a scratch folder with the files that they name, and runs each line in it with the `gesticulator` that is on the PATH: in
`.ci/run full` the one of a wheel in an empty environment. Exit code 1 where a line fails. Nothing of the checkout is
imported; only pages and recordings are read.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("README.md", "docs/index.md", "docs/use.md", "docs/characters.md", "docs/viewer.md", "docs/live.md",
         "docs/train.md")
SECONDS = 1800.0
"""Seconds after which a line counts as hanging."""
SERVERS = ("view", "live", "serve")
"""Verbs that run until they are interrupted."""
LEFT_OUT = {
    r"-m venv|pip install|apt-get|npm ": "sets up a machine",
    r"-m pytest": "is run in a checkout; a wheel has no tests",
    r"benchmarks/": "is run in a checkout; a wheel has no benchmarks",
    r"\.fbx": "needs Blender",
    r"cast\.glb": "needs a file of several characters",
    r"build performer": "needs gesticulator-performer and its data",
    r"train .*after_dropout": "takes hours; training with --preset tiny is run",
    r"acceptance": "needs a store with a test split; --preset tiny has none",
    r"SOURCE|DIR\b|\.\.\.": "names no file",
    r"folder (?!--source toy)|mine|texts from": "names the data of a user",
    r"torchrun": "needs several graphics cards",
    r"bundle push": "needs an account of a hub",
}
"""What a line looks like -> why it is not run here."""
TINY = {r"(train --data store --out bundle)(?= *(#|$))": r"\1 --preset tiny"}
"""What takes hours as it is written -> what is run in its place."""
_FENCE = re.compile(r"^```(sh|python)\n(.*?)^```", re.M | re.S)
_STUBS = """
class microphone:
    sound = __import__("numpy").zeros((20, 4800), "float32")
    left = iter(sound)
    read = staticmethod(lambda: next(microphone.left, None))
class avatar:
    show = staticmethod(lambda pose, at: None)
"""
"""What the example of a stream leaves to the reader."""


@dataclass(frozen=True)
class Example:
    """A command (one line) or a Python block of a page."""

    page: str
    kind: str
    text: str

    @property
    def reason(self) -> str:
        """Why it is not run; "" where it is."""
        if self.kind == "python":
            return ""
        return next((why for pattern, why in LEFT_OUT.items() if re.search(pattern, self.text)), "")


def examples(page: str) -> Iterator[Example]:
    """Those of a page, in order; lines that a backslash continues are joined, commands that `&&` joins are parted."""
    for kind, block in _FENCE.findall((ROOT / page).read_text(encoding="utf-8")):
        if kind == "python":
            yield Example(page, kind, block)
            continue
        for line in block.replace("\\\n", " ").splitlines():
            for command in line.split(" && "):
                if command.strip() and not command.lstrip().startswith("#"):
                    yield Example(page, kind, command.strip())


def prepare(folder: Path) -> None:
    """The files that the pages name: recordings, transcripts and characters."""
    for name in ("speech", "talk"):
        subprocess.run([sys.executable, "-c", _CUT, str(ROOT / "examples" / "speech.flac"), f"{name}.wav"], cwd=folder,
                       check=True)
        (folder / f"{name}.txt").write_text("Good morning everybody, and welcome back to the show.\n")
    for name in ("monday.wav", "tuesday.wav", "recordings/first.wav", "recordings/second.wav"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(folder / "speech.wav", folder / name)
    for name in ("examples", "tests"):
        (folder / name).mkdir()
    shutil.copy(ROOT / "tests" / "toy.py", folder / "tests" / "toy.py")
    for name in ("speech.flac", "speech.txt"):
        shutil.copy(ROOT / "examples" / name, folder / "examples" / name)
    (folder / "texts").mkdir()
    for name in ("first", "second"):
        shutil.copy(folder / "speech.txt", folder / "texts" / f"{name}.txt")
    command = ["gesticulator", "speech.wav", "--legs", "-o", "rig.glb", "-o", "rig.bvh", "--plan-out", "plan.json"]
    subprocess.run(command, cwd=folder, check=True)
    for name in ("avatar.glb", "avatar.vrm", "rig.vrm"):
        shutil.copy(folder / "rig.glb", folder / name)
    for name in ("talk.plan.json", "gesture.json"):
        shutil.copy(folder / "plan.json", folder / name)
    subprocess.run(["gesticulator", "talk.wav", "--plan-out", "talk.plan.json", "--quiet"], cwd=folder, check=True)


_CUT = """
import sys, soundfile
sound, rate = soundfile.read(sys.argv[1])
soundfile.write(sys.argv[2], sound[:8 * rate], rate)
"""


def run(example: Example, folder: Path) -> str:
    """Run one; what went wrong, "" where nothing did."""
    if example.kind == "python":
        return _ended(subprocess.Popen([sys.executable, "-c", _STUBS + example.text], cwd=folder, text=True,
                                       stdout=subprocess.PIPE, stderr=subprocess.STDOUT))
    text = example.text.removeprefix(".venv/bin/")
    for pattern, smaller in TINY.items():
        text = re.sub(pattern, smaller, text)
    # A comment begins after a blank: the # of FILE#NAME is part of a word, which shlex does not see.
    words = shlex.split(re.sub(r"\s#.*", "", text))
    serves = words[0] == "gesticulator" and words[1] in SERVERS
    if serves:
        words += (["--port", "0"] if "--port" not in words else []) + (
            ["--no-browser"] if words[1] != "serve" and "--no-browser" not in words else [])
    process = subprocess.Popen(words, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                               env={**os.environ, "PYTHONUNBUFFERED": "1"})
    if serves:
        assert process.stdout is not None
        late = threading.Timer(SECONDS, process.kill)
        late.start()
        for line in process.stdout:
            if re.search(r"\bready\b", line):  # not the address of /readyz, which comes before
                break
        late.cancel()
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
    return _ended(process)


def _ended(process: subprocess.Popen[str]) -> str:
    try:
        output, _ = process.communicate(timeout=SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        return f"still ran after {SECONDS:g} s"
    return "" if process.returncode == 0 else f"exit code {process.returncode}\n{output[-2000:]}"


def main(pages: list[str]) -> int:
    """Run the pages; exit code 1 where one of their lines failed."""
    # A job that a shell put in the background ignores the interrupt, and so would the servers that it starts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    failed = count = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        prepare(folder)
        for page in pages or PAGES:
            for example in examples(page):
                first = example.text.strip().splitlines()[0][:100]
                if example.reason:
                    print(f"left out  {page}: {first}: {example.reason}", flush=True)
                    continue
                begin = time.monotonic()
                wrong = run(example, folder)
                count, failed = count + 1, failed + bool(wrong)
                print(f"{'FAILED' if wrong else 'ran   '}  {page}: {first} ({time.monotonic() - begin:.0f} s)"
                      + (f"\n{wrong}" if wrong else ""), flush=True)
    print(f"{count} examples run, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
