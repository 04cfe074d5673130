"""Gestures for a talking avatar: the protocol of the gesticulator server, a client of it, and a Pipecat processor.

>>> async with connect("ws://127.0.0.1:8765/stream", Hello(sample_rate=24000)) as stream:
...     await stream.send(pcm16)
...     async for message in stream:
...         ...
"""

from pipecat_gesticulator.client import GestureStream, connect
from pipecat_gesticulator.player import PosePlayer
from pipecat_gesticulator.protocol import SCHEMA, Hello, Joint, Poses, Welcome
from pipecat_gesticulator.resuming import ResumingStream, connect_resuming
from pipecat_gesticulator.steady import SteadyPlayer

__all__ = ["SCHEMA", "GestureStream", "Hello", "Joint", "PosePlayer", "Poses", "ResumingStream", "SteadyPlayer",
           "Welcome", "connect", "connect_resuming"]
