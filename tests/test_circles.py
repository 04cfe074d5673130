"""No two files import each other, straight or by way of others: imports inside functions and imports for type checking
count, and so do modules that are named by a string and imported later."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
TABLES = {"data_module.corpora.table", "interpreters", "gesticulator.characters.reading", "gesticulator.export.writers",
          "gesticulator.systems", "eval.commands", "eval.pictures", "eval.probes"}
"""Tables of plug-ins: they name their modules by strings, and the modules may import what stands beside the table."""


def named_by_strings(source: str, modules: Mapping[str, object]) -> Iterator[str]:
    """Modules that a file names in `import_module("...")` or `__import__("...")`, or as "module:object"."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            module, colon, name = node.value.partition(":")
            if module in modules and colon and name.isidentifier():
                yield module
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__") and node.args[0].value in modules:
                yield str(node.args[0].value)


def imported_later(modules: Mapping[str, object]) -> dict[str, set[str]]:
    """Module -> the modules that it names by strings; tables of plug-ins name none."""
    named: dict[str, set[str]] = {}
    for module in set(modules) - TABLES:
        file = ROOT.joinpath(*module.split("."))
        source = file / "__init__.py" if file.is_dir() else file.with_suffix(".py")
        named[module] = set(named_by_strings(source.read_text(encoding="utf-8"), modules)) - {module}
    return named


def circles(imports: dict[str, set[str]]) -> list[list[str]]:
    """The sets of files that reach each other (Tarjan's strongly connected components of two files or more)."""
    order: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(file: str) -> None:
        order[file] = lowest[file] = len(order)
        stack.append(file)
        for other in sorted(imports.get(file, ())):
            if other not in order:
                visit(other)
                lowest[file] = min(lowest[file], lowest[other])
            elif other in stack:
                lowest[file] = min(lowest[file], order[other])
        if lowest[file] == order[file]:
            place = stack.index(file)
            if len(stack) - place > 1:
                found.append(sorted(stack[place:]))
            del stack[place:]

    for file in sorted(imports):
        if file not in order:
            visit(file)
    return found


def test_circles_are_found() -> None:
    imports = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": {"e"}, "e": set(), "f": {"a", "e"}, "g": {"h"}, "h": {"g"}}
    assert circles(imports) == [["a", "b", "c"], ["g", "h"]]


def test_modules_that_are_named_by_strings_are_seen() -> None:
    modules = dict.fromkeys(("a.b", "a.c", "a.d", "a.e"))
    source = ("import importlib\ndef later():\n    importlib.import_module('a.b').run()\n    import_module('a.c')\n"
              "    return __import__('elsewhere')\nWRITER = 'a.d:write'\nABOUT = 'a.e: a sentence'\n")
    assert set(named_by_strings(source, modules)) == {"a.b", "a.c", "a.d"}


def test_a_circle_through_a_type_and_a_string_is_found(tmp_path: Path) -> None:
    """The shape that was once missed: the result names the file of its record by a string, the record imports the
    result for its annotations alone."""
    package = tmp_path / "toy"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "result.py").write_text("from importlib import import_module\n"
                                       "def plan(): return import_module('toy.record').plan_of\n")
    (package / "record.py").write_text("from typing import TYPE_CHECKING\n"
                                       "if TYPE_CHECKING:\n    from toy.result import Result\n")
    (package / "other.py").write_text("import toy.result\n")
    modules = dict.fromkeys(f"toy.{name}" for name in ("result", "record", "other"))
    imports = {name: set(named_by_strings((tmp_path / f"{name.replace('.', '/')}.py").read_text(), modules))
               for name in modules}
    assert circles(imports) == [], "the string alone is not a circle"
    imports["toy.record"].add("toy.result")
    imports["toy.other"].add("toy.result")
    assert circles(imports) == [["toy.record", "toy.result"]]


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=False, cache_dir=None)
    later = imported_later(dict.fromkeys(graph.modules))
    imports = {file: graph.find_modules_directly_imported_by(file) | later.get(file, set()) for file in graph.modules}
    assert len(imports) > 100
    assert circles(imports) == []
