"""`gesticulator view talk.flac`: a page that plays and edits the performance, with the models as its backend."""

from __future__ import annotations

import argparse
import gc
import json
import signal
import tempfile
import webbrowser
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError, complain
from data_module.files import opened, write_text
from gesticulator.cli import Command, limited_threads, our_warnings
from gesticulator.infer import Worker, load
from gesticulator.jobs import Job, RunSettings, performance_arguments, run_settings_of, settings_of

if TYPE_CHECKING:
    from gesticulator.characters.rig import Character
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.page.server import PageServer
    from gesticulator.plan.plan import GesturePlan

ENDING = ".edits.plan.json"
"""Ending of the plan file beside `talk.wav` to which the edits are saved, `talk.wav.edits.plan.json`."""
SHOWN = (".glb", ".gltf", ".vrm")
"""Suffixes of characters that the page can show."""


def arguments(p: argparse.ArgumentParser) -> None:
    p.usage = f"{p.prog} SPEECH [options]"
    p.add_argument("speech", metavar="SPEECH", type=Path, help="an audio file, as for gesticulator infer")
    page = p.add_argument_group("page")
    page.add_argument("--port", type=int, default=0, metavar="N", help="port on 127.0.0.1 (default: any free one)")
    page.add_argument("--no-browser", action="store_true", help="print the address instead of opening a window")
    performance_arguments(p)
    p.set_defaults(face="full")  # what somebody looks at should look back


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from gesticulator.page.server import PageServer

    settings = run_settings_of(args)
    job = _job(args)
    # The port comes first: one that is taken is found before the models load.
    with PageServer(args.port) as server, our_warnings(), limited_threads(settings.threads):
        _prepare(server, job, settings)
        _serve(server, args.no_browser)
        server.rendering.acquire()  # a rendering that is under way ends first
    return 0


def _job(args: argparse.Namespace) -> Job:
    """The recording; `InputError` for errors that can be found before loading anything."""
    if args.character is not None and Path(args.character).suffix.lower() not in SHOWN:
        raise InputError(args.character, "cannot be shown by the page", f"give one of {', '.join(SHOWN)}")
    opened(args.speech).close()
    return replace(settings_of(args), source=args.speech, text=None if args.text is None else Path(args.text))


def _prepare(server: PageServer, job: Job, settings: RunSettings) -> None:
    """Generate the performance, and give the server its page and the renderer of edited plans."""
    from gesticulator.export import html
    from gesticulator.gesticulator import Gesticulator
    from gesticulator.page.palette import moving_figures
    from gesticulator.page.session import EditSession, levels_of

    source = job.source
    assert source is not None
    # A character that stands on its legs in its file needs legs in the motion, too.
    chosen, stands = _character(job)
    gesticulator = Gesticulator.from_pretrained(settings.bundle)
    gesticulator.keeps_generations = True
    # A plan that was given by name comes before the saved one, which it will replace.
    if job.options.plan is None:
        job = _with_saved_edits(gesticulator, job)
    job = replace(job, options=replace(job.options, legs=job.options.legs or stands))
    performance = Worker(gesticulator).performed(job, load(job))
    session = EditSession(gesticulator, performance)
    scene = performance.scene()
    live = {"token": server.token, "renderings": [session.opened(performance)],
            "levels": levels_of(gesticulator.bundle), "speakers": list(gesticulator.bundle.speakers)}
    more = {"live": live, **({} if chosen is None else html.character_data(*chosen, scene.face))}
    if performance.retiming is not None:
        print(f"  {performance.retiming}", flush=True)
        more["notice"] = f"The edits were moved onto the new sound. {performance.retiming}"
    server.page = html.page({performance.decided.interpreter: scene}, html.title_of(source), more=more).encode()
    # What is only tried is not saved.
    session.on_edit = lambda request, plan: None if request.get("trial") else save(source, plan)
    # What stays for the whole session need not be looked through for garbage, which would delay edits by a third of a
    # second now and then.
    gc.collect()
    gc.freeze()
    server.render = session.answer
    # Decoding all lexemes takes a second: only when the palette is opened, and once.
    speaker = gesticulator.resolver.speaker(performance.decided.speaker)
    server.figures = cache(lambda: json.dumps(moving_figures(gesticulator.bundle, speaker)).encode())


