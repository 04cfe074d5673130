"""Every reader of files against broken files: only `InputError` comes out, within 2 seconds and 500 MB.

A real file of each kind is written, damaged as disks, programs and people damage files (flipped bits, a cut end,
pieces that are missing or there twice, foreign bytes, numbers far too large), and read. A file that happens to be still
good may be read. A new reader is a new entry of `READERS`; a test below finds those that have none.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import json
import os
import pkgutil
import re
import time
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import published
import published_bvh
import pytest
import soundfile
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import data_module
from data_module.arrays import read_npz
from data_module.build_report import report_of
from data_module.controls import FEATURES, read_curve
from data_module.corpora.base import DroppedError, Options
from data_module.corpora.serialised import deserialise
from data_module.corpora.table import open_corpus
from data_module.corpora.trinity import read_words
from data_module.errors import InputError
from data_module.motion import skeletons, smartbody
from data_module.motion.bvh import bvh_text, read_bvh, read_hierarchy, write_bvh
from data_module.motion.representation import TED_JOINTS
from data_module.motion.smplx import read_smplx
from data_module.performer.borrowed import load_borrowed
from data_module.performer.strokes import load_strokes, read_manifest
from data_module.performer.takes import load_takes
from data_module.speech.audio import load_speech
from data_module.speech.speech_encoder import load_fairseq
from data_module.store import Recording, RecordingInfo, Store, StoreWriter, _fingerprint, _sha256
from data_module.text.transcript import FORMATS, read_transcript
from data_module.truth import Phrase, PlayedStroke, Syllable, Truth
from data_module.types import Speech, Word
from eval.clip import foreign
from eval.metrics.eye import ReferenceSpace
from eval.metrics.gesture_features import reference_windows

resource = pytest.importorskip("resource", reason="what a process has taken is POSIX's to tell")

SECONDS, MEGABYTES = 2.0, 500.0
"""What one reading may take."""
EXAMPLES = int(os.environ.get("GESTICULATOR_FUZZ", "40"))
"""Damaged files per reader; the variable is for a longer search."""
RATE = 16000


@dataclass(frozen=True)
class Case:
    """A reader and a file for it.

    sample: writes a real file, and what belongs beside it, into a folder, and gives its path. read: reads it as a user
    of it would. covers: names of the functions that are tried so. packed: puts damaged bytes back where they belong,
    into an archive or under a hash, given the path; by default they are the file. examples: share of `EXAMPLES`.
    """

    sample: Callable[[Path], Path]
    read: Callable[[Path], object]
    covers: tuple[str, ...]
    content: Callable[[Path], bytes] = Path.read_bytes
    packed: Callable[[Path, bytes], object] = Path.write_bytes
    examples: float = 1.0


# ---------------------------------------------------------------------------------------------------- samples

def _written(name: str, data: bytes | str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        file = folder / name
        file.write_bytes(data.encode() if isinstance(data, str) else data)
        return file

    return write


def _noise(seconds: float = 1.0) -> np.ndarray:
    return (0.1 * np.random.default_rng(0).standard_normal(round(RATE * seconds))).astype(np.float32)


def _sound(kind: str, subtype: str | None) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        soundfile.write(folder / f"a.{kind.lower()}", _noise(), RATE, format=kind, subtype=subtype)
        return folder / f"a.{kind.lower()}"

    return write


def _container(suffix: str, kind: str, codec: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        av = pytest.importorskip("av", reason="PyAV is in the extra 'video'")
        with av.open(str(folder / f"a.{suffix}"), "w", format=kind) as file:
            stream = file.add_stream(codec, rate=48000)
            stream.layout = "mono"
            for start in range(0, 48000, 4800):
                part = (3000 * np.sin(np.arange(start, start + 4800) / 20)).astype(np.int16)[None]
                frame = av.AudioFrame.from_ndarray(part, format="s16", layout="mono")
                frame.sample_rate, frame.pts, frame.time_base = 48000, start, Fraction(1, 48000)
                for packet in stream.encode(frame):
                    file.mux(packet)
            for packet in stream.encode(None):
                file.mux(packet)
        return folder / f"a.{suffix}"

    return write


def _bvh(folder: Path) -> Path:
    write_bvh(folder / "a.bvh", published_bvh.moving(0.5, 30.0))
    return folder / "a.bvh"


_SMPLX = {"poses": 0.2 * np.random.default_rng(0).standard_normal((8, 165)), "trans": np.zeros((8, 3)),
          "mocap_frame_rate": np.array(30)}


def _smplx(folder: Path) -> Path:
    np.savez_compressed(folder / "a.npz", **_SMPLX)  # type: ignore[arg-type]
    return folder / "a.npz"


def _member(name: str) -> Callable[[Path], bytes]:
    def content(file: Path) -> bytes:
        with zipfile.ZipFile(file) as archive:
            return archive.read(name)

    return content


def _with_member(name: str) -> Callable[[Path, bytes], object]:
    """The archive with a damaged member and a checksum that fits, so that it is not the checksum that stops it."""
    def pack(file: Path, data: bytes) -> None:
        with zipfile.ZipFile(file) as archive:
            content = {member: archive.read(member) for member in archive.namelist()}
        with zipfile.ZipFile(file, "w") as archive:
            for member, old in content.items():
                archive.writestr(member, data if member == name else old)

    return pack


_SPACE: dict[str, tuple[int, ...]] = {"mean": (40,), "sd": (40,), "axes": (10, 40), "own_mean": (10,),
                                      "own_root": (10, 10)}
_WINDOWS: dict[str, tuple[int, ...]] = {"windows_a": (2, 34, 27), "windows_b": (2, 34, 27)}


def _arrays(shapes: dict[str, tuple[int, ...]]) -> Callable[[Path], Path]:
    """An archive of positive numbers in these shapes."""
    def write(folder: Path) -> Path:
        rng = np.random.default_rng(3)
        np.savez(folder / "a.npz", **{name: rng.uniform(0.5, 1.0, shape) for name, shape in shapes.items()})
        return folder / "a.npz"

    return write


def _skeleton_text() -> str:
    joints = list(smartbody.JOINT_TABLE.values())
    inner = ""
    for n, name in enumerate(joints[1:], 1):
        x = 0.1 * n * (name.endswith("Lf") - name.endswith("Rt"))
        y = 0.0 if x else 0.2 * n
        inner += f"joint {name}\n{{ offset {x:g} {y:g} 0.0\nprerot axis 0 1 0 ang {n}\nchannel Quat\n}}\n"
    return f"# SK\nskeleton\nroot {joints[0]}\n{{ offset 0 1 0\nprerot axis 1 0 0 ang 5\nchannel Quat\n{inner}}}\nend\n"


def _motion_text() -> str:
    joints = list(smartbody.JOINT_TABLE.values())
    rows = np.random.default_rng(0).normal(size=(5, 3 + 3 * len(joints))).round(4)
    channels = "".join(f"{joints[0]} {axis}Pos\n" for axis in "XYZ") + "".join(f"{name} Quat\n" for name in joints)
    frames = "".join(f"kt {t / 30:.6f} fr {' '.join(map(str, row))}\n" for t, row in enumerate(rows))
    return f'SkMotion\n\nname "a"\n\nchannels {len(joints) + 3}\n{channels}\nframes 5\n{frames}\nready time: 0.05\n'


def _smartbody(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / "a.sk").write_text(_skeleton_text())
        (folder / "a.skm").write_text(_motion_text())
        return folder / mutated

    return write


def _read_smartbody(file: Path) -> object:
    bind, clip = smartbody.read_sk(file.with_suffix(".sk")), smartbody.read_skm(file.with_suffix(".skm"))
    return skeletons.to_character(smartbody.motion_of(bind, clip, path=str(file)))


def _positions(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        points = np.random.default_rng(0).normal(size=(6, len(TED_JOINTS), 3))
        np.save(folder / "a.npy", points.astype(np.float32))
        (folder / "a.json").write_text(json.dumps({"joints": TED_JOINTS, "fps": 15, "up": "-Y"}))
        return folder / mutated

    return write


WORDS = [("hello", 0.1, 0.4), ("there", 0.4, 0.55), ("", 0.55, 0.7), ("friend", 0.7, 0.95)]
TRANSCRIPTS = {
    ".txt": "Hello there, well-known friend. 3 o'clock!\n",
    ".textgrid": published.textgrid_of(WORDS),
    ".srt": "1\n00:00:00,100 --> 00:00:00,500\nhello <i>there</i>\n\n2\n00:00:00,700 --> 00:00:00,950\nfriend\n",
    ".vtt": ("WEBVTT\n\nNOTE a\n\n1\n00:00.100 --> 00:00.500 align:start\nhello &amp; there\n\n"
             "00:00.700 --> 00:00.950\nfriend\n"),
    ".json": json.dumps({"segments": [{"start": 0.1, "end": 0.5, "text": "hello there", "words": [
        {"word": word, "start": start, "end": end} for word, start, end in WORDS if word]}, {
        "start": 0.7, "end": 0.95, "text": "friend"}]}),
}


def _store(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        writer = StoreWriter(folder / "s", "test", {"hours": 1.0}, 3, "none")
        speech = Speech(_noise(), RATE, tuple(Word(*word) for word in WORDS), "ann")
        motion = skeletons.from_vector(0.1 * np.random.default_rng(0).normal(size=(20, 48)), 20.0)
        truth = Truth((PlayedStroke("BeatMid", "clip", "left", 0.0, 0.5, 0.7, 0.9, 0.48, 1.03, True),),
                      (Syllable(0.1, 0.15, 0.4, 0, -1.5, 2.5, 0.3),), (Phrase(0.1, 0.9, -0.25),))
        writer.add(Recording(RecordingInfo("a", "train", "ann", "ann", "en", group="g"), speech, motion, truth))
        writer.finish(["a"])
        return folder / "s" / mutated

    return write


def _read_store(file: Path) -> object:
    folder = next(parent for parent in file.parents if parent.name == "s")
    store = Store.open(folder)
    return [store.load(name) for name in store.names], report_of(store)


def _with_hashes(pack: Callable[[Path, bytes], object]) -> Callable[[Path, bytes], object]:
    """A store whose listing was made to fit its damaged recording."""
    def packed(file: Path, data: bytes) -> None:
        pack(file, data)
        listing = file.parents[1] / "store.json"
        content = json.loads(listing.read_text())
        content["recordings"][0]["sha256"][file.suffix[1:]] = _sha256(file)
        content["fingerprint"] = _fingerprint(content["recordings"])
        listing.write_text(json.dumps(content))

    return packed


def _with_fingerprint(file: Path, data: bytes) -> None:
    """A listing that was edited, and its fingerprint with it, where it still is JSON."""
    try:
        content = json.loads(data)
        content["fingerprint"] = _fingerprint(content["recordings"])
        data = json.dumps(content).encode()
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        pass
    file.write_bytes(data)


def _strokes(mutated: str) -> Callable[[Path], Path]:
    """Two clips of the 16-joint character, metres, in which one arm and then the other goes up and comes down."""
    def write(folder: Path) -> Path:
        rows = []
        for side in ("Left", "Right"):
            vectors = np.zeros((75, 16, 3))
            up = np.interp(np.arange(75), [0, 20, 35, 40, 60, 75], [0, 0, 1.2, 1.2, 0, 0])
            vectors[:, skeletons.CHARACTER.index(side + "Arm"), 2] = up
            motion = skeletons.from_vector(vectors.reshape(75, -1), 30.0)
            (folder / f"ann_{side}.bvh").write_text(bvh_text(skeletons.scaled(motion, 0.01)))
            rows.append(f"ann_{side}.bvh,ann,Standing,Beat,{side.lower()},75,{35 / 30}")
        head = "file,speaker,posture,lexeme,hand,frames,emphasis"
        (folder / "manifest.csv").write_text("\n".join([head, *rows, ""]))
        return folder / mutated

    return write


def _read_strokes(file: Path) -> object:
    return read_manifest(file.parent), load_strokes(file.parent)


def _clips(mutated: str) -> Callable[[Path], Path]:
    """Clips of free motion: somebody who talks, somebody who stands, and a stroke that is lent to others."""
    def write(folder: Path) -> Path:
        _strokes("manifest.csv")(folder)
        rows = ["file,person,licence,emphasis"]
        for name, side in (("cmu_18_08", "Left"), ("m_idle_neutral_01", "Right"), ("pn_me", "Right"),
                           ("pn_you", "Left")):
            (folder / f"{name}.bvh").write_bytes((folder / f"ann_{side}.bvh").read_bytes())
            rows.append(f"{name}.bvh,{'pn' if name.startswith('pn') else 'ann'},none,{35 / 30}")
        (folder / "manifest.csv").write_text("\n".join([*rows, ""]))
        return folder / mutated

    return write


def _read_clips(file: Path) -> object:
    return load_takes(file.parent), load_borrowed(file.parent)


def _pairs(folder: Path) -> Path:
    motion = skeletons.from_vector(np.zeros((30, 48)), 20.0)
    write_bvh(folder / "a.bvh", motion)
    soundfile.write(folder / "a.wav", _noise(1.5), RATE)
    truth = Truth((PlayedStroke("Beat", "c", "left", 0.0, 0.5, 0.7, 0.9, 0.4, 1.0, True),),
                  (Syllable(0.1, 0.15, 0.4, 0, 0.0, 0.0, 0.0),), (Phrase(0.1, 0.9, 0.0),))
    beside = {"words": [{"text": "hello", "start": 0.1, "end": 0.5}], "performer": "ann", "language": "en",
              "split": "train"} | truth.to_json()
    (folder / "a.json").write_text(json.dumps(beside))
    return folder / "a.json"


def _read_pairs(file: Path) -> object:
    reader = open_corpus("folder", file.parent, Options())
    return [reader.read(item) for item in reader.items()]


def _beat2(folder: Path) -> Path:
    published.write_beat2(folder, published.TAKE, published.poses_of(45))
    (folder / "train_test_split.csv").write_text(f"id,type\n{published.TAKE},test\n")
    return folder / "train_test_split.csv"


def _ted(folder: Path) -> Path:
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'ted'")
    return _written("value", published.ted_value("VIDEO", "100"))(folder)


def _checkpoint(folder: Path) -> Path:
    import torch

    weights, before = {}, 1
    for layer, kernel in enumerate((10, 8, 4, 4, 4, 1, 1, 1)):
        name = f"feature_extractor.conv_layers.{layer}"
        weights |= {f"{name}.0.weight": torch.zeros(4, before, kernel), f"{name}.2.weight": torch.ones(4),
                    f"{name}.2.bias": torch.zeros(4)}
        before = 4
    torch.save({"model": weights, "args": {"activation": "gelu"}}, folder / "a.pt")
    return folder / "a.pt"


def _bundle(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        from untrained import PLAIN, untrained

        from gesticulator.bundle import bundle

        bundle.save(untrained(*PLAIN), folder / "bundle", "")
        return folder / "bundle" / mutated

    return write


def _read_bundle(file: Path) -> object:
    from gesticulator.bundle import bundle

    return bundle.load(file.parent)


def _with_index(file: Path, data: bytes) -> None:
    """Weights that were damaged, and the list of hashes made to fit."""
    file.write_bytes(data)
    listing = file.parent / "bundle.json"
    index = json.loads(listing.read_text())
    index["files"][file.name] = hashlib.sha256(data).hexdigest()
    listing.write_text(json.dumps(index))


_SPEECH = Speech(_noise(), RATE)
READERS: dict[str, Case] = {
    **{kind: Case(_sound(kind, subtype), load_speech, ("load_speech",), examples=share)
       # MP3 takes a process each.
       for kind, subtype, share in (("WAV", "PCM_16", 1), ("FLAC", "PCM_16", 1), ("OGG", "VORBIS", 1),
                                    ("AIFF", "PCM_16", 1), ("MP3", None, 0.2))},
    **{suffix: Case(_container(suffix, kind, codec), load_speech, ("load_speech",))
       for suffix, kind, codec in (("m4a", "mp4", "aac"), ("webm", "webm", "libopus"), ("mkv", "matroska", "flac"))},
    "bvh": Case(_bvh, lambda file: skeletons.to_character(read_bvh(file)), ("read_bvh",)),
    "bvh, the hierarchy": Case(_bvh, read_hierarchy, ("read_hierarchy",)),
    "smplx, the archive": Case(_smplx, lambda file: skeletons.to_character(read_smplx(file)),
                               ("read_smplx", "read_npz")),
    **{f"smplx, {name}": Case(_smplx, lambda file: (skeletons.to_character(read_smplx(file)), read_npz(file)),
                              ("read_smplx", "read_npz"), _member(f"{name}.npy"), _with_member(f"{name}.npy"))
       for name in _SMPLX},
    **{f"{kind}, {name}": Case(_arrays(shapes), read, ("read_numbers", "read_npz"), _member(f"{name}.npy"),
                               _with_member(f"{name}.npy"), examples=0.5)
       for kind, shapes, read in (("eye's space", _SPACE, ReferenceSpace.load),
                                  ("FGD windows", _WINDOWS, reference_windows))
       for name in tuple(shapes)[:2]},
    "eye's space, the archive": Case(_arrays(_SPACE), ReferenceSpace.load, ("read_numbers",), examples=0.5),
    "smartbody, skeleton": Case(_smartbody("a.sk"), _read_smartbody, ("read_sk",)),
    "smartbody, motion": Case(_smartbody("a.skm"), _read_smartbody, ("read_skm",)),
    **{f"transcript {suffix}": Case(_written(f"a{suffix}", text), lambda file: read_transcript(file, _SPEECH),
                                    ("read_transcript", "read_text")) for suffix, text in TRANSCRIPTS.items()},
    "control curve": Case(_written("a.csv", "# from a tool\ntime;height;speed\n0;0,1;0,3\n1,5;0,2;0,4\n"),
                          lambda file: [read_curve(file, feature) for feature in FEATURES[:2]], ("read_curve",)),
    "store, listing": Case(_store("store.json"), _read_store, ("Store.open",)),
    "store, edited listing": Case(_store("store.json"), _read_store, ("Store.open",), packed=_with_fingerprint),
    "store, report": Case(_store("report.json"), _read_store, ("Store.open",), lambda file: b'{"recordings": 1}'),
    "store, sound": Case(_store("recordings/a.flac"), _read_store, ("Store.open",),
                         packed=_with_hashes(Path.write_bytes)),
    **{f"store, {name}": Case(_store("recordings/a.npz"), _read_store, ("Store.open",), _member(f"{name}.npy"),
                              _with_hashes(_with_member(f"{name}.npy")))
       for name in ("rotations", "fps", "joints", "word_text", "strokes_beat", "strokes_held_out")},
    "strokes, manifest": Case(_strokes("manifest.csv"), _read_strokes, ("read_manifest", "load_strokes", "read_table")),
    "clips, manifest": Case(_clips("manifest.csv"), _read_clips, ("read_clips", "load_takes", "load_borrowed"),
                            examples=0.5),
    "clips, motion": Case(_clips("cmu_18_08.bvh"), _read_clips, ("load_takes",), examples=0.5),
    "strokes, clip": Case(_strokes("ann_Left.bvh"), _read_strokes, ("load_strokes",)),
    "foreign positions": Case(_positions("a.npy"), foreign.read_motion, ("read_motion", "read_positions", "read_npy")),
    "foreign sidecar": Case(_positions("a.json"), lambda file: foreign.read_motion(file.with_suffix(".npy")),
                            ("read_motion", "read_positions")),
    "folder, NAME.json": Case(_pairs, _read_pairs, ("read_motion",)),
    "trinity, words": Case(_written("a.json", json.dumps(published_bvh.google(WORDS))), read_words, ("read_words",)),
    "beat2, its list": Case(_beat2, lambda file: open_corpus("beat2", file.parent, Options()).items(), ("read_table",)),
    "ted, a value": Case(_ted, lambda file: deserialise(file.read_bytes(), source=file), ("deserialise",)),
    "fairseq checkpoint": Case(_checkpoint, load_fairseq, ("load_fairseq",)),
    "bundle, index": Case(_bundle("bundle.json"), _read_bundle, ("read_index", "load")),
    "bundle, weights": Case(_bundle("generator.safetensors"), _read_bundle, ("load",)),
    "bundle, weights and their hash": Case(_bundle("generator.safetensors"), _read_bundle, ("load",),
                                           packed=_with_index),
}


# ---------------------------------------------------------------------------------------------------- damage

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
NUMBERS = (b"-1", b"0", b"1e999", b"-1e308", b"1e30", b"nan", b"inf", b"9" * 400, b"9" * 5000, b"4294967296",
           b"18446744073709551616", b"0.0000000001", b'"x"', b"null", b"[]", b"true")


def _flipped(data: bytearray, a: float, b: float, choice: int) -> None:
    for place in (a, b):
        if data:
            data[int(place * len(data)) % len(data)] ^= 1 << choice % 8


def _set(data: bytearray, a: float, b: float, choice: int) -> None:
    at = int(a * len(data))
    value = (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\0\0\0\x80")[choice % 4]
    data[at:at + 4] = value[:len(data) - at]


def _cut(data: bytearray, a: float, b: float, choice: int) -> None:
    del data[int(a * len(data)):]


def _inserted(data: bytearray, a: float, b: float, choice: int) -> None:
    at = int(a * len(data))
    data[at:at] = (b"\0" * 64, b"\n" * 3000, b'"', b"[" * 3000, b"1" * 20_000, b" " * 20_000, b"\xff\xfe\xfd", b"{",
                   b",", b"../../etc/passwd", b"\xe2\x80\xae", b"\xf0\x9f\x98\x80", b"-", b"e", b"\r\n", b";")[choice]


def _deleted(data: bytearray, a: float, b: float, choice: int) -> None:
    first, last = sorted((int(a * len(data)), int(b * len(data))))
    del data[first:min(last, first + (1 << choice))]


def _repeated(data: bytearray, a: float, b: float, choice: int) -> None:
    first, last = sorted((int(a * len(data)), int(b * len(data))))
    data[first:first] = data[first:min(last, first + (1 << choice))]


def _renumbered(data: bytearray, a: float, b: float, choice: int) -> None:
    found = list(_NUMBER.finditer(bytes(data[:200_000])))
    if found:
        match = found[int(a * len(found)) % len(found)]
        data[match.start():match.end()] = NUMBERS[choice % len(NUMBERS)]


DAMAGE = (_flipped, _set, _cut, _inserted, _deleted, _repeated, _renumbered, _renumbered)
_SHARE = st.floats(0, 1, exclude_max=True)


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[Callable[..., None], float, float, int]]:
    one = st.tuples(st.sampled_from(DAMAGE), _SHARE, _SHARE, st.integers(0, 15))
    return draw(st.lists(one, min_size=1, max_size=4))


# ---------------------------------------------------------------------------------------------------- the property

def _peak() -> float:
    """Megabytes that this process has held at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _held() -> float:
    """Megabytes that it holds now, where the system tells; else what it has held at most."""
    file = Path("/proc/self/statm")
    return int(file.read_text().split()[1]) * resource.getpagesize() / 1e6 if file.is_file() else _peak()


