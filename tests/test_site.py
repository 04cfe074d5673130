"""The modules of the API pages state and document what is public."""

import importlib
import re
from pathlib import Path

import pytest

API = Path(__file__).resolve().parent.parent / "docs" / "api"
MODULES = sorted({name for page in API.glob("*.md")
                  for name in re.findall(r"^::: (\S+)$", page.read_text(encoding="utf-8"), re.M)})


@pytest.mark.parametrize("name", MODULES)
def test_modules_of_the_api_pages_document_what_is_public(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__all__, name
    for public in module.__all__:
        assert not public.startswith("_")
        value = getattr(module, public)
        if callable(value) and getattr(value, "__module__", name) == name:
            assert value.__doc__, f"{name}.{public} has no docstring"
