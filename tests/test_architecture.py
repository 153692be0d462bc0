"""The plan of the house: which room may import which, what the core never imports, and how long files and functions get."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import piegraph_cli

PACKAGE = Path(piegraph_cli.__file__).parent

ORDER = [
    *("errors", "text", "params", "files", "process", "signals", "weights", "kernels"),
    *("recording", "physics", "perception", "dynamics", "environments", "planning", "evaluation"),
    *("workspace", "capture", "stages", "service", "report", "viewer", "experiments", "bench", "doctor", "commands"),
]
"""Rooms and modules of the package: each imports itself and what stands before it, nothing else."""

CORE = ORDER[ORDER.index("recording") : ORDER.index("workspace")]
"""Works on arrays: it knows no artifacts, no stages and no command line."""

FILE_LINES, FUNCTION_LINES = 350, 40
KERNELS = {"physics/spring_kernel.py", "dynamics/network_kernel.py", "dynamics/rigid_kernel.py", "kernels/peak.py"}

FILES = sorted(path for path in PACKAGE.rglob("*.py") if "pipelines" not in path.parts)


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and full name of everything that is imported, inside functions too; relative imports are not used here."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_never_point_up(path):
    room = room_of(path)
    if room in ("__init__", "__main__"):
        return
    assert room in ORDER, f"{room} has no place in ORDER"
    allowed = ORDER[: ORDER.index(room) + 1]
    for line, name in imports(ast.parse(path.read_text())):
        package, *parts = name.split(".")
        if package != "piegraph_cli" or parts[0].startswith("__"):
            assert room not in CORE or package not in ("h5py", "typer"), f"{name_of(path)}:{line} imports {name}"
            continue
        assert parts[0] in allowed, f"{name_of(path)}:{line}: {room} imports {parts[0]}, which comes after it"


def test_the_order_names_what_there_is():
    rooms = {room_of(path) for path in FILES} - {"__init__", "__main__"}
    assert rooms == set(ORDER)


def test_no_model_imports_an_environment():
    for path in (PACKAGE / "dynamics").rglob("*.py"):
        for line, name in imports(ast.parse(path.read_text())):
            assert not name.startswith("piegraph_cli.environments"), f"{name_of(path)}:{line}: a model that cheats"


def modules_imported(path: Path) -> set[str]:
    """Modules of the package that a module imports, wherever in it but for types alone, by file name."""
    tree = ast.parse(path.read_text())
    tree.body = [
        node for node in tree.body if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    ]
    found = set()
    for _, name in imports(tree):
        parts = name.split(".")[1:] if name.startswith("piegraph_cli.") else []
        for depth in (len(parts), len(parts) - 1):
            file = PACKAGE.joinpath(*parts[:depth]).with_suffix(".py") if depth > 0 else PACKAGE / "none"
            if file.is_file():
                found.add(name_of(file))
                break
    return found


def test_no_module_needs_itself():
    graph = {name_of(path): modules_imported(path) for path in FILES}
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above, name])
        if name not in done:
            for other in graph.get(name, ()):
                visit(other, (*above, name))
            done.add(name)

    for name in graph:
        visit(name, ())


@pytest.mark.parametrize("path", [p for p in FILES if name_of(p) not in KERNELS], ids=name_of)
def test_files_and_functions_can_be_read(path):
    text = path.read_text()
    assert len(text.splitlines()) <= FILE_LINES
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
            length = node.end_lineno - node.lineno + 1
            assert length <= FUNCTION_LINES, f"{name_of(path)}:{node.lineno} {node.name}: {length} lines"
