"""Batches: what is noted, what is done again, who does what; the manifest survives being killed. Ray where it is."""

from __future__ import annotations

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
from gesticulator import manifest as manifests
from gesticulator.batch import BatchTask, done_here, parse_shard, run_batch, sharded
from gesticulator.manifest import DONE, FAILED, Manifest, ManifestRow, merged, read_manifest, write_manifest

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "speech.flac"
MADE = ("1", "bundle", "settings")


def task(number: int, seconds: float = 1.0, name: str | None = None) -> BatchTask:
    return BatchTask(number, Path("sounds", name or f"{number:03}.wav"), (Path("out", f"{number}.bvh"),), MADE,
                     seconds=seconds)


# ------------------------------------------------------------------------------------------------------- shards

def test_shards_share_all_tasks_evenly_whatever_their_order_and_their_folder() -> None:
    rng = random.Random(0)
    tasks = [task(number, rng.choice([0.0, 3.0, 10.0, 10.0, rng.uniform(1, 600)])) for number in range(200)]
    shards = [sharded(tasks, index, 7) for index in range(1, 8)]
    assert sorted(one.number for shard in shards for one in shard) == list(range(200))
    loads = [sum(one.seconds for one in shard) for shard in shards]
    assert max(loads) - min(loads) <= min(one.seconds for one in tasks if one.seconds) + 10.0
    for shard in shards:
        assert [one.seconds for one in shard] == sorted((one.seconds for one in shard), reverse=True)
    moved = [replace(one, source=Path("/elsewhere") / one.source.name) for one in rng.sample(tasks, 200)]
    assert [one.number for one in sharded(moved, 3, 7)] == [one.number for one in shards[2]]


# ----------------------------------------------------------------------------------------------------- manifests

def test_a_manifest_is_read_as_it_was_written(tmp_path: Path) -> None:
    rows = [ManifestRow("b,ä\n.wav", "12", 3.25, ("x.bvh", "y.glb"), FAILED, 'cut "short"', 0.125, "1", "2", "3", "h"),
            ManifestRow("a.wav"), ManifestRow("caf\udce9.wav")]
    write_manifest(tmp_path / "m.jsonl", rows)
    assert read_manifest(tmp_path / "m.jsonl") == {row.input: row for row in rows}, "names that are no text, too"


