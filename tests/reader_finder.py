"""Which functions of a source file read files or parse bytes or text, found by what they call, not by their names."""

import ast
import re
from collections.abc import Iterator

_READING = re.compile(r"""
    # our own checked readers
    data_module\.(files\.(read_bytes|read_text|read_table|read_json|read_object|parse_json|decoded) | arrays\.read_\w+)
    # Python's
    | \?open | io\.open | os\.(fdopen|read|pread) | mmap\.mmap | (json|marshal|pickle|tomllib|plistlib)\.loads?
    | json\.decoder\.\w+ | csv\.(reader|DictReader) | struct\.(unpack\w*|iter_unpack|Struct) | \?int\.from_bytes
    | array\.array | (base64|binascii)\.(\w*decode\w*|a2b_\w+)
    | (zlib|gzip|bz2|lzma)\.(open|decompress\w*|\w+File)
    | zipfile\.(ZipFile|Path) | tarfile\.\w+ | wave\.open | configparser\.\w+ | sqlite3\.connect | ast\.literal_eval
    | xml\.(etree|parsers|dom|sax)\.(?!saxutils).* | html\.parser\.\w+ | urllib\.request\.\w+
    | sys\.stdin\.(buffer\.)?read\w* | shlex\.split
    # those of libraries
    | numpy\.(load|loadtxt|genfromtxt|from(file|string|buffer|regex)|memmap|lib\.format\.read_\w+)
    | torch\.(load|frombuffer|jit\.load|hub\.load\w*) | safetensors(\.\w+)?\.(load\w*|safe_open|deserialize)
    | soundfile\.(read|info|blocks|SoundFile) | librosa\.(load|stream) | av\.open | PIL\.Image\.open | lmdb\.open
    | (yaml|ruamel)\.\w*load\w* | scipy\.io\.(\w+\.)?(loadmat|read) | pandas\.read_\w+ | joblib\.load
    | pyarrow\.(\w+\.)?(read_\w+|open_\w+|BufferReader|ParquetFile|deserialize|memory_map|py_buffer)
    | (pxr|mujoco|bpy)\..*(Open|from_xml\w*|import_\w+) | transformers\.\w+\.from_pretrained | pocketsphinx\.Decoder
""", re.VERBOSE)
"""Functions that read or parse, by where they are imported from; "?" stands before names that no import gives."""
_METHODS = frozenset({"read_text", "read_bytes", "open", "read", "readline", "readlines", "readinto", "recv"})
"""Methods of files, paths, archives and connections."""
_HARMLESS = re.compile(r"importlib\.resources\.files\(\).*|json\.loads json\.dumps\(\)")
"""What looks so and reads nothing of a user: a file of the package, a value that becomes JSON and a value again."""
_HASHING = re.compile(r"hashlib\.\w+|\?digest\.update")
_WRITING = re.compile(r"[rbt+]*[wax][rbt+]*")


def readers_of(source: str) -> dict[str, list[str]]:
    """The readers of a module, "Class.function" as Python qualifies it, each with what it reads with.

    A function is a reader where it calls something of `_READING` or a method of `_METHODS`, but to write or to hash, or
    turns text into a number and expects that it is none (`int` or `float` in a `try` that catches ValueError).
    """
    module = ast.parse(source)
    origins = dict(_origins(module))
    hashed = {inner for call in ast.walk(module) if isinstance(call, ast.Call)
              and _HASHING.fullmatch(_dotted(call.func, origins)) for inner in ast.walk(call)}
    found: dict[str, list[str]] = {}
    for name, node in _functions(module, ""):
        calls = sorted({what for inner in _body(node) if inner not in hashed and (what := _reads(inner, origins))})
        if calls:
            found.setdefault(name, []).extend(calls)
    return found


def _origins(module: ast.Module) -> Iterator[tuple[str, str]]:
    """Each name of a module and what it stands for: what it is imported from, or its own class or function."""
    for node in module.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.name
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            for one in node.names:
                yield (one.asname, one.name) if one.asname else (one.name.split(".")[0],) * 2
        elif isinstance(node, ast.ImportFrom):
            for one in node.names:
                yield one.asname or one.name, f"{node.module}.{one.name}"


def _functions(node: ast.AST, within: str) -> Iterator[tuple[str, ast.AST]]:
    """Each function with its qualified name, and the code outside of them as "<module>" or the class's name."""
    yield within.removesuffix(".").removesuffix(".<locals>") or "<module>", node
    for inner in _body(node):
        if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _functions(inner, f"{within}{inner.name}.<locals>.")
        elif isinstance(inner, ast.ClassDef):
            yield from _functions(inner, f"{within}{inner.name}.")


def _body(node: ast.AST) -> Iterator[ast.AST]:
    """What stands in a function, class or module, without what stands in the functions and classes inside."""
    for inner in ast.iter_child_nodes(node):
        yield inner
        if not isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from _body(inner)


def _reads(node: ast.AST, origins: dict[str, str]) -> str:
    """What a node reads with, "" for nothing."""
    if isinstance(node, ast.Try) and any("ValueError" in ast.unparse(one.type) for one in node.handlers if one.type):
        numbers = (inner for line in node.body for inner in ast.walk(line) if isinstance(inner, ast.Call)
                   and isinstance(inner.func, ast.Name) and inner.func.id in ("int", "float"))
        return "a number of a text" if any(numbers) else ""
    if not isinstance(node, ast.Call) or _writes(node):
        return ""
    name = _dotted(node.func, origins)
    root, _, method = name.rpartition(".")
    of_object = (root.startswith("?") and root != "?self") or "()" in root or root == "pathlib.Path"
    reads = _READING.fullmatch(name) or (of_object and method in _METHODS)
    return name if reads and not _HARMLESS.fullmatch(" ".join((name, *(_dotted(one, origins) for one in node.args)))) \
        else ""


def _writes(call: ast.Call) -> bool:
    return any(isinstance(value, ast.Constant) and isinstance(value.value, str) and _WRITING.fullmatch(value.value)
               for value in (*call.args, *(one.value for one in call.keywords)))


def _dotted(node: ast.expr, origins: dict[str, str]) -> str:
    """The name of an object from its import on, with "?" before what no import gives and "()" after a call."""
    match node:
        case ast.Attribute():
            return f"{_dotted(node.value, origins)}.{node.attr}"
        case ast.Call():
            return f"{_dotted(node.func, origins)}()"
        case ast.BinOp(op=ast.Div()):  # a path below another
            return _dotted(node.left, origins)
        case ast.Name():
            return origins.get(node.id, f"?{node.id}")
    return "?"
