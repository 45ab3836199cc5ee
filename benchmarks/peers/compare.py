"""Peers and our own methods on the same scenes in one run: rates, differences, ratios of times.

    python benchmarks/peers/compare.py --output runs/peers --workers 2

A run that was killed goes on when it is given again; a changed peer begins anew. `make bench-peers`
builds the peers' own environment first. Peers whose package is missing are in the table as such.
"""

from __future__ import annotations

import argparse
import hashlib
import math
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

from over_all import METHOD, OVER_ALL
from peer_registry import Peer, registered
from peer_table import markdown_table
from posed_scenes import PosedScenes

from mht_slam.cli.options import WorkOptions
from mht_slam.cli.study import progress_bar
from mht_slam.evaluation.bench.compare import Outcome, compare
from mht_slam.evaluation.bench.methods import GRAPH_EVIDENCE, ORDER_KEEPING, POLYGON
from mht_slam.evaluation.bench.summary import markdown, summarise
from mht_slam.evaluation.bench.sweep import Cell, Sweep
from mht_slam.evaluation.bench.tables import tidy_rows, time_rows, write_csv
from mht_slam.plotting.bench_rates import exact_rates_figure
from mht_slam.simulation.scenes import SceneKind

OURS = (GRAPH_EVIDENCE, "quadrature evidence", "smallest epsilon", POLYGON, ORDER_KEEPING,
        "nearest bearing")  # fmt: skip
SETTINGS: tuple[tuple[SceneKind, int, float], ...] = (
    ("annulus", 3, 1.0),
    ("annulus", 3, 3.0),
    ("annulus", 4, 1.0),
    ("model", 3, 1.0),
    ("model", 3, 3.0),
)
"""Layout, number of landmarks, and standard deviation of a bearing, degrees."""
TABLES_ONLY = ("compare.py", "peer_table.py")
"""Files of this folder on which no result rests."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare, print the table, and write it beside rows, times and figure."""
    options = _parser().parse_args(arguments)
    peers = registered()
    methods = {OVER_ALL: METHOD} | {
        name: found.method for name, found in peers.items() if not found.missing
    }
    jobs = [
        (PosedScenes(cell_of(kind, n, sigma)), scene)
        for kind, n, sigma in SETTINGS
        for scene in range({3: options.scenes, 4: options.scenes_of_four}[n])
    ]
    store = options.output / f"scenes-{_digest()}"
    work = WorkOptions(workers=options.workers)
    with work.executor() as executor, progress_bar("comparing") as progress:
        outcome = compare(
            jobs, methods, ours=OURS, store=store, executor=executor, progress=progress
        )
    table = markdown_table(outcome, peers)
    print(table)
    _write(options.output, outcome, table, peers)
    return 0


def cell_of(kind: SceneKind, n: int, sigma_deg: float) -> Cell:
    """Return scenes of n landmarks and Gaussian noise that nothing clips, epsilon three sigma."""
    sigmas = (math.radians(sigma_deg),)
    sweep = Sweep(kinds=(kind,), landmarks=(n,), noises=("gaussian",), sigmas=sigmas)
    return sweep.cells[0]


def _write(output: Path, outcome: Outcome, table: str, peers: Mapping[str, Peer]) -> None:
    summary = summarise(outcome)
    (output / "summary.md").write_text(table + "\n", encoding="utf-8")
    (output / "details.md").write_text(markdown(summary), encoding="utf-8")
    write_csv(output / "rows.csv", tidy_rows(outcome))
    write_csv(output / "times.csv", time_rows(outcome))
    drawn = exact_rates_figure(summary)
    drawn.figure.savefig(output / "exact_rates.png", dpi=150)
    packages = sorted({"gtsam", "filterpy", "scipy"}.union(*(p.needs for p in peers.values())))
    versions = "\n".join(f"{name} {_version(name)}" for name in packages)
    (output / "versions.txt").write_text(versions + "\n", encoding="utf-8")


def _digest() -> str:
    """Digest of all that the peers' results rest on besides our package: their code and engines."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        if path.name not in TABLES_ONLY:
            digest.update(path.name.encode() + path.read_bytes())
    for package in ("filterpy", "stonesoup"):
        digest.update(_version(package).encode())
    return digest.hexdigest()[:12]


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/peers"))
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--scenes", type=int, default=40, help="of each cell with 3 landmarks")
    parser.add_argument("--scenes-of-four", type=int, default=12, help="of each cell with 4")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
