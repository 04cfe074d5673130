"""The study of meanings: the page tells raters nothing but sentences, and known answers give known figures."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import chromium

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import FINGERED
from data_module.types import Motion
from eval.clip import marked_gestures
from eval.clip.marked_gestures import AFTER, BEFORE, MarkedGesture, checked_gestures
from eval.commands import STUDY
from eval.study import meaning, meaning_answers
from eval.study.meaning import CATCH, GESTURE, NONE, OTHER, MeaningOptions
from eval.table import load
from gesticulator.directing.named_gestures import laid_over, span_of_gesture
from gesticulator.export.figure import figure_points
from gesticulator.plan.gestures import REPERTOIRE
from gesticulator.plan.plan import GestureCue

NAMES = ("point you", "shrug", "sweep no", "stop palm", "calm down", "thumbs up", "so so", "big spread", "small pinch",
         "increase", "number one", "wait finger")


def _motion(cues: Sequence[tuple[GestureCue, float]]) -> Motion:
    times = np.arange(round((BEFORE + AFTER) * 30.0)) / 30.0
    poses = laid_over(np.zeros((len(times), 3 * len(FINGERED))), times, cues)
    return Motion(FINGERED, rotation.from_exponential_map(poses.reshape(len(poses), -1, 3)),
                  np.zeros((len(poses), 3)), 30.0)


@pytest.fixture(scope="module")
def clips() -> list[MarkedGesture]:
    """A clip of each gesture over the pose at rest of the skeleton, and none without."""
    still = _motion([])
    return [MarkedGesture(name, _motion([(GestureCue(name), BEFORE)]), still, BEFORE, "walrus", float(number))
            for number, name in enumerate(NAMES)]


@pytest.fixture(scope="module")
def first(clips: list[MarkedGesture], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder of a study of these clips; another one can be made of them."""
    out = tmp_path_factory.mktemp("meaning")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(meaning, "marked_gestures", lambda *_: iter(clips))
        meaning.make(None, [], out, MeaningOptions(NAMES, raters=7))  # type: ignore[arg-type]
        yield out


@pytest.fixture
def made(first: Path, tmp_path: Path) -> Path:
    """A copy of that folder."""
    shutil.copytree(first, tmp_path / "made")
    return tmp_path / "made"


def _data(folder: Path) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="study">(.*?)</script>',
                      (folder / "page" / "index.html").read_text(), re.DOTALL)
    assert found
    return json.loads(found.group(1))


def _key(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "key.json").read_text())


# ---------------------------------------------------------------- trials and the page

def test_every_gesture_has_a_saying_of_its_own_that_does_not_describe_the_movement() -> None:
    says = meaning.sayings()
    assert set(says) == set(REPERTOIRE) and len(set(says.values())) == len(says)
    for name, saying in says.items():
        words = set(re.findall("[a-z]+", saying.lower()))
        assert saying[0].isupper() and saying[-1] in ".!?", name
        assert not words & {"palm", "palms", "finger", "fingers", "arm", "arms", "fist", "thumb", "speaker"}, name


def test_a_clip_holds_any_gesture() -> None:
    assert all(span_of_gesture(name)[0] <= BEFORE and span_of_gesture(name)[1] <= AFTER for name in REPERTOIRE)


def test_answers_are_five_with_the_right_one_and_none_of_its_form(clips: list[MarkedGesture]) -> None:
    trials = [trial for seed in range(30) for trial in meaning.trials_of(clips, NAMES, seed)]
    assert {trial.kind for trial in trials} == {GESTURE, NONE, OTHER, CATCH}
    for trial in trials:
        assert len(set(trial.answers)) == 5 and trial.meaning in trial.answers
        assert not {"number one", "wait finger"} <= set(trial.answers), "nothing but the words tells them apart"
        if trial.kind == GESTURE:
            assert trial.shown == trial.meaning
        if trial.kind == OTHER:
            assert trial.shown is not None and trial.shown not in trial.answers
        if trial.kind == CATCH:
            assert trial.shown != trial.meaning and trial.shown in trial.answers
    places = Counter(trial.answers.index(trial.meaning) for trial in trials if trial.kind == GESTURE)
    assert all(0.12 < places[place] / places.total() < 0.28 for place in range(5)), "the place must not tell"
    others = Counter(name for trial in trials if trial.meaning == "shrug" for name in trial.answers)
    assert set(others) == set(NAMES), "any other gesture may be a wrong answer"


