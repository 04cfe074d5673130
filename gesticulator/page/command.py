"""`gesticulator view talk.flac`: a page that plays and edits the performance, with the models as its backend."""

from __future__ import annotations

import argparse
import gc
import json
import tempfile
import webbrowser
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from gesticulator.arguments import (
    check_choices,
    controls_from_args,
    options_from_args,
    performance_arguments,
    print_list,
)
from gesticulator.batch.jobs import STDIN, Job, load, performed, retargeter_for
from gesticulator.cli import PROGRAM, Command, limited_threads, our_warnings
from gesticulator.page.export import exported, formats
from gesticulator.page.saved_edits import SavedEdits, place_of, put_aside, read_saved
from interpreters import INTERPRETERS

if TYPE_CHECKING:
    from gesticulator.characters.rig import Character
    from gesticulator.page.server import PageServer
    from gesticulator.performance import Performance
    from gesticulator.pipeline import Gesticulator

SHOWN = (".glb", ".gltf", ".vrm")
"""Suffixes of characters that the page can show."""


def arguments(p: argparse.ArgumentParser) -> None:
    p.usage = f"{p.prog} SPEECH [options]"
    p.add_argument("speech", nargs="*", metavar="SPEECH", help="an audio file, as for gesticulator infer")
    page = p.add_argument_group("page")
    page.add_argument("--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: any free one)")
    page.add_argument("--no-browser", action="store_true", help="print the address instead of opening a window")
    page.add_argument("--anew", action="store_true", help="begin without the edits that were saved beside the sound")
    page.add_argument("--beside", choices=INTERPRETERS, metavar="NAME", help="a second take beside it, whose lexemes "
                      f"this interpreter chooses: {', '.join(INTERPRETERS)}")
    performance_arguments(p)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from gesticulator.page.page_place import served_again
    from gesticulator.page.server import PageServer

    if args.list:
        from gesticulator.pipeline import Gesticulator

        with limited_threads(int(args.threads)):
            print_list(Gesticulator.from_pretrained(args.bundle), args.list)
        return 0
    job = _job(args)
    check_choices(args)
    assert job.source is not None
    name: str | None = None
    if args.plan is not None or args.beside is not None:  # a page with edits of its own
        server = PageServer(args.port)
    else:
        server, name = served_again(args.port, job.source, args.anew)
    with server, our_warnings(), limited_threads(int(args.threads)):
        _prepare(server, job, args, name)
        _serve(server, args)
    return 0


def _job(args: argparse.Namespace) -> Job:
    """The recording; `InputError` for errors that can be found before loading anything."""
    from data_module.speech.audio import check_file

    if len(args.speech) != 1:
        given = f"names {len(args.speech)} recordings" if args.speech else "is missing"
        raise InputError("speech", given, f"name one sound file; see {PROGRAM} view --help")
    if args.speech[0] == STDIN:
        raise InputError("standard input", "cannot be viewed", "name a sound file")
    if args.plan is not None and args.beside is not None:
        raise InputError("--beside", "draws another take, and --plan replays one", "leave one of them out")
    if args.character is not None and Path(args.character).suffix.lower() not in SHOWN:
        raise InputError(args.character, "cannot be shown by the page", f"give one of {', '.join(SHOWN)}")
    check_file(Path(args.speech[0]), args.any_length)
    return Job(Path(args.speech[0]), text=None if args.text is None else Path(args.text))


def _prepare(server: PageServer, job: Job, args: argparse.Namespace, name: str | None = None) -> None:
    """Generate one or two performances, and give the server its page and the renderer of edited plans. name: of the
    place where browsers keep the edits."""
    from gesticulator.export import html
    from gesticulator.page.session import EditSession, directions_of, levels_of
    from gesticulator.pipeline import Gesticulator

    chosen, stands = _character(args)
    system = Gesticulator.from_pretrained(args.bundle)
    system.keeps_generations = True
    since = _go_on(system, job, args)
    takes = _takes(system, job, args, args.legs or stands)
    session = EditSession(system, *takes.values())
    scenes = {name: take.scene() for name, take in takes.items()}
    numbers = [session.opened(take) for take in takes.values()]
    assert job.source is not None
    live = {"token": server.token, "renderings": numbers, "formats": formats(), "levels": levels_of(system.bundle),
            "directions": directions_of(system), "since": since, **({} if name is None else {"place": name})}
    character = {} if chosen is None else html.character_data(*chosen, next(iter(scenes.values())).face)
    moved = next(iter(takes.values())).retiming
    report = {} if moved is None else {"notice": "The edits were moved onto the new sound. " + " ".join(moved.lines())}
    more = {"live": live, **report, **character}
    server.page = html.page(scenes, html.title_of(job.source), together=len(takes) > 1, more=more).encode()
    if args.beside is None:
        saved = server.saved = SavedEdits(place_of(job.source))
        # What is only tried is not saved.
        session.on_edit = lambda request, plan: None if request.get("trial") else saved.keep(lambda: plan)
    server.render = session.answer
    # What stays for the whole session need not be looked through for garbage, which would delay edits by a third of a
    # second now and then.
    gc.collect()
    gc.freeze()
    server.export = partial(exported, rendered=session.exported, retargeter=retargeter_for(args))
    server.figures = cache(partial(_figures, system, takes))


