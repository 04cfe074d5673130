"""The site: its index lists every page of the navigation, and its search works when pages are opened from a disk."""

from __future__ import annotations

import importlib
import importlib.util
import re
import shutil
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from browser import chromium

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"


def make_index() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_index", DOCS / "make_index.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_index_is_what_the_navigation_makes_it() -> None:
    page = DOCS / "index.md"
    assert page.read_text(encoding="utf-8") == make_index().index(ROOT), "run python docs/make_index.py"


def test_a_page_of_the_navigation_stands_in_the_index_with_its_summary(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "mkdocs.yml").write_text(
        "nav:\n  - Home: index.md\n  - Guide:\n      - Use: use.md\n      - Tables:\n          - One: results/one.md\n")
    (tmp_path / "docs" / "use.md").write_text("# Use\n\nTurn *speech* into\n[motion](a.md). More is said here.\n")
    (tmp_path / "docs" / "index.md").write_text("# Title\n\n## Pages\n\nold\n")
    assert make_index().index(tmp_path) == (
        "# Title\n\n## Pages\n\n### Guide\n\n| page | content |\n|---|---|\n"
        "| [Use](use.md) | Turn *speech* into motion. |\n")


def test_a_page_without_a_summary_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "bare.md"
    page.write_text("# Bare\n\n```sh\ngesticulator\n```\n")
    with pytest.raises(SystemExit, match=r"bare\.md"):
        make_index().summary(page)


MODULES = sorted({name for page in (DOCS / "api").glob("*.md")
                  for name in re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.M)})


@pytest.mark.parametrize("name", MODULES)
def test_modules_of_the_api_pages_say_what_is_public(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__all__, name
    for public in module.__all__:
        assert not public.startswith("_")
        value = getattr(module, public)
        if callable(value) and getattr(value, "__module__", name) == name:
            assert value.__doc__, f"{name}.{public} has no docstring"


def rooms(package: str) -> set[str]:
    """The folders and modules of a package, as they are written on the page."""
    return {f"{path.name}/" if path.is_dir() else path.name for path in (ROOT / package).iterdir()
            if path.suffix == ".py" or (path / "__init__.py").exists()} - {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("package", ["gesticulator", "eval"])
def test_the_architecture_names_every_room(package: str) -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    table = page.split(f"## The rooms of `{package}/`")[1].split("\n## ")[0]
    named = [name for row in re.findall(r"^\| (`.*?) \|", table, re.M) for name in re.findall(r"`([^`]+)`", row)]
    assert sorted(named) == sorted(rooms(package))


def test_the_picture_of_the_architecture_shows_every_room() -> None:
    drawn = set(re.findall(r'class="name">([^<]+)<', (DOCS / "pictures" / "architecture.svg").read_text()))
    assert rooms("gesticulator") - {"version.py"} <= drawn, "run docs/pictures/make_architecture.py"


def test_no_room_imports_one_above_it() -> None:
    spec = importlib.util.spec_from_file_location("make_architecture", DOCS / "pictures" / "make_architecture.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.without_circles({"a": {"b": 3}, "b": {"c": 1, "a": 1}, "c": {}})[1] == [("b", "a")]
    assert module.without_circles(module.rooms(module.imports()))[1] == []


TABLES = re.findall(r"\| `([\w.]+):(\w+)` \| (?:`([\w.]+)` )?\|",
                    (DOCS / "architecture.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("module", "name", "group"), TABLES)
def test_tables_of_the_architecture_are_there_with_their_groups(module: str, name: str, group: str) -> None:
    held = importlib.import_module(module)
    table = getattr(held, name)
    assert len(table)
    # Of metrics and stages, those of other packages are in a registry beside the table of ours.
    beside = {f"OTHER_{name}", f"other_{name.lower()}"} & set(vars(held))
    assert bool(beside) if group and not hasattr(table, "group") else getattr(table, "group", "") == group


def test_the_search_works_from_a_disk(tmp_path: Path) -> None:
    """The theme, the plugins and the worker of the site, on two pages of our own, opened without a server."""
    pytest.importorskip("material", reason="mkdocs-material is not installed")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    pages = tmp_path / "docs"
    pages.mkdir()
    (pages / "index.md").write_text("# Home\n\nNothing to be found here.\n")
    (pages / "other.md").write_text("# Other\n\nA page on *marsupials*.\n")
    shutil.copy(DOCS / "iframe-worker.js", pages)
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    kept = {name: settings[name] for name in ("site_name", "theme", "extra", "use_directory_urls")}
    kept["plugins"] = [plugin for plugin in settings["plugins"] if isinstance(plugin, str)]
    config = tmp_path / "mkdocs.yml"
    config.write_text(yaml.safe_dump(kept))
    build(load_config(str(config), site_dir=str(tmp_path / "site")))

    requests: list[str] = []
    with chromium() as browser:
        page = browser.new_page()
        page.on("request", lambda request: requests.append(request.url))
        page.goto((tmp_path / "site" / "index.html").as_uri())
        page.keyboard.press("s")
        page.keyboard.type("marsupials")
        link = page.wait_for_selector(".md-search-result__link", timeout=20_000)
        assert "other.html" in link.get_attribute("href")
    assert [url for url in requests if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
