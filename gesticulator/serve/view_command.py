"""`gesticulator view talk.flac`: a page that shows the performance and edits it, with the models behind it."""

from __future__ import annotations

import argparse
import threading
import webbrowser
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from gesticulator.arguments import asked_controls, check_choices, performance_arguments
from gesticulator.batch.jobs import STDIN, Job
from gesticulator.batch.one import load, performed
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator
    from gesticulator.plan.plan import GesturePlan
    from gesticulator.serve.edits import LivePlans
    from gesticulator.serve.page_server import PageServer

SHOWN = (".glb", ".gltf", ".vrm")
"""Files that the page can show as a character."""


def arguments(p: argparse.ArgumentParser) -> None:
    """Add what the command takes."""
    p.usage = f"{p.prog} SPEECH [options]"
    p.add_argument("speech", nargs="*", metavar="SPEECH", help="an audio file, as for gesticulator infer")
    page = p.add_argument_group("page")
    page.add_argument("--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: any free one)")
    page.add_argument("--no-browser", action="store_true", help="print the address instead of opening a window")
    page.add_argument("--beside", choices=INTERPRETERS, metavar="NAME", help="a second take beside it, whose lexemes "
                      f"this interpreter chooses: {', '.join(INTERPRETERS)}")
    performance_arguments(p)


def run(asked: argparse.Namespace) -> int:
    """Serve until the user ends it."""
    from gesticulator.serve.page_server import PageServer

    job = _job(asked)
    check_choices(asked)
    with PageServer(asked.port) as server, our_warnings(), limited_threads(int(asked.threads)):
        _prepare(server, job, asked)
        _serve(server, asked)
    return 0


def _job(asked: argparse.Namespace) -> Job:
    """The one recording; `InputError` for what is known to be wrong before anything is loaded."""
    from data_module.speech.audio import check_file

    if len(asked.speech) != 1:
        given = f"names {len(asked.speech)} recordings" if asked.speech else "is missing"
        raise InputError("speech", given, f"name one sound file; see {PROGRAM} view --help")
    if asked.speech[0] == STDIN:
        raise InputError("standard input", "cannot be viewed", "name a sound file")
    if asked.list:
        raise InputError("--list", f"is of {PROGRAM} infer", "leave it out")
    if asked.plan is not None and asked.beside is not None:
        raise InputError("--beside", "draws another take, and --plan replays one", "leave one of them out")
    if asked.character is not None and Path(asked.character).suffix.lower() not in SHOWN:
        raise InputError(asked.character, "cannot be shown by the page", f"give one of {', '.join(SHOWN)}")
    check_file(Path(asked.speech[0]), asked.any_length)
    return Job(Path(asked.speech[0]), text=None if asked.text is None else Path(asked.text))


def _prepare(server: PageServer, job: Job, asked: argparse.Namespace) -> None:
    """Perform the recording, once or twice, and give the server its page and what renders edited plans."""
    from gesticulator.export import html
    from gesticulator.pipeline import Gesticulator
    from gesticulator.serve.edits import LivePlans

    character, stands = _character(asked)
    system = Gesticulator.from_pretrained(asked.bundle)
    takes = _takes(system, job, asked, asked.legs or stands)
    first = next(iter(takes.values()))
    plans = LivePlans(system, first)
    assert job.source is not None
    more = {"live": {"token": server.token}, **character}
    server.page = html.page({name: take.scene() for name, take in takes.items()}, html.title_of(job.source),
                            together=len(takes) > 1, more=more).encode()
    server.render = plans.answer
    # While the page opens: what edits start from is drawn, which takes as long as the takes themselves did.
    threading.Thread(target=_prepare_edits, args=(server, plans, [take.plan() for take in takes.values()]),
                     daemon=True).start()


def _prepare_edits(server: PageServer, plans: LivePlans, of: list[GesturePlan]) -> None:
    with server.rendering:
        for plan in of:
            plans.prepare(plan)


def _character(asked: argparse.Namespace) -> tuple[dict[str, Any], bool]:
    """The members of the page's data about the character that is asked for, and whether she stands on her legs."""
    if asked.character is None:
        return {}, False
    from gesticulator.characters.frames import measure
    from gesticulator.characters.reading import choose
    from gesticulator.export.html import character_data

    character, mapping = choose(asked.character, asked.mapping, asked.save_mapping)
    joints = {joint: character.node_ids[node] for joint, node in mapping.named().items()}
    sits = asked.seated or (not asked.legs and measure(character, mapping).sits)
    return character_data(character.path, joints), mapping.legs and not sits


def _takes(system: Gesticulator, job: Job, asked: argparse.Namespace, legs: bool) -> dict[str, Performance]:
    """What each take is called -> its performance."""
    controls, speech = asked_controls(system, asked), load(job, asked)
    first = performed(job, speech, system, asked, controls, legs)
    first = first.labelled(job.name, first.notes)
    name = first.decided.interpreter
    if asked.beside is None:
        return {name: first}
    # Words whose times were found once are not sought again.
    speech, job = replace(speech, words=first.speech.words), replace(job, text=None)
    other = argparse.Namespace(**{**vars(asked), "interpreter": asked.beside})
    second = performed(job, speech, system, other, controls, legs).labelled(job.name, first.notes)
    return {name: first, asked.beside if asked.beside != name else f"{name} again": second}


def _serve(server: PageServer, asked: argparse.Namespace) -> None:
    print(f"{server.url}  (Ctrl C ends it)", flush=True)
    if not asked.no_browser:
        webbrowser.open(server.url)
    with suppress(KeyboardInterrupt):
        server.serve_forever()
    # What is being rendered ends first: a thread that is stopped within torch ends the process with a crash.
    server.rendering.acquire()


COMMAND = Command(
    "open a page that plays a performance and edits its plan", arguments, run,
    examples=(
        "view talk.flac",
        "view talk.flac --text talk.txt --character rig.vrm",
        "view talk.flac --plan talk.plan.json",
        "view talk.flac --interpreter lstm --beside advantage --port 8123 --no-browser",
    ))
