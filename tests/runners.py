"""The runners of models that a test made, with the sizes that their weights have."""

import numpy as np
from torch import nn

from data_module.layers import BlockLinear
from data_module.layers_run import Tensors
from data_module.motion.movement_run import BasisRunner
from generator.flow import FlowGenerator
from generator.flow_run import FlowRunner
from generator.settings import GeneratorWidths
from interpreters.base import InterpreterSizes
from interpreters.cql import QNetwork
from interpreters.cql_run import QRunner
from interpreters.gate import ActivityGate
from interpreters.gate_run import GateRunner
from interpreters.lstm import LstmInterpreter, StyleInterpreter
from interpreters.lstm_run import LstmRunner
from interpreters.planner import UnitPlanner, UnitStyleInterpreter
from interpreters.planner_run import PlannerRunner, UnitStyleRunner
from interpreters.style_run import StyleRunner


def tensors_of(model: nn.Module) -> Tensors:
    return Tensors({key: value.detach().numpy() for key, value in model.state_dict().items()})


def width_in(layer: BlockLinear | None) -> int:
    """d of the rows that a layer reads; 0 for none."""
    if layer is None:
        return 0
    return layer.linear.in_features // (layer.blocks * layer.frames) if layer.narrow is None else \
        layer.narrow.in_features


def sizes_for(frames: int, audio: int, lexemes: np.ndarray, speakers: int, text: int = 0) -> InterpreterSizes:
    """Both levels of the audio have the same width."""
    return InterpreterSizes(frames, audio, audio, speakers, text, 0, 0, np.float32(lexemes))


def played_lstm(model: LstmInterpreter) -> LstmRunner:
    text = width_in(model.encode_text) if model.text_head is None else model.text_head.narrow.in_features
    motion = 0 if model.encode_pose is None else model.encode_pose.in_features // 3
    return LstmRunner(model.config, InterpreterSizes(
        model.frames, 0, width_in(model.encode_audio), model.speakers, text, model.control_width, motion,
        model.lexemes.numpy()), tensors_of(model))


def played_style(model: StyleInterpreter) -> StyleRunner:
    sizes = sizes_for(model.frames, width_in(model.encode_audio), model.lexemes.numpy(), model.speakers,
                      width_in(model.encode_text))
    return StyleRunner(model.config, sizes, model.code_width, tensors_of(model))


def played_q(model: QNetwork, kind: type[QRunner] = QRunner) -> QRunner:
    sizes = sizes_for(model.frames, width_in(model.encode_audio), np.zeros((model.lexemes, 1)), model.speakers)
    return kind(model.config, sizes, tensors_of(model))


def played_gate(model: ActivityGate) -> GateRunner:
    return GateRunner(model.config, model.frames, width_in(model.encode_audio), model.speakers, tensors_of(model))


def played_planner(model: UnitPlanner) -> PlannerRunner:
    return PlannerRunner(model.config, model.encode_audio.frames, width_in(model.encode_audio), model.speakers,
                         len(model.fit), tensors_of(model))


def played_unit_style(model: UnitStyleInterpreter) -> UnitStyleRunner:
    return UnitStyleRunner(model.config, model.encode_audio.frames, width_in(model.encode_audio), model.speakers,
                           model.code_width, tensors_of(model))


def played_flow(model: FlowGenerator, speakers: int) -> FlowRunner:
    basis, tensors = model.basis, tensors_of(model)
    played = BasisRunner(model.frames, basis.parts, dict(zip(basis.parts, basis.widths, strict=True)),
                         tensors.within("basis"))
    return FlowRunner(model.config, GeneratorWidths(
        model.frames, basis.motion_width, width_in(model.encode_audio), 0, model.control_width, model.lexemes, speakers,
        model.unit_width), model.present.numpy(), played, tensors)
