"""The cost of edits of a plan: `python benchmarks/editing.py [--minutes 10] [--speech FILE ...] [--text FILE]
[--legs standing|seated] [--local]`.

Processor time from the page's request to its answer (`EditSession.answer`), in the order of an editor's session: after
twenty edits of all kinds, a swap costs what it cost at first. With --minutes, the recordings are repeated up to that
length.
"""

from __future__ import annotations

import argparse
import copy
import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
import torch

from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.types import Speech
from gesticulator import Gesticulator
from gesticulator.export.html import describe
from gesticulator.page.session import EditSession

ROOT = Path(__file__).resolve().parents[1]
Plain = dict[str, Any]


@dataclass
class Editor:
    """A page's side of edits, which prints a row of the table for each edit with a name."""

    session: EditSession
    plan: Plain
    have: int

    def edit(self, what: str, plan: Plain) -> None:
        """Send a plan."""
        request = {"have": self.have, "plan": plan}
        begin = time.process_time()
        answer = self.session.answer(request)
        seconds = time.process_time() - begin
        header = json.loads(answer[4:4 + int.from_bytes(answer[:4], "little")])
        if what:
            print(f"| {what} | {seconds:.3f} | {header['range'][1] - header['range'][0]:,} |", flush=True)
        self.have, self.plan = header["rendering"], header["plan"]

    def changed(self, what: str, change: Callable[[list[Plain], Plain], None]) -> None:
        """Edit a copy of the present plan."""
        plan = copy.deepcopy(self.plan)
        change(plan["blocks"], plan)
        self.edit(what, plan)


def _swap(at: int) -> Callable[[list[Plain], Plain], None]:
    return lambda blocks, plan: blocks[at].update(lexeme=(blocks[at]["lexeme"] + 7) % 200)


def _delete(at: int) -> Callable[[list[Plain], Plain], None]:
    def delete(blocks: list[Plain], plan: Plain) -> None:
        blocks[at].update(end=blocks[at + 1]["end"], flag=blocks[at + 1]["flag"])
        del blocks[at + 1]

    return delete


def _move(at: int) -> Callable[[list[Plain], Plain], None]:
    def move(blocks: list[Plain], plan: Plain) -> None:
        middle = (blocks[at]["start"] + 2 * blocks[at]["end"]) / 3
        blocks[at].update(end=middle, flag="edited")
        blocks[at + 1]["start"] = middle

    return move


def _knob(**values: Any) -> Callable[[list[Plain], Plain], None]:
    return lambda blocks, plan: plan["knobs"].update(values)


def session(editor: Editor, local: bool = False) -> None:
    """The edits of the table. local: those of blocks alone."""
    count = len(editor.plan["blocks"])
    at = [count * part // 20 for part in range(1, 20)]
    editor.changed("first swap", _swap(at[9]))
    before = editor.plan
    editor.changed("swap", _swap(at[3]))
    editor.edit("undo", before)
    editor.changed("silence", lambda blocks, plan: blocks[at[4]].update(silent=not blocks[at[4]]["silent"]))
    editor.changed("mirror", lambda blocks, plan: blocks[at[5]].update(mirror=True))
    editor.changed("smaller", lambda blocks, plan: blocks[at[6]].update(intensity=0.5))
    editor.changed("named gesture", lambda blocks, plan: plan.update(cues=[{"gesture": "wave",
                                                                           "time": blocks[at[7]]["end"]}]))
    editor.changed("delete a beat", _delete(at[8]))
    editor.changed("move a beat", _move(at[11]))
    editor.changed("pin a hand", lambda blocks, plan: plan.update(pins=[{
        "time": blocks[at[12]]["start"], "joint": "LeftHand", "position": [0.25, 1.25, 0.3]}]))
    for number in range(12):
        editor.changed("", _swap(at[number]))
    editor.changed("swap after 20 edits", _swap(at[13]))
    before = editor.plan
    editor.changed("swap at the start", _swap(2))
    editor.edit("undo", before)
    if local:
        return
    for name, value, other in (("intensity", 1.5, 1.0), ("activity", 0.5, 1.0)):
        editor.changed(f"{name} {value} of the whole take", _knob(**{name: value}))
        editor.changed(f"swap under {name} {value}", _swap(at[14]))
        editor.changed(f"{name} {other} again", _knob(**{name: other}))
    before = editor.plan
    speakers = [name for name in editor.session.speakers if name != before["speaker"]]
    settings = {**before["made_by"]["settings"], "legs": "standing"}
    for what, parts in {
            "another performer": {"speaker": speakers[0]}, "another variation": {"variation": before["variation"] + 1},
            "a curve of the hands' height": {"curves": [{"knob": "height", "times": [0.0, 5.0], "values": [0.1, 0.3]}]},
            "another interpreter": {"interpreter": "statistical"},
            "legs": {"made_by": {**before["made_by"], "settings": settings}}}.items():
        editor.edit(what, {**editor.plan, **parts})
        editor.edit(f"{what}, undone", before)


def _speech(files: list[Path], minutes: float | None) -> Speech:
    """The recordings one after the other, repeated up to a length."""
    parts = []
    for file in files:
        samples, rate = soundfile.read(file, dtype="float32")
        parts.append(resample(Speech(samples if samples.ndim == 1 else samples.mean(axis=1), rate),
                              SAMPLE_RATE).samples)
    samples = np.concatenate(parts)
    if minutes is not None:
        count = round(60 * minutes * SAMPLE_RATE)
        samples = np.tile(samples, -(-count // len(samples)))[:count]
    return Speech(samples, SAMPLE_RATE)


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    p.add_argument("--speech", type=Path, nargs="+", default=[ROOT / "examples" / "speech.flac"])
    p.add_argument("--text", type=Path, help="what is said")
    p.add_argument("--minutes", type=float, help="length up to which the recordings are repeated")
    p.add_argument("--legs", choices=("standing", "seated"), help="what the character does with its legs all along")
    p.add_argument("--local", action="store_true", help="leave out changes of the whole take")
    asked = p.parse_args()
    torch.set_num_threads(1)
    speech, system = _speech(asked.speech, asked.minutes), Gesticulator.from_pretrained()
    system.keeps_generations = True
    begin = time.process_time()
    first = system(speech, text=asked.text, seed=1, legs=asked.legs == "standing", seated=asked.legs == "seated")
    drawn = time.process_time() - begin
    plan = describe(first.scene())["plan"]
    editing = EditSession(system, first)
    gc.collect()
    gc.freeze()  # as gesticulator view does
    begin = time.process_time()
    editor = Editor(editing, plan, editing.opened(first))
    opened = time.process_time() - begin
    print(f"{speech.duration:.0f} s, {len(plan['blocks'])} blocks; generated in {drawn:.1f} s, "
          f"editable {opened:.2f} s after that")
    print("\n| edit | s | frames sent |\n|---|---|---|")
    session(editor, asked.local)


if __name__ == "__main__":
    main()