def _figures(system: Gesticulator, takes: dict[str, Performance]) -> bytes:
    """The figures of the palette as JSON."""
    from gesticulator.page.palette import moving_figures

    speaker = system.speaker_index(next(iter(takes.values())).decided.speaker)
    return json.dumps(moving_figures(system.bundle, speaker)).encode()


def _character(args: argparse.Namespace) -> tuple[tuple[Character, dict[str, int]] | None, bool]:
    """The requested character with our joint -> its node in the file, if any, and whether it stands on its legs."""
    if args.character is None:
        return None, False
    from gesticulator.characters.frames import measure
    from gesticulator.characters.reading import choose

    character, mapping = choose(args.character, args.mapping, args.save_mapping)
    joints = {joint: character.node_ids[node] for joint, node in mapping.named().items()}
    sits = args.seated or (not args.legs and measure(character, mapping).sits)
    return (character, joints), mapping.legs and not sits


def _go_on(system: Gesticulator, job: Job, args: argparse.Namespace) -> float:
    """Let the arguments go on with the edits that were saved beside the sound, if there are any; if the sound was
    exported again since, with those that have a place in it. When they were saved, milliseconds since 1970, or 0."""
    from data_module.speech.audio import SAMPLE_RATE, amplified, resample
    from gesticulator.directing.directions import check_bundle_of, planned
    from gesticulator.options import InferenceOptions
    from gesticulator.plan.plan import sound_hash

    if args.anew or args.plan is not None or args.beside is not None or job.source is None:
        return 0.0
    plan = read_saved(job.source)
    if plan is None:
        return 0.0
    try:
        check_bundle_of(system.bundle, plan)
        given = options_from_args(args, controls_from_args(system, args), args.legs)
        planned(InferenceOptions.of({**given, "plan": plan}))
    except InputError as error:
        put_aside(job.source, str(error))
        return 0.0
    args.plan = str(place_of(job.source))
    speech = resample(amplified(load(job, args), float(plan.made_by.get("settings", {}).get("gain", 0.0))), SAMPLE_RATE)
    args.retime = sound_hash(speech) != plan.sound.sha256
    how = "moved onto the new sound" if args.retime else "opened"
    print(f"{args.plan}: the saved edits are {how}; --anew begins without them", flush=True)
    return place_of(job.source).stat().st_mtime * 1000.0


def _takes(system: Gesticulator, job: Job, args: argparse.Namespace, legs: bool) -> dict[str, Performance]:
    """Name -> performance of each take."""
    controls, speech = controls_from_args(system, args), load(job, args)
    first = performed(job, speech, system, args, controls, legs)
    first = first.labelled(job.name, first.notes)
    if first.retiming is not None:
        print("\n".join(f"  {line}" for line in first.retiming.lines()), flush=True)
    name = first.decided.interpreter
    if args.beside is None:
        return {name: first}
    # Word times are aligned once and reused.
    speech, job = replace(speech, words=first.speech.words), replace(job, text=None)
    other = argparse.Namespace(**{**vars(args), "interpreter": args.beside})
    second = performed(job, speech, system, other, controls, legs).labelled(job.name, first.notes)
    return {name: first, args.beside if args.beside != name else f"{name} again": second}


def _serve(server: PageServer, args: argparse.Namespace) -> None:
    print(f"{server.url}  (Ctrl C ends it)", flush=True)
    with tempfile.TemporaryDirectory(prefix="gesticulator-") as folder:
        if not args.no_browser:
            webbrowser.open(_way_in(Path(folder), server.url))
        with suppress(KeyboardInterrupt):
            server.serve_forever()
    if server.saved is not None:
        server.saved.save()
    server.rendering.acquire()  # after the one that is running
    server.settle()


def _way_in(folder: Path, url: str) -> str:
    """The address of a file that leads to the page: a browser's command line can be read by all users of the machine,
    a file in a folder of one's own cannot."""
    file = folder / "open.html"
    file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><title>gesticulator</title>')
    return file.as_uri()


COMMAND = Command(
    "open a page that plays a performance and edits its plan", arguments, run,
    examples=(
        "view talk.flac",
        "view talk.flac --text talk.txt --character rig.vrm",
        "view talk.flac --plan talk.plan.json",
        "view talk.flac --interpreter lstm --beside advantage --port 8123 --no-browser",
    ))
