"""Batches: what is noted, what is done again, who does what; the manifest survives being killed. Ray where it is."""

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
import soundfile

from data_module.errors import InputError
from gesticulator import infer
from gesticulator.batch import ManifestRow, done_here, opened_manifest, parse_shard, read_manifest, run_batch, sharded

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"


# ------------------------------------------------------------------------------------------------------- shards

def test_shards_share_all_recordings_evenly_whatever_their_order_and_their_folder() -> None:
    rng = random.Random(0)
    rows = [ManifestRow(f"sounds/{number:03}.wav", seconds=rng.choice([0.0, 3.0, 10.0, 10.0, rng.uniform(1, 600)]))
            for number in range(200)]
    shards = [sharded(rows, index, 7) for index in range(1, 8)]
    assert sorted(row.input for shard in shards for row in shard) == [row.input for row in rows]
    loads = [sum(row.seconds for row in shard) for shard in shards]
    assert max(loads) - min(loads) <= min(row.seconds for row in rows if row.seconds) + 10.0
    for shard in shards:
        assert [row.seconds for row in shard] == sorted((row.seconds for row in shard), reverse=True)
    moved = [replace(row, input=f"/elsewhere/{Path(row.input).name}") for row in rng.sample(rows, 200)]
    assert [Path(row.input).name for row in sharded(moved, 3, 7)] == [Path(row.input).name for row in shards[2]]


# ----------------------------------------------------------------------------------------------------- manifests

def write_manifest(path: Path, *rows: ManifestRow) -> None:
    with opened_manifest(path) as manifest:
        for row in rows:
            manifest.add(row)


def test_a_manifest_is_read_as_it_was_written_and_those_of_shards_one_after_the_other(tmp_path: Path) -> None:
    rows = [ManifestRow("b,ä\n.wav", "12", 3.25, ("x.bvh", "y.glb"), 'cut "short"', 0.125, "1", "2", "3", "h"),
            ManifestRow("a.wav"), ManifestRow("caf\udce9.wav")]
    write_manifest(tmp_path / "m.jsonl", *rows)
    assert read_manifest(tmp_path / "m.jsonl") == {row.input: row for row in rows}, "names that are no text, too"
    write_manifest(tmp_path / "n.jsonl", ManifestRow("c.wav"))
    (tmp_path / "all.jsonl").write_bytes(b"".join((tmp_path / f"{name}.jsonl").read_bytes() for name in "mn"))
    assert [*read_manifest(tmp_path / "all.jsonl")] == [*(row.input for row in rows), "c.wav"]