def test_the_page_holds_the_clips_of_the_key_and_names_no_gesture(made: Path, clips: list[MarkedGesture]) -> None:
    page, data, key = (made / "page" / "index.html").read_text(), _data(made), _key(made)
    assert [file.name for file in (made / "page").iterdir()] == ["index.html"], "the key must not lie with the page"
    assert not re.search(r"https?://|\bfetch\(|XMLHttpRequest|sendBeacon|WebSocket|@import", page)
    for word in (*(f'"{name}"' for name in NAMES), "walrus", GESTURE + '"', NONE, OTHER):
        assert word not in page
    says, by_name = meaning.sayings(), {clip.gesture: clip for clip in clips}
    ids = [item["id"] for item in data["items"]]
    assert ids == sorted(key["items"]) and len({len(item["motion"]) for item in data["items"]}) == 1
    for item in data["items"]:
        own = key["items"][item["id"]]
        assert item["answers"] == [says[name] for name in own["answers"]]
        assert ("choose" in item) == (own["kind"] == CATCH)
        clip = by_name[own["shown"] or "shrug"]
        expected = figure_points(clip.motion if own["shown"] else clip.without, np.arange(138) / 30, fingers=True)
        steps = np.frombuffer(base64.b64decode(item["motion"]), "<i2").reshape(138, len(data["points"]), 3)
        for number, name in enumerate(data["points"]):
            np.testing.assert_allclose(steps[:, number] / data["stepsPerMetre"], expected[name], atol=1e-4)
    assert "RightHandIndex3Tip" in data["points"], "hand shapes are seen"


def test_orders_differ_and_are_permutations(made: Path) -> None:
    data = _data(made)
    assert len(data["orders"]) == 7 and len({json.dumps(order) for order in data["orders"]}) == 7
    for order in data["orders"]:
        assert sorted(trial for trial, _ in order) == list(range(len(data["items"])))
        assert all(sorted(answers) == list(range(5)) for _, answers in order)


def test_same_input_gives_the_same_page_and_another_seed_another(made: Path, tmp_path: Path) -> None:
    again, other = tmp_path / "again", tmp_path / "other"
    meaning.make(None, [], again, MeaningOptions(NAMES, raters=7))  # type: ignore[arg-type]
    assert hash((again / "page" / "index.html").read_bytes()) == hash((made / "page" / "index.html").read_bytes())
    meaning.make(None, [], other, MeaningOptions(NAMES, raters=7, seed=1))  # type: ignore[arg-type]
    assert not set(_key(other)["items"]) & set(_key(made)["items"])


def test_too_few_and_unknown_gestures_are_refused() -> None:
    with pytest.raises(InputError, match="is the name of no gesture"):
        checked_gestures(["shrug", "shruk"])
    assert checked_gestures(["wave", "wave hello"]) == ["wave hello"]
    with pytest.raises(InputError, match="name 10 or more"):
        meaning.make(None, [], Path("/nowhere"), MeaningOptions(["shrug", "stop"]))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="--takes"):
        MeaningOptions(takes=0)


def test_gestures_stand_apart_and_inside_the_recording() -> None:
    from data_module.types import Speech

    times = marked_gestures._times(Speech(np.zeros(16000 * 33, np.float32), 16000))
    assert times[0] == BEFORE and times[-1] + AFTER <= 33.0 and np.allclose(np.diff(times), 5.0) and len(times) == 6
    assert marked_gestures._times(Speech(np.zeros(16000 * 4, np.float32), 16000)) == []


# ---------------------------------------------------------------- answers