def _character(job: Job) -> tuple[tuple[Character, dict[str, int]] | None, bool]:
    """The requested character with our joint -> its node in the file, if any, and whether it stands on its legs."""
    if job.character is None:
        return None, False
    from gesticulator.characters.mapping import check
    from gesticulator.characters.reading import choose

    # The mapping may be saved before anything else: it is what a user corrects when joints are wrong.
    character, mapping = choose(job.character.file, job.character.mapping, job.character.save_mapping)
    check(mapping, character)
    joints = {joint: character.node_ids[node] for joint, node in mapping.named().items()}
    return (character, joints), mapping.legs and not job.options.seated


def _with_saved_edits(gesticulator: Gesticulator, job: Job) -> Job:
    """The job, going on with the edits that were saved beside the sound, if there are any; if the sound was exported
    again since, with those that have a place in it."""
    from data_module.speech.audio import SAMPLE_RATE, amplified, resample
    from gesticulator.directing.directions import check_bundle_of, planned
    from gesticulator.plan.plan import sound_hash

    assert job.source is not None
    plan = read_saved(job.source)
    if plan is None:
        return job
    options = replace(job.options, plan=plan)
    try:
        check_bundle_of(gesticulator.bundle, plan)
        planned(options)
    except InputError as error:
        put_aside(job.source, str(error))
        return job
    # The hash of a plan is of the sound as the models take it: with its gain, at their rate.
    speech = resample(amplified(load(job), float(plan.made_by.get("settings", {}).get("gain", 0.0))), SAMPLE_RATE)
    moved = sound_hash(speech) != plan.sound.sha256
    how = "moved onto the new sound" if moved else "opened"
    print(f"{found_beside(job.source)}: the saved edits are {how}; without this file none are", flush=True)
    return replace(job, options=replace(options, retime=moved))


def _serve(server: PageServer, no_browser: bool) -> None:
    """Serve until Ctrl C, or until the system ends the program."""
    # As an interruption: a rendering that is under way ends, and is saved.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # At once, though the output is a pipe: who starts the program reads the address from it.
    print(f"{server.url}  (Ctrl C ends it)", flush=True)
    with tempfile.TemporaryDirectory(prefix="gesticulator-") as folder:
        if not no_browser:
            webbrowser.open(_way_in(Path(folder), server.url))
        with suppress(KeyboardInterrupt):
            server.serve_forever()


def _way_in(folder: Path, url: str) -> str:
    """The address of a file that leads to the page: a browser's command line can be read by all users of the machine,
    a file in a folder of one's own cannot."""
    file = folder / "open.html"
    file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><title>gesticulator</title>')
    return file.as_uri()


# -------------------------------------------------------------------------------------------------- saved edits

def place_of(source: Path) -> Path:
    """The file for the edits of a sound."""
    return source.with_name(source.name + ENDING)


def found_beside(source: Path) -> Path:
    """The file with the edits of a sound: under its former name, shared by sounds of one stem, if there is no other."""
    place, former = place_of(source), source.with_name(source.stem + ENDING)
    return place if place.is_file() or not former.is_file() else former


def read_saved(source: Path) -> GesturePlan | None:
    """The plan saved beside a sound; None without one. A file that cannot be used is put aside, with a warning."""
    from gesticulator.plan.plan_file import read_plan

    place = found_beside(source)
    if not place.is_file():
        return None
    try:
        plan = read_plan(place)
    except (InputError, OSError) as error:
        put_aside(source, str(error))
        return None
    # Edits of another sound stay where they are.
    return plan if place == place_of(source) or plan.sound.name in ("", source.name) else None


def put_aside(source: Path, why: str) -> None:
    """Rename the saved plan of a sound, and say so."""
    place = found_beside(source)
    # Never overwritten: it may be hours of work under another bundle.
    names = (place.with_name(f"{place.name}.old{end}") for end in ("", *map(".{}".format, range(2, 10_000))))
    aside = next(name for name in names if not name.exists())
    place.replace(aside)
    complain(f"{place}: is not opened, and is now {aside.name}: {why}")


def save(source: Path, plan: GesturePlan) -> None:
    """Save the edited plan of a sound beside it. A file that cannot be written is reported, and the page goes on."""
    place = place_of(source)
    try:
        write_text(place, plan.to_json())
    except OSError as error:
        complain(f"{place}: the edits are not saved ({error.strerror or error})")


COMMAND = Command(
    "open a page that plays a performance and edits its plan", arguments, run,
    examples=(
        "view talk.flac",
        "view talk.flac --text talk.txt --character rig.vrm",
        "view talk.flac --plan talk.plan.json",
        "view talk.flac --interpreter advantage --port 8123 --no-browser",
    ))
