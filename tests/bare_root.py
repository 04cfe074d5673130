"""Runs the server as a container would, without a container: in a root that holds Python, its packages and ours and
nothing else, read-only but for /tmp, without a network but for its loopback, as the image's user.

`python tests/bare_root.py ROOT USER COMMAND...`, in new namespaces of mounts and of the network (`unshare`): builds the
root, enters it, starts the command, waits until it is healthy, ends it by SIGTERM, and prints what it saw as JSON.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
OURS = ("data_module", "lexicon", "interpreters", "generator", "eval", "gesticulator",
        "integrations/pipecat-gesticulator/pipecat_gesticulator/protocol.json")
"""What the Dockerfile copies."""
SYSTEM = ("/usr", "/bin", "/lib", "/lib64", "/etc/ld.so.cache", "/dev/null", "/dev/urandom")
_SET_FLAGS, _UP = 0x8914, 0x1 | 0x40
"""To bring an interface up (SIOCSIFFLAGS; IFF_UP, IFF_RUNNING)."""


def held() -> list[Path]:
    """What the root holds."""
    places = {Path(one) for one in (*SYSTEM, sys.base_prefix, sys.prefix)} | {HERE / one for one in OURS}
    places |= {Path(one) for one in sys.path if one and Path(one).is_dir() and not HERE.is_relative_to(one)}
    return sorted((place for place in places - {HERE / "tests"} if place.exists()), key=lambda one: len(one.parts))


def build(root: Path) -> None:
    """Mount all of it below a folder, read-only, and an empty /tmp that may be written."""
    subprocess.run(["mount", "-t", "tmpfs", "none", root], check=True)
    for place in held():
        inside = root / place.relative_to("/")
        if inside.exists():
            continue  # within one that is there
        inside.parent.mkdir(parents=True, exist_ok=True)
        inside.mkdir() if place.is_dir() else inside.touch()
        subprocess.run(["mount", "--rbind", place, inside], check=True)
        if not place.is_relative_to("/dev"):
            subprocess.run(["mount", "-o", "remount,bind,ro", place, inside], check=True)
    (root / "proc").mkdir()
    subprocess.run(["mount", "--rbind", "/proc", root / "proc"], check=True)
    (root / "tmp").mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "none", root / "tmp"], check=True)
    (root / "tmp").chmod(0o1777)
    subprocess.run(["mount", "-o", "remount,ro", root], check=True)


def loopback_up() -> None:
    """127.0.0.1 answers, and no other address does."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        fcntl.ioctl(one, _SET_FLAGS, struct.pack("16sh", b"lo", _UP) + bytes(14))


def healthy(port: int) -> bool:
    """Whether the server says that it is."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=5) as answer:
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False


def main(root: Path, user: int, command: list[str]) -> dict[str, object]:
    """Run the command there; exit_code: None where it was not healthy in time."""
    build(root)
    loopback_up()
    os.chroot(root)
    os.chdir("/tmp")
    os.setgroups([])
    os.setgid(user)
    os.setuid(user)
    seen: dict[str, object] = {"folders": sorted(one.name for one in Path("/").iterdir()),
                               "ours": sorted(one.name for one in HERE.iterdir())}
    port = int(command[command.index("--port") + 1])
    process = subprocess.Popen([sys.executable, "-m", "gesticulator", *command], stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 600
    while process.poll() is None and time.monotonic() < until and not healthy(port):
        time.sleep(0.2)
    seen["healthy"] = process.poll() is None and healthy(port)
    process.send_signal(signal.SIGTERM) if seen["healthy"] else process.kill()
    _, seen["log"] = process.communicate()
    return seen | {"exit_code": process.returncode}


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])))
