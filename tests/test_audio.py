"""Reading recordings: every format, and everything that can be wrong with one."""

from __future__ import annotations

import io
import sys
import warnings
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from data_module.errors import InputError, install_line
from data_module.speech import audio
from data_module.types import Samples, Speech
from gesticulator.infer import level_note, music_note

SPEECH = Path(__file__).parents[1] / "examples" / "speech.flac"
FORMATS = [("wav", "WAV", "PCM_16"), ("flac", "FLAC", "PCM_16"), ("ogg", "OGG", "VORBIS"), ("mp3", "MP3", None)]


def tone(rate: int, seconds: float = 2.0, hertz: float = 440.0) -> Samples:
    return (0.3 * np.sin(2 * np.pi * hertz * np.arange(round(rate * seconds)) / rate)).astype(np.float32)


def check_tone(speech: Speech, apart: float) -> None:
    """It is of 440 Hz and 0.3 of full scale, to the share `apart`."""
    middle = speech.samples[4000:28000].astype(np.float64)
    spectrum = np.abs(np.fft.rfft(middle * np.hanning(len(middle))))
    assert abs(np.argmax(spectrum) * audio.SAMPLE_RATE / len(middle) - 440.0) < 1.0
    assert np.sqrt(np.mean(middle ** 2)) == pytest.approx(0.3 / np.sqrt(2), rel=apart)


def encoded(samples: np.ndarray, rate: int, kind: str = "WAV", subtype: str | None = "PCM_16") -> bytes:
    memory = io.BytesIO()
    soundfile.write(memory, samples, rate, format=kind, subtype=subtype)
    return memory.getvalue()


def put(folder: Path, name: str, data: bytes) -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        audio.load_speech(path)
    line = str(caught.value)
    assert "\n" not in line
    assert path.name in line
    for word in words:
        assert word in line