def test_what_a_killed_process_noted_is_there_and_half_a_line_is_not(tmp_path: Path) -> None:
    path = tmp_path / "m.jsonl"
    write_manifest(path, ManifestRow("a.wav"))
    code = ("import os, sys; from pathlib import Path; from gesticulator.batch import ManifestRow, opened_manifest\n"
            f"with opened_manifest(Path({str(path)!r})) as manifest:\n"
            "    manifest.add(ManifestRow('b.wav')); manifest.add(ManifestRow('a.wav', error='cut'))\n"
            "    os.kill(os.getpid(), 9)")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    with path.open("ab") as file:
        file.write(b'{"input": "c.wav", "sta')
    assert {name: row.error for name, row in read_manifest(path).items()} == {"a.wav": "cut", "b.wav": ""}
    write_manifest(path, ManifestRow("d.wav"))
    assert sorted(read_manifest(path)) == ["a.wav", "b.wav", "d.wav"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["m.jsonl"]


def test_a_manifest_is_held_by_one_process_and_must_be_one(tmp_path: Path) -> None:
    with opened_manifest(tmp_path / "m.jsonl"), pytest.raises(InputError, match="in use"):
        write_manifest(tmp_path / "m.jsonl")
    with pytest.raises(InputError, match="not the name of a manifest"):
        write_manifest(tmp_path / "m.csv")
    with pytest.raises(InputError, match="does not exist"):
        read_manifest(tmp_path / "none.jsonl")


@pytest.mark.parametrize("line", [
    b"[" * 5000, b'{"input": "a", "time": ' + b"9" * 400 + b"}", b'{"input": "a", "seconds": NaN}',
    b'{"input": "a", "seconds": "1"}', b'{"input": "a", "output": "x.bvh"}', b'{"input": "a", "output": [3]}',
    b'{"input": "a", "sha256": 7}', b'{"input": "a", "error": ["x"]}', b'{"error": ""}', b"{", b"[1]", b'{"input": 3}',
    b"\xff", b'{"input": "a", "else": 1}',
])
def test_a_row_of_other_kinds_is_refused(line: bytes, tmp_path: Path) -> None:
    (tmp_path / "m.jsonl").write_bytes(line + b"\n")
    with pytest.raises(InputError, match="is not a manifest") as error:
        read_manifest(tmp_path / "m.jsonl")
    assert len(str(error.value)) < 400


@pytest.mark.parametrize("asked", ["9" * 5000 + "/" + "9" * 5000, "1/" + "9" * 400, "\u00b2/3", "0/1", "-1/2", "1/1/1"])
def test_a_shard_of_other_digits_is_refused(asked: str) -> None:
    with pytest.raises(InputError, match="is not a shard"):
        parse_shard(asked)


# ------------------------------------------------------------------------------------------- what is done again

def capitals(done: list[str], path: str) -> float:
    """Process a recording by copying it in capitals, and note its name."""
    source = Path(path)
    done.append(source.stem)
    text = source.read_text()
    if "bad" in text:
        raise InputError(source, "is bad", "mend it")
    target = source.parent / "out" / f"{source.stem}.bvh"
    target.parent.mkdir(exist_ok=True)
    target.write_text(text.upper())
    return float(len(text))


@pytest.fixture
def rows(tmp_path: Path) -> list[ManifestRow]:
    """Five recordings, of which 3.wav is bad; the longer the higher the number."""
    for number in range(5):
        (tmp_path / f"{number}.wav").write_text(("bad" if number == 3 else "good") + "." * 100 * number)
    return [ManifestRow(str(tmp_path / f"{number}.wav"), output=(str(tmp_path / "out" / f"{number}.bvh"),),
                        settings="some") for number in range(5)]


def again(rows: Sequence[ManifestRow], tmp_path: Path) -> str:
    """The recordings that another run processes."""
    done = list[str]()
    run_batch(rows, tmp_path / "m.jsonl", partial(done_here, lambda: partial(capitals, done)), quiet=True)
    return "".join(done)


def test_what_was_half_written_goes_and_nothing_else(rows: list[ManifestRow], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    left = [out / ".2.bvh.0123456789ab", out / ".4.bvh.fedcba987654"]
    stays = [out / ".9.bvh.0123456789ab", out / ".2.bvh.notes", out / ".2.bvh.0123456789AB"]
    for file in (*left, *stays):
        file.touch()
    again(rows, tmp_path)
    assert not any(file.exists() for file in left) and all(file.exists() for file in stays)


def test_only_what_is_missing_or_changed_is_done_again(rows: list[ManifestRow], tmp_path: Path,
                                                       capfd: pytest.CaptureFixture[str]) -> None:
    assert again(rows, tmp_path) == "43210", "the longest first"
    read = read_manifest(tmp_path / "m.jsonl")
    assert [bool(read[row.input].error) for row in rows] == [False, False, False, True, False]
    assert "is bad" in read[rows[3].input].error and capfd.readouterr().err.count("\n") == 1
    assert read[rows[2].input].seconds == 204.0
    assert again(rows, tmp_path) == "3"
    (tmp_path / "1.wav").write_text("good and new")
    (tmp_path / "out" / "2.bvh").unlink()
    (tmp_path / "3.wav").write_text("mended")
    assert again(rows, tmp_path) == "213"
    assert again(rows, tmp_path) == ""
    others = [replace(row, settings="other") for row in rows[:2]]
    assert again(others, tmp_path) == "10"
    assert again([others[0], replace(others[1], output=(str(tmp_path / "out" / "new.bvh"),))], tmp_path) == "1"


# ------------------------------------------------------------------------------------------------- the command

@pytest.fixture(scope="module")
def talks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of four recordings of 1 to 2 s, of which c.wav is too short."""
    folder = tmp_path_factory.mktemp("talks")
    samples, rate = soundfile.read(EXAMPLE, dtype="float32")
    for index, name in enumerate("abcd"):
        soundfile.write(folder / f"{name}.wav", samples[index * rate:(index + 1) * rate + index * rate // 3], rate)
    (folder / "c.wav").write_bytes((folder / "c.wav").read_bytes()[:4_000])
    return folder


@pytest.fixture(scope="module")
def plain(talks: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the command makes of the recordings without a manifest."""
    out = tmp_path_factory.mktemp("plain")
    assert infer.main([str(talks), "-o", f"{out}/", "--quiet"]) == 1
    return motions(out)


def motions(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.bvh")}


def test_shards_of_a_folder_make_the_same_bytes(
        talks: Path, plain: dict[str, bytes], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    codes = [infer.main([str(talks), "-o", f"{out}/", "--shard", f"{index}/2"]) for index in (1, 2)]
    assert sorted(codes) in ([0, 1], [0, 2]), "the shard with the bad file says so"
    assert motions(out) == plain and sorted(plain) == ["a.bvh", "b.bvh", "d.bvh"]
    rows = {Path(name).name: row for path in out.glob("manifest.*-of-2.*") for name, row in read_manifest(path).items()}
    assert [name for name, row in sorted(rows.items()) if not row.error] == ["a.wav", "b.wav", "d.wav"]
    assert "too short" in rows["c.wav"].error and "done" in capfd.readouterr().out
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.bvh")}
    assert infer.main([str(talks), "-o", f"{out}/", "--shard", "1/2", "--quiet"]) == codes[0]
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.bvh")} == before


@pytest.mark.parametrize("asked", [["--shard", "3/2"], ["--shard", "half"], ["--manifest", "m.csv"],
                                   ["--ray", "local:0"]])
def test_wrong_batches_are_one_line(asked: list[str], talks: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    line = refused("infer", talks, "-o", f"{tmp_path}/out/", *asked)
    assert any(word in line for word in asked) and not list(tmp_path.iterdir())


# ---------------------------------------------------------------------------------------------------------- Ray

def _dying_once(folder: Path, path: str) -> float:
    """A recording that is noted when it is begun; with the first of number 2, its worker dies."""
    (folder / f"begun-{path}-{os.getpid()}").touch()
    if path == "2" and len(list(folder.glob("begun-2-*"))) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def _dies_once(folder: Path) -> Callable[[str], float]:
    return partial(_dying_once, folder)


@pytest.fixture(scope="module")
def cluster() -> Iterator[None]:
    """A Ray cluster of two workers on this machine."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'gesticulator[scale]'")
    here = str(Path(__file__).resolve().parent)
    paths = os.pathsep.join([here, str(Path(here).parent), os.environ.get("PYTHONPATH", "")])
    ray.init(address="local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
             runtime_env={"env_vars": {"PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}})
    yield
    ray.shutdown()


def on_ray(make: Callable[[], Callable[[str], float]], *names: str) -> list[ManifestRow]:
    """The rows of recordings that a cluster has processed."""
    from gesticulator.batch import done_on_ray

    return list(done_on_ray("local:2", make, [ManifestRow(name) for name in names]))


@pytest.mark.usefixtures("cluster")
def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    rows = on_ray(partial(_dies_once, tmp_path), *"0123")
    assert sorted(row.input for row in rows) == [*"0123"] and not any(row.error for row in rows)
    assert len(list(tmp_path.glob("begun-2-*"))) == 2 and len(list(tmp_path.glob("begun-*"))) == 5


@pytest.mark.usefixtures("cluster")
def test_a_folder_on_ray_makes_the_same_bytes(talks: Path, plain: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert infer.main([str(talks), "-o", f"{out}/", "--ray", "local:2", "--quiet"]) == 1
    assert motions(out) == plain
    (manifest,) = out.glob("manifest.*")
    assert sorted(bool(row.error) for row in read_manifest(manifest).values()) == [False, False, False, True]


def _cannot(folder: Path) -> Callable[[str], float]:
    raise InputError(folder, "is not on this machine", "mount it")


@pytest.mark.usefixtures("cluster")
def test_a_worker_that_cannot_load_the_models_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a worker: cannot do its work .*is not on this machine"):
        on_ray(partial(_cannot, tmp_path), *map(str, range(100)))


def _dies() -> Callable[[str], float]:
    return lambda path: float(os.kill(os.getpid(), signal.SIGKILL) or 0)


@pytest.mark.usefixtures("cluster")
def test_a_recording_whose_worker_always_dies_fails_alone() -> None:
    (row,) = on_ray(_dies, "7")
    assert row.input == "7" and "its worker died 3 times" in row.error
