"""Real characters: their joints are those that a human sees, and what comes out of them is sound, or refused.

GESTICULATOR_ZOO names the folder in which their packages are unpacked; one that is missing is skipped with the reason.
"""

from __future__ import annotations

import os

import pytest

from data_module.errors import InputError
from gesticulator.characters.joints import find_joints
from gesticulator.characters.reading import read_character
from gesticulator.characters.retarget import Retargeter
from tests.zoo import ANIMALS, CACHE, Animal, Unavailable, character_file

full = pytest.mark.skipif(CACHE not in os.environ, reason=f"{CACHE} does not name a folder for the packages")


@full
@pytest.mark.parametrize("animal", ANIMALS, ids=lambda animal: animal.name)
def test_a_real_character_is_as_a_human_sees_it(animal: Animal) -> None:
    try:
        file = character_file(animal)
    except Unavailable as reason:
        pytest.skip(str(reason))
    character = read_character(file)
    found = find_joints(character)
    if animal.refused:
        with pytest.raises(InputError, match=animal.refused):
            Retargeter(character, found)
        return
    names = {joint: character.names[found.joints[joint]] for joint in animal.joints}
    assert names == dict(animal.joints)
    moved = Retargeter(character, found)
    assert moved.legs
    assert [doubt for doubt in moved.doubts if "distinguish left" not in doubt] == []