def _saved(folder: Path, raters: Mapping[str, Any]) -> list[Path]:
    """Files of raters; each answers an item (of the key) as its function says, by the name of a gesture."""
    key, files = _key(folder), []
    for rater, chooses in raters.items():
        answers = [{"item": name, "choice": own["answers"].index(chooses(own)), "place": 1, "plays": 1, "seconds": 2.0}
                   for name, own in key["items"].items()]
        files.append(folder / f"answers-{rater}.json")
        files[-1].write_text(json.dumps({"study": key["study"], "rater": rater, "answers": answers}))
    return files


def _first_wrong(own: Mapping[str, Any]) -> str:
    return next(name for name in own["answers"] if name != own["meaning"])


def _careful(own: Mapping[str, Any]) -> str:
    """One who knows the gestures, but takes a shrug for another one, and reads."""
    right = own["kind"] in (GESTURE, CATCH) and own["meaning"] != "shrug"
    return own["meaning"] if right or own["kind"] == CATCH else _first_wrong(own)


def test_known_answers_give_known_figures(made: Path, capsys: Any, tmp_path: Path) -> None:
    files = _saved(made, {"1": _careful, "2": _careful, "10": _first_wrong})
    out = tmp_path / "meaning.json"
    assert STUDY.main("gesticulator study", ["analyse", "--key", str(made / "key.json"), "--out", str(out),
                                             *map(str, files)]) == 0
    everything, by_meaning, confused = load(out)
    named: Any = {kind: row["named"] for kind, row in everything.rows.items()}
    assert named[GESTURE].mean == pytest.approx(2 * 11 / 36) and named[NONE].mean == 0.0 == named[OTHER].mean
    assert named[GESTURE].low < named[GESTURE].mean < named[GESTURE].high and named[CATCH].mean == pytest.approx(2 / 3)
    assert any("rater 10: misses 2 of 2 catch trials" in note for note in everything.notes)
    rows: Any = by_meaning.rows
    assert next(iter(rows)) == "shrug" and rows["shrug"]["right"].mean == 0.0 and rows["shrug"]["above"] == "no"
    assert rows["so so"]["right"].mean == pytest.approx(2 / 3)
    wrong = rows["shrug"]["taken"]
    assert wrong.endswith("(3)"), wrong
    pair: Any = confused.rows[f"shrug as {wrong.removesuffix(' (3)')}"]
    assert pair == {"times": 3, "offered": 3}
    assert by_meaning.facts["chosen"]["shrug"] == {wrong.removesuffix(" (3)"): 3}
    capsys.readouterr()
    assert STUDY.main("gesticulator study", ["analyse", "--key", str(made / "key.json"), "--without", "10", "--",
                                             *map(str, files)]) == 0
    said = capsys.readouterr().out
    assert "2 raters" in said and "left out on demand: rater 10" in said


def test_a_rater_who_guesses_is_at_chance(made: Path) -> None:
    rng = np.random.default_rng(3)
    raters = {str(k): (lambda own: own["answers"][int(rng.integers(5))]) for k in range(1, 120)}
    key = meaning_answers.read_meaning_key(made / "key.json")
    tables = meaning_answers.meaning_tables(meaning_answers.read_choices(_saved(made, raters), key))
    for row in tables[0].rows.values():
        named: Any = row["named"]
        assert named.low < 0.2 < named.high
    named = tables[0].rows[GESTURE]["named"]
    assert named.n == 119 * 12 and 0.03 < named.high - named.low < 0.12


@pytest.mark.parametrize(("change", "says"), [
    (lambda held: "{", "is not valid JSON"),
    (lambda held: [1], "is not a file of answers"),
    (lambda held: held | {"study": "other"}, "belongs to study 'other'"),
    (lambda held: held | {"rater": " "}, "without a rater"),
    (lambda held: held | {"answers": [{"item": "x", "choice": 1}]}, "does not know"),
    (lambda held: held | {"answers": [held["answers"][0] | {"choice": 5}]}, "does not know"),
    (lambda held: held | {"answers": [held["answers"][0] | {"choice": True}]}, "does not know"),
    (lambda held: held | {"answers": [held["answers"][0] | {"choice": k} for k in (1, 2)]}, "twice and differently"),
    (lambda held: held | {"answers": []}, "hold no answer"),
])
def test_bad_answers_are_one_line_and_exit_2(made: Path, capsys: Any, change: Any, says: str) -> None:
    held = change(json.loads(_saved(made, {"1": _careful})[0].read_text()))
    bad = made / "bad.json"
    bad.write_text(held if isinstance(held, str) else json.dumps(held))
    with pytest.raises(SystemExit) as left:
        STUDY.main("gesticulator study", ["analyse", "--key", str(made / "key.json"), str(bad)])
    line = capsys.readouterr().err
    assert left.value.code == 2 and line.count("\n") == 1 and says in line


