"""Settings: presets, overrides, hashes, and the round trip to plain values."""

import json

import pytest

from data_module.errors import InputError
from generator.model import PERCEPTUAL, RECONSTRUCTION, STYLE
from gesticulator.bundle.config import Config, from_dict, to_dict, with_settings
from gesticulator.training.presets import PRESETS, preset


@pytest.mark.parametrize("name", PRESETS)
def test_round_trip_through_json(name: str) -> None:
    config = preset(name)
    assert config.name == name
    assert from_dict(Config, json.loads(json.dumps(to_dict(config)))) == config


def test_paper_presets_carry_the_papers_numbers() -> None:
    trinity, chinese = preset("paper-trinity"), preset("paper-chinese")
    assert (trinity.rhythm.frames, chinese.rhythm.frames) == (10, 12)
    assert (trinity.lexicon.size, trinity.lexicon.code_width, trinity.window) == (50, 192, 8)
    g = trinity.generator
    assert (g.motion_features, g.audio_features, g.style_width, g.position_width, g.groups, g.classes) \
        == (128, 128, 32, 32, 64, 128)
    assert g.motion_features + g.audio_features + trinity.lexicon.code_width + g.style_width + g.position_width == 512
    assert (RECONSTRUCTION, PERCEPTUAL, g.lexeme, STYLE) == (1.0, 0.5, 0.2, 1.0)
    assert all(s.rate == 3e-4 and s.betas == (0.9, 0.999) for s in
               (trinity.schedules.lexicon, trinity.schedules.generator, trinity.schedules.interpreter))


def test_settings_reach_every_depth_and_keep_types() -> None:
    config = with_settings(preset("tiny"), ["rhythm.beats.d_max=1", "lexicon.widths=[4,5,6,7]",
                                            "lexicon.quantizer=vq-vae", "silence.hint=false", "text.encoder=",
                                            "silence.lexemes=[3,1]", "front_end.layers=[1,4]"])
    assert config.text.encoder == "" and config.silence.lexemes == (3, 1) and config.front_end.layers == (1, 4)
    assert config.rhythm.beats.d_max == 1.0 and isinstance(config.rhythm.beats.d_max, float)
    assert config.lexicon.widths == (4, 5, 6, 7) and config.lexicon.quantizer == "vq-vae"
    assert config.silence.hint is False
    assert preset("tiny").lexicon.quantizer == "k-means", "presets are values, not shared state"


@pytest.mark.parametrize("setting", ["lexicon.size", "lexicon.nothing=3", "nothing.size=3", "lexicon.size=many",
                                     "lexicon.size.more=3", "lexicon=3", "silence.hint=1",
                                     "silence.lexemes=3"])
def test_a_wrong_setting_is_one_clear_line(setting: str) -> None:
    with pytest.raises(InputError) as error:
        with_settings(preset("tiny"), [setting])
    assert setting in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("setting", ["encoder.width=0", "encoder.width=wide"])
def test_a_value_that_cannot_be_is_refused_by_the_name_of_its_setting(setting: str) -> None:
    with pytest.raises(InputError, match=setting.partition("=")[0]):
        with_settings(preset("tiny"), [setting])


def test_a_value_of_no_characters_is_refused() -> None:
    with pytest.raises(InputError, match="cannot be used"):
        with_settings(preset("tiny"), ["encoder.width=\udcff"])


def test_unknown_preset_and_foreign_settings_are_refused() -> None:
    with pytest.raises(InputError, match="default"):
        preset("large")
    with pytest.raises(InputError, match="surprise"):
        from_dict(Config, {**to_dict(preset("tiny")), "surprise": 1})
