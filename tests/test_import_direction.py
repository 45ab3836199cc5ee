"""Imports run one way through the layers, and a bare import of the package stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]

VALUES = ["errors", "arrays", "progress", "measurements", "association", "models", "hypotheses"]
FOUNDATION = [*VALUES, "comparison", "compiled", "matchings", "parallel"]
READERS_OF_THE_VALUES = ["simulation", "datasets", "vision"]
MAIN_JOB = [
    "consistency",
    "polygon",
    "evidence",
    "factors",
    "graph",
    "tree",
    "tracking",
    "pipeline",
]
AROUND_IT = ["incremental", "evaluation", "plotting", "cli"]

MAY_IMPORT: dict[str, set[str]] = {
    "errors": set(),
    "arrays": {"errors"},
    "compiled": set(),
    "matchings": {"errors", "arrays"},
    "parallel": set(),
    "progress": set(),
    "measurements": {"errors", "arrays"},
    "association": {"errors", "arrays", "measurements"},
    "models": {"errors", "arrays", "measurements", "association"},
    "hypotheses": {"errors", "arrays", "measurements", "association", "models"},
    "comparison": set(VALUES),
    "presets": {"models"},
    "vision": set(VALUES),
    # The renderer draws what vision's camera would see, and drives are those of the recordings.
    "simulation": {*VALUES, "vision", "datasets"},
    "datasets": set(VALUES),
    "consistency": set(FOUNDATION),
    "polygon": {*FOUNDATION, "consistency"},
    "evidence": {*FOUNDATION, "consistency"},
    "factors": set(),
    "graph": {*FOUNDATION, "consistency", "evidence", "factors"},  # polygon would bring shapely
    "tree": {*FOUNDATION, "evidence", "factors", "graph"},
    "triangulation": {*FOUNDATION, "polygon"},
    "tracking": {*FOUNDATION, "consistency"},  # graph would bring GTSAM along
    "pipeline": {*FOUNDATION, *MAIN_JOB},
    "fitting": {*FOUNDATION, "evidence", "graph", "tree"},
    "incremental": {*FOUNDATION, *MAIN_JOB, "fitting", "presets"},
    # The bench draws scenes; ceilings and baselines read the drives of recordings.
    "evaluation": {*FOUNDATION, *MAIN_JOB, "incremental", "simulation", "datasets"},
    "plotting": {*FOUNDATION, *MAIN_JOB, "incremental", "evaluation", "vision"},
    "cli": {*FOUNDATION, *READERS_OF_THE_VALUES, *MAIN_JOB, *AROUND_IT, "presets"},
}
"""The packages and modules of mht_slam that each one may import, besides itself."""

ONLY_IN = {
    "gtsam": {"graph", "factors", "tree", "incremental", "evaluation"},
    "shapely": {"hypotheses", "consistency", "polygon", "plotting", "pipeline"},
    "numba": {"compiled"},
    "skimage": {"vision"},
    "matplotlib": {"plotting", "cli"},
    "pyarrow": {"evaluation"},
    "rich": {"cli"},
    "tyro": {"cli"},
}
"""The only places that may import a heavy or outward-looking library."""


def sources() -> list[tuple[str, Path]]:
    """Every module with the layer it belongs to."""
    package = REPOSITORY / "mht_slam"
    inside = [(path.relative_to(package).parts[0], path) for path in package.rglob("*.py")]
    found = [(layer.removesuffix(".py"), path) for layer, path in inside if path.parent.name]
    found += [("factors", path) for path in (REPOSITORY / "factors").rglob("*.py")]
    return sorted((layer, path) for layer, path in found if layer != "__init__")


def imported_names(tree: ast.AST, package: list[str]) -> Iterator[str]:
    """Every dotted module a tree imports, inside functions too, but not for type checking."""
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in ast.unparse(tree.test):
        for child in tree.orelse:
            yield from imported_names(child, package)
        return
    if isinstance(tree, ast.Import):
        yield from (alias.name for alias in tree.names)
    elif isinstance(tree, ast.ImportFrom):
        above = package[: len(package) - tree.level + 1] if tree.level else []
        module = ".".join([*above, *([tree.module] if tree.module else [])])
        yield from (f"{module}.{alias.name}" for alias in tree.names)
    for child in ast.iter_child_nodes(tree):
        yield from imported_names(child, package)


def imports_of(path: Path) -> list[list[str]]:
    package = ["mht_slam", *path.relative_to(REPOSITORY).parent.parts]
    if package[1:2] == ["mht_slam"]:
        package = package[1:]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [name.split(".") for name in imported_names(tree, package)]


@pytest.mark.parametrize(
    ("layer", "path"), sources(), ids=lambda value: getattr(value, "stem", value)
)
def test_a_module_imports_only_what_lies_below_it(layer: str, path: Path) -> None:
    assert layer in MAY_IMPORT, f"give {layer} a place among the layers"
    for parts in imports_of(path):
        if parts[0] == "mht_slam":
            # Without a module, only the version may be read from the package's front door.
            home = parts[1] if len(parts) > 1 else "__init__"
            allowed = {layer, "__version__", *MAY_IMPORT[layer]}
            assert home in allowed, f"{path} imports {'.'.join(parts)}"
        assert parts[0] != "factors", f"{path} imports factors past mht_slam.factors"
        places = ONLY_IN.get(parts[0])
        assert places is None or layer in places, f"{path} imports {parts[0]}"


def test_the_factors_serve_any_gtsam_user() -> None:
    for path in (REPOSITORY / "factors").rglob("*.py"):
        ours = {"gtsam", "numpy", "mht_slam.factors"}
        for parts in imports_of(path):
            top = ".".join(parts[:2]) if parts[0] == "mht_slam" else parts[0]
            assert top in ours or top in sys.stdlib_module_names, f"{path} imports {top}"


def test_an_import_for_type_checking_only_is_no_import() -> None:
    tree = ast.parse(
        "import a\nif TYPE_CHECKING:\n import b\nelse:\n import c\ndef f():\n from .d import e\n"
    )
    assert list(imported_names(tree, ["mht_slam", "graph"])) == ["a", "c", "mht_slam.graph.d.e"]


def test_a_bare_import_is_light() -> None:
    heavy = ("matplotlib", "pandas", "gtsam", "numba", "shapely", "scipy", "rich", "tyro")
    program = (
        f"import sys, mht_slam; print([name for name in {heavy!r} if name in sys.modules]); "
        "mht_slam.BearingScan([0.1]); mht_slam.Association([], (1,)); "
        f"print([name for name in {heavy!r} if name in sys.modules])"
    )
    done = subprocess.run(  # noqa: S603 - our own interpreter and program
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.split("\n")[:2] == ["[]", "[]"]
