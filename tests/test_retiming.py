"""A plan goes along when its sound is exported again: blocks stay as they were decided where their beats still fit."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st
from performances import EXAMPLE, example

from data_module.errors import InputError
from data_module.speech.audio import amplified, load_speech, resample, write_flac
from data_module.speech.sound_map import SoundMap, Stretch
from data_module.types import Speech, Word
from gesticulator import Gesticulator, infer
from gesticulator.editing.moved_beats import BeatMap
from gesticulator.plan import plan as plans
from gesticulator.plan.plan import GesturePlan
from gesticulator.plan.plan_file import parse_plan

PAUSE = 4.6
"""Seconds: the middle of the pause from 4.2 to 5.1 s."""
FRAME = 0.01
"""Seconds between the spectra by which onsets are found."""


@pytest.fixture(scope="module")
def speech() -> Speech:
    return example(9.0)


@pytest.fixture(scope="module")
def plan(system: Gesticulator, speech: Speech) -> GesturePlan:
    words = tuple(Word(text, start, start + 0.3) for text, start in (("one", 1.0), ("two", 6.5), ("one", 8.0)))
    made = system(replace(speech, words=words), seed=1, cues=(
        plans.GestureCue("wave", time=2.0), plans.GestureCue("nod", "one", 2), plans.GestureCue("shrug", "two")))
    return parse_plan(made.plan().to_json())


def joined(*parts: np.ndarray) -> Speech:
    return Speech(np.concatenate(parts).astype(np.float32), 16000)


def piece(speech: Speech, start: float, end: float | None = None) -> np.ndarray:
    return speech.samples[round(start * 16000):None if end is None else round(end * 16000)]


def other_voice(seconds: float) -> np.ndarray:
    """Other speech: a later part of the example, backwards and a third higher."""
    samples, _ = soundfile.read(EXAMPLE, start=20 * 16000, frames=round(seconds * 20000), dtype="float32")
    return np.interp(np.arange(0, len(samples) - 1, 1.25), np.arange(len(samples)), samples[::-1])


def mp3(speech: Speech) -> Speech:
    memory, copy = io.BytesIO(), resample(speech, 44100)
    soundfile.write(memory, copy.samples, 44100, format="MP3", subtype="MPEG_LAYER_III")
    memory.seek(0)
    return load_speech(memory)


def starts(plan: GesturePlan) -> np.ndarray:
    return np.array([block.start for block in plan.blocks])


def decisions(plan: GesturePlan) -> list[tuple[object, ...]]:
    return [(block.lexeme, block.silent, block.draw, block.locked, block.intensity) for block in plan.blocks]


@pytest.mark.parametrize("export", ["quieter", "at another rate", "as MP3"])
def test_an_export_of_the_same_sound_keeps_every_block(system: Gesticulator, speech: Speech, plan: GesturePlan,
                                                       export: str) -> None:
    new = {"quieter": lambda: amplified(speech, -6.0), "at another rate": lambda: resample(speech, 48000),
           "as MP3": lambda: mp3(speech)}[export]
    found = system.retimed(plan, new())
    assert decisions(found.plan) == decisions(plan) and not found.anew and not found.losses
    np.testing.assert_allclose(starts(found.plan), starts(plan), atol=1e-6)
    assert found.plan.drawn.lexemes == plan.drawn.lexemes and not any(plans.edited_blocks(found.plan))
    assert parse_plan(found.plan.to_json()) == found.plan


def test_the_very_same_sound_leaves_the_plan(system: Gesticulator, speech: Speech, plan: GesturePlan) -> None:
    found = system.retimed(plan, speech)
    assert found.plan is plan and found.kept == len(plan.blocks)


@pytest.mark.parametrize("seconds", [0.3, 0.307])
def test_what_follows_a_shortened_pause_moves_by_the_cut_and_no_lexeme_changes(
        system: Gesticulator, speech: Speech, plan: GesturePlan, seconds: float) -> None:
    found = system.retimed(plan, joined(piece(speech, 0, PAUSE), piece(speech, PAUSE + seconds)))
    assert decisions(found.plan) == decisions(plan) and not found.dropped
    before, after = starts(plan) <= 4.2, starts(plan) >= 5.1
    np.testing.assert_allclose(starts(found.plan)[before], starts(plan)[before], atol=1e-6)
    np.testing.assert_allclose(starts(found.plan)[after], starts(plan)[after] - seconds, atol=FRAME)
    pause = ~before & ~after
    shifts = (starts(found.plan) - starts(plan))[pause]
    assert (np.diff(shifts) <= 1e-6).all() and -seconds - FRAME <= shifts.min() and shifts.max() <= 1e-6
    assert found.plan.cues == (plan.cues[0], plan.cues[1], plan.cues[2])
    assert [word.start for word in found.plan.words] == pytest.approx([1.0, 6.5 - seconds, 8.0 - seconds], abs=FRAME)


def test_silence_before_the_sound_moves_all_and_is_all_that_is_new(system: Gesticulator, speech: Speech,
                                                                   plan: GesturePlan) -> None:
    found = system.retimed(plan, joined(np.zeros(16000), speech.samples))
    new = len(found.plan.blocks) - len(plan.blocks)
    assert decisions(found.plan)[new:] == decisions(plan)
    np.testing.assert_allclose(starts(found.plan)[new:], starts(plan) + 1.0, atol=FRAME)
    assert found.anew == new and found.plan.blocks[new].start == pytest.approx(1.0, abs=FRAME)
    names = {entry.lexeme: entry.name for entry in found.plan.lexicon}
    for block in found.plan.blocks[:new]:
        assert block.silent and block.name == names[block.lexeme] and len(block.alternatives) == 5
    assert len(set(found.plan.drawn.numbers)) == len(found.plan.blocks)
    assert not any(plans.edited_blocks(found.plan))


def test_only_the_blocks_of_another_sentence_are_decided_anew(system: Gesticulator, speech: Speech, plan: GesturePlan
                                                              ) -> None:
    begin, end, longer = 5.5, 7.5, 0.6
    found = system.retimed(plan, joined(piece(speech, 0, begin), other_voice(end - begin + longer), piece(speech, end)))
    kept = {block.draw.block: block for block in found.plan.blocks if block.draw.block < len(plan.blocks)}
    for at, block in enumerate(plan.blocks):
        if block.end <= begin - 0.1:
            assert kept[at].lexeme == block.lexeme and kept[at].end == pytest.approx(block.end, abs=1e-6)
        elif block.start >= end + 0.1:
            assert kept[at].lexeme == block.lexeme and kept[at].start == pytest.approx(block.start + longer, abs=FRAME)
        elif begin + 0.1 < block.start and block.end < end - 0.1:
            assert at not in kept
    anew = [block for block in found.plan.blocks if block.draw.block >= len(plan.blocks)]
    assert begin - 0.5 < anew[0].start < begin + 0.3 and end + longer - 0.3 < anew[-1].end < end + longer + 0.5
    assert any('shrug at "two"' in line for line in found.losses)
    assert [word.text for word in found.plan.words] == ["one", "one"]
    made = system(joined(piece(speech, 0, begin), other_voice(end - begin + longer), piece(speech, end)),
                  plan=found.plan)
    assert made.plan().drawn == found.plan.drawn
    assert [block.lexeme for block in made.plan().blocks] == [block.lexeme for block in found.plan.blocks]


def test_edits_locks_pins_and_curves_go_along_or_are_reported(system: Gesticulator, speech: Speech, plan: GesturePlan
                                                              ) -> None:
    blocks = list(plan.blocks)
    last = len(blocks) - 3
    moved = blocks[last].end - 0.04
    blocks[3] = replace(blocks[3], locked=True, intensity=1.5)
    blocks[last - 2] = replace(blocks[last - 2], lexeme=3)
    blocks[last], blocks[last + 1] = replace(blocks[last], end=moved), replace(blocks[last + 1], start=moved)
    edited = replace(
        plan, blocks=tuple(blocks), pins=(plans.PosePin(3.0, "Head", position=(0.0, 1.6, 0.0)), plans.PosePin(
            7.0, "RightHand", position=(0.1, 1.2, 0.3), hold=0.5)),
        curves=(plans.KnobCurve("intensity", (1.0, 7.0), (1.0, 0.5)),), meanings=(plans.PlanMeaning(6.0, 6.5, "size"),),
        knobs=replace(plan.knobs, hold_still=((7.5, 8.0),)))
    found = system.retimed(edited, joined(piece(speech, 0, PAUSE), piece(speech, PAUSE + 0.3)))
    assert decisions(found.plan) == decisions(edited)
    assert plans.edited_blocks(found.plan) == plans.edited_blocks(edited)
    assert found.plan.blocks[last].end == pytest.approx(moved - 0.3, abs=FRAME)
    assert [pin.time for pin in found.plan.pins] == pytest.approx([3.0, 6.7], abs=FRAME)
    assert found.plan.pins[1].hold == pytest.approx(0.5)
    assert found.plan.curves[0].times == pytest.approx((1.0, 6.7), abs=FRAME)
    assert found.plan.knobs.hold_still[0] == pytest.approx((7.2, 7.7), abs=FRAME)
    assert found.plan.meanings[0].start == pytest.approx(5.7, abs=FRAME)
    gone = system.retimed(edited, joined(piece(speech, 0, 5.5)))
    assert [pin.time for pin in gone.plan.pins] == [3.0] and gone.plan.blocks[3].locked
    assert any("pin of RightHand at 7.00 s" in line for line in gone.losses)
    assert any(line.startswith("the edit of the block") for line in gone.losses)


def test_another_recording_and_a_plan_without_its_sound_are_refused(system: Gesticulator, speech: Speech,
                                                                    plan: GesturePlan) -> None:
    with pytest.raises(InputError, match="% of its speech; give another export of it"):
        system.retimed(plan, joined(other_voice(8.0)))
    quieter = amplified(speech, -3.0)
    with pytest.raises(InputError, match="is missing"):
        system.retimed(replace(plan, fingerprint=None), quieter)
    foreign = replace(plan, made_by={**plan.made_by, "bundle": {"lexicon": "other"}})
    with pytest.raises(InputError, match="another bundle"):
        system.retimed(foreign, quieter)


def test_the_command_moves_a_plan_renders_it_and_writes_the_report(
        system: Gesticulator, speech: Speech, plan: GesturePlan, tmp_path: Path, refused: Callable[..., str],
        capfd: pytest.CaptureFixture[str]) -> None:
    sound, out, given = tmp_path / "new.flac", tmp_path / "new.json", tmp_path / "plan.json"
    write_flac(sound, joined(piece(speech, 0, PAUSE), piece(speech, PAUSE + 0.3)))
    given.write_text(plan.to_json())
    command = [str(sound), "--plan", str(given), "-o", str(tmp_path / "a.bvh"), "--plan-out", str(out)]
    assert "add --retime" in refused("infer", *command)
    assert "give the plan" in refused("infer", sound, "-o", tmp_path / "a.bvh", "--retime")
    assert infer.main([*command, "--retime"]) == 0
    assert f"re-timed: {len(plan.blocks)} blocks kept, 0 decided anew" in capfd.readouterr().out
    assert infer.main([str(sound), "--plan", str(out), "-o", str(tmp_path / "b.bvh"), "--quiet"]) == 0
    assert (tmp_path / "a.bvh").read_bytes() == (tmp_path / "b.bvh").read_bytes()


@given(st.lists(st.tuples(st.floats(0.5, 5.0), st.floats(0.0, 2.0), st.floats(0.0, 2.0)), min_size=1, max_size=5),
       st.integers(0, 2**32 - 1))
def test_moved_times_never_go_back(parts: list[tuple[float, float, float]], seed: int) -> None:
    """Whatever was cut and added between stretches: [length, seconds that are gone, seconds that are new]."""
    time = there = 0.0
    stretches = [Stretch(np.array([-0.02]), np.array([-0.02]))]
    for length, gone, new in parts:
        stretches.append(Stretch(np.array([time, time + length]), np.array([there, there + length])))
        time, there = time + length + gone + 0.02, there + length + new + 0.02
    stretches.append(Stretch(np.array([time]), np.array([there])))
    rng = np.random.default_rng(seed)
    edges = np.cumsum([0.0, *rng.uniform(0.2, 0.5, int(time / 0.3) + 1)])
    flags = tuple(rng.choice(["onset", "even_pseudo"], len(edges) - 1).tolist())
    drawn = plans.DrawnBlocks(tuple(edges.tolist()), flags, (False,) * len(flags), (0,) * len(flags), plans.PlanKnobs())
    frames = [rng.integers(0, 16, (int(end * 50) + 2, 12), dtype=np.uint8) for end in (time, there)]
    beats = BeatMap(SoundMap(*frames, tuple(stretches), 1.0), drawn, np.sort(rng.uniform(0, there, 20)))
    times = np.sort(rng.uniform(0, time, 60))
    moved = [beats.anywhere(one) for one in times.tolist()]
    assert (np.diff(moved) >= -1e-9).all()
    for one in times.tolist():
        place, moment = beats.place(one), beats.moment(one)
        assert place is None or place.end <= place.start + 1e-9
        assert moment is None or -0.1 <= moment <= there + 0.1
