"""A sample and a reading for every reader of files, and ways to damage a file: for tests and benchmarks/fuzz.py."""

import base64
import hashlib
import io
import json
import re
import threading
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import published
import published_bvh
import pytest
import recogniser_samples
import soundfile
from hypothesis import strategies as st

from data_module.arrays import read_npz
from data_module.corpora.base import Options
from data_module.corpora.folder import FolderOptions
from data_module.corpora.serialised import deserialise
from data_module.corpora.table import open_corpus
from data_module.errors import InputError
from data_module.files import file_hash
from data_module.motion import skeletons
from data_module.motion.bvh import read_bvh, read_hierarchy, write_bvh
from data_module.motion.representation import TED_JOINTS
from data_module.motion.smplx import read_smplx
from data_module.speech.audio import load_speech
from data_module.speech.fingerprint import fingerprint_frames, fingerprint_text
from data_module.store import Recording, RecordingInfo, Store, StoreWriter, _fingerprint
from data_module.text.transcript import read_transcript
from data_module.types import Speech, Word
from eval.clip import foreign
from eval.clip.positions import POINTS
from eval.metrics.eye import ReferenceSpace
from eval.metrics.gesture_features import PUBLISHED, Encoder
from eval.metrics.gesture_features import published as published_network
from eval.score.ratings import read_ratings

RATE = 16000


@dataclass(frozen=True)
class Case:
    """A reader and a file for it.

    sample: writes a real file, and what belongs beside it, into a folder, and gives its path. read: reads it as a user
    of it would. content: the bytes that are damaged. packed: puts damaged bytes back where they belong, into an archive
    or under a hash, given the path; by default they are the file. examples: share of `EXAMPLES`.
    """

    sample: Callable[[Path], Path]
    read: Callable[[Path], object]
    content: Callable[[Path], bytes] = Path.read_bytes
    packed: Callable[[Path, bytes], object] = Path.write_bytes
    examples: float = 1.0


# ---------------------------------------------------------------------------------------------------- samples

def _genea(folder: Path) -> Path:
    for name in ("trn_2023_v0_000_main-agent", "trn_2023_v0_000_interloctr"):
        for suffix in (".bvh", ".wav", ".tsv"):
            (folder / f"{name}{suffix}").touch()  # only listed here
    table = folder / "metadata.csv"
    table.write_text("prefix,main-agent_id,main-agent_has_fingers,interloctr_id,interloctr_has_fingers\n"
                     "trn_2023_v0_000,3,finger_incl,17,finger_excl\n")
    return table


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


def _read_pipe(file: Path) -> object:
    """As standard input gives a file: nothing can be read twice."""
    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

    return load_speech(Pipe(file.read_bytes()))


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


def _space(folder: Path) -> Path:
    shapes = {"mean": (40,), "sd": (40,), "axes": (10, 40), "own_mean": (10,), "own_root": (10, 10)}
    rng = np.random.default_rng(3)
    np.savez(folder / "a.npz", **{name: rng.uniform(0.5, 1.0, shape) for name, shape in shapes.items()})
    return folder / "a.npz"


def _published_network(folder: Path) -> Path:
    """A network in the shape of the published one."""
    from safetensors.torch import save_file

    save_file({f"pose_encoder.{key}": value.contiguous() for key, value in Encoder().state_dict().items()},
              folder / PUBLISHED)
    return folder / PUBLISHED


