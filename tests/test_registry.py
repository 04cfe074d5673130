"""Tables of plug-ins: ours and those of other packages, and what is said of broken, clashing and unknown ones."""

import re
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from data_module import registry
from data_module.errors import InputError, install_line
from data_module.registry import Registry, RegistryEntry, Requirement

Make = Callable[..., Registry[RegistryEntry]]


class Package:
    """A distribution, as `EntryPoint.dist` has it."""

    def __init__(self, name: str) -> None:
        self.name = name


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Makes a registry with one entry of ours and entry points of others: (package, name, value) each."""
    (tmp_path / "outside_good.py").write_text(
        "from data_module.registry import RegistryEntry\n"
        "def works(): return 7\nNUMBER = 3\nENTRY = RegistryEntry('says seven', 'outside_good:works')\n"
        "LOST = RegistryEntry('leads nowhere', 'outside_good:nowhere')\n")
    (tmp_path / "outside_broken.py").write_text("raise RuntimeError('no\\nluck')\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    def registry_of(*points: tuple[str, str, str]) -> Registry[RegistryEntry]:
        known = []
        for package, name, value in points:
            point = EntryPoint(name, value, "gesticulator.things")
            vars(point)["dist"] = Package(package)
            known.append(point)
        monkeypatch.setattr(registry, "entry_points", lambda group: known if group == "gesticulator.things" else [])
        return Registry("things", "a thing", {
            "ours": RegistryEntry("ours", "data_module.files:write_text"),
            "rare": RegistryEntry("rare", "data_module.files:write_text",
                          needs=Requirement("no_such_module", "nosuch", "some-extra"))}, RegistryEntry)

    yield registry_of
    for name in ("outside_good", "outside_broken"):
        sys.modules.pop(name, None)


def test_names_and_entries_import_nothing(make: Make) -> None:
    things = make(("theirs", "b", "outside_broken:x"), ("theirs", "a", "outside_good:works"))
    assert list(things) == ["ours", "rare", "a", "b"] and len(things) == 4
    assert things["b"].about == "of the package theirs" and "b" in things and "c" not in things
    assert not {"outside_good", "outside_broken"} & set(sys.modules)


def test_ours_and_theirs_are_loaded(make: Make) -> None:
    things = make(("theirs", "plain", "outside_good:works"), ("theirs", "full", "outside_good:ENTRY"))
    from data_module.files import write_text

    assert things.load("ours") is write_text
    assert things.load("plain")() == things.load("full")() == 7
    assert things.entry("full").about == "says seven" and things.entry("plain").about == "of the package theirs"


def test_an_unknown_name_is_refused_with_the_known_ones_and_the_nearest(make: Make) -> None:
    things = make(("theirs", "theirs", "outside_good:works"))
    for ask in (things.load, things.entry):
        with pytest.raises(InputError, match=r"their: is not a thing; did you mean theirs. take one of ours, rare, th"):
            ask("their")
    with pytest.raises(KeyError):
        things["their"]


@pytest.mark.parametrize(("value", "wrong"), [
    ("outside_broken:x", r"RuntimeError: no luck"), ("no_module_at_all:x", "ModuleNotFoundError"),
    ("outside_good:nowhere", "AttributeError"), ("outside_good:NUMBER", "is not a thing"),
    ("not a value", "cannot be loaded"), ("outside_good:LOST", "AttributeError")])
def test_a_broken_entry_is_one_line_and_harms_no_other(make: Make, value: str, wrong: str,
                                                       capfd: pytest.CaptureFixture[str]) -> None:
    things = make(("theirs", "bad", value), ("theirs", "good", "outside_good:works"))
    with pytest.raises(InputError, match=wrong) as caught:
        things.load("bad")
    assert "theirs" in str(caught.value) and "\n" not in str(caught.value)
    usable = things.usable()
    assert {"ours", "rare", "good"} <= set(usable)
    if "LOST" not in value:  # whose entry itself is fine
        assert "bad" not in usable and capfd.readouterr().err.count("\n") == 1


def test_our_entry_wins_a_clash_then_the_first_package(make: Make) -> None:
    things = make(("zeta", "x", "z:z"), ("alpha", "x", "a:a"), ("alpha", "ours", "a:b"))
    assert things["ours"].about == "ours" and things["x"].where == "a:a"
    assert list(things) == ["ours", "rare", "x"]


def test_a_missing_library_is_named_with_the_extra_that_installs_it(make: Make) -> None:
    with pytest.raises(InputError, match="rare: needs nosuch, .*" + re.escape(install_line("some-extra"))):
        make().load("rare")
