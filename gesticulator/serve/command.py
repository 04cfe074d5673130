"""`gesticulator serve` and `gesticulator live`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from data_module.errors import InputError
from data_module.files import read_text
from gesticulator.cli import Command

if TYPE_CHECKING:
    from gesticulator.serve.server import ServerAddress
    from gesticulator.serve.settings import ServerLimits

TOKEN_VARIABLE = "GESTICULATOR_TOKEN"
"""Environment variable with the token, which keeps it out of process lists."""
_LIMITS = {"streams": "maximum number of streams; fewer are admitted where the measured cost of a stream says so",
           "address_streams": "maximum number of streams of an address or a tenant; 0 for no limit of its own",
           "address_opens": "new streams per second of an address or a tenant",
           "core_share": "computing time per second that may be promised to streams",
           "resume_seconds": "time for which a lost stream is kept for its client",
           "stream_seconds": "maximum duration of a stream",
           "waiting_seconds": "maximum of waiting audio", "message_bytes": "maximum message length",
           "unread_bytes": "maximum of unread poses", "drain_seconds": "time for open streams after SIGTERM"}
"""Field of `ServerLimits` -> help of its option."""


def arguments(p: argparse.ArgumentParser) -> None:
    from gesticulator.serve.settings import ServerLimits

    plain = ServerLimits()
    where = p.add_argument_group("address and access")
    where.add_argument("--host", default="127.0.0.1", help="address to listen on (default 127.0.0.1, this machine)")
    where.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    where.add_argument("--origin", action="append", default=[], metavar="URL",
                       help="origin of web pages that may connect, such as https://example.org (pages on this machine "
                       "always may); can be repeated")
    where.add_argument("--token-file", metavar="FILE", help="a file with the token that clients must send (or set "
                       f"{TOKEN_VARIABLE})")
    where.add_argument("--keys-file", metavar="FILE", help="a file of tenants' keys, a line each: TENANT KEY "
                       "[streams=N] [priority=N]; read again when it changes")
    where.add_argument("--trusted-proxy", action="append", default=[], metavar="NETWORK",
                       help="address or network of a proxy that says who a client is (X-Forwarded-For), such as "
                       "10.0.0.0/8; can be repeated")
    where.add_argument("--metrics-port", type=int, metavar="PORT", help="port of /metrics, without a token (default: "
                       "the port of streams, with the token)")
    where.add_argument("--metrics-host", default="", metavar="ADDRESS", help="address of that port, such as 127.0.0.1 "
                       "(default: that of --host)")
    where.add_argument("--no-token", action="store_true", help="require no token for another --host")
    limits = p.add_argument_group("limits of each worker")
    for name, text in _LIMITS.items():
        default = getattr(plain, name)
        limits.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default,
                            metavar="S" if isinstance(default, float) else "N",
                            help=f"{text} (default {default:{'g' if isinstance(default, float) else ''}})")
    p.add_argument("--workers", type=int, default=1, metavar="N", help="number of processes, one per core (default 1)")
    _output_arguments(p, "the first stream", "per worker")


def _output_arguments(p: argparse.ArgumentParser, of: str, threads: str) -> None:
    p.add_argument("--vmc", metavar="HOST:PORT", help=f"also send the poses of {of} by VMC, such as 127.0.0.1:39539")
    p.add_argument("--osc", metavar="HOST:PORT", help="the same by plain OSC, for TouchDesigner or Unreal Engine, such "
                   "as 127.0.0.1:9000")
    p.add_argument("--osc-axes", default="y-up", choices=("y-up", "unreal"), help="y-up: metres, Y up, right-handed, "
                   "with angles in degrees; unreal: centimetres, Z up, left-handed (default y-up)")
    p.add_argument("--bundle", metavar="NAME|DIR", help="trained weights: default, paper, or a folder")
    p.add_argument("--threads", type=int, default=1, metavar="N", help=f"torch threads {threads} (default 1)")


def run(args: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; exit code 0."""
    from gesticulator.serve.launch import Launch, launch

    return launch(Launch(
        address=read_address(args), limits=read_limits(args), workers=args.workers, vmc=args.vmc, bundle=args.bundle,
        threads=args.threads, osc=args.osc, osc_axes=args.osc_axes))


def read_address(args: argparse.Namespace) -> ServerAddress:
    """Where to listen and who may connect; `InputError` for invalid options, and without websockets."""
    check_library()
    from gesticulator.serve.door import read_keys
    from gesticulator.serve.server import ServerAddress

    keys = None if args.keys_file is None else Path(args.keys_file)
    if keys is not None:
        read_keys(keys)
    return ServerAddress(args.host, args.port, tuple(args.origin), read_token(args), keys, tuple(args.trusted_proxy),
                         args.metrics_port, args.metrics_host)


def check_library() -> None:
    """`InputError` without the package websockets."""
    try:
        import websockets  # noqa: F401
    except ImportError:
        raise InputError("serve", "needs the package websockets", "pip install 'gesticulator[live]'") from None


def read_limits(args: argparse.Namespace) -> ServerLimits:
    """The limits given on the command line; `InputError` for an invalid one."""
    from gesticulator.serve.settings import ServerLimits

    return ServerLimits(**{name: getattr(args, name) for name in _LIMITS})


def read_token(args: argparse.Namespace) -> str:
    """The token that clients must send, "" for none; `InputError` if other machines could connect without one."""
    token = os.environ.get(TOKEN_VARIABLE, "")
    if args.token_file is not None:
        token = read_text(args.token_file, "write one line into it", 1 << 12).strip()
        if not token:
            raise InputError(args.token_file, "holds no token", "write one into it")
    if not (token or args.keys_file or args.no_token) and args.host not in ("127.0.0.1", "::1", "localhost"):
        raise InputError(f"--host {args.host}", "lets other machines connect",
                         "give a --token-file, a --keys-file, or --no-token")
    return token


COMMAND = Command(
    "answer audio with poses, live, over a WebSocket", arguments, run,
    examples=(
        "serve",
        "serve --port 9000 --workers 4",
        "serve --host 0.0.0.0 --token-file token.txt --origin https://example.org",
        "serve --vmc 127.0.0.1:39539",
        "serve --osc 127.0.0.1:9000 --osc-axes unreal",
    ))


def live_arguments(p: argparse.ArgumentParser) -> None:
    p.add_argument("--port", type=int, default=8765, help="port (default 8765; 0 chooses a free one)")
    p.add_argument("--no-browser", action="store_true", help="serve the page without opening it")
    _output_arguments(p, "the stream", "to use")


def run_live(args: argparse.Namespace) -> int:
    """Serve the page on this machine until SIGTERM or SIGINT; exit code 0."""
    check_library()
    from gesticulator.serve.launch import Launch, launch
    from gesticulator.serve.server import ServerAddress
    from gesticulator.serve.settings import ServerLimits

    limits = ServerLimits(drain_seconds=1.0, core_share=100.0)
    return launch(Launch(ServerAddress(port=args.port), limits, vmc=args.vmc,
                         bundle=args.bundle, threads=args.threads, live=True, browser=not args.no_browser,
                         osc=args.osc, osc_axes=args.osc_axes))


LIVE = Command(
    "open a page that gestures to your microphone or to a recording", live_arguments, run_live,
    examples=(
        "live",
        "live --port 9000 --no-browser",
    ))
