"""The main job, as a user calls it: files in, files out, the same bytes every time, and one line for bad input."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import soundfile
from performances import RATE, babble, write_example

from data_module.motion.bvh import read_bvh
from data_module.motion.skeletons import JOINTS
from gesticulator import infer
from gesticulator.gesticulator import Gesticulator


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sound") / "speech.flac"
    soundfile.write(path, babble(8.0), RATE)
    return path


def run(arguments: list[str], tiny_bundle: Path) -> int:
    return infer.main([*arguments, "--bundle", str(tiny_bundle)])


def test_a_recording_becomes_motion_page_and_plan(recording: Path, tiny_bundle: Path, tmp_path: Path,
                                                  capsys: pytest.CaptureFixture[str]) -> None:
    out = {suffix: tmp_path / f"gesture{suffix}" for suffix in (".bvh", ".html", ".json")}
    assert run([str(recording), "-o", str(out[".bvh"]), "--preview", str(out[".html"]), "--explain",
                str(out[".json"])], tiny_bundle) == 0
    motion = read_bvh(out[".bvh"])
    assert motion.skeleton.names == JOINTS or set(motion.skeleton.names) == set(JOINTS)
    assert motion.fps == pytest.approx(60) and motion.duration == pytest.approx(8.0, abs=0.02)
    blocks = json.loads(out[".json"].read_text())["blocks"]
    assert blocks[0]["start"] == 0 and blocks[-1]["end"] == pytest.approx(8.0)
    assert all(a["end"] == b["start"] for a, b in pairwise(blocks))
    assert all(len(b["alternatives"]) == 5 for b in blocks)
    assert any(b["silent"] for b in blocks) and not all(b["silent"] for b in blocks)
    assert '"face":"' in out[".html"].read_text(), "a page shows a face"
    summary = capsys.readouterr().out
    assert summary.count("\n") == 3 and summary.startswith("speech.flac: 8.0 s of sound")
    assert re.search(r" times as fast as real time \([\d.]+ s in all, [\d.]+ s of it to start\) -> ", summary)


def test_the_same_seed_gives_the_same_bytes_in_another_process(recording: Path, tiny_bundle: Path, tmp_path: Path
                                                               ) -> None:
    files = []
    for name in "ab":
        target = tmp_path / f"{name}.bvh"
        subprocess.run([sys.executable, "-m", "gesticulator.infer", str(recording), "-o", str(target), "--bundle",
                        str(tiny_bundle), "--temperature", "1", "--seed", "3", "--quiet"], check=True)
        files.append(target.read_bytes())
    assert files[0] == files[1]
    run([str(recording), "-o", str(tmp_path / "c.bvh"), "--temperature", "1", "--seed", "4"], tiny_bundle)
    assert (tmp_path / "c.bvh").read_bytes() != files[0]


LIGHT = """
import sys
from pathlib import Path
sys.modules.update(dict.fromkeys(("torch", "librosa", "numba", "sklearn", "transformers")))
from gesticulator import Gesticulator, infer
sound, out = map(Path, sys.argv[1:])
infer.main([str(sound), "-o", str(out / "light.bvh"), "--quiet"])
# A third of the memory and an eighth of the time of a short recording would be scipy's.
assert not [name for name in sys.modules if name.startswith(("scipy.s", "scipy.i", "scipy.n", "scipy.f"))]

from data_module.speech.audio import load_speech
speech = load_speech(sound)
stream = Gesticulator.from_pretrained().stream(speech.sample_rate)
(out / "frames").write_text(str(len(stream.feed(speech.samples)) + len(stream.finish())))

from gesticulator.jobs import run_settings_of
from gesticulator.page.command import COMMAND, _job, _prepare
from gesticulator.page.server import PageServer
args = COMMAND.parser("gesticulator view").parse_args([str(sound), "--face", "full"])
with PageServer() as server:
    _prepare(server, _job(args), run_settings_of(args))
    (out / "page.html").write_bytes(server.page)
