"""A build in shards and with a manifest: the same bytes, and faults that are rows. On Ray: `test_ray_faults`."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile

from data_module.build import main
from data_module.errors import InputError
from data_module.files import lock
from data_module.motion import skeletons
from data_module.motion.bvh import write_bvh
from gesticulator.batch.build import COMMAND
from gesticulator.batch.manifest import DONE, FAILED, merged, read_manifest

ROOT = Path(__file__).resolve().parent.parent
SPEECH = ROOT / "examples" / "speech.flac"
NAMES = tuple(f"clip_{place}" for place in range(6))
BAD = "clip_2"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six recordings of one to three seconds, of which one has no sound."""
    folder, rng = tmp_path_factory.mktemp("source"), np.random.default_rng(0)
    samples, rate = soundfile.read(SPEECH, dtype="int16")
    for place, name in enumerate(NAMES):
        frames = 60 + 24 * place
        turns = np.cumsum(rng.normal(0, 0.004, (frames, 48)), axis=0)
        write_bvh(folder / f"{name}.bvh", skeletons.from_vector(turns, 60.0))
        soundfile.write(folder / f"{name}.flac", samples[place * rate:place * rate + frames * rate // 60], rate)
    (folder / f"{BAD}.flac").write_bytes(b"no sound")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


@pytest.fixture(scope="module")
def plain(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What a build by one process writes."""
    out = tmp_path_factory.mktemp("plain") / "store"
    assert main(["folder", "--source", str(source), "--out", str(out), "--workers", "1"]) == 0
    return contents(out)


def asked(source: Path, out: Path, *more: str) -> list[str]:
    return ["folder", "--source", str(source), "--out", str(out), "--workers", "1", *more]


def command(source: Path, out: Path, *more: str) -> list[str]:
    return [sys.executable, "-m", "gesticulator", "build", *asked(source, out, *more)]


def test_shards_at_once_make_a_store_of_the_same_bytes(source: Path, plain: dict[str, bytes], tmp_path: Path,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "store"
    shards = [subprocess.Popen(command(source, out, "--shard", f"{index}/2"), cwd=ROOT, stdout=subprocess.DEVNULL)
              for index in (1, 2)]
    assert [shard.wait() for shard in shards] == [0, 0] and not out.exists()
    manifests = sorted(tmp_path.glob("store.manifest.*"))
    assert len(manifests) == 2
    rows = merged(manifests)
    assert {name: row.status for name, row in rows.items()} == dict.fromkeys(NAMES, DONE) | {BAD: FAILED}
    assert "clip_2.flac" in rows[BAD].error and rows["clip_5"].seconds == pytest.approx(3.0, abs=0.02)
    loads = [sum(row.seconds for row in read_manifest(path).values()) for path in manifests]
    assert abs(loads[0] - loads[1]) < 3.1, "by their size, though one of them turned out to be nothing"
    made = {file: file.stat().st_mtime_ns for file in (tmp_path / "store.partial").rglob("*.npz")}
    assert len(made) == len(NAMES) - 1
    assert COMMAND.main("gesticulator build", asked(source, out)) == 0
    assert contents(out) == plain and "(5 recordings were there already)" in capsys.readouterr().out
    assert {file.name: file.stat().st_mtime_ns for file in out.rglob("*.npz")} == {
        file.name: when for file, when in made.items()}
    assert COMMAND.main("gesticulator build", asked(source, out, "--shard", "1/2")) == 0
    assert "is there already" in capsys.readouterr().out


def test_a_share_and_a_whole_build_keep_out_of_each_others_way(source: Path, tmp_path: Path,
                                                               capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "store"
    with lock(out, "a share of a build", beside=True, shared=True):
        with pytest.raises(SystemExit):
            COMMAND.main("gesticulator build", asked(source, out))
        assert "is in use by a share of a build" in capsys.readouterr().err
    with lock(out, "a build", beside=True), pytest.raises(SystemExit):
        COMMAND.main("gesticulator build", asked(source, out, "--shard", "1/2"))
    with pytest.raises(SystemExit):
        COMMAND.main("gesticulator build", asked(source, out, "--shard", "3/2"))
    assert not list(tmp_path.glob("store*"))
    said = capsys.readouterr().err
    assert "--shard 3/2: is not a shard" in said


@pytest.mark.skipif(os.name == "nt", reason="no limit on the size of a file")
def test_a_recording_that_does_not_fit_is_a_row_and_the_others_are_made(source: Path, plain: dict[str, bytes],
                                                                         tmp_path: Path) -> None:
    sizes = sorted(len(data) for name, data in plain.items() if name.startswith("recordings/") and ".npz" in name)
    limit = (sizes[-1] + sizes[-2]) // 2
    code = ("import resource, sys; from gesticulator.batch.build import COMMAND\n"
            f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n"
            "sys.exit(COMMAND.main('gesticulator build', sys.argv[1:]))")
    out, notes = tmp_path / "store", tmp_path / "m.jsonl"
    more = ("--no-dataset", "--manifest", str(notes))
    done = subprocess.run([sys.executable, "-c", code, *asked(source, out, *more)], cwd=ROOT, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 2 and not out.exists()
    assert "is not finished: 1 of 6 recordings failed, such as clip_5" in done.stderr.splitlines()[-1]
    rows = read_manifest(notes)
    assert {name for name, row in rows.items() if row.status == FAILED} == {BAD, "clip_5"}
    assert "clip_5.npz" in rows["clip_5"].error and "free space" in rows["clip_5"].error
    assert not [file for file in tmp_path.rglob(".*") if file.is_file()], "nothing half-written"
    assert COMMAND.main("gesticulator build", asked(source, out, *more)) == 0
    assert read_manifest(notes)["clip_5"].status == DONE
    recordings = {name: data for name, data in plain.items() if name.startswith("recordings/") or name == "store.json"}
    assert {name: contents(out)[name] for name in recordings} == recordings


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, of four megabytes."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(command, check=False, capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_a_full_disk_loses_nothing(source: Path, plain: dict[str, bytes], small_disk: Path,
                                   capsys: pytest.CaptureFixture[str]) -> None:
    """Filled but for what two recordings need; the manifest lies on it, too."""
    needed = sum(len(data) for data in plain.values())
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes((4 << 20) - needed * 2 // 5))
    out = small_disk / "store"
    command = asked(source, out, "--manifest", str(small_disk / "m.jsonl"))
    with pytest.raises(SystemExit) as caught:
        COMMAND.main("gesticulator build", command)
    said = capsys.readouterr().err.splitlines()
    assert caught.value.code == 2 and "No space left on device" in " ".join(said) and not out.exists()
    assert not [file for file in small_disk.rglob(".*") if file.is_file()], "nothing half-written"
    made = [file.read_bytes() for file in small_disk.rglob("*.npz")]
    assert 0 < len(made) < len(NAMES) - 1
    assert set(made) <= {data for name, data in plain.items() if name.endswith(".npz")}
    ballast.unlink()
    assert COMMAND.main("gesticulator build", command) == 0 and contents(out) == plain
    rows = read_manifest(small_disk / "m.jsonl")
    assert {name: row.status for name, row in rows.items()} == dict.fromkeys(NAMES, DONE) | {BAD: FAILED}


def test_a_worker_with_other_files_is_told(source: Path, tmp_path: Path) -> None:
    """A machine of a cluster that sees another folder under the same path must not add to the store."""
    from data_module.build import Workshop
    from data_module.corpora.base import Options
    from data_module.corpora.table import open_corpus
    from data_module.store import StoreWriter
    from gesticulator.batch.build import _worker

    reader = open_corpus("folder", source, Options())
    writer = StoreWriter(tmp_path / "s", "folder", {**reader.settings(), "unit": 0.5}, 1, reader.licence)
    with pytest.raises(InputError, match="not the same on all machines"):
        _worker(Workshop("folder", source, Options(), writer, None), reader.items())