def test_twenty_decibels_are_ten_times_the_amplitude_in_a_file_and_in_a_stream() -> None:
    wave = 0.05 * np.sin(np.arange(16000, dtype=np.float32) / 7)
    np.testing.assert_allclose(audio.amplified(Speech(wave, 16000), 20.0).samples, 10 * wave, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(audio.amplified(Speech(wave, 16000), -20.0).samples, wave / 10, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(audio.SampleFeed(16000, 20.0).take(wave), 10 * wave, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(("kind", "half"), [(np.int16, 2**14), (np.int32, 2**30), (np.uint8, 64)])
def test_half_of_full_scale_is_a_half_whatever_the_type(kind: type, half: int) -> None:
    middle = 128 if kind is np.uint8 else 0
    samples = np.tile(np.array([middle + half, middle - half], kind), 4000)
    for found in (audio.as_speech(samples, 16000).samples, audio.SampleFeed(16000).take(samples)):
        np.testing.assert_allclose(found.reshape(-1, 2), [[0.5, -0.5]] * 4000)


@pytest.mark.parametrize(("offset", "moved"), [(0.2, True), (-0.02, True), (0.005, False), (0.0, False)])
def test_a_zero_line_that_is_off_is_moved_to_0_and_any_other_stays_to_the_bit(tmp_path: Path, offset: float,
                                                                              moved: bool) -> None:
    wave = (tone(16000) + offset).astype(np.float32)
    path = put(tmp_path, "a.wav", encoded(wave, 16000, subtype="FLOAT"))
    for found in (audio.load_speech(path).samples, audio.as_speech(wave, 16000).samples):
        np.testing.assert_allclose(found, tone(16000) if moved else wave, rtol=0, atol=2e-5 if moved else 0)


@pytest.mark.parametrize(("suffix", "kind", "subtype"), FORMATS)
@pytest.mark.parametrize("rate", [8000, 11025, 16000, 24000, 44100, 48000])
@pytest.mark.parametrize("channels", [1, 2])
def test_a_tone_keeps_its_pitch_length_and_level_in_every_format(
        tmp_path: Path, suffix: str, kind: str, subtype: str | None, rate: int, channels: int) -> None:
    sound = np.repeat(tone(rate)[:, None], channels, axis=1)
    path = put(tmp_path, f"a.{suffix}", encoded(sound, rate, kind, subtype))
    speech = audio.load_speech(path)
    assert speech.sample_rate == audio.SAMPLE_RATE
    assert speech.words is None
    assert abs(speech.duration - 2.0) < 0.002
    check_tone(speech, 0.03)


def test_flac_round_trip_is_exact_to_16_bits(tmp_path: Path) -> None:
    noise = (0.2 * np.random.default_rng(0).standard_normal(16000)).astype(np.float32)
    audio.write_flac(tmp_path / "a.flac", Speech(noise, audio.SAMPLE_RATE))
    assert np.abs(audio.load_speech(tmp_path / "a.flac").samples - noise).max() <= 1.0 / 32768
    assert [path.name for path in tmp_path.iterdir()] == ["a.flac"]


def test_what_is_no_sound_is_refused_in_one_line(tmp_path: Path) -> None:
    random = np.random.default_rng(0).bytes(80000)
    refused(tmp_path / "missing.wav", "does not exist")
    refused(tmp_path, "is a folder")
    refused(put(tmp_path, "empty.wav", b""), "empty")
    refused(put(tmp_path, "text.wav", b"not a sound at all\n" * 100), "decoded")
    refused(put(tmp_path, "text.mp3", b"not a sound at all\n" * 100), "decoded")
    refused(put(tmp_path, "random.mp3", b"\xff\xfb" + random), "decoded")
    refused(put(tmp_path, "a.raw", random), "decoded")
    refused(put(tmp_path, "header.wav", encoded(tone(16000), 16000)[:30]), "decoded")


def test_samples_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    refused(put(tmp_path, "none.wav", encoded(tone(16000)[:0], 16000)), "no samples")
    refused(put(tmp_path, "short.wav", encoded(tone(16000, 0.29), 16000)), "0.29 s", "0.3 s")
    audio.load_speech(put(tmp_path, "enough.wav", encoded(tone(16000, 0.3), 16000)))
    for value in (np.nan, np.inf):
        sound = tone(48000, 4.0)
        sound[round(48000 * 3.2):] = value
        refused(put(tmp_path, "nan.wav", encoded(sound, 48000, subtype="FLOAT")), "not a number", "at 3.2 s")
        feed = audio.SampleFeed(48000)
        feed.take(sound[:48000 * 3])
        with pytest.raises(InputError, match=r"not a number .* at 3.2 s"):
            audio.as_speech(sound, 48000)
        with pytest.raises(InputError, match=r"not a number .* at 3.2 s"):
            feed.take(sound[48000 * 3:])
    refused(put(tmp_path, "big.wav", encoded(tone(16000) * 30000, 16000, subtype="FLOAT")), "full scale")
    refused(put(tmp_path, "slow.wav", encoded(tone(500, 9.0), 500)), "500 samples per second")


@pytest.mark.parametrize(("suffix", "kind", "subtype"), FORMATS)
@pytest.mark.parametrize("share", [0.5, 0.9])
def test_a_cut_file_is_refused_where_its_header_says_so_and_else_read_as_far_as_it_goes(
        tmp_path: Path, suffix: str, kind: str, subtype: str | None, share: float) -> None:
    noise = (0.1 * np.random.default_rng(0).standard_normal(44100 * 4)).astype(np.float32)
    whole = encoded(noise, 44100, kind, subtype)
    cut = put(tmp_path, f"cut.{suffix}", whole[:int(len(whole) * share)])
    if suffix == "flac":
        refused(cut, "copy it again")
    else:
        # OGG gives whole pages alone, and each frame of an MP3 needs the one before it.
        assert audio.load_speech(cut).duration == pytest.approx(4.0 * share, abs=0.01 if suffix == "wav" else 0.5)


@pytest.mark.parametrize("tag", [b"", b"ID3\4\0\0\0\0\1\x48" + bytes(200)])
@pytest.mark.parametrize("behind", [b"", b"TAG" + bytes(125), b"APETAGEX" + bytes(4000), b"\xff\xf3\x18\xc4\0"])
def test_an_mp3_is_read_to_its_end_whatever_its_first_frame_tells_of_the_others(tmp_path: Path, tag: bytes,
                                                                                 behind: bytes) -> None:
    """A variable bit rate without a count, whose first frames are the largest; and two files that were joined."""
    rng = np.random.default_rng(0)
    counted = encoded(np.concatenate([0.5 * rng.uniform(-1, 1, 4000), tone(16000, 6.0)]), 16000, "MP3", None)
    assert audio.load_speech(put(tmp_path, "a.mp3", tag + counted)).duration == pytest.approx(6.25, abs=0.01)
    uncounted = counted[counted.index(counted[:2], 4):]
    assert b"Info" not in uncounted and b"Xing" not in uncounted
    for data, seconds in ((tag + uncounted + behind, 6.25), (2 * (tag + counted) + behind, 12.5)):
        assert audio.load_speech(put(tmp_path, "b.mp3", data)).duration == pytest.approx(seconds, abs=0.4)


def test_a_flac_without_a_length_is_read_to_its_end(tmp_path: Path) -> None:
    data = bytearray(encoded(tone(16000), 16000, "FLAC"))
    data[21] &= 0xF0
    data[22:26] = bytes(4)
    assert np.allclose(audio.load_speech(put(tmp_path, "a.flac", bytes(data))).samples, tone(16000), atol=1e-4)


@pytest.mark.parametrize("size", [0, 0x7FFFFFDB, 0x7FFFFFFF, 0xFFFFFFFF, 2_000_000_000, 200_000])
@pytest.mark.parametrize(("kind", "extra"), [("WAV", 0), ("WAV", 2000), ("WAVEX", 0), ("WAVEX", 90)])
def test_sizes_that_recorders_leave_behind_mean_the_bytes_that_are_there(tmp_path: Path, size: int, kind: str,
                                                                       extra: int) -> None:
    """extra: bytes of a chunk of notes before the samples."""
    whole = encoded(tone(16000), 16000, kind)
    data = bytearray(whole)
    place = data.find(b"data")
    data[4:8] = data[place + 4:place + 8] = size.to_bytes(4, "little")
    if extra:
        data[place:place] = b"LIST" + extra.to_bytes(4, "little") + b"INFO" + bytes(extra - 4)
    speech = audio.load_speech(put(tmp_path, "a.wav", bytes(data)))
    assert np.array_equal(speech.samples, audio.load_speech(put(tmp_path, "b.wav", whole)).samples)


# ---------------------------------------------------------------------------------------------------- channels

def voice(seconds: float = 2.0, seed: int = 0) -> Samples:
    """Noise that comes and goes four times a second, as syllables do."""
    time = np.arange(round(48000 * seconds)) / 48000
    noise = np.random.default_rng(seed).standard_normal(len(time))
    return (0.05 * noise * np.maximum(0.0, np.sin(2 * np.pi * 4 * time))).astype(np.float32)


HUM = (0.05 * np.sin(2 * np.pi * 50 * np.arange(96000) / 48000)).astype(np.float32)


@pytest.mark.parametrize(("columns", "taken"), [
    ([voice(), -voice()], 0), ([0.9 * voice(), -voice()], 1), ([voice() + HUM, HUM - voice()], 0),
    ([0 * HUM, voice(), -voice(), 0 * HUM], 1),
    ([voice(2, 1), voice(2, 2), 0.3 * voice(), HUM, 0 * HUM, 0 * HUM], 2), ([4 * HUM, voice()], 1),
    # What a mean does not harm stays one: the same in all, another one in each, one side alone, a quiet centre.
    ([voice(), voice()], None), ([voice(), voice(2, 1)], None), ([0 * HUM, voice()], None),
    ([voice(), voice(), 0.1 * voice(2, 1), HUM, voice(), voice()], None),
])
def test_the_channel_with_the_speech_is_taken_where_a_mean_would_lose_it(tmp_path: Path, columns: list[Samples],
                                                                          taken: int | None) -> None:
    sound = np.stack(columns, axis=1)
    expected = sound.mean(axis=1) if taken is None else sound[:, taken]
    path = put(tmp_path, "a.wav", encoded(sound, 48000, subtype="FLOAT"))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = [audio.load_speech(path), audio.resample(audio.as_speech(sound, 48000), audio.SAMPLE_RATE)]
    for speech in found:
        same = audio.resample(Speech(expected, 48000), audio.SAMPLE_RATE)
        np.testing.assert_allclose(speech.samples, same.samples, atol=2e-5)
    lines = [str(remark.message) for remark in said]
    assert len(lines) == (0 if taken is None else 2)
    assert all(f"channel {(taken or 0) + 1} is taken of {len(columns)}," in line for line in lines)


# ---------------------------------------------------------------------------------------------------- streams

@pytest.mark.parametrize(("suffix", "kind", "subtype"), FORMATS)
def test_a_stream_is_read_as_a_file_is(tmp_path: Path, suffix: str, kind: str, subtype: str | None) -> None:
    data = encoded(tone(44100), 44100, kind, subtype)
    path = put(tmp_path, f"a.{suffix}", data)
    expected = audio.load_speech(path).samples

    class Pipe(io.RawIOBase):
        def __init__(self) -> None:
            self.rest = data

        def readable(self) -> bool:
            return True

        def readinto(self, target: Any) -> int:
            count = min(len(target), 1000, len(self.rest))
            target[:count], self.rest = self.rest[:count], self.rest[count:]
            return count

    with path.open("rb") as file:
        for stream in (io.BytesIO(data), io.BufferedReader(Pipe()), file):
            assert np.array_equal(audio.load_speech(stream).samples, expected)


# ---------------------------------------------------------------------------------------------------- containers

CONTAINERS = [("m4a", "mp4", "aac"), ("mp4", "mp4", "aac"), ("mov", "mov", "pcm_s16le"), ("webm", "webm", "libopus"),
              ("mkv", "matroska", "flac"), ("avi", "avi", "pcm_s16le"), ("aac", "adts", "aac"), ("wtv", "wtv", "mp2"),
              ("mxf", "mxf_opatom", "pcm_s16le")]


def contained(samples: Samples, kind: str, codec: str, rate: int = 48000, picture: bool = False, late: float = 0.0,
              **options: str) -> bytes:
    """Sound, [n] or [n, channels], in a container, with a video of black pictures when asked."""
    av = pytest.importorskip("av", reason="PyAV is in the extra 'video'")
    memory = io.BytesIO()
    with av.open(memory, "w", format=kind, options=options) as file:
        if picture:
            video = file.add_stream("mpeg4", rate=25)
            video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        stream = file.add_stream(codec, rate=rate)
        stream.layout = layout = {1: "mono", 6: "5.1", 8: "7.1"}[samples[:1].size or 1]
        if picture:
            for number in range(round(25 * (late + len(samples) / rate))):
                frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))
                frame.pts = number
                for packet in video.encode(frame):
                    file.mux(packet)
            for packet in video.encode(None):
                file.mux(packet)
        for start in range(0, len(samples), 4096):
            part = (32767 * samples[start:start + 4096]).astype(np.int16).reshape(1, -1)
            frame = av.AudioFrame.from_ndarray(part, format="s16", layout=layout)
            frame.sample_rate, frame.pts = rate, start + round(late * rate)
            frame.time_base = Fraction(1, rate)
            for packet in stream.encode(frame):
                file.mux(packet)
        for packet in stream.encode(None):
            file.mux(packet)
    return memory.getvalue()


@pytest.mark.parametrize(("kind", "codec"), [("ac3", "ac3"), ("eac3", "eac3"), ("wav", "flac"), ("wav", "ac3"),
                                             ("mpegts", "aac"), ("vob", "ac3"), ("amr", "amr_nb"), ("rm", "real_144"),
                                             ("w64", "pcm_f32le"), ("flv", "aac"), ("wav", "pcm_mulaw"),
                                             ("wav", "libmp3lame"), ("wv", "wavpack"), ("tta", "tta"),
                                             ("voc", "pcm_s16le")])
def test_sound_is_found_by_content_whatever_holds_it_and_whenever_its_clock_starts(tmp_path: Path, kind: str,
                                                                                 codec: str) -> None:
    rate = 8000 if codec in ("pcm_mulaw", "amr_nb", "real_144") else 48000
    data = contained(tone(rate), kind, codec, rate=rate, picture=kind == "vob")
    speech = audio.load_speech(put(tmp_path, "a.sound", data))
    assert abs(speech.duration - 2.0) < 0.09
    check_tone(speech, 0.2 if kind == "amr" else 0.1)  # its filters are for voices


@pytest.mark.parametrize("suffix", ["ul", "mulaw", "alaw"])
def test_what_telephones_record_has_no_header_and_is_told_by_its_name(tmp_path: Path, suffix: str) -> None:
    data = encoded(tone(8000), 8000, "RAW", "ALAW" if suffix == "alaw" else "ULAW")
    check_tone(audio.load_speech(put(tmp_path, f"a.{suffix}", data)), 0.05)


@pytest.mark.parametrize(("kind", "codec", "centre"), [("ogg", "libopus", 1), ("ogg", "flac", 2), ("mp4", "aac", 2)])
@pytest.mark.parametrize("channels", [6, 8])
def test_the_centre_is_found_in_every_order_of_channels(tmp_path: Path, kind: str, codec: str, centre: int,
                                                        channels: int) -> None:
    data = contained(np.outer(tone(48000), np.arange(channels) == 2), kind, codec)
    said = f"channel {centre + 1} is taken of {channels}, of which it is the centre"
    with pytest.warns(audio.SoundWarning, match=said):
        check_tone(audio.load_speech(put(tmp_path, "a.sound", data)), 0.1)


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_what_a_browser_records_has_no_length_and_is_read_to_its_end_or_a_cut(tmp_path: Path, share: float) -> None:
    data = contained(tone(48000, 6.0), "webm", "libopus", live="1")  # no duration, clusters of unknown size
    speech = audio.load_speech(put(tmp_path, "rec.webm", data[:round(share * len(data))]))
    assert speech.duration == pytest.approx(6.0 * share, abs=0.1 if share == 1.0 else 0.3)
    check_tone(speech, 0.05)


def test_a_codec_that_cannot_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = contained(tone(48000), "wav", "flac")
    monkeypatch.setitem(sys.modules, "av", None)
    refused(put(tmp_path, "a.wav", data), "codec", "PyAV")


@pytest.mark.parametrize(("suffix", "kind", "codec", "picture"), [
    *[(*row, False) for row in CONTAINERS],
    *[(*row, True) for row in CONTAINERS if row[0] in ("mp4", "mov", "mkv", "avi")]])
def test_sound_in_containers_and_of_videos(tmp_path: Path, suffix: str, kind: str, codec: str, picture: bool) -> None:
    path = put(tmp_path, f"a.{suffix}", contained(tone(48000), kind, codec, picture=picture))
    speech = audio.load_speech(path)
    assert abs(speech.duration - 2.0) < 0.06
    check_tone(speech, 0.05)
    with path.open("rb") as file:
        assert np.array_equal(audio.load_speech(file).samples, speech.samples)


def test_sound_that_begins_late_in_a_video_begins_late(tmp_path: Path) -> None:
    path = put(tmp_path, "a.mov", contained(tone(48000), "mov", "pcm_s16le", picture=True, late=0.5))
    samples = audio.load_speech(path).samples
    assert np.abs(samples[:7900]).max() < 1e-3 < np.abs(samples[8100:8200]).max()
    assert len(samples) == pytest.approx(40000, abs=200)


def test_ogg_streams_in_a_row_are_one_sound(tmp_path: Path) -> None:
    """As a radio station sends them, and as the answers of a speech synthesiser are joined."""
    data = contained(tone(48000), "ogg", "libopus") + contained(tone(48000, 1.0), "ogg", "libopus")
    check_tone(speech := audio.load_speech(put(tmp_path, "a.ogg", data)), 0.05)
    assert speech.duration == pytest.approx(3.0, abs=0.1)


def test_of_several_tracks_the_first_is_taken_which_is_said(tmp_path: Path) -> None:
    data = contained(tone(48000), "matroska", "flac")
    av = pytest.importorskip("av")
    with av.open(io.BytesIO(data)) as old, av.open(str(tmp_path / "two.mkv"), "w") as new:
        tracks = [new.add_stream_from_template(old.streams.audio[0]) for _ in range(2)]
        for packet in old.demux(audio=0):
            if packet.dts is not None:
                packet.stream = tracks[0]
                new.mux(packet)
    with pytest.warns(audio.SoundWarning, match="has 2 tracks of sound, of which the first is taken"):
        check_tone(audio.load_speech(tmp_path / "two.mkv"), 0.05)


def test_videos_that_cannot_be_used_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = (0.1 * np.random.default_rng(0).standard_normal(48000 * 4)).astype(np.float32)
    whole = contained(noise, "matroska", "flac")
    refused(put(tmp_path, "head.mkv", whole[:60]))
    refused(put(tmp_path, "none.mp4", contained(tone(48000)[:0], "mp4", "aac")), "")
    late = contained(noise, "mov", "pcm_s16le")
    refused(put(tmp_path, "index.mov", late[:len(late) // 2]), "decoded")
    # The index first, as for the web, and the sound cut off behind it.
    av = pytest.importorskip("av")
    place = str(tmp_path / "whole.mov")
    with av.open(io.BytesIO(late)) as old, av.open(place, "w", options={"movflags": "faststart"}) as new:
        stream = new.add_stream_from_template(old.streams.audio[0])
        for packet in old.demux(audio=0):
            if packet.dts is not None:
                packet.stream = stream
                new.mux(packet)
    fast = (tmp_path / "whole.mov").read_bytes()
    refused(put(tmp_path, "fast.mov", fast[:len(fast) // 2]), "is cut short", "of the 4.00 s")
    monkeypatch.setitem(sys.modules, "av", None)
    refused(put(tmp_path, "a.mkv", whole), "PyAV", install_line("video"))


# ---------------------------------------------------------------------------------------------------- level

def test_a_recording_that_is_too_low_is_told_its_gain() -> None:
    rng = np.random.default_rng(0)
    loud = (np.repeat(rng.random(40) < 0.6, 4000) * rng.standard_normal(160_000) * 0.05).astype(np.float32)
    assert level_note(Speech(loud, 16000)) is None
    for gain in (-30, -46):
        note = str(level_note(Speech(loud * np.float32(10 ** (gain / 20)), 16000)))
        # Loud frames are at -26 dBFS, the usual level, so the gain is what was lost.
        assert f"at {-26 + gain} dBFS" in note and f"--gain {-gain}" in note
    assert "silence" in str(level_note(Speech(np.zeros(16000, np.float32), 16000)))


def test_music_is_told_and_speech_is_not() -> None:
    time = np.arange(96_000) / 16000
    chord = sum(np.sin(2 * np.pi * note * part * time) / part for note in (220, 277, 330) for part in range(1, 9))
    music = (0.05 * chord * np.exp(-2.0 * (time % 0.5))).astype(np.float32)
    assert "steady tones" in str(music_note(Speech(music, 16000)))
    assert music_note(audio.load_speech(SPEECH)) is None and music_note(Speech(voice(), 48000)) is None


def _warned(folder: Path, samples: Samples, rate: int = 16000) -> list[str]:
    path = put(folder, "a.wav", encoded(samples, rate))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        audio.load_speech(path)
    return [str(remark.message) for remark in said]


def test_what_harms_a_recording_is_said_and_a_good_one_passes_in_silence(tmp_path: Path) -> None:
    samples = audio.load_speech(SPEECH).samples
    samples = samples / np.abs(samples).max()
    assert _warned(tmp_path, samples) == _warned(tmp_path, 0.3 * samples) == _warned(tmp_path, tone(16000)) == []
    for level in (1.0, 0.4):  # cut off by the recorder, and made quieter afterwards
        line, = _warned(tmp_path, level * np.clip(6 * samples, -1, 1).astype(np.float32))
        assert "a.wav: is clipped" in line
    assert _warned(tmp_path, samples, 8000) == []
    line, = _warned(tmp_path, samples, 5512)
    assert "5512 samples per second" in line
