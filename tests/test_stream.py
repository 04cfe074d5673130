"""A stream: the same frames as a file for any pieces, no jump at any seam, memory that stays, and an end to a word."""

import gc
import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from performances import system

from data_module.errors import InputError
from data_module.motion.kinematics import positions_of
from data_module.speech.audio import SAMPLE_RATE, load_speech, resample
from data_module.types import Array, Motion, Samples, Speech, Word
from gesticulator.bundle.features import representation_of
from gesticulator.sampling.cutter import BlockCutter
from gesticulator.stream import Stream, StreamFrames, StreamState

EXAMPLE = Path(__file__).parents[1] / "examples" / "speech.flac"
FPS = 60.0
SHORT = 2.83
"""Seconds of the pieces that are fed again and again: nine blocks, and no whole number of frames."""
FASTEST, HARDEST = 3.5, 76.0
"""m/s and m/s^2 that no hand passes at a seam: what strokes do on other voices (2.3 and 35 in the example). A jump of
2.1 cm between two frames would be 76."""
HURRIED = 4.0
"""m/s after hurried blocks: of the few frames of a candidate none is over 3.5 from the one before, but between them a
hand may be a little faster."""
HURRIED_HARDEST = 100.0
"""m/s^2 of one chosen performance with hurried blocks; a jump of 3 cm between two frames would be 108."""
HEAD_FASTEST, HEAD_HARDEST = 0.85, 10.0
"""The same for the head, which does up to .75 and 8 where nothing is changed, waited for or passed over."""


@lru_cache(maxsize=1)
def example() -> Samples:
    return load_speech(EXAMPLE).samples


@lru_cache(maxsize=4)
def from_file(seconds: float) -> Motion:
    return system()(Speech(example()[:round(seconds * SAMPLE_RATE)], SAMPLE_RATE)).motion


def fed(stream: Stream, samples: NDArray, sizes: Sequence[int]) -> list[StreamFrames]:
    """Sound in pieces of these sizes, again and again, without the end."""
    out, at, turn = [], 0, 0
    while at < len(samples):
        size = sizes[turn % len(sizes)]
        out.append(stream.feed(samples[at:at + size]))
        at, turn = at + size, turn + 1
    return out


def joined(parts: Sequence[StreamFrames]) -> Array:
    """[T, J, 4] of parts that follow each other without a gap."""
    first = parts[0].first
    for part in parts:
        assert part.first == first
        first += len(part)
    return np.concatenate([part.rotations for part in parts])


# ---------------------------------------------------------------------------------------------------- as a file

def test_fifteen_seconds_of_speech_in_pieces_are_the_file_to_the_last_bit() -> None:
    sound = example()[:15 * SAMPLE_RATE]
    stream = system().stream()
    # Four seconds as from a microphone, ten at once, and the rest a sample and two ticks at a time.
    parts = [*fed(stream, sound, (*[320] * 200, 10 * SAMPLE_RATE, 1, 1600)), stream.finish()]
    made = system()(Speech(sound, SAMPLE_RATE))
    assert np.array_equal(joined(parts), made.rotations)
    blocks = [block for part in parts for block in part.blocks]
    assert [block.lexeme for block in blocks] == made.lexemes.tolist()
    assert [0.0, *(block.end for block in blocks)] == made.blocks.edges.tolist()


@given(st.lists(st.integers(1, 10 * SAMPLE_RATE), min_size=1, max_size=12))
@settings(max_examples=5, deadline=None)
def test_any_pieces_give_the_same_bytes(sizes: list[int]) -> None:
    # No piece is so small that all are: that is tried below.
    sizes = [*sizes, 4000]
    stream = system().stream()
    parts = [*fed(stream, example()[:round(SHORT * SAMPLE_RATE)], sizes), stream.finish()]
    assert np.array_equal(joined(parts), from_file(SHORT).rotations)


