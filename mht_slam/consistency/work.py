"""How much work a search has done, may still do, and reports."""

from __future__ import annotations

from mht_slam.progress import Progress

_REPORT_EVERY = 1024


class Work:
    """Counts the nodes of a search.

    Attributes
    ----------
    n_nodes : nodes gone through.
    exhausted : whether the search was told to stop before its end.
    """

    def __init__(self, max_nodes: int, progress: Progress | None) -> None:
        self.n_nodes = 0
        self.exhausted = False
        self._max_nodes = max_nodes
        self._progress = progress

    def spend(self) -> bool:
        """Count one more node; False when there are none left."""
        if self.n_nodes >= self._max_nodes:
            self.exhausted = True
            return False
        self.n_nodes += 1
        if self._progress is not None and self.n_nodes % _REPORT_EVERY == 0:
            self._progress(self.n_nodes, self._max_nodes)
        return True