def _positions(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        points = np.random.default_rng(0).normal(size=(6, len(TED_JOINTS), 3))
        np.save(folder / "a.npy", points.astype(np.float32))
        (folder / "a.json").write_text(json.dumps({"fps": 15}))
        return folder / mutated

    return write


def _points(folder: Path) -> Path:
    points = np.random.default_rng(0).normal(size=(len(POINTS), 6, 3)).astype(np.float16)
    np.savez(folder / "a.points.npz", **dict(zip(POINTS, points, strict=True)))
    return folder / "a.points.npz"


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
    ".tsv": "start\tend\ttext\n100\t500\thello [nod] there\n700\t950\tfriend\n",
    **dict.fromkeys((".ass", ".ssa"), "[Events]\nDialogue: 0,0:00:00.10,0:00:00.50,D,,0,0,0,,hello {\\i1}there\n"),
    ".csv": 'start,end,text\n100,500,"hello there"\n',
    ".sbv": "0:00:00.100,0:00:00.500\nhello there\n", ".lrc": "[00:00.10]hello there\n[00:00.70]friend\n",
    ".ctm": "a 1 0.10 0.30 hello 0.9 lex\n", ".jsonl": '{"text": "hello"}\n{"text": "there"}\n',
    **dict.fromkeys((".ttml", ".dfxp"),
                    '<tt><body><p begin="00:00:00.100" end="00:00:00.500">hello there</p></body></tt>'),
}
MARKED = [("[shrug]hello", 0.1, 0.3), ("there", 0.3, 0.5), ("[count:3]", 0.5, 0.5), ("friend", 0.7, 0.95)]