def test_a_call_in_steps_gives_the_same_bytes_a_block_at_a_time() -> None:
    """A conversation as a scheduler takes it, beside one that makes each call at once."""
    sound = example()[:round(2 * SHORT * SAMPLE_RATE)]
    calls: list[tuple[str, Any]] = [("feed", sound[:45_000]), ("idle", 3.1), ("listen", sound[:20_000]),
                                    ("think", 0.7), ("feed", sound[45_000:70_000]), ("pass_over", 1.3),
                                    ("feed", sound[70_000:]), ("interrupt", 9.0), ("idle", 2.0), ("finish", None)]
    whole, stepped = system().stream(seed=3), system().stream(seed=3)
    for call, value in calls:
        given = () if value is None else (value,)
        truth = getattr(whole, call)(*given)
        parts = list(stepped.steps(call, *given))  # type: ignore[arg-type]
        assert all(len(part.blocks) <= 1 for part in parts)
        assert all(len(part) <= 0.7 * FPS for part in parts), "no part is longer than a block and what waited for it"
        assert parts[0].first == truth.first
        np.testing.assert_array_equal(np.concatenate([part.rotations for part in parts]), truth.rotations)
        assert [block for part in parts for block in part.blocks] == list(truth.blocks)
        assert (stepped.time, stepped.made, stepped.state) == (whole.time, whole.made, whole.state)


@pytest.mark.parametrize("asked", [{"legs": True, "fps": 25.0}, {"variation": 2, "hand_height": "low"},
                                   {"interpreter": "statistical", "gain": -6.0}], ids=["legs", "variation", "gain"])
def test_what_is_asked_of_a_file_is_asked_of_a_stream(asked: dict) -> None:
    speech = Speech(example()[:round(SHORT * SAMPLE_RATE)], SAMPLE_RATE)
    stream = system().stream(**asked)
    parts = [*fed(stream, speech.samples, (1234,)), stream.finish()]
    made = system()(speech, **asked).motion
    assert np.array_equal(joined(parts), made.rotations)
    assert np.array_equal(np.concatenate([part.root_positions for part in parts]), made.root_positions)


def test_sound_at_another_rate_and_in_whole_numbers_is_that_of_the_file() -> None:
    faster = resample(Speech(example()[:round(SHORT * SAMPLE_RATE)], SAMPLE_RATE), 44100).samples
    sound = (faster * 32767).astype(np.int16)
    stream = system().stream(44100)
    parts = [*fed(stream, sound, (441, 10000)), stream.finish()]
    assert np.array_equal(joined(parts), system()(sound, 44100).rotations)


def test_words_that_are_known_before_are_those_of_the_file_and_late_ones_do_no_harm() -> None:
    sound = example()[:round(SHORT * SAMPLE_RATE)]
    words = (Word("hello", 0.2, 0.6), Word("there", 0.6, 1.1), Word("friend", 1.4, 2.0))
    whole = system()(Speech(sound, SAMPLE_RATE, words)).rotations
    stream, late = (system().stream(text=True) for _ in range(2))
    stream.add_words(words)
    assert np.array_equal(joined([*fed(stream, sound, (1600,)), stream.finish()]), whole)
    parts = fed(late, sound, (1600,))
    late.add_words(words)
    made = joined([*parts, late.finish()])
    assert made.shape == whole.shape and np.isfinite(made).all()


@pytest.mark.parametrize("latency", ["full", "low"])
def test_no_frame_comes_later_than_is_told(latency: str) -> None:
    stream, sound, late = system().stream(latency=latency), example()[:6 * SAMPLE_RATE], []
    for at in range(0, len(sound), 320):
        part = stream.feed(sound[at:at + 320])
        late += ((at + 320) / SAMPLE_RATE - part.times).tolist()
    assert max(late) <= stream.look_ahead
    assert stream.look_ahead < (1.8 if latency == "full" else 1.1)
    assert np.median(late) < (1.2 if latency == "full" else 0.75)
    assert len(joined([stream.finish()])) > 0 and stream.made == 6 * FPS


def test_low_latency_gives_the_same_bytes_for_any_pieces() -> None:
    sound = example()[:round(SHORT * SAMPLE_RATE)]
    one, other = system().stream(latency="low"), system().stream(latency="low")
    assert np.array_equal(joined([*fed(one, sound, (160,)), one.finish()]),
                          joined([*fed(other, sound, (20000, 3)), other.finish()]))


def test_the_beginning_of_a_foreseen_block_is_enough_for_the_block_before_it() -> None:
    config, given = system().bundle.config, []
    whole = replace(config, generator=replace(config.generator, after_dropout=0.0))  # whose models take it as a guess
    for each in (config, whole):
        cutter = BlockCutter(each)
        cutter.low = True
        given.append(cutter.feed(example()[:6 * SAMPLE_RATE]))
    inside = 2 * config.rhythm.frames
    assert len(given[0]) == len(given[1]) > 12
    for begun, guessed in zip(*given, strict=True):
        assert begun.foreseen and np.array_equal(begun.low[:inside], guessed.low[:inside])
        assert not np.array_equal(begun.low[inside:], guessed.low[inside:])


# ---------------------------------------------------------------------------------------------------- seams