@pytest.mark.parametrize("name", READERS)
def test_only_input_errors_come_out_of_damaged_files(name: str, tmp_path: Path) -> None:
    case = READERS[name]
    file = case.sample(tmp_path)
    content = case.content(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        case.read(file)
    beside = {other: other.read_bytes() for other in tmp_path.rglob("*") if other.is_file()}
    worst: list[tuple[float, float]] = []

    @settings(max_examples=max(5, round(case.examples * EXAMPLES)), deadline=None, database=None, derandomize=True,
              phases=(Phase.generate, Phase.shrink), suppress_health_check=list(HealthCheck))
    @given(damages())
    def survives(wanted: list[tuple[Callable[..., None], float, float, int]]) -> None:
        data = bytearray(content)
        for damage, a, b, choice in wanted:
            damage(data, a, b, choice)
        for other, old in beside.items():
            other.write_bytes(old)
        case.packed(file, bytes(data))
        said = ""
        before, peak, begun = _held(), _peak(), time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                warnings.filterwarnings("error", category=RuntimeWarning)
                case.read(file)
        except (InputError, DroppedError) as error:
            said = str(error)
        assert "\n" not in said and len(said) < 1000 + len(str(tmp_path))
        took = time.process_time() - begun
        grown = _peak() - before if _peak() > peak else 0.0
        worst.append((took, grown))
        assert took < SECONDS and grown < MEGABYTES, f"{took:.2f} s, {grown:.0f} MB"

    survives()


def test_every_reader_is_in_the_table() -> None:
    covered = {function for case in READERS.values() for function in case.covers}
    modules = [foreign, *(importlib.import_module(found.name) for found in
                                       pkgutil.walk_packages(data_module.__path__, "data_module."))]
    there = {name for module in modules for name, function in inspect.getmembers(module, inspect.isfunction)
             if function.__module__ == module.__name__ and re.match(r"read_|load_|deserialise", name)
             # A path or a folder comes first; what is read from one recording is no file.
             and next(iter(inspect.signature(function).parameters), "") in ("path", "folder", "source", "data")}
    assert there - covered - {"read_take", "read_folder"} == set(), "these readers have no entry in READERS"
    assert {f"transcript {suffix}" for suffix in FORMATS} <= set(READERS)
    assert covered >= {"load", "read_index", "Store.open"}