"""


def test_what_is_played_needs_nothing_that_only_training_takes(tmp_path: Path) -> None:
    sound = write_example(tmp_path / "talk.flac", 4.0)
    subprocess.run([sys.executable, "-c", LIGHT, str(sound), str(tmp_path)], check=True)
    performance = Gesticulator.from_pretrained()(sound)
    assert len(performance.motion) == int((tmp_path / "frames").read_text())
    performance.save(tmp_path / "heavy.bvh")
    assert (tmp_path / "light.bvh").read_bytes() == (tmp_path / "heavy.bvh").read_bytes()
    assert (tmp_path / "page.html").read_text().rstrip().endswith("</html>")


def test_the_shortest_recording_and_pure_silence_give_a_person_at_rest(tiny_bundle: Path, tmp_path: Path) -> None:
    soundfile.write(tmp_path / "short.wav", babble(0.3), RATE)
    soundfile.write(tmp_path / "silence.wav", np.zeros(RATE * 20, np.float32), RATE)
    for name in ("short", "silence"):
        assert run([str(tmp_path / f"{name}.wav"), "-o", str(tmp_path / f"{name}.bvh")], tiny_bundle) == 0
    assert len(read_bvh(tmp_path / "short.bvh")) == 18
    system = Gesticulator.from_pretrained(tiny_bundle)
    made = system(str(tmp_path / "silence.wav"))
    assert made.blocks.silent.all() and set(made.lexemes.tolist()) <= set(system.bundle.silent.tolist())


def bad_files(folder: Path) -> dict[str, Path]:
    (folder / "empty.wav").write_bytes(b"")
    (folder / "text.wav").write_text("this is not sound\n" * 50)
    soundfile.write(folder / "zero.wav", np.zeros(0, np.float32), RATE)
    sound = babble(1.0)
    sound[100] = np.nan
    soundfile.write(folder / "nan.wav", sound, RATE, subtype="FLOAT")
    return {name: folder / f"{name}.wav" for name in ("missing", "empty", "text", "zero", "nan")} | {
        "directory": folder}


@pytest.mark.parametrize("name", ["missing", "empty", "text", "zero", "nan", "directory"])
def test_bad_recordings(name: str, tiny_bundle: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    source = bad_files(tmp_path)[name]
    before = set(tmp_path.iterdir())
    assert str(source) in refused("infer", source, "-o", tmp_path / "o.bvh", "--preview", tmp_path / "o.html",
                                  "--bundle", tiny_bundle)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("arguments", "said"), [
    (["--speaker", "nobody"], "nobody"), (["--bundle", "nowhere"], "nowhere"), (["--fps", "0"], "fps"),
    (["--temperature", "-1"], "temperature"), (["-o", "o.max"], ".bvh"),
    (["--explain", "o.txt"], ".json"), (["--activity", "2"], "--activity 2"), (["--activity", "nan"], "--activity"),
    (["--hand-height", "sky"], "--hand-height"), (["--hand-speed", "-1"], "--hand-speed"),
    (["--hand-radius", "nowhere.csv"], "nowhere.csv"), (["--text", "nowhere.txt"], "nowhere.txt"),
])
def test_bad_arguments(arguments: list[str], said: str, recording: Path, tiny_bundle: Path, tmp_path: Path,
                       refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refused("infer", recording, "-o", "o.bvh", "--bundle", tiny_bundle, *arguments)
    assert list(tmp_path.iterdir()) == []


# ---------------------------------------------------------------------------------------------- batches

@pytest.fixture
def talks(tmp_path: Path) -> Path:
    """A folder of three recordings, of which b.wav is too short."""
    folder = tmp_path / "talks"
    folder.mkdir()
    for seed, name in enumerate(("a.flac", "b.wav", "c.wav")):
        soundfile.write(folder / name, babble(1.0, seed=seed), RATE)
    (folder / "b.wav").write_bytes((folder / "b.wav").read_bytes()[:4_000])
    return folder


def test_one_bad_recording_of_a_folder_is_told_and_the_rest_is_done(
        talks: Path, tiny_bundle: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert run([str(talks), "-o", f"{tmp_path / 'new' / 'out'}/"], tiny_bundle) == 1
    out, error = capfd.readouterr()
    assert sorted(path.name for path in (tmp_path / "new" / "out").iterdir()) == ["a.bvh", "c.bvh"]
    told = error.splitlines()
    assert len(told) == 2 and "b.wav: lasts 0.12 s, too short" in told[0]
    assert told[1] == "gesticulator: 2 of 3 recordings done, 1 failed"
    assert [line.split(":")[0] for line in out.splitlines()] == ["a.flac", "c.wav"]
    # In a batch a recording makes the bytes that it makes alone, whatever failed before it.
    assert run([str(talks / "c.wav"), "-o", str(tmp_path / "alone.bvh"), "--quiet"], tiny_bundle) == 0
    assert (tmp_path / "alone.bvh").read_bytes() == (tmp_path / "new" / "out" / "c.bvh").read_bytes()


def test_the_threads_of_the_environment_change_no_bit(recording: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    made = []
    for threads in ("1", "3"):
        target = tmp_path / f"{threads}.json"
        subprocess.run([sys.executable, "-m", "gesticulator.infer", str(recording), "--explain", str(target), "-o",
                        str(tmp_path / "o.bvh"), "--bundle", str(tiny_bundle), "--quiet"], check=True,
                       env={**os.environ, "OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads})
        made.append((target.read_bytes(), (tmp_path / "o.bvh").read_bytes()))
    assert made[0] == made[1]


def test_a_recording_from_standard_input(recording: Path, tiny_bundle: Path, tmp_path: Path) -> None:
    asked = ["--bundle", str(tiny_bundle), "--fps", "20"]
    done = subprocess.run([sys.executable, "-m", "gesticulator", "-", "-o", f"{tmp_path}/", *asked], check=True,
                          input=recording.read_bytes(), capture_output=True)
    assert done.stdout.startswith(b"standard input: 8.0 s")
    infer.main([str(recording), "-o", str(tmp_path / "file.bvh"), *asked, "--quiet"])
    assert (tmp_path / "stdin.bvh").read_bytes() == (tmp_path / "file.bvh").read_bytes()


def test_a_nearly_silent_recording_is_told_with_the_gain_that_helps(
        recording: Path, tiny_bundle: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    samples, rate = soundfile.read(recording, dtype="float32")
    soundfile.write(tmp_path / "faint.wav", samples * 10 ** (-46 / 20), rate, subtype="FLOAT")
    asked = [str(tmp_path / "faint.wav"), "-o", str(tmp_path / "o.bvh"), "--quiet"]
    assert run(asked, tiny_bundle) == 0
    told = capfd.readouterr().err
    assert told.count("\n") == 1 and told.startswith("gesticulator: warning: faint.wav: ")
    gain = told.split("--gain ")[1].split(")")[0]
    assert run([*asked, "--gain", gain], tiny_bundle) == 0
    assert capfd.readouterr().err == "", "the gain that was named is enough"
    assert run([str(recording), *asked[1:]], tiny_bundle) == 0
    assert capfd.readouterr().err == "", "an ordinary recording needs none"


# ---------------------------------------------------------------------------------------------- text

WORDS = (("heavy", 0.2, 0.6), ("bread", 0.7, 1.4), ("rises", 1.5, 2.2), ("slowly", 6.0, 7.5))
FOREIGN = "тяжёлый хлеб медленно поднимается"


def as_json(path: Path) -> Path:
    path.write_text(json.dumps([{"word": w, "start": a, "end": b} for w, a, b in WORDS]))
    return path


def as_plain(path: Path) -> Path:
    path.write_text(FOREIGN, encoding="utf-8")
    return path


def test_a_folder_of_transcripts_serves_recordings_by_name(recording: Path, tiny_bundle: Path, tmp_path: Path,
                                                           capfd: pytest.CaptureFixture[str]) -> None:
    soundfile.write(tmp_path / "other.wav", babble(1.0, seed=1), RATE)
    texts = tmp_path / "texts"
    texts.mkdir()
    as_json(texts / "speech.json")
    both = [str(recording), str(tmp_path / "other.wav"), "-o", f"{tmp_path / 'out'}/", "--text", str(texts)]
    assert run(both, tiny_bundle) == 1, "a recording without its transcript fails, and the other is done"
    error = capfd.readouterr().err
    assert error.count("\n") == 2 and "no transcript of other" in error and "speech" not in error.splitlines()[1]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["speech.bvh"]
    as_plain(texts / "other.txt")
    assert run(both, tiny_bundle) == 0
    out = capfd.readouterr().out.splitlines()
    assert "times given" in out[1] and "estimates" in out[3] and out[4] == "2 recordings done"
    with pytest.raises(SystemExit):
        run([*both[:-1], str(texts / "speech.json")], tiny_bundle)
    assert "several recordings" in capfd.readouterr().err


# ------------------------------------------------------------------------------- style editing and activity