def moves(rotations: Array, stream: Stream) -> dict[str, tuple[Array, Array]]:
    """Speed [T - 1] and acceleration [T - 2] of the hands (the greater) and of the head."""
    motion = Motion(stream.skeleton, rotations, np.zeros((len(rotations), 3)), FPS)
    places, out = positions_of(motion), {}
    for name, joints in (("hands", ("RightHand", "LeftHand")), ("head", ("Head",))):
        at = places[:, [stream.skeleton.index(joint) for joint in joints]]
        speed = np.diff(at, axis=0) * FPS
        harder = np.diff(speed, axis=0) * FPS
        out[name] = (np.linalg.norm(speed, axis=-1).max(-1), np.linalg.norm(harder, axis=-1).max(-1))
    return out


@pytest.mark.parametrize("latency", ["full", "low"])
def test_no_seam_jumps(latency: str) -> None:
    """Speech, a pause in the feed, speech again, thought, another's voice, an answer."""
    sound, step = example(), SAMPLE_RATE // 20
    stream = system().stream(latency=latency)
    parts = fed(stream, sound[:4 * SAMPLE_RATE], (step,))
    assert stream.state == StreamState.SPEAKING
    for wait, state in ((stream.idle, StreamState.IDLE), (stream.think, StreamState.THINKING)):
        for _ in range(24):
            parts.append(wait(0.05))
            assert stream.made == np.ceil(stream.time * FPS - 1e-6), "who idles waits for nothing"
        assert stream.state == state
        parts += fed(stream, sound[4 * SAMPLE_RATE:6 * SAMPLE_RATE], (step,))
    parts += [stream.listen(sound[at:at + step]) for at in range(0, 4 * SAMPLE_RATE, step)]
    assert stream.state == StreamState.LISTENING
    parts += [*fed(stream, sound[8 * SAMPLE_RATE:10 * SAMPLE_RATE], (step,)), stream.finish()]
    made = joined(parts)
    assert len(made) == round((4 + 1.2 + 2 + 1.2 + 2 + 4 + 2) * FPS)
    found = moves(made, stream)
    assert found["hands"][0].max() < FASTEST and found["hands"][1].max() < HARDEST
    assert found["head"][0].max() < HEAD_FASTEST and found["head"][1].max() < HEAD_HARDEST


def test_a_change_of_the_look_ahead_leaves_no_jump_and_no_gap() -> None:
    """From full to low and back, again and again, in the middle of strokes and of idling, beside two streams that never
    change: frames come as late as their mode says, and those before the first change are the same."""
    sound, step = example()[:13 * SAMPLE_RATE], SAMPLE_RATE // 50
    stream, full = system().stream(), system().stream()
    unchanged = joined(fed(full, sound[:4 * SAMPLE_RATE], (step,)))
    longest, least, changes = full.look_ahead, system().stream(latency="low").look_ahead, (2.0, 4.7, 6.1, 8.6, 10.9)
    assert stream.look_ahead == longest > least + 0.4
    parts, late, changed, low = [], {"full": list[float](), "low": list[float]()}, -10.0, False
    for at in range(0, len(sound), step):
        now = at / SAMPLE_RATE
        if sum(change <= now for change in changes) % 2 != low:
            low, changed = not low, now
            stream.latency = "low" if low else "full"
            assert stream.latency == ("low" if low else "full")
        if 7.0 <= now < 7.0 + step / SAMPLE_RATE:  # a break: the next utterance begins in the mode that is set
            parts.append(stream.idle(0.5))
        part = stream.feed(sound[at:at + step])
        parts.append(part)
        came = stream.time - part.times
        assert np.all(came <= longest), "a change back brings no frame too late"
        if now > changed + 0.1:
            late[stream.latency] += came.tolist()
    parts.append(stream.finish())
    made = joined(parts)
    assert len(made) == round(13.5 * FPS)
    before = round((2.0 - longest) * FPS)
    assert before > 10 and np.array_equal(made[:before], unchanged[:before])
    assert max(late["low"]) <= least and np.median(late["full"]) - np.median(late["low"]) > 0.2
    found = moves(made, stream)
    # Within the strokes of these ten seconds it is up to 58 m/s^2 with either look-ahead.
    assert found["hands"][0].max() < FASTEST and found["hands"][1].max() < HURRIED_HARDEST
    assert found["head"][0].max() < HEAD_FASTEST and found["head"][1].max() < HEAD_HARDEST


