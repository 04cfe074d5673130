"""A hub on this machine: the part of the interface of huggingface.co that reads and writes repositories of models."""

from __future__ import annotations

import base64
import hashlib
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlparse

SECRET = "hf_secret"


@dataclass
class Hub:
    """Repositories: id -> commit -> file -> content; branches: id -> branch -> commit. requests: what was asked for."""

    repositories: dict[str, dict[str, dict[str, bytes]]] = field(default_factory=dict)
    branches: dict[str, dict[str, str]] = field(default_factory=dict)
    objects: dict[str, bytes] = field(default_factory=dict)
    private: set[str] = field(default_factory=set)
    requests: list[str] = field(default_factory=list)
    address: str = ""

    def commit(self, name: str, files: dict[str, bytes], branch: str = "main") -> str:
        """Put files on a branch, which begins at main; the commit."""
        known, branches = self.repositories.setdefault(name, {}), self.branches.setdefault(name, {})
        whole = {**known.get(branches.get(branch, branches.get("main", "")), {}), **files}
        digest = hashlib.sha1(repr(sorted(whole.items())).encode()).hexdigest()
        known[digest], branches[branch] = whole, digest
        return digest


class _Handler(BaseHTTPRequestHandler):
    hub: Hub
    protocol_version = "HTTP/1.1"

    def answer(self, status: int, body: bytes | dict[str, Any] | list[Any] = b"", **headers: str) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for key, value in {"Content-Length": str(len(data)), **headers}.items():
            self.send_header(key.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def missing(self, code: str) -> None:
        self.answer(401 if code == "RepoNotFound" else 404, X_Error_Code=code)

    def content(self) -> Any:
        return self.rfile.read(int(self.headers.get("Content-Length") or 0))

    @property
    def known(self) -> bool:
        return self.headers.get("Authorization") == f"Bearer {SECRET}"

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        path = unquote(urlparse(self.path).path).strip("/")
        self.hub.requests.append(f"{self.command} {path}")
        if path == "api/whoami-v2":
            return self.answer(200, {"name": "org", "type": "user"}) if self.known else self.answer(401)
        words = path.removeprefix("api/models/").split("/")
        name, (verb, revision, *rest) = "/".join(words[:2]), [*words[2:], "main", "main"][:max(len(words) - 2, 2)]
        if name not in self.hub.repositories or (name in self.hub.private and not self.known):
            return self.missing("RepoNotFound")
        commits = self.hub.repositories[name]
        digest = revision if revision in commits else self.hub.branches[name].get(revision, "")
        if digest not in commits:
            return self.missing("RevisionNotFound")
        files = commits[digest]
        if path.startswith("api/") and verb == "tree":
            return self.answer(200, [{"type": "file", "path": file, "size": len(data), "oid": _oid(data)}
                                     for file, data in files.items()])
        if path.startswith("api/"):
            return self.answer(200, {"id": name, "sha": digest, "siblings": [{"rfilename": file} for file in files]})
        data = files.get("/".join(rest))
        if data is None:
            return self.missing("EntryNotFound")
        return self.answer(200, data, ETag=f'"{_oid(data)}"', X_Repo_Commit=digest)

    def do_POST(self) -> None:
        path, data = unquote(urlparse(self.path).path).strip("/"), self.content()
        self.hub.requests.append(f"POST {path}")
        if not self.known:
            return self.answer(401)
        words = path.removeprefix("api/models/").split("/")
        name = "/".join(words[:2]).removesuffix(".git")
        if path == "api/repos/create":
            given = json.loads(data)
            name = f"{given['organization']}/{given['name']}"
            if name not in self.hub.repositories:
                self.hub.commit(name, {})
            return self.answer(200, {"url": f"{self.hub.address}/{name}"})
        if path == "api/validate-yaml":
            return self.answer(200, {"errors": [], "warnings": []})
        if words[2] == "branch":
            self.hub.branches[name].setdefault(words[3], self.hub.branches[name]["main"])
            return self.answer(200, {})
        if words[2] == "preupload":
            return self.answer(200, {"files": [
                {"path": file["path"], "uploadMode": "lfs" if file["path"].endswith(".safetensors") else "regular",
                 "shouldIgnore": False} for file in json.loads(data)["files"]]})
        if words[2] == "info":
            return self.answer(200, {"transfer": "basic", "objects": [
                {**entry, "actions": {"upload": {"href": f"{self.hub.address}/objects/{entry['oid']}"}}}
                for entry in json.loads(data)["objects"]]}, Content_Type="application/vnd.git-lfs+json")
        rows = [json.loads(line) for line in data.splitlines()]
        files = {row["value"]["path"]: base64.b64decode(row["value"]["content"]) if row["key"] == "file"
                 else self.hub.objects[row["value"]["oid"]] for row in rows if row["key"] != "header"}
        digest = self.hub.commit(name, files, words[3])
        return self.answer(200, {"commitUrl": f"{self.hub.address}/{name}/commit/{digest}", "commitOid": digest,
                                 "success": True})

    def do_PUT(self) -> None:
        self.hub.objects[self.path.rpartition("/")[2]] = self.content()
        self.answer(200)

    def log_message(self, *_: Any) -> None:
        """Nothing is printed."""


def _oid(data: bytes) -> str:
    return hashlib.sha1(data).hexdigest()


@contextmanager
def hub_server() -> Iterator[Hub]:
    """A hub at a free port of this machine, until the end of the block."""
    hub = Hub()
    with ThreadingHTTPServer(("127.0.0.1", 0), type("Handler", (_Handler,), {"hub": hub})) as server:
        hub.address = f"http://127.0.0.1:{server.server_port}"
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield hub
        server.shutdown()