def _store(mutated: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        writer = StoreWriter(folder / "s", "test", {"hours": 1.0}, 3, "none")
        speech = Speech(_noise(), RATE, tuple(Word(*word) for word in WORDS), "ann")
        motion = skeletons.from_vector(0.1 * np.random.default_rng(0).normal(size=(20, 48)), 20.0)
        writer.add(Recording(RecordingInfo("a", "train", "ann", "ann", "en", group="g"), speech, motion))
        writer.finish(["a"])
        return folder / "s" / mutated

    return write


def _read_store(file: Path) -> object:
    folder = next(parent for parent in file.parents if parent.name == "s")
    store = Store.open(folder)
    return [store.load(name) for name in store.names]


def _with_hash(pack: Callable[[Path, bytes], object]) -> Callable[[Path, bytes], object]:
    """A store whose listing was made to fit its damaged recording."""
    def packed(file: Path, data: bytes) -> None:
        pack(file, data)
        listing = file.parents[1] / "store.json"
        content = json.loads(listing.read_text())
        content["recordings"][0]["sha256"][file.suffix[1:]] = file_hash(file)
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


def _pairs(folder: Path) -> Path:
    motion = skeletons.from_vector(np.zeros((30, 48)), 20.0)
    write_bvh(folder / "a.bvh", motion)
    soundfile.write(folder / "a.wav", _noise(1.5), RATE)
    beside = {"words": [{"text": "hello", "start": 0.1, "end": 0.5}], "performer": "ann", "language": "en",
              "split": "train"}
    (folder / "a.json").write_text(json.dumps(beside))
    return folder / "a.json"


def _folder_splits(folder: Path) -> Path:
    _pairs(folder)
    (folder / "splits.txt").write_text("name,split\na,train\n")
    return folder / "splits.txt"


def _read_pairs(file: Path) -> object:
    reader = open_corpus("folder", file.parent, Options())
    return [reader.read(item) for item in reader.items()]


def _ted(folder: Path) -> Path:
    pytest.importorskip("pyarrow", reason="pyarrow is in the extra 'ted'")
    return _written("value", published.ted_value("VIDEO", "100"))(folder)


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


def _glb(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        from small_characters import write_character

        write_character(folder / name, vrm="1.0" if name.endswith(".vrm") else "")
        return folder / name

    return write


def _gltf_text(file: Path) -> bytes:
    """The JSON of a GLB."""
    data = file.read_bytes()
    return data[20:20 + int.from_bytes(data[12:16], "little")]


def _with_gltf_text(file: Path, text: bytes) -> None:
    """A GLB whose JSON was damaged and whose lengths fit."""
    data = file.read_bytes()
    rest = data[20 + int.from_bytes(data[12:16], "little"):]
    text += b" " * (-len(text) % 4)
    size = 20 + len(text) + len(rest)
    file.write_bytes(b"".join((data[:8], size.to_bytes(4, "little"), len(text).to_bytes(4, "little"), data[16:20], text,
                               rest)))


def _read_character(file: Path) -> object:
    from gesticulator.characters.joints import find_joints
    from gesticulator.characters.reading import read_character
    from gesticulator.export.gltf import open_gltf

    file = file.with_suffix(".gltf") if file.suffix == ".bin" else file
    character = read_character(file)
    if file.suffix != ".bvh":
        open_gltf(file).to_bytes()
    return find_joints(character)


def _gltf(damaged: str, beside: bool) -> Callable[[Path], Path]:
    """A character as a .gltf, its buffer and picture in files beside it or as base64 in its text."""
    def write(folder: Path) -> Path:
        glb = _glb("a.glb")(folder)
        document, text = json.loads(_gltf_text(glb)), _gltf_text(glb)
        binary = glb.read_bytes()[28 + len(text):][:document["buffers"][0]["byteLength"]]
        glb.unlink()
        picture = document["images"][0]
        view = document["bufferViews"][picture.pop("bufferView")]
        start = view.get("byteOffset", 0)
        for row, name, data in ((document["buffers"][0], "a.bin", binary),
                                (picture, "a.png", binary[start:start + view["byteLength"]])):
            row["uri"] = name if beside else "data:application/octet-stream;base64," + base64.b64encode(data).decode()
            if beside:
                (folder / name).write_bytes(data)
        (folder / "a.gltf").write_text(json.dumps(document))
        return folder / damaged

    return write


def _mapping(folder: Path) -> Path:
    from gesticulator.characters.joints import find_joints
    from gesticulator.characters.mapping import save_mapping
    from gesticulator.characters.reading import read_character

    character = read_character(_glb("a.glb")(folder))
    save_mapping(folder / "m.json", find_joints(character), character)
    return folder / "m.json"


def _read_mapping(file: Path) -> object:
    from gesticulator.characters.mapping import check, load_mapping
    from gesticulator.characters.reading import read_character

    character = read_character(file.with_name("a.glb"))
    mapping = load_mapping(file, character)
    check(mapping, character)
    return mapping


def _plan(folder: Path) -> Path:
    from test_plan import a_plan

    return _written("a.json", a_plan(6).to_json())(folder)


def _read_plan(file: Path) -> object:
    from gesticulator.plan.plan_file import read_plan

    return read_plan(file).to_json().encode()


def _request(folder: Path) -> Path:
    """A plan as a page sends it, with the head of its request."""
    body = _plan(folder).read_bytes().strip()
    head = ("POST /place/render HTTP/1.1", "Host: 127.0.0.1:1", "Origin: http://127.0.0.1:1",
            "X-Gesticulator-Token: secret", "Content-Type: application/json", f"Content-Length: {len(body) + 9}", "",
            "")
    return _written("a.http", "\r\n".join(head).encode() + b'{"plan":' + body + b"}")(folder)


class _Client:
    """A connection that sent what lies in a file; it keeps what it is sent."""

    def __init__(self, file: Path) -> None:
        self.sent, self.answer = file.read_bytes(), b""

    def makefile(self, *_: object) -> io.BytesIO:
        return io.BytesIO(self.sent)

    def sendall(self, data: bytes) -> None:
        self.answer += data

    def settimeout(self, _: float) -> None:
        """It never waits."""


def _read_request(file: Path) -> object:
    """The answer of a server whose rendering reads the plan; AssertionError where it says that the program failed."""
    from gesticulator.page.server import _PageHandler
    from gesticulator.plan.plan_file import plan_from

    def render(request: dict[str, Any], abandoned: Callable[[], bool], report: Callable[[bytes], object]) -> bytes:
        if not isinstance(request.get("plan"), dict):
            raise InputError("the request", "holds no plan", "send one")
        return json.dumps(plan_from(request["plan"]).to_dict()).encode()

    server = SimpleNamespace(
        server_port=1, token="secret", secret="place", page=b"",
        rendering=threading.Lock(), render=render, abandons=lambda page, number: lambda: False)
    client = _Client(file)
    _PageHandler(client, ("127.0.0.1", 1), server)  # type: ignore[arg-type]
    assert b" 500 " not in client.answer, client.answer[:1000]
    return client.answer


def _manifest(folder: Path) -> Path:
    from gesticulator.batch import ManifestRow, opened_manifest

    with opened_manifest(folder / "m.jsonl") as manifest:
        manifest.add(ManifestRow("a.wav", "12", 3.25, ("x.bvh", "y.glb"), "cut short", 0.125, "1", "2", "3", "h"))
        manifest.add(ManifestRow("b.wav", "13", 1.0, ("b.bvh",)))
    return folder / "m.jsonl"


def _read_manifest(file: Path) -> object:
    """The rows as they would be written."""
    from gesticulator.batch import read_manifest

    return [row.line for row in read_manifest(file).values()]


_KEY = {"study": "s", "systems": ["ours", "truth"], "aspects": ["beat_match"], "clips": [{}],
        "items": {"x": {"clip": 0, "system": "ours"}, "y": {"clip": 0, "system": "truth"}}}
_ANSWERS = {"study": "s", "rater": "1", "answers": [{"item": "x", "ratings": {"beat_match": 3}},
                                                    {"item": "y", "ratings": {"beat_match": 5}}]}


def _study(name: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / "key.json").write_text(json.dumps(_KEY))
        (folder / "1.json").write_text(json.dumps(_ANSWERS))
        return folder / name

    return write


def _read_study(file: Path) -> object:
    from eval.study import anova

    key = anova.read_key(file.with_name("key.json"))
    return anova.read_ratings([file.with_name("1.json")], key)


def _lips(folder: Path) -> Path:
    from gesticulator.face.lips import SHIPPED

    for file in SHIPPED.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder / "face.json"


def _read_lips(file: Path) -> object:
    from gesticulator.face.lips import load_weights

    return load_weights(file.parent)


def _read_tables(file: Path) -> object:
    from eval import table

    return table.load(file)


def _read_words_of_a_command(file: Path) -> object:
    """Each line of the file as what a user writes on a command line."""
    from data_module.controls import Levels
    from data_module.settings import with_settings
    from gesticulator.batch import parse_shard
    from gesticulator.gesticulator import hand_target
    from gesticulator.jobs import _cue, _seconds
    from gesticulator.live.vmc import read_target
    from gesticulator.options import RANGES
    from interpreters.settings import LstmConfig

    levels = Levels(np.zeros((3, 3)), np.zeros(3), np.ones(3))
    lines = file.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    readers: tuple[Callable[[str], object], ...] = (
        read_target, parse_shard, _cue, lambda text: with_settings(LstmConfig(), [text]),
        lambda text: RANGES["seed"].parse("--seed", text), lambda text: RANGES["temperature"].parse("-t", text),
        _seconds, lambda text: hand_target("--height", text, "height", levels))
    refusals = []
    for read, line in zip(readers, lines, strict=False):
        try:
            read(line)
        except InputError as error:
            refusals.append(str(error))
    return refusals


def _read_message(file: Path) -> object:
    from gesticulator.live.protocol import read_hello, read_message

    text = file.read_bytes().decode("utf-8", "replace")
    return read_message(text), read_hello(text)


def _read_sound_message(file: Path) -> object:
    from gesticulator.live.protocol import StreamRequest

    return [StreamRequest(RATE, format).samples(file.read_bytes()) for format in ("pcm16", "float32")]


def _read_token(file: Path) -> object:
    from argparse import Namespace

    from gesticulator.live.command import read_token

    return read_token(Namespace(token_file=file, no_token=False, host="0.0.0.0"))


def _results(folder: Path) -> Path:
    from test_table import ABOUT, TABLE

    from eval.table import save

    save([TABLE], folder / "t.json", ABOUT)
    return folder / "t.json"


READERS: dict[str, Case] = {
    **{kind: Case(_sound(kind, subtype), load_speech, examples=share)
       # MP3 takes a process each.
       for kind, subtype, share in (("WAV", "PCM_16", 1), ("FLAC", "PCM_16", 1), ("OGG", "VORBIS", 1),
                                    ("AIFF", "PCM_16", 1), ("MP3", None, 0.2))},
    **{suffix: Case(_container(suffix, kind, codec), load_speech)
       for suffix, kind, codec in (("m4a", "mp4", "aac"), ("webm", "webm", "libopus"), ("mkv", "matroska", "flac"))},
    "sound from a pipe": Case(_sound("WAV", "PCM_16"), _read_pipe),
    "bvh": Case(_bvh, lambda file: skeletons.to_character(read_bvh(file))),
    "bvh, the hierarchy": Case(_bvh, read_hierarchy),
    "smplx, the archive": Case(_smplx, lambda file: skeletons.to_character(read_smplx(file))),
    **{f"smplx, {name}": Case(_smplx, lambda file: (skeletons.to_character(read_smplx(file)), read_npz(file)),
                              _member(f"{name}.npy"), _with_member(f"{name}.npy"))
       for name in _SMPLX},
    "eye's space": Case(_space, ReferenceSpace.load, _member("mean.npy"), _with_member("mean.npy"), 0.5),
    "eye's space, the archive": Case(_space, ReferenceSpace.load, examples=0.5),
    "published network": Case(_published_network, lambda file: published_network(file.parent), examples=0.5),
    **{f"transcript {suffix}": Case(_written(f"a{suffix}", text), lambda file: read_transcript(file, _SPEECH))
       for suffix, text in TRANSCRIPTS.items()},
    **{f"transcript of {name}": Case(_written(f"a{suffix}", write(MARKED)), lambda file: read_transcript(file, _SPEECH),
                                     examples=0.3)
       for name, (suffix, write) in recogniser_samples.FILES.items()},
    "store, listing": Case(_store("store.json"), _read_store),
    "store, edited listing": Case(_store("store.json"), _read_store, packed=_with_fingerprint),
    "store, sound": Case(_store("recordings/a.flac"), _read_store, packed=_with_hash(Path.write_bytes)),
    **{f"store, {name}": Case(_store("recordings/a.npz"), _read_store, _member(f"{name}.npy"),
                              _with_hash(_with_member(f"{name}.npy")))
       for name in ("rotations", "fps", "joints", "word_text")},
    "foreign positions": Case(_positions("a.npy"), foreign.read_motion),
    "foreign sidecar": Case(_positions("a.json"), lambda file: foreign.read_motion(file.with_suffix(".npy"))),
    "foreign points": Case(_points, foreign.read_motion),
    "ratings": Case(_written("people.json", '{"N": 72.0, "A": 60}'), read_ratings),
    "folder, NAME.json": Case(_pairs, _read_pairs),
    "folder, its splits": Case(_folder_splits, lambda file: open_corpus("folder", file.parent,
                                                                        FolderOptions(split=str(file))).items()),
    "beat2, its list": Case(published.listed_beat2, lambda file: open_corpus("beat2", file.parent, Options()).items()),
    "genea, its metadata": Case(_genea, lambda file: open_corpus("genea", file.parent, Options()).items()),
    "ted, a value": Case(_ted, lambda file: deserialise(file.read_bytes(), source=file)),
    "bundle, index": Case(_bundle("bundle.json"), _read_bundle),
    "bundle, weights": Case(_bundle("generator.safetensors"), _read_bundle),
    "bundle, weights and their hash": Case(_bundle("generator.safetensors"), _read_bundle, packed=_with_index),
    "glb character": Case(_glb("a.glb"), _read_character),
    "glb character, its JSON": Case(_glb("a.glb"), _read_character, _gltf_text, _with_gltf_text, 2.0),
    "vrm character, its JSON": Case(_glb("a.vrm"), _read_character, _gltf_text, _with_gltf_text),
    "gltf character, data in its text": Case(_gltf("a.gltf", beside=False), _read_character),
    "gltf character, files beside it": Case(_gltf("a.gltf", beside=True), _read_character),
    "gltf character, the file beside it": Case(_gltf("a.bin", beside=True), _read_character, examples=0.5),
    "bvh character": Case(_bvh, _read_character),
    "mapping": Case(_mapping, _read_mapping),
    "plan": Case(_plan, _read_plan),
    "fingerprint in a plan": Case(_written("a.txt", fingerprint_text(np.random.default_rng(0).integers(
        0, 16, (40, 12), dtype=np.uint8))), lambda file: fingerprint_frames(file.read_text("latin-1"))),
    "request to the server of a page": Case(_request, _read_request, examples=2.0),
    "manifest": Case(_manifest, _read_manifest),
    **{f"study {name}": Case(_study(name), _read_study) for name in ("key.json", "1.json")},
    "weights of the lips": Case(_lips, _read_lips),
    "table of results": Case(_results, _read_tables),
    "words of a command": Case(_written("a.txt", "\n".join((
        "127.0.0.1:39539", "2/8", "hello:2=wave", "width=30", "7", "1.5", "3.2-5.0", "0.2"))),
                               _read_words_of_a_command, examples=2.0),
    "message of a client": Case(_written("a.json", json.dumps({
        "type": "hello", "protocol": 1, "sample_rate": 16000, "format": "pcm16", "fps": 30, "seed": 4,
        "options": {"speaker": "ann", "temperature": 1.0}})), _read_message),
    "sound of a client": Case(_written("a.raw", _noise(0.05).astype("<f4").tobytes()), _read_sound_message),
    "token": Case(_written("a.txt", "secret\n"), _read_token),
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


def _exchanged(pattern: re.Pattern[bytes], others: Sequence[bytes]) -> Callable[..., None]:
    """A value becomes another where one stands."""
    def damage(data: bytearray, a: float, b: float, choice: int) -> None:
        found = list(pattern.finditer(bytes(data[:200_000])))
        if found:
            match = found[int(a * len(found)) % len(found)]
            data[match.start():match.end()] = others[choice % len(others)]

    return damage


def _swapped(data: bytearray, a: float, b: float, choice: int) -> None:
    """Two pieces change places."""
    first, last = sorted((int(a * len(data)), int(b * len(data))))
    size = min(1 << choice, last - first, len(data) - last)
    data[first:first + size], data[last:last + size] = data[last:last + size], data[first:first + size]


_TOKEN = re.compile(rb'"(?:[^"\\\\]|\\\\.)*"|-?\d+(?:\.\d+)?|true|false|null')
TOKENS = (b"{}", b"[]", b"[[1]]", b'""', b'"\\u0000"', b'"\\ud800"', b'"\\u001b[2J"', b"true", b"1e400", b"9" * 400,
          b"-1", b"2.5", b"NaN", b"[" * 200 + b"]" * 200, b'{"a": null}', b'"' + b"x" * 5000 + b'"')
_retyped, _renumbered = _exchanged(_TOKEN, TOKENS), _exchanged(_NUMBER, NUMBERS)
DAMAGE = (_swapped, _retyped, _retyped, _flipped, _set, _cut, _inserted, _deleted, _repeated, _renumbered, _renumbered)
_SHARE = st.floats(0, 1, exclude_max=True)


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[Callable[..., None], float, float, int]]:
    one = st.tuples(st.sampled_from(DAMAGE), _SHARE, _SHARE, st.integers(0, 15))
    return draw(st.lists(one, min_size=1, max_size=4))