@pytest.mark.parametrize("latency", ["full", "low"])
def test_what_is_passed_over_leaves_no_jump_and_no_gap(latency: str) -> None:
    """Sound that came too late, in the middle of strokes, for a moment and for long; hurried blocks between."""
    sound, stream, parts, seams = example(), system().stream(latency=latency), [], []
    for at, passed in ((0, 1.3), (4, 0.4), (7, 3.0)):
        parts += fed(stream, sound[at * SAMPLE_RATE:(at + 3) * SAMPLE_RATE], (1600,))
        stream.hurried = True
        parts += fed(stream, sound[(at + 3) * SAMPLE_RATE:(at + 4) * SAMPLE_RATE], (1600,))
        seams.append(stream.made)
        parts.append(stream.pass_over(passed))
        seams.append(stream.made)
        assert stream.state == StreamState.SPEAKING
        assert stream.made == np.ceil(stream.time * FPS - 1e-6), "what is past is given at once"
        stream.hurried = False
    parts += [*fed(stream, sound[10 * SAMPLE_RATE:12 * SAMPLE_RATE], (1600,)), stream.finish()]  # in mid-word
    made = joined(parts)
    assert len(made) == round((3 * 4 + 4.7 + 2) * FPS)
    found = moves(made, stream)
    assert found["hands"][1].max() < HURRIED_HARDEST and found["head"][1].max() < HEAD_HARDEST
    for seam in seams:  # into the pass, and out of it with what is drawn in the second after it
        assert found["hands"][0][seam - 10:seam + 60].max() < HURRIED
        assert found["head"][0][seam - 10:seam + 60].max() < HEAD_FASTEST
    # Who has nothing to say to what she did not hear keeps her hands still: all but the life of them.
    assert found["hands"][0][seams[-1] - 40:seams[-1]].max() < 0.1


def test_who_listens_nods_in_the_pauses_of_the_other() -> None:
    voice = np.concatenate([example()[2 * SAMPLE_RATE:5 * SAMPLE_RATE], np.zeros(SAMPLE_RATE, np.float32)])
    heard, alone = system().stream(), system().stream()
    step = SAMPLE_RATE // 10
    nods = joined([heard.listen(voice[at:at + step]) for at in range(0, len(voice), step)])
    still = joined([alone.idle(0.1) for _ in range(0, len(voice), step)])
    head = heard.skeleton.index("Head")
    apart = 2 * np.degrees(np.arccos(np.clip(np.abs((nods[:, head] * still[:, head]).sum(-1)), 0, 1)))
    assert apart[:int(1.2 * FPS)].max() < 1e-3, "nothing is done to a voice that has not said anything"
    assert apart.max() > 1.5


# ---------------------------------------------------------------------------------------------------- interrupt

@pytest.mark.parametrize("latency", ["full", "low"])
def test_who_is_interrupted_stops_and_lets_the_hands_down(latency: str) -> None:
    """At many moments of a gesture, of hands that hang nearly and of hands that are high and fast; with frames that are
    taken back."""
    rest = resting()
    for at in (1.4, 2.0, 3.1, 4.4, 8.2):
        stream = system().stream(latency=latency)
        parts = fed(stream, example()[:round((at + 1.6) * SAMPLE_RATE)], (1600,))
        stopped = stream.interrupt(at)
        assert stream.state == StreamState.IDLE and stopped.first == np.ceil(at * FPS - 1e-6)
        after = joined([stopped, *(stream.idle(0.1) for _ in range(20))])
        made = np.concatenate([joined(parts)[:stopped.first], after])
        found, frame = moves(made, stream)["hands"], stopped.first
        assert found[0][frame - 3:].max() < FASTEST and found[1][frame - 3:].max() < HARDEST
        motion = Motion(stream.skeleton, made, np.zeros((len(made), 3)), FPS)
        hands = [stream.skeleton.index(side + "Hand") for side in ("Right", "Left")]
        places = positions_of(motion)[:, hands]
        hung = np.linalg.norm(places - rest[hands], axis=-1).max(-1)
        # With full latency more of what was computed stays, as corrections are smoothed into frames that were shown.
        slow = frame + round((0.35 if latency == "full" else 0.3) * FPS)
        # It comes from a raised posture.
        assert found[0][slow] < 0.42, at
        # From there on they go down as evenly as what is left of 1.2 s allows, on arcs that are up to twice as long as
        # the straight way (a hand beside the trunk goes down in front of it): who has less than 0.07 m to go stays
        # under it.
        left = 1.2 - (slow - frame) / FPS
        assert found[0][slow:].max() < max(0.3, 3.78 / left * hung[slow]), at
        down, later = (places[frame + round(seconds * FPS)] for seconds in (1.2, 1.7))
        assert np.abs(down - rest[hands])[:, 1].max() < 0.03, "they are as low as who rests has them"
        assert np.linalg.norm(later - down, axis=-1).max() < 0.04, "what is left is the life of hands that hang"


