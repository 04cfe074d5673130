"""What the tools do: perform a recording or a text, edit its plan, render it, each as files of one folder.

Recordings, transcripts and characters are read wherever they lie; results are written into the folder alone.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from gesticulator.gesticulator import Gesticulator
from gesticulator.plan.gestures import REPERTOIRE, mark_of
from gesticulator.plan.plan import GestureCue, GesturePlan, edited_blocks
from gesticulator.plan.plan_file import plan_from, read_plan, write_plan_file

LONGEST_TEXT = 5000
"""Characters of a text that is spoken: about five minutes."""


@dataclass(frozen=True)
class Result:
    """What a tool made. speech: path of the sound; files: suffix -> path; page: address of the page that plays it;
    plan: path of the plan; seconds: of the sound; gestures: the named ones that are made, with their word or the time
    of their stroke; notes: remarks."""

    speech: str
    files: dict[str, str]
    page: str
    plan: str
    seconds: float
    gestures: list[dict[str, Any]]
    notes: list[str]


class Studio:
    """The tools' state: a folder for results, and the models, which are loaded by the first call. One call at a time:
    a second one waits."""

    def __init__(self, folder: Path, bundle: str | None = None, voice: str = "en-us") -> None:
        self.folder, self.voice, self._bundle, self._turn = folder.absolute(), voice, bundle, threading.Lock()

    @cached_property
    def gesticulator(self) -> Gesticulator:
        """The models."""
        return Gesticulator.from_pretrained(self._bundle)

    def perform(self, speech: str, text: str, character: str, formats: Sequence[str], options: Mapping[str, Any],
                name: str = "") -> Result:
        """Gestures for a recording, or for a text, which espeak-ng speaks. options: fields of `InferenceOptions`."""
        if not speech and not text:
            raise InputError("perform", "has neither speech nor text", "give a sound file, a text, or both")
        title = self._named(name or (Path(speech).stem if speech else text[:40]))
        with self._turn:
            sound = Path(speech) if speech else self._spoken(text, title)
            return self._made(sound, title, character, formats, text=text or None, **options)

    def render(self, plan: str, speech: str, character: str, formats: Sequence[str]) -> Result:
        """An edited plan on its sound."""
        with self._turn:
            title = self._named(Path(plan).name.removesuffix(".plan.json"))
            return self._made(Path(speech), title, character, formats, plan=read_plan(plan))

    def edit_plan(self, plan: str, add: Sequence[Mapping[str, Any]], remove: Sequence[str],
                  knobs: Mapping[str, Any]) -> dict[str, Any]:
        """A new plan file with gestures added and removed and with other knobs; what it holds.

        add: gestures at a word or a time (`GestureCue`). remove: names of gestures, or words at which one is made.
        knobs: members of `PlanKnobs`. `InputError` for what a plan cannot hold, and for a removal of nothing.
        """
        old = read_plan(plan)
        gone = {name for name in remove for entry in (*old.cues, *old.meanings) if name in (entry.gesture, entry.word)}
        if missing := set(remove) - gone:
            raise InputError(plan, f"has no gesture of or at {min(missing)!r}", "name one of its cues or meanings")
        rest = {kind: tuple(entry for entry in getattr(old, kind) if not gone & {entry.gesture, entry.word})
                for kind in ("cues", "meanings")}
        cues = (*rest.pop("cues"), *(GestureCue(**cue) for cue in add))
        edited = replace(old, **rest, cues=cues, knobs=replace(old.knobs, **knobs))
        # Read back from plain values: every range is checked as it is for a file.
        checked, target = plan_from(edited.to_dict(), "the edited plan"), self._next(Path(plan))
        write_plan_file(target, checked)
        return {"plan": str(target), "gestures": gestures_of(checked), "knobs": asdict(checked.knobs),
                "blocks_generated_again": sum(edited_blocks(checked)), "blocks": len(checked.blocks)}

    def _made(self, sound: Path, title: str, character: str, formats: Sequence[str], **options: Any) -> Result:
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("ignore")
            for module in ("data_module", "gesticulator"):
                warnings.filterwarnings("always", module=module)
            performance = self.gesticulator(sound, **options, legs=True)
            if character:
                performance = performance.on(character)
        files = {suffix: str(performance.save(self.folder / f"{title}.{suffix}"))
                 for suffix in dict.fromkeys(kind.lstrip(".") for kind in (*formats, "html"))}
        plan = write_plan_file(self.folder / f"{title}.plan.json", performance.plan())
        notes = [*performance.decided.notes, *dict.fromkeys(str(remark.message) for remark in remarks)]
        return Result(str(sound), files, Path(files["html"]).as_uri(), str(plan), round(performance.duration, 2),
                      gestures_of(performance.decided), notes)

    def _spoken(self, text: str, title: str) -> Path:
        from data_module.text.marks import marked_text

        program = shutil.which("espeak-ng")
        if program is None:
            raise InputError("text", "needs a voice, and espeak-ng is not installed", "install it, or give a recording")
        if len(text) > LONGEST_TEXT:
            raise InputError("text", f"is longer than {LONGEST_TEXT} characters", "cut it into parts")
        target = self.folder / f"{title}.wav"
        self.folder.mkdir(parents=True, exist_ok=True)
        words = marked_text(text)[0]
        done = subprocess.run([program, "-v", self.voice, "-w", str(target), "--", words], capture_output=True,
                              text=True, timeout=120, check=False)
        if done.returncode:
            raise InputError("espeak-ng", f"failed ({done.stderr.strip()[:200]})", "name another --voice")
        return target

    def _named(self, text: str) -> str:
        """A file name within the folder."""
        return re.sub(r"[^\w-]+", "-", text.lower()).strip("-")[:60] or "talk"

    def _next(self, plan: Path) -> Path:
        """The file of the next version of a plan, in the folder: talk.plan.json, talk-2.plan.json, ..."""
        stem = re.sub(r"-\d+$", "", self._named(plan.name.removesuffix(".plan.json")))
        number = 2
        while (target := self.folder / f"{stem}-{number}.plan.json").exists():
            number += 1
        return target


def gestures_of(plan: GesturePlan) -> list[dict[str, Any]]:
    """The named gestures of a plan: those of its cues, and those that its words call for."""
    return [{"gesture": entry.gesture, "word": entry.word, "time": entry.time}
            for entry in (*plan.cues, *plan.meanings) if entry.gesture]


def listed(search: str) -> list[dict[str, Any]]:
    """The repertoire, or what of it has a word of `search` in its name or meaning."""
    words = search.lower().split()
    return [{"name": gesture.name, "meaning": gesture.meaning, "hands": gesture.hands, "mark": mark_of(gesture.name),
             "common": gesture.core, "offensive": gesture.offensive} for gesture in REPERTOIRE.values()
            if not words or any(word in f"{gesture.name} {gesture.meaning}".lower() for word in words)]
