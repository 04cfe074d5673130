"""How `--interpreter cql` chooses: sampled by default, arg max at temperature 0, with a warning."""

import warnings

import pytest

from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import NAMED
from gesticulator.gesticulator import Gesticulator, InterpreterWarning
from gesticulator.options import InferenceOptions
from gesticulator.training.presets import preset


def temperature(system: Gesticulator, **asked: object) -> float:
    return system.resolver.setup(InferenceOptions(**asked), text=False).temperature  # type: ignore[arg-type]


def test_the_shipped_q_network_is_sampled_and_temperature_0_is_arg_max(system: Gesticulator) -> None:
    by_default = temperature(system, interpreter="cql")
    assert by_default == system.bundle.config.selection.q_temperature == preset("default").selection.q_temperature > 0
    assert temperature(system, interpreter="cql", temperature=0.0) == 0.0
    assert temperature(system, interpreter="lstm") == system.bundle.config.selection.temperature


def test_the_published_presets_keep_the_greedy_choice() -> None:
    for name in ("racer-trinity", "racer-chinese", "paper-trinity"):
        assert preset(name).selection.q_temperature == 0


@pytest.mark.parametrize(("bundle", "name"), [
    ("default", "cql"), ("default", "statistical"), ("paper", "cql"), ("paper", "cql-literal")])
def test_a_policy_that_is_no_better_is_remarked_upon(bundle: str, name: str) -> None:
    system = Gesticulator(bundles.load(NAMED[bundle]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        system.resolver.setup(InferenceOptions(interpreter="lstm"), text=False)
        assert not caught
        system.resolver.setup(InferenceOptions(interpreter=name), text=False)
    (warning,) = caught
    assert warning.category is InterpreterWarning
    assert name in str(warning.message) and "lstm" in str(warning.message) and "\n" not in str(warning.message)