@pytest.mark.parametrize("change", [
    {"items": {}}, {"items": {"x": {"kind": "gesture"}}}, {"study": 5},
    {"items": {"x": {"kind": "gesture", "meaning": "a", "answers": ["a"] * 5, "shown": None}}},
    {"items": {"x": {"kind": "gesture", "meaning": "f", "answers": list("abcde"), "shown": None}}},
    {"items": {"x": {"kind": "film", "meaning": "a", "answers": list("abcde"), "shown": None}}},
])
def test_a_key_that_holds_other_things_is_refused(made: Path, change: dict[str, Any]) -> None:
    (made / "key.json").write_text(json.dumps(_key(made) | change))
    with pytest.raises(InputError, match="is not the key of a study of meanings"):
        meaning_answers.read_meaning_key(made / "key.json")


# ---------------------------------------------------------------- in a browser

@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium."""
    with chromium() as window:
        yield window


def test_a_rater_goes_through_the_page_by_keyboard(browser: Any, made: Path, tmp_path: Path) -> None:
    """The figure moves, answers open at the end, keys choose; a reload keeps the answers; the file can be analysed."""
    path, complaints, requests = made / "page" / "index.html", [], []
    text = path.read_text()
    path.write_text(text.replace('"seconds":4.6', '"seconds":0.6'))
    assert path.read_text() != text
    page = browser.new_page(viewport={"width": 1100, "height": 800})
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(path.as_uri() + "?rater=9")
    page.keyboard.press("Tab")
    page.focus("#number")
    page.keyboard.press("Enter")
    data, key = _data(made), _key(made)
    order, chosen = data["orders"][8 % 7], {}
    for place, (number, answers) in enumerate(order):
        item = data["items"][number]
        if place == 2:
            page.reload()
            page.click("#begin button")
        assert page.inner_text("#place") == f"Clip {place + 1} of {len(order)}"
        # A slow machine may have played the clip by now.
        assert page.evaluate("""() => trial.seen || document.getElementById("choices").disabled""")
        assert page.is_disabled("#next")
        page.wait_for_function("() => trial.seen", timeout=20_000)
        assert page.locator("#choices label span").all_inner_texts() == [item["answers"][answer] for answer in answers]
        if "choose" in item:
            assert item["answers"][item["choose"]] in page.inner_text("#question")
        if place == 1:
            before = page.evaluate("document.getElementById('figure').toDataURL()")
            page.keyboard.press("Space")
            page.wait_for_function("() => trial.begun === null", timeout=20_000)
            assert page.evaluate("trial.plays") == 2 and before
        row = place % 5
        page.keyboard.press("Enter")
        assert page.inner_text("#place") == f"Clip {place + 1} of {len(order)}", "Enter without a choice does nothing"
        page.keyboard.press(str(row + 1))
        chosen[item["id"]] = answers[row]
        page.keyboard.press("Enter")
    assert page.is_visible("#end")
    with page.expect_download() as saved:
        page.keyboard.press("Enter")
    file = tmp_path / saved.value.suggested_filename
    saved.value.save_as(file)
    page.close()
    assert complaints == [] and all(url.startswith(("file:", "data:", "blob:")) for url in requests)
    assert file.name == f"answers-{key['study']}-9.json"
    choices = meaning_answers.read_choices([file], meaning_answers.read_meaning_key(made / "key.json"))
    assert choices.raters == ("9",)
    assert choices.chosen == {("9", name): key["items"][name]["answers"][choice] for name, choice in chosen.items()}
