"""A user's script: it runs against the installed wheel and type-checks strictly."""

from __future__ import annotations

from pathlib import Path

import mht_slam as ms
import mht_slam.factors as factors


def main() -> None:
    """Use a value, a name from every layer, and the factors as an installed package."""
    scan = ms.BearingScan([0.5, 1.0, 2.0])
    run = ms.StraightRun([scan, scan, scan])
    truth: ms.Association = ms.Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], run.n_detections)
    assert truth.is_full  # noqa: S101
    for name in ms.__all__:
        getattr(ms, name)
    installed = Path(ms.__file__).parent
    assert "site-packages" in installed.parts  # noqa: S101
    assert Path(str(factors.__file__)).parent == installed / "factors"  # noqa: S101


if __name__ == "__main__":
    main()