def test_what_a_killed_process_noted_is_there_and_half_a_line_is_not(tmp_path: Path) -> None:
    path = tmp_path / "m.jsonl"
    with Manifest(path) as notes:
        notes.add(ManifestRow("a.wav"))
    code = ("import os, sys; from pathlib import Path; from gesticulator.manifest import Manifest, ManifestRow\n"
            f"with Manifest(Path({str(path)!r})) as notes:\n"
            "    notes.add(ManifestRow('b.wav')); notes.add(ManifestRow('a.wav', status='failed'))\n"
            "    os.kill(os.getpid(), 9)")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    with path.open("ab") as file:
        file.write(b'{"input": "c.wav", "sta')
    assert {name: row.status for name, row in read_manifest(path).items()} == {"a.wav": FAILED, "b.wav": DONE}
    with Manifest(path) as notes:
        notes.add(ManifestRow("d.wav"))
    assert sorted(read_manifest(path)) == ["a.wav", "b.wav", "d.wav"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["m.jsonl"]


def test_a_manifest_is_held_by_one_process_and_must_be_one(tmp_path: Path) -> None:
    with Manifest(tmp_path / "m.jsonl"), pytest.raises(InputError, match="in use"), Manifest(tmp_path / "m.jsonl"):
        pass
    with pytest.raises(InputError, match="not the name of a manifest"):
        Manifest(tmp_path / "m.csv")
    with pytest.raises(InputError, match="does not exist"):
        read_manifest(tmp_path / "none.jsonl")


@pytest.mark.parametrize("line", [
    b"[" * 5000, b'{"input": "a", "time": ' + b"9" * 400 + b"}", b'{"input": "a", "seconds": NaN}',
    b'{"input": "a", "seconds": "1"}', b'{"input": "a", "output": "x.bvh"}', b'{"input": "a", "output": [3]}',
    b'{"input": "a", "sha256": 7}', b'{"input": "a", "error": ["x"]}', b'{"input": "a\\u0000"}', b'{"status": "done"}',
    b'{"input": "a", "error": "' + b"x" * (1 << 20) + b'"}', b"{", b"[1]", b'{"input": 3}', b"\xff",
    b'{"input": "a", "status": "maybe"}',
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


def test_manifests_of_shards_are_joined_and_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_manifest(tmp_path / "1.jsonl", [ManifestRow("a.wav", seconds=1800.0, time=180.0), ManifestRow(
        "b.wav", status=FAILED, error="b.wav: is empty")])
    write_manifest(tmp_path / "2.jsonl", [ManifestRow("c.wav", seconds=1800.0, time=180.0),
                                            ManifestRow("a.wav", status=FAILED, error="died")])
    rows = merged([tmp_path / "1.jsonl", tmp_path / "2.jsonl"])
    assert {name: row.status for name, row in rows.items()} == {"a.wav": DONE, "b.wav": FAILED, "c.wav": DONE}
    assert manifests.COMMAND.main("gesticulator manifest", [
        str(tmp_path / "1.jsonl"), str(tmp_path / "2.jsonl"), "-o", str(tmp_path / "all.jsonl"), "--failed"]) == 0
    out = capsys.readouterr().out
    assert "b.wav: b.wav: is empty" in out and "1.00 h" in out and "0.100" in out and "a.wav" not in out
    assert read_manifest(tmp_path / "all.jsonl") == rows


# ------------------------------------------------------------------------------------------- what is done again

class Copier:
    """Does a recording by copying it in capitals; notes the order."""

    def __init__(self, tasks: Sequence[BatchTask]) -> None:
        self.tasks, self.done = tasks, list[int]()

    def __call__(self) -> Callable[[int], float]:
        return self.do

    def do(self, number: int) -> float:
        self.done.append(number)
        one = self.tasks[number]
        text = one.source.read_text()
        if "bad" in text:
            raise InputError(one.source, "is bad", "mend it")
        for output in one.outputs:
            output.parent.mkdir(exist_ok=True)
            output.write_text(text.upper())
        return float(len(text))


@pytest.fixture
def tasks(tmp_path: Path) -> list[BatchTask]:
    """Five recordings, of which 3.wav is bad; the longer the higher the number."""
    made = []
    for number in range(5):
        source = tmp_path / f"{number}.wav"
        source.write_text(("bad" if number == 3 else "good") + "." * 100 * number)
        made.append(BatchTask(number, source, (tmp_path / "out" / f"{number}.bvh",), MADE))
    return made


def again(tasks: Sequence[BatchTask], tmp_path: Path) -> list[int]:
    """The numbers that another run does."""
    copier = Copier(tasks)
    run_batch(tasks, tmp_path / "m.jsonl", partial(done_here, copier), quiet=True)
    return copier.done


def test_what_was_half_written_goes_and_nothing_else(tasks: list[BatchTask], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    left = [out / ".2.bvh.0123456789ab", out / ".4.bvh.fedcba987654"]
    stays = [out / ".9.bvh.0123456789ab", out / ".2.bvh.notes", out / ".2.bvh.0123456789AB"]
    for file in (*left, *stays):
        file.touch()
    again(tasks, tmp_path)
    assert not any(file.exists() for file in left) and all(file.exists() for file in stays)


def test_only_what_is_missing_or_changed_is_done_again(tasks: list[BatchTask], tmp_path: Path,
                                                       capfd: pytest.CaptureFixture[str]) -> None:
    assert again(tasks, tmp_path) == [4, 3, 2, 1, 0], "the longest first"
    rows = read_manifest(tmp_path / "m.jsonl")
    assert [rows[str(one.source)].status for one in tasks] == [DONE, DONE, DONE, FAILED, DONE]
    assert "is bad" in rows[str(tasks[3].source)].error and capfd.readouterr().err.count("\n") == 1
    assert rows[str(tasks[2].source)].seconds == 204.0
    assert again(tasks, tmp_path) == [3]
    tasks[1].source.write_text("good and new")
    tasks[2].outputs[0].unlink()
    tasks[3].source.write_text("mended")
    assert again(tasks, tmp_path) == [2, 1, 3]
    assert again(tasks, tmp_path) == []
    others = [replace(one, made_with=("1", "bundle", "other")) for one in tasks[:2]]
    assert again(others, tmp_path) == [1, 0]
    assert again([others[0], replace(others[1], outputs=(tmp_path / "out" / "new.bvh",))], tmp_path) == [1]


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


def test_shards_of_a_folder_make_the_same_bytes_and_their_manifests_join(
        talks: Path, plain: dict[str, bytes], tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    codes = [infer.main([str(talks), "-o", f"{out}/", "--shard", f"{index}/2"]) for index in (1, 2)]
    assert sorted(codes) in ([0, 1], [0, 2]), "the shard with the bad file says so"
    assert motions(out) == plain and sorted(plain) == ["a.bvh", "b.bvh", "d.bvh"]
    rows = merged(sorted(out.glob("manifest.*-of-2.*")))
    assert {Path(name).name: row.status for name, row in rows.items()} == {
        "a.wav": DONE, "b.wav": DONE, "c.wav": FAILED, "d.wav": DONE}
    assert "too short" in rows[str(talks / "c.wav")].error and "done" in capfd.readouterr().out
    before = {path: path.stat().st_mtime_ns for path in out.glob("*.bvh")}
    assert infer.main([str(talks), "-o", f"{out}/", "--shard", "1/2", "--quiet"]) == codes[0]
    assert {path: path.stat().st_mtime_ns for path in out.glob("*.bvh")} == before


@pytest.mark.parametrize("asked", [["--shard", "3/2"], ["--shard", "half"], ["--manifest", "m.csv"],
                                   ["--ray", "local:0"]])
def test_wrong_batches_are_one_line(asked: list[str], talks: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
                                    ) -> None:
    with pytest.raises(SystemExit) as stop:
        infer.main([str(talks), "-o", f"{tmp_path}/out/", *asked])
    assert stop.value.code == 2 and capfd.readouterr().err.count("\n") == 1 and not list(tmp_path.iterdir())


# ---------------------------------------------------------------------------------------------------------- Ray

def _dying_once(folder: Path, number: int) -> float:
    """A recording that is noted when it is begun; with the first of number 2, its worker dies."""
    (folder / f"begun-{number}-{os.getpid()}").touch()
    if number == 2 and len(list(folder.glob("begun-2-*"))) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return 1.0


def _dies_once(folder: Path) -> Callable[[int], float]:
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


@pytest.mark.usefixtures("cluster")
def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    from gesticulator.ray_pool import done_on_ray

    outcomes = list(done_on_ray("local:2", partial(_dies_once, tmp_path), list(range(4))))
    assert sorted(outcome.number for outcome in outcomes) == [0, 1, 2, 3]
    assert not any(outcome.error for outcome in outcomes)
    assert len(list(tmp_path.glob("begun-2-*"))) == 2 and len(list(tmp_path.glob("begun-*"))) == 5


@pytest.mark.usefixtures("cluster")
def test_a_folder_on_ray_makes_the_same_bytes(talks: Path, plain: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert infer.main([str(talks), "-o", f"{out}/", "--ray", "local:2", "--quiet"]) == 1
    assert motions(out) == plain
    (manifest,) = out.glob("manifest.*")
    assert sorted(row.status for row in read_manifest(manifest).values()) == [DONE, DONE, DONE, FAILED]


def _cannot(folder: Path) -> Callable[[int], float]:
    raise InputError(folder, "is not on this machine", "mount it")


@pytest.mark.usefixtures("cluster")
def test_a_worker_that_cannot_load_the_models_is_one_error(tmp_path: Path) -> None:
    from gesticulator.ray_pool import done_on_ray

    with pytest.raises(InputError, match=r"a worker: cannot do its work .*is not on this machine"):
        list(done_on_ray("local:2", partial(_cannot, tmp_path), range(100)))


def _dying(number: int) -> float:
    os.kill(os.getpid(), signal.SIGKILL)
    return float(number)


def _dies() -> Callable[[int], float]:
    return _dying


@pytest.mark.usefixtures("cluster")
def test_a_recording_whose_worker_always_dies_fails_alone() -> None:
    from gesticulator.ray_pool import done_on_ray

    (outcome,) = done_on_ray("local:2", _dies, [7])
    assert outcome.number == 7 and "its worker died 3 times" in outcome.error
