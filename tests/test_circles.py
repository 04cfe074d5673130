"""No two files import each other, directly or through others.

Imports inside functions, imports for type checking and modules that are imported by a literal name count as well.
"""

import ast
from collections.abc import Container, Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("data_module", "lexicon", "interpreters", "generator", "gesticulator", "eval")
TABLES = {"data_module.corpora.table", "interpreters", "gesticulator.characters.reading", "gesticulator.export.writers",
          "eval.commands", "eval.pictures"}
"""Tables of plug-ins name their modules by strings; the modules may import what stands beside the table."""


def literal_imports(source: str, modules: Container[object]) -> Iterator[str]:
    """Modules that a source names in `import_module("...")` or `__import__("...")`, or as "module:object"."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            module, colon, name = node.value.partition(":")
            if module in modules and colon and name.isidentifier():
                yield module
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__") and node.args[0].value in modules:
                yield str(node.args[0].value)


def test_literal_imports_are_found() -> None:
    source = ("import importlib\ndef later():\n    importlib.import_module('a.b').run()\n    import_module('a.c')\n"
              "    return __import__('elsewhere')\nWRITER = 'a.d:write'\nABOUT = 'a.e: a sentence'\n")
    assert set(literal_imports(source, {"a.b", "a.c", "a.d", "a.e"})) == {"a.b", "a.c", "a.d"}


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=False, cache_dir=None)
    imports = {}
    for module in graph.modules:
        place = ROOT.joinpath(*module.split("."))
        source = (place / "__init__.py" if place.is_dir() else place.with_suffix(".py")).read_text(encoding="utf-8")
        named = set() if module in TABLES else set(literal_imports(source, graph.modules))
        imports[module] = (graph.find_modules_directly_imported_by(module) | named) - {module}
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        pytest.fail(f"a circle of imports: {' -> '.join(error.args[1])}")