def resting() -> Array:
    """[J, 3] metres of the joints of who rests."""
    bundle = system().bundle
    pose = bundle.statistics.rest_pose[system().resolver.speaker(None)]
    places: Array = positions_of(representation_of(bundle.config).motion(pose[None], FPS))[0]
    return places


def test_what_was_played_stays_and_speech_goes_on_after_an_interruption() -> None:
    stream, sound = system().stream(legs=True), example()
    before = joined(fed(stream, sound[:5 * SAMPLE_RATE], (8000,)))
    cut = stream.interrupt(2.5)
    again = joined([cut, stream.idle(0.4), *fed(stream, sound[5 * SAMPLE_RATE:8 * SAMPLE_RATE], (8000,)),
                    stream.finish()])
    assert cut.first == 150 and len(again) == round(3.4 * FPS)
    found = moves(np.concatenate([before[:150], again]), stream)["hands"]
    joint = slice(150 - 3, 150 + round((0.4 + 1.0) * FPS))  # the cut, the wait, and the first second of the answer
    assert found[0].max() < FASTEST and found[1][joint].max() < HARDEST
    assert found[1].max() < HURRIED_HARDEST, "strokes that are drawn later are as hard as drawn strokes may be"


# ---------------------------------------------------------------------------------------------------- for ever

@pytest.mark.parametrize("what", ["speech", "idling", "interruptions", "face"])
def test_memory_does_not_grow(what: str) -> None:
    sound = example()[3 * SAMPLE_RATE:4 * SAMPLE_RATE]
    stream, sizes = system().stream(face="full" if what == "face" else "off"), list[int]()
    stream.history = 2.0
    tracemalloc.start()
    try:
        for second in range(16):
            if what == "idling":
                stream.idle(1.0)
            elif what == "interruptions":  # more often than what is remembered lasts
                stream.idle(1.5)
                stream.interrupt(stream.time - 0.5)
            else:
                stream.feed(sound)
            if second in (6, 15):
                gc.collect()
                sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert sizes[1] - sizes[0] < 64_000, "nine seconds more take less than the sound of one of them"


# ---------------------------------------------------------------------------------------------------- bad input

@pytest.mark.parametrize("bad", [np.array([0.0, np.nan]), np.array([np.inf, 0.0]), np.full(100, 1e4),
                                 np.zeros((2, 3, 4)), np.zeros((2, 320)), np.array(["a"]), np.zeros(3, complex)],
                         ids=["nan", "infinite", "loud", "shape", "channels first", "text", "complex"])
def test_what_is_no_sound_is_refused_and_nothing_is_lost(bad: NDArray) -> None:
    sound, stream = example()[:round(SHORT * SAMPLE_RATE)], system().stream()
    parts = fed(stream, sound[:20000], (5000,))
    for take in (stream.feed, stream.listen):
        with pytest.raises(InputError) as caught:
            take(bad)
        assert "\n" not in str(caught.value)
    parts += [*fed(stream, sound[20000:], (5000,)), stream.finish()]
    assert np.array_equal(joined(parts), from_file(SHORT).rotations)


def test_other_mistakes_are_told_in_a_line() -> None:
    g = system()
    for rate in (0, -1, 10, 1e9, float("nan"), 16000.5):
        with pytest.raises(InputError, match="sample_rate"):
            g.stream(rate)
    with pytest.raises(InputError, match="latency"):
        g.stream(latency="none")
    with pytest.raises(InputError, match="words"):
        g.stream().add_words([Word("a", 0.0, 1.0)])
    with pytest.raises(InputError, match="no samples"):
        g.stream().finish()
    stream = g.stream()
    for seconds in (-1.0, float("nan"), 1e6):
        with pytest.raises(InputError, match="seconds"):
            stream.idle(seconds)
        with pytest.raises(InputError, match="interrupt"):
            stream.interrupt(seconds)
    stream.idle(0.5)
    stream.finish()
    for ask in (stream.finish, stream.interrupt, lambda: stream.idle(1.0), lambda: stream.pass_over(1.0),
                lambda: stream.feed(np.zeros(3))):
        with pytest.raises(InputError, match="finished"):
            ask()
