"""How hard the tree searches."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from mht_slam.arrays import finite_number, whole_number

EARLY_SCANS = 3


@dataclass(frozen=True)
class Effort:
    """How hard a search over all scans of a run tries; more finds more and takes longer.

    Raises `OptionError` naming the field, for a value out of its range.

    Attributes
    ----------
    keep : branches kept after each scan.
    solve : children solved at each scan, the most promising first.
    drop : nats below the best at which a branch or child is given up.
    early : times more branches kept and children solved up to the third scan, since two scans of a
        straight run fit every association.
    ranked, depth : at so many of the best proposed motions the best `depth` matchings are found.
    finalists : branches over all scans that are changed by moves.
    moves : changes of each that are solved, the most promising first.
    rounds : times the moves are repeated from what they found.
    """

    keep: int = 10
    solve: int = 24
    drop: float = 15.0
    early: int = 8
    ranked: int = 3
    depth: int = 10
    finalists: int = 3
    moves: int = 16
    rounds: int = 4

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name == "drop":
                finite_number(self.drop, "drop", above=0.0)
            else:
                least = 1 if entry.name in ("keep", "solve", "early") else 0
                whole_number(getattr(self, entry.name), entry.name, at_least=least)

    def at(self, n_scans: int) -> Effort:
        """Return the effort for the children that have so many scans."""
        if n_scans > EARLY_SCANS:
            return self
        more = {name: self.early * getattr(self, name) for name in ("keep", "solve", "depth")}
        return replace(self, **more, early=1)
