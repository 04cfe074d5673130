"""Which recordings a command names and which files it writes: names in, jobs out, without a model."""

import os
from pathlib import Path

import pytest

from data_module.errors import InputError
from gesticulator.jobs import TRANSCRIPTS, jobs_for


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Recordings b.wav, A.flac and c.MP3 with other things beside them; the current folder is the one above."""
    inside = tmp_path / "talks"
    (inside / "more").mkdir(parents=True)
    for name in ("b.wav", "A.flac", "c.MP3", "notes.txt", ".hidden.wav", "more/d.wav"):
        (inside / name).write_bytes(b"sound")
    (inside / "folder.wav").mkdir()
    monkeypatch.chdir(tmp_path)
    return inside


def sources(*names: str, output: str = "out/") -> list[str]:
    return [str(job.source) for job in jobs_for(names, {".bvh": output})]


def test_a_folder_is_its_sound_files_sorted_and_not_those_below(folder: Path) -> None:
    assert sources("talks") == sources("talks/") == ["talks/A.flac", "talks/b.wav", "talks/c.MP3"]


def test_a_recording_that_is_named_twice_is_done_once(folder: Path) -> None:
    assert sources("talks/b.wav", "talks", str(folder / "b.wav")) == ["talks/b.wav", "talks/A.flac", "talks/c.MP3"]


def test_an_empty_folder_is_refused(folder: Path) -> None:
    (folder.parent / "empty").mkdir()
    with pytest.raises(InputError, match="without sound files"):
        jobs_for(["empty"], {".bvh": "out/"})


def targets(output: str, *names: str) -> list[str]:
    return [str(target) for job in jobs_for(names or ("talks/b.wav",), {".bvh": output}) for target in job.targets]


def test_a_slash_or_a_folder_means_a_folder_and_anything_else_a_file(folder: Path) -> None:
    assert targets("new/") == [str(Path("new", "b.bvh"))]
    assert targets("talks") == [str(Path("talks", "b.bvh"))]
    assert targets("new/deep/x.bvh") == [str(Path("new", "deep", "x.bvh"))]
    assert targets("x.BVH") == ["x.BVH"]
    for wrong in ("new", "x.fbx", "a.b/x"):
        with pytest.raises(InputError, match=r"does not end in \.bvh.*/ for a folder"):
            targets(wrong)
    assert not (folder.parent / "new").exists(), "folders are made when there is something to write"


def test_one_file_for_several_recordings_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="one file for 3 recordings"):
        targets("x.bvh", "talks")


def test_two_recordings_of_one_name_are_refused(folder: Path) -> None:
    (folder / "b.mp3").write_bytes(b"sound")
    with pytest.raises(InputError, match=r"b\.wav: would be written to .*b\.bvh, like .*b\.mp3"):
        targets("out/", "talks")
    with pytest.raises(InputError, match="would be written"):
        targets("out/", "talks/b.wav", "other/b.wav")
    assert len(targets("out/", "-", "talks/c.MP3")) == 2


def test_a_place_that_cannot_be_written_is_the_fault_of_one_recording(folder: Path) -> None:
    (folder.parent / "out" / "b.bvh").mkdir(parents=True)
    faults = {job.name: job.fault for job in jobs_for(["talks"], {".bvh": "out/"})}
    assert faults["A.flac"] is None and "is a folder" in str(faults["b.wav"])
    (fault,) = (job.fault for job in jobs_for(["talks/b.wav"], {".bvh": "talks/A.flac/x.bvh"}))
    assert "is not a folder" in str(fault)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_rights_are_checked_beforehand(folder: Path) -> None:
    (folder.parent / "locked").mkdir(mode=0o555)
    (fault,) = (job.fault for job in jobs_for(["talks/b.wav"], {".bvh": "locked/new/x.bvh"}))
    assert "cannot be written" in str(fault)


def test_transcripts_are_found_by_name_in_order_of_what_they_tell(folder: Path) -> None:
    texts = folder.parent / "texts"
    texts.mkdir()
    for suffix in reversed(TRANSCRIPTS):
        (texts / f"b{suffix}").write_text("words")
        (job,) = jobs_for(["talks/b.wav"], {".bvh": "out/"}, "texts")
        assert job.text == texts.relative_to(folder.parent) / f"b{suffix}"
    faults = [job.fault for job in jobs_for(["talks"], {".bvh": "out/"}, "texts")]
    assert [fault is None for fault in faults] == [False, True, False] and "no transcript of A" in str(faults[0])
    with pytest.raises(InputError, match="one transcript for several"):
        jobs_for(["talks"], {".bvh": "out/"}, "texts/b.txt")
    with pytest.raises(InputError, match="does not exist"):
        jobs_for(["talks"], {".bvh": "out/"}, "nowhere")
    (job,) = jobs_for(["talks/c.MP3"], {".bvh": "out/"}, "texts/b.txt")
    assert job.text == Path("texts/b.txt"), "one recording may have any transcript"


def test_standard_input_has_a_name_of_its_own(folder: Path) -> None:
    (job,) = jobs_for(["-", "-"], {".bvh": "out/"})
    assert job.source is None and job.targets == (Path("out/stdin.bvh"),) and job.name == "standard input"
