"""The one door: its verbs, what is said of those that are broken, and printing that never fails."""

import contextlib
import io
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gesticulator import __version__, cli
from gesticulator.infer import COMMAND
from gesticulator.options import RANGES

HEAVY = {"torch", "numpy", "librosa", "scipy", "sklearn", "transformers", "soundfile", "matplotlib"}

# A package of somebody else's that adds verbs: one that works, one that is no command, and broken ones.
OTHERS = '''
import argparse
from gesticulator.cli import Command

def told(parser): parser.add_argument("--number", type=int, default=7)
def run(asked):
    print("number", asked.number)
    return 3

WORKS = Command("prints a number", told, run, ("works --number 5",))
NO_COMMAND = "infer"
'''


@pytest.fixture
def verbs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Installs verbs by name and entry point value, beside nothing else."""
    (tmp_path / "others_verbs.py").write_text(OTHERS)
    (tmp_path / "broken_verb.py").write_text("import nowhere_to_be_found")
    (tmp_path / "raising_verb.py").write_text("raise RuntimeError('no\\nluck')")
    monkeypatch.syspath_prepend(str(tmp_path))

    def install(**values: str) -> None:
        points = {name: EntryPoint(name, value, "gesticulator.commands") for name, value in values.items()}
        monkeypatch.setitem(vars(cli.VERBS), "points", points)

    yield install
    for name in ("others_verbs", "broken_verb", "raising_verb"):
        sys.modules.pop(name, None)


def test_a_verb_gets_its_arguments_and_gives_its_exit_code(verbs: Callable[..., None],
                                                           capfd: pytest.CaptureFixture[str]) -> None:
    verbs(works="others_verbs:WORKS", infer="gesticulator.infer:COMMAND")
    assert cli.main(["works", "--number", "5"]) == 3
    assert capfd.readouterr().out == "number 5\n"
    assert cli.main(["works"]) == 3
    with pytest.raises(SystemExit) as stop:
        cli.main(["works", "--help"])
    shown = capfd.readouterr().out
    assert stop.value.code == 0 and "gesticulator works --number 5" in shown and "prints a number" in shown


def test_help_lists_the_verbs_on_one_screen_and_tells_of_broken_ones(verbs: Callable[..., None],
                                                                     capfd: pytest.CaptureFixture[str]) -> None:
    verbs(works="others_verbs:WORKS", infer="gesticulator.infer:COMMAND", broken="broken_verb:COMMAND",
          raising="raising_verb:COMMAND", other="others_verbs:NO_COMMAND", lacking="others_verbs:NOWHERE")
    assert cli.main(["--help"]) == 0
    out, error = capfd.readouterr()
    listed = [line.split()[0] for line in out.splitlines() if line.startswith("  ") and "short for" not in line]
    assert listed == ["infer", "works"] and len(out.splitlines()) < 24
    told = error.splitlines()
    assert len(told) == 4, "a line for each"
    assert [name for name in ("broken", "lacking", "other", "raising") if not any(name in line for line in told)] == []
    assert cli.main([]) == 2, "nothing asked is wrong usage"
    assert "nowhere_to_be_found" in error


def test_an_unknown_verb_is_told_and_the_nearest_named(refused: Callable[..., str]) -> None:
    assert "did you mean infer?" in refused("infre")
    assert "is neither a verb nor a file" in refused("zzzz", "--help")


def test_a_recording_without_a_verb_is_inferred_whatever_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                                                  refused: Callable[..., str]) -> None:
    monkeypatch.chdir(tmp_path)
    assert "speech.wav: does not exist" in refused("speech.wav", "-o", "o.bvh")
    (tmp_path / "talk").write_bytes(b"no sound")
    assert "talk: is not sound" in refused("talk", "-o", "o.bvh"), "a file without an ending is not a verb"
    # A file that is called like a verb: the verb is meant, and ./infer is the file.
    (tmp_path / "infer").write_bytes(b"no sound")
    assert "speech: is missing" in refused("infer")
    assert "infer: is not sound" in refused("./infer", "-o", "o.bvh")


def test_the_same_command_by_every_name() -> None:
    helps = [subprocess.run([sys.executable, *way, "--help"], capture_output=True, text=True, timeout=60, check=True
                            ).stdout for way in (["-m", "gesticulator", "infer"], ["-m", "gesticulator.infer"])]
    assert helps[0] == helps[1] and "gesticulator infer SPEECH" in helps[0]
    versions = [subprocess.run([sys.executable, *way, "--version"], capture_output=True, text=True, timeout=60
                               ).stdout for way in (["-m", "gesticulator"], ["-m", "gesticulator.infer"])]
    assert versions == [f"gesticulator {__version__}\n"] * 2


@pytest.mark.parametrize("arguments", [["--help"], ["infer", "--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = ("import sys\nfrom gesticulator import cli\n"
            f"try: cli.main({arguments!r})\nexcept SystemExit: pass\n"
            f"assert not {HEAVY!r} & set(sys.modules), {HEAVY!r} & set(sys.modules)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_every_example_of_infer_is_understood() -> None:
    parser = COMMAND.parser("gesticulator infer")
    for line in COMMAND.examples:
        verb, *arguments = line.split(" < ")[0].split()
        asked = parser.parse_args(arguments)
        assert verb == "infer" and asked.speech


def test_abbreviations_are_refused(refused: Callable[..., str]) -> None:
    assert "--temper" in refused("speech.wav", "-o", "o.bvh", "--temper", "1")


# ------------------------------------------------------------------------------------------------- numbers

@pytest.mark.parametrize(("name", "text"), [
    ("seed", "-1"), ("seed", "1.5"), ("seed", "x"), ("seed", "9" * 5000), ("seed", "1_0"), ("temperature", "nan"),
    ("temperature", "inf"), ("temperature", "-0.1"), ("threads", "0"), ("threads", "1000000000"), ("threads", "-2"),
    ("fps", "nan"), ("fps", "inf"), ("fps", "0"), ("fps", "1e400"), ("activity", "nan"), ("activity", "1.01"),
    ("gain", "inf"), ("gain", "71"), ("activity", ""),
])
def test_numbers_out_of_range_are_refused_before_anything_is_read(name: str, text: str,
                                                                 refused: Callable[..., str]) -> None:
    said = refused("infer", "speech.wav", "-o", "o.bvh", f"--{name}={text}")
    assert said.startswith(f"gesticulator: --{name} ") and RANGES[name].advice in said and len(said) < 200


ODD = ["", " ", "-", "--", ".", "..", "/", "a/", "*", "[", "**/x.wav", "no.wav", "x.bvh", "x.html", "é", "\udce9", "\n",
       "a" * 300, "a" * 5000, "nan", "-1", "1e999", "9" * 5000, "infer", "low", "NUL", "~", "%s", "{0}", "@file",
       "--seed=x"]
FLAGS = ["-o", "--preview", "--explain", "--text", "--gain", "--speaker", "--hand-height", "--activity",
         "--interpreter", "--temperature", "--seed", "--fps", "--bundle", "--threads", "--quiet", "--nothing"]


@given(st.lists(st.sampled_from(ODD + FLAGS), max_size=8))
@settings(max_examples=300)
def test_whatever_is_typed_ends_in_lines_and_code_2(words: list[str]) -> None:
    out, error = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as empty, contextlib.chdir(empty), contextlib.redirect_stdout(out), \
            contextlib.redirect_stderr(error):
        try:
            code = cli.main(["infer", *words])
        except SystemExit as stop:
            code = stop.code
        assert list(Path(empty).iterdir()) == []
    # A line for each recording that cannot be done, and one that sums up.
    assert code == 2 and 1 <= error.getvalue().count("\n") <= len(words) + 2
    assert all(line.startswith("gesticulator: ") for line in error.getvalue().splitlines())


# --------------------------------------------------------------------------------------------------- printing

PRINTING = '''
import argparse, sys
from gesticulator.cli import Command
def run(asked):
    print("caf\\u00e9 \\udcff \\u4f60")
    print("to stderr \\udcff", file=sys.stderr)
    open("opened.txt", "w").write("mine")
    return 0
sys.exit(Command("prints", lambda parser: None, run).main("x", []))
'''


@pytest.mark.parametrize(("encoding", "shown"), [("ascii", b"caf\\xe9 \\udcff \\u4f60\n"),
                                                 ("utf-8", "café \\udcff 你\n".encode())])
def test_what_a_terminal_cannot_show_is_printed_as_an_escape(encoding: str, shown: bytes, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PRINTING], capture_output=True, cwd=tmp_path, timeout=60,
                          env={**os.environ, "PYTHONIOENCODING": encoding})
    assert done.returncode == 0, done.stderr
    assert done.stdout == shown and done.stderr == b"to stderr \\udcff\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_behind_standard_output_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "code.py").write_text(PRINTING)
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run([sys.executable, "code.py"], stdout=full, stderr=subprocess.PIPE, cwd=tmp_path,
                              timeout=60)
    assert done.returncode == 2 and b"No space left" in done.stderr and b"Traceback" not in done.stderr
